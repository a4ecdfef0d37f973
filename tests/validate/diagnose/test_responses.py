"""Frequency responses and steady states of models whose transfer function is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.signal

from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.capabilities import HasDifferenceEquation
from flysid.model.statespace import StateSpace
from flysid.validate.diagnose.responses import (
    answers,
    impulse_response,
    measured_rests,
    poles_and_zeros,
    responses,
    steady_outputs,
    step_from,
)
from flysid.validate.runs.fitone import in_words
from tests.fakes import FirstOrder

HZ = np.geomspace(0.01, 9.9, 50)
LINEAR = FirstOrder(a=0.9, b=0.1)


@dataclass(frozen=True, eq=False)
class WithPolynomials(FirstOrder):
    """The same model, saying what it is."""

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        A = np.array([[[self.a]]])
        B = np.array([[[0.0]], [[self.b]]])
        return tuple((A, (r + 1) * B, np.zeros(1)) for r in range(len(self.labels)))


def test_polynomials_and_simulation_agree_with_the_transfer_function() -> None:
    z = np.exp(2j * np.pi * HZ * LINEAR.dt_s)
    truth = 0.1 / (z - 0.9)
    by_simulation = responses(LINEAR, HZ, 0, 0)
    by_rule = responses(WithPolynomials(a=0.9, b=0.1, labels=("R1", "R2")), HZ, 0, 0)
    np.testing.assert_allclose(by_simulation[0], truth, rtol=1e-9)
    np.testing.assert_allclose(by_rule[0], truth, rtol=1e-9)
    np.testing.assert_allclose(by_rule[1], 2 * truth, rtol=1e-9)
    assert responses(replace(LINEAR, labels=("R1", "R2")), HZ, 0, 0) == []


def test_a_linear_model_answers_by_its_difference_equation() -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(2000, 1))
    y = LINEAR.simulate(u) + 0.001 * rng.normal(size=(2000, 1))
    fitted = ARX(na=1, nb=1, nk=1).fit(Dataset.from_arrays(u, y, LINEAR.dt_s))
    assert isinstance(fitted, HasDifferenceEquation)
    z = np.exp(2j * np.pi * HZ * LINEAR.dt_s)
    (response,) = responses(fitted, HZ, 0, 0)
    np.testing.assert_allclose(response, 0.1 / (z - 0.9), rtol=0.02)


def test_an_integrator_has_no_gain_at_zero_frequency() -> None:
    (response,) = responses(WithPolynomials(a=1.0, b=0.1), np.array([0.0, 1.0]), 0, 0)
    assert np.isnan(response[0])
    assert np.isfinite(response[1])


def test_impulse_and_steady_state() -> None:
    np.testing.assert_allclose(impulse_response(LINEAR, 0, 0, 5), [0, 0.1, 0.09, 0.081, 0.0729], rtol=1e-9)
    levels = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_allclose(
        steady_outputs(LINEAR, levels, np.zeros(1), 0, 0), levels, rtol=1e-2, atol=1e-12
    )
    runaway = steady_outputs(replace(LINEAR, a=1.0), levels, np.zeros(1), 0, 0)
    assert np.isnan(runaway[[0, 2]]).all()


def test_a_step_from_rest_is_that_of_the_difference_equation() -> None:
    model = FirstOrder(a=0.9, b=0.1, c=0.3)
    moved = step_from(model, np.array([2.0]), 0.5, (0, 0), 40)
    assert moved[0] == 0.0
    np.testing.assert_allclose(moved, 0.5 * (1.0 - 0.9 ** np.arange(40)), atol=1e-9)


def test_poles_and_zeros_are_those_of_the_plant() -> None:
    """(z - 0.5) (z - 0.8) y = z^-1 (z + 0.3) u: as a difference equation and as states."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=4000)
    y = scipy.signal.lfilter([0.0, 0.0, 1.0, 0.3], [1.0, -1.3, 0.4], u)[:, None]
    data = Dataset.from_arrays([u[:, None]], [y + 1e-6 * rng.normal(size=y.shape)], 0.1)
    for model in (ARX(na=2, nb=2, nk=2).fit(data), StateSpace(order=3).fit(data)):
        ((poles, zeros),) = poles_and_zeros(model, 0, 0)
        assert any(abs(poles - 0.8) < 1e-3)
        assert any(abs(poles - 0.5) < 1e-3)
        assert any(abs(zeros + 0.3) < 1e-3)


def test_equilibria_are_where_nothing_drifts() -> None:
    """Steps of 10 s into a lag of 1 s: of every step the end rests; of a ramp, nothing does."""
    levels = [0.0, 1.0, -1.0, 2.0, 0.5]
    u = np.repeat(levels, 100)[:, None]
    data = flown_with(u)
    rests = measured_rests(data, 3.0, 0, 0)
    assert len(rests) >= len(levels)
    np.testing.assert_allclose(rests[:, 1], 3.0 * rests[:, 0], atol=0.35)
    ramp = flown_with(np.linspace(-1.0, 1.0, 60)[:, None])
    assert measured_rests(ramp, 3.0, 0, 0).shape == (0, 2)


def flown_with(u: FloatArray) -> Dataset:
    """y of gain 3 and a lag of 1 s, sampled at 10 Hz."""
    a = np.exp(-0.1)
    y = scipy.signal.lfilter([0.0, 3.0 * (1.0 - a)], [1.0, -a], u, axis=0)
    return Dataset.from_arrays([u], [y], 0.1)


def test_a_mode_that_a_zero_nearly_cancels_is_not_the_time_that_is_told() -> None:
    """Its slowest pole takes 7 s; a step is there after one, as what is printed of it says."""
    dt = 0.02
    u = np.repeat(np.random.default_rng(1).normal(size=300), 20)[:, None]
    a = np.poly([np.exp(-dt / 7.0), np.exp(-dt / 1.0)])
    b = np.array([0.0, 1.0, -np.exp(-dt / 7.5)])
    y = scipy.signal.lfilter(0.01 * b, a, u[:, 0])[:, None]
    fitted = ARX(na=2, nb=2, nk=1, refine=False).fit(Dataset.from_arrays(u, y, dt))
    assert fitted.rules()[0].time_constant_s == pytest.approx(7.0, rel=0.02)
    (told,) = answers(fitted)
    assert told.gain[0] == pytest.approx(0.01 * b.sum() / a.sum(), rel=0.01)
    assert told.reached_s[0] == pytest.approx(1.0, rel=0.15)
    words = in_words(fitted)
    assert "63 % of that is reached after" in words
    assert "time constant" not in words
