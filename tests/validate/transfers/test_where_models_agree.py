"""What counts as agreement between a model, a step and a measured response, at its bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import e, pi
from typing import cast

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.frequency.continuous_transfer import Band, ContinuousTransfer
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import ComplexArray
from flysid.model.step_response import StepResponse
from flysid.validate.transfers.agreement import (
    agree,
    in_a_loop,
    misfit,
    response_caution,
    transfer_figures,
)
from tests.fakes import flat_response

EPS = 0.05
HALF = 1.959964 * EPS
"""Half width of an interval of endless degrees of freedom, in ln |G|."""


def measured(count: int, ratio: float = 2.0, late_s: float = 0.0) -> MeasuredResponse:
    """One, as measured from two inputs; the second doubles it. All points count."""
    one = np.ones((count, 2))
    return replace(
        flat_response(count),
        omega=np.power(ratio, np.arange(float(count))),
        response=one * np.array([1.0 + 0.0j, 2.0]),
        coherence=0.99 * one,
        error=EPS * one,
        averages=100.0 * one,
        freedom=np.full(count, 1e9),
        late_s=late_s,
    )


@pytest.mark.parametrize(("db", "degrees"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 7.57), (0.0, -7.57)])
def test_a_model_agrees_within_a_decibel_and_7_57_degrees_beside_the_interval(
    db: float, degrees: float
) -> None:
    whole = np.ones(5)
    for share, agrees in ((0.99, True), (1.01, False)):
        size = share * np.log(10.0 ** (abs(db) / 20.0)) + HALF * (db != 0.0)
        turn = share * np.radians(abs(degrees)) + HALF * (degrees != 0.0)
        model = 2.0 * np.exp(np.sign(db) * size + 1j * np.sign(degrees) * turn) * whole
        assert agree(measured(5), 1, model).tolist() == [agrees] * 5


def test_one_point_alone_may_be_chance_two_are_not() -> None:
    far = np.ones(7, dtype=np.complex128)
    far[3] = 9.0
    assert agree(measured(7), 0, far).all()
    far[4] = 9.0
    assert agree(measured(7), 0, far).tolist() == [True, True, True, False, False, True, True]


def test_what_the_stamps_leave_open_widens_the_phase_alone() -> None:
    """0.1 s at 1, 2, 4 rad/s: 12.5, 23.2 and 45.3 degrees at 95 % with the scatter, and 7.57 beside them."""
    turned = np.full(4, np.exp(1j * np.radians(32.0)), dtype=np.complex128)
    assert agree(measured(4, late_s=0.1), 0, turned).tolist() == [False, False, True, True]
    assert not agree(measured(4, late_s=0.1), 0, np.full(4, 1.5 + 0.0j, dtype=np.complex128)).any()


def test_misfit_is_the_mean_square_over_an_octave_beyond_the_scatter() -> None:
    """Points two thirds of an octave apart: each shares with its neighbours, not with those beyond."""
    found = measured(6, 2.0 ** (2.0 / 3.0))
    off = np.array([0.1, 0.3, 0.2, 0.0, 0.4, 0.1])
    model: ComplexArray = np.asarray(2.0 * np.exp(off * (1.0 + 0.5j)), dtype=np.complex128)
    excess = 0.5 * (1.0 + 0.25) * off**2 - EPS**2
    assert misfit(found, 1, model, np.ones(6, dtype=bool)) == pytest.approx(
        [np.sqrt(excess[max(k - 1, 0) : k + 2].mean()) for k in range(6)]
    )
    among = np.array([False, True, True, True, True, True])
    assert misfit(found, 1, model, among)[:2] == pytest.approx(
        [np.sqrt(excess[1]), np.sqrt(excess[1:3].mean())]
    )
    assert not misfit(found, 1, model, np.zeros(6, dtype=bool)).any()
    near: ComplexArray = np.full(6, 2.0 * np.exp(0.9 * EPS) + 0.0j)
    assert not misfit(found, 1, near, np.ones(6, dtype=bool)).any()


@dataclass
class _Step:
    """A step response that answers as told, known to a relative error."""

    response: ComplexArray
    relative: float
    is_settled: bool = True
    sample_s: float = 0.01

    @property
    def time_s(self) -> FloatArray:
        return np.array([0.0, self.sample_s, 2.0 * self.sample_s])

    def frequency_response(self, omega: FloatArray, dt_s: float) -> tuple[ComplexArray, FloatArray]:
        del dt_s
        return self.response[: len(omega)], np.full(len(omega), self.relative)


def said(response: ComplexArray, relative: float = 0.0, **kinds: object) -> str:
    step = _Step(response, relative, **kinds)  # type: ignore[arg-type]
    return response_caution(measured(len(response)), 0, cast(StepResponse, step))


def test_a_step_excludes_a_response_at_three_points_in_a_row() -> None:
    """By a decibel or 7.57 degrees beyond both intervals, as far as the quickest sample shows anything."""
    for relative in (0.0, 0.04):
        both = np.hypot(HALF, 1.959964 * relative)
        for allowed in (np.log(10.0 ** (1.0 / 20.0)) + both, 1j * (np.radians(7.57) + both)):
            assert said(np.exp(0.99 * allowed) * np.ones(5), relative) == ""
            assert said(np.exp(-1.01 * allowed) * np.ones(5), relative) != ""
    three = np.array([1.0, 1.0, e, e, e, 1.0, 1.0]) + 0.0j
    assert said(three).startswith("two figures exclude each other: at 8 rad/s the response is ")
    assert "0.0 +- 0.9 dB, 0 +- 6 degrees ('flysid tf') and 8.7 +- 0 dB, 0 +- 0 degrees" in said(three)
    assert said(np.array([1.0, 1.0, e, e, 1.0, 1.0, 1.0]) + 0.0j) == ""
    assert said(three, is_settled=False) == ""
    assert said(three, sample_s=0.031) != ""
    assert said(three, sample_s=0.0315) == ""  # half a radian between samples at 16 rad/s


def test_the_words_on_a_loop_name_the_band_in_both_units() -> None:
    assert in_a_loop((pi, 2.0 * pi), [(1.0, 2.0), (8.0, 9.0)]) == (
        "a loop is closed, and where it reacts to the output the measured response is -1/controller: so from "
        "1 to 2 and 8 to 9 rad/s. Trust it from 3.14 to 6.28 rad/s (0.5 to 1 Hz) only, where the coherence "
        "is above 0.6 and the loop does not bend it. Name what drives the loop: --reference FIELD"
    )
    assert in_a_loop(None, []).startswith("no band can be trusted: a loop is closed, and where it reacts ")


@pytest.mark.parametrize(
    ("band", "gain", "slow", "quick", "dead"),
    [
        ((0.5, 4.0), True, True, True, True),  # a mode is seen within an octave of the band
        ((0.5, 3.9), True, True, False, True),
        ((1.0, 20.0), True, True, True, True),
        ((1.01, 20.0), False, True, True, True),  # a mode lies below it
        ((2.01, 20.0), False, False, True, True),
        (None, False, False, False, False),
    ],
    ids=str,
)
def test_figures_are_given_where_a_band_carries_them(
    band: Band | None, gain: bool, slow: bool, quick: bool, dead: bool
) -> None:
    """8 / ((s + 1) (s + 8)), 0.1 s late: a gain of 1 +- 1.96 x 0.04 / 8, as of the numerator alone."""
    covariance = np.zeros((4, 4))
    covariance[0, 0] = 0.04**2
    found = transfer_figures(
        ContinuousTransfer(np.array([8.0]), np.array([1.0, 9.0, 8.0]), covariance, 0.1, "u", "y"), band
    )
    assert (found["gain"] is not None) is gain
    if gain:
        assert found["gain"] == pytest.approx({"value": 1.0, "low": 0.9902, "high": 1.0098}, abs=1e-4)
    assert found["dead_time"] == ({"value": 0.1, "low": None, "high": None} if dead else None)
    modes = sorted(found["modes"], key=lambda m: -m["pole"][0])
    assert [m["pole"] for m in modes] == [pytest.approx([-1.0, 0.0]), pytest.approx([-8.0, 0.0])]
    assert [m["frequency_rad_s"] is not None for m in modes] == [slow, quick]
    if slow:
        assert modes[0]["time_constant_s"]["value"] == pytest.approx(1.0)
