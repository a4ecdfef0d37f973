"""Transfer functions fitted to measured responses: the plant's own, with intervals that hold it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.frequency.rational import Form, Rational, forms
from flysid.model.frequency.response import measure_response
from flysid.model.frequency.sampling import sample
from flysid.model.frequency.simulation_fit import ACCEPTABLE, best_fit, fit_response
from tests.model.linear.test_frequency_response import DT_S, PLANT, experiment, steps

TRUTH = np.array([*PLANT[1][1:], *PLANT[0]])


@pytest.mark.parametrize("weighting", ["coherence", "likelihood"])
def test_intervals_hold_the_plant(weighting: str) -> None:
    """20 chirps; the larger campaign is bench/frequency_coverage.py."""
    inside = []
    for seed in range(20):
        measured = measure_response(experiment(seed, "chirp", noise=0.004), points=40)
        fit = fit_response(measured, Form(2, (0,), (0.0,)), weighting=weighting)  # type: ignore[arg-type]
        found = np.append(fit.rational.denominator[1:], fit.rational.numerators[0])
        inside.append(np.abs(found - TRUTH) < 1.96 * np.sqrt(np.diag(fit.covariance)))
        assert fit.acceptable
    assert np.mean(inside) > 0.83


def test_the_order_is_chosen_and_the_choice_explained() -> None:
    measured = measure_response(experiment(0, "steps", noise=0.0005, n=8000))
    fit, words = best_fit([fit_response(measured, form) for form in forms(1)])
    assert fit.form.poles == 2
    assert fit.rational.denominator == pytest.approx(PLANT[1], rel=0.05)
    assert float(fit.cost[0]) < 5
    assert "lowest BIC of" in words
    wrong = fit_response(measured, Form(1, (0,), (0.0,)))
    assert wrong.cost[0] > 10 * fit.cost[0]


def test_a_dead_time_is_found_with_its_error() -> None:
    rng = np.random.default_rng(0)
    u = steps(8000, rng)
    b, a, _ = cont2discrete(PLANT, DT_S, "zoh")
    y = lfilter(np.append(np.zeros(5), b.ravel()), a.ravel(), u) + 1e-3 * rng.standard_normal(8000)
    fit = fit_response(measure_response(Dataset.from_arrays(u, y, DT_S)), Form(2, (0,), (None,)))
    error = float(np.sqrt(fit.covariance[-1, -1]))
    assert 0 < error < 0.02
    assert fit.rational.dead_time_s[0] == pytest.approx(0.1, abs=3 * error)


def test_two_inputs_share_the_poles() -> None:
    rng = np.random.default_rng(2)
    u = np.column_stack([steps(8000, rng), steps(8000, rng)])
    truth = Rational(np.array([1.0, 2.0, 9.0]), (np.array([3.0]), np.array([1.0, 4.0])), np.zeros(2))
    a, b = sample(truth, DT_S, "zero")
    y = sum(lfilter(taps, a, u[:, j]) for j, taps in enumerate(b)) + 1e-3 * rng.standard_normal(8000)
    measured = measure_response(Dataset.from_arrays(u, np.asarray(y), DT_S))
    fit = fit_response(measured, Form(2, (0, 1), (0.0, 0.0)))
    assert fit.rational.denominator == pytest.approx(truth.denominator, rel=0.03)
    assert fit.rational.numerators[0] == pytest.approx(truth.numerators[0], rel=0.03)
    found = np.concatenate([fit.rational.denominator[1:], *fit.rational.numerators])
    miss = found - [2.0, 9.0, 3.0, 1.0, 4.0]
    assert (np.abs(miss) < 3.5 * np.sqrt(np.diag(fit.covariance))).all()


def test_an_unstable_plant_under_a_controller_is_found() -> None:
    """y = 2 / (s - 0.5) u, u = r - 2 y, r a sweep far above the noise."""
    rng = np.random.default_rng(3)
    r = 3.0 * steps(12000, rng)
    y = np.zeros(12000)
    u = np.zeros(12000)
    pole = np.exp(0.5 * DT_S)
    for k in range(12000):
        if k:
            y[k] = pole * y[k - 1] + 4.0 * (pole - 1.0) * u[k - 1]
        u[k] = r[k] - 2.0 * y[k]
    data = Dataset.from_arrays(u, y + 1e-3 * rng.standard_normal(12000), DT_S)
    fit = fit_response(measure_response(data), Form(1, (0,), (0.0,), stable=False))
    assert fit.rational.denominator == pytest.approx([1.0, -0.5], abs=0.05)
    assert not fit.rational.is_stable
    mirrored = fit_response(measure_response(data), Form(1, (0,), (0.0,)))
    assert mirrored.rational.is_stable
    assert mirrored.cost[0] > 10 * fit.cost[0]


def test_what_no_transfer_function_describes_is_called_so() -> None:
    rng = np.random.default_rng(4)
    u = steps(8000, rng)
    comb = np.zeros(60)
    comb[[1, 21, 41]] = [1.0, 1.0, 0.5]
    y = lfilter(comb, [1.0], u) + 1e-3 * rng.standard_normal(8000)
    measured = measure_response(Dataset.from_arrays(u, y, DT_S))
    fit, words = best_fit([fit_response(measured, form) for form in forms(1, poles=1)])
    assert fit.cost[0] > ACCEPTABLE
    assert "above 100" in words


def test_bad_requests_are_named() -> None:
    rng = np.random.default_rng(0)
    deaf = measure_response(Dataset.from_arrays(rng.standard_normal(3000), rng.standard_normal(3000), DT_S))
    with pytest.raises(DataError, match="explains 'y' at too few"):
        fit_response(deaf, Form(1, (0,), (0.0,)))
    heard = measure_response(experiment(0, "steps"), points=4)
    with pytest.raises(DataError, match="too few"):
        fit_response(heard, Form(4, (3,), (None,)), bands=[(0.1, 60.0)])
    for form in (
        Form(1, (2,), (0.0,)),
        Form(2, (0, 0), (0.0,)),
        Form(2, (0,), (-0.1,)),
        Form(-1, (0,), (0.0,)),
    ):
        with pytest.raises(UsageError):
            fit_response(heard, form)


def test_sampling_agrees_with_the_library_and_delays_by_fractions() -> None:
    rational = Rational(np.array([1.0, 4.0, 7.0]), (np.array([1.0, 0.8]),), np.zeros(1))
    for hold, name in (("zero", "zoh"), ("first", "foh")):
        a, b = sample(rational, DT_S, hold)  # type: ignore[arg-type]
        expected_b, expected_a, _ = cont2discrete(([1.0, 0.8], [1.0, 4.0, 7.0]), DT_S, name)
        assert a == pytest.approx(expected_a)
        assert b[0][:3] == pytest.approx(expected_b.ravel(), abs=1e-12)
    late = Rational(rational.denominator, rational.numerators, np.array([0.033]))
    fine = Rational(rational.denominator, rational.numerators, np.zeros(1))
    u = np.random.default_rng(0).standard_normal(100)
    a, b = sample(late, DT_S, "zero")
    coarse = lfilter(b[0], a, u)
    a, b = sample(fine, DT_S / 20, "zero")
    shifted: FloatArray = np.concatenate([np.zeros(33), np.repeat(u, 20)])[:2000]
    assert coarse == pytest.approx(lfilter(b[0], a, shifted)[::20], abs=1e-9)
