"""Gain and modes of a transfer function: values, and errors by differences of every coefficient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.frequency.continuous_transfer import (
    ContinuousMode,
    ContinuousTransfer,
    TransferEstimate,
)

ROOT = np.random.default_rng(1).normal(size=(6, 6))
"""Of a covariance of two numerator's, three denominator's coefficients, and the dead time."""
DENOMINATOR = np.polymul([1.0, 2.0], [1.0, 1.2, 9.0])
PAIR = TransferEstimate(3.0, 0.1), TransferEstimate(0.2, 0.01)


def transfer(coefficients: FloatArray, scale: float = 1e-3) -> ContinuousTransfer:
    return ContinuousTransfer(
        coefficients[:2],
        np.append(1.0, coefficients[2:5]),
        scale**2 * ROOT @ ROOT.T,
        coefficients[5],
        "u",
        "y",
    )


PLAIN = np.array([0.5, 4.0, *DENOMINATOR[1:], 0.1])


@pytest.mark.parametrize(
    ("figure", "value"),
    [
        (lambda t: t.gain, 4.0 / 18.0),
        (lambda t: t.modes[0].frequency_rad_s, 2.0),
        (lambda t: t.modes[0].time_constant_s, 0.5),
        (lambda t: t.modes[1].frequency_rad_s, 3.0),
        (lambda t: t.modes[1].damping, 0.2),
        (lambda t: t.dead_time, 0.1),
    ],
)
def test_a_figure_has_the_error_of_its_slopes(
    figure: Callable[[ContinuousTransfer], TransferEstimate], value: float
) -> None:
    found = figure(transfer(PLAIN))
    assert found.value == pytest.approx(value)
    slopes = [
        (figure(transfer(PLAIN + step)).value - figure(transfer(PLAIN - step)).value) / 2e-6
        for step in 1e-6 * np.eye(6)
    ]
    assert found.error == pytest.approx(1e-3 * np.linalg.norm(ROOT.T @ slopes), rel=1e-6)
    low, high = found.interval
    assert [low, high] == pytest.approx([value - 1.959964 * found.error, value + 1.959964 * found.error])


def test_errors_of_a_response_are_those_of_its_slopes() -> None:
    omega = np.array([0.3, 3.0, 20.0])
    slopes = np.array(
        [
            np.log(transfer(PLAIN + step).at(omega) / transfer(PLAIN - step).at(omega)) / 2e-6
            for step in 1e-6 * np.eye(6)
        ]
    )
    gain, turn = transfer(PLAIN).error_at(omega)
    assert gain == pytest.approx(1e-3 * np.linalg.norm(ROOT.T @ slopes.real, axis=0), rel=1e-6)
    assert turn == pytest.approx(1e-3 * np.linalg.norm(ROOT.T @ slopes.imag, axis=0), rel=1e-6)


@pytest.mark.parametrize(
    ("pole", "time", "words"),
    [
        (-4.0, TransferEstimate(0.25, 0.1), "time constant 0.25 +- 0.2 s"),
        (-4.0, TransferEstimate(0.25, 0.2), "not determined (-4 +- 6.3 rad/s)"),  # 1.96 x 0.2 x 4^2
        (4.0, TransferEstimate(-0.25, 0.01), "unstable: doubles in 0.173 s"),  # ln 2 / 4
        (0.0, None, "integrator"),
        (-0.6 + 2.9j, None, "3 +- 0.2 rad/s, damping 0.2 +- 0.02"),
        (0.6 + 2.9j, None, "unstable: 3 +- 0.2 rad/s, damping 0.2 +- 0.02"),
    ],
    ids=str,
)
def test_modes_in_words(pole: complex, time: TransferEstimate | None, words: str) -> None:
    assert str(ContinuousMode(pole, *PAIR, time)) == words


def test_where_modes_and_gain_lie_in_the_half_planes() -> None:
    stable = transfer(PLAIN)
    assert stable.is_stable
    unstable = replace(stable, denominator=np.array([1.0, -0.8, 6.6, -18.0]))  # (s - 2) (s^2 + 1.2 s + 9)
    assert not unstable.is_stable
    assert unstable.modes[0].time_constant_s is not None
    assert unstable.modes[0].time_constant_s.value == pytest.approx(-0.5)
    assert unstable.modes[0].time_constant_s.most == 0.0
    integrating = replace(stable, denominator=np.array([1.0, 1.2, 9.0, 0.0]))
    assert np.isnan(integrating.gain.value)
    assert not integrating.is_stable
