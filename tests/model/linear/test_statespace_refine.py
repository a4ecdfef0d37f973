"""State space on the simulation error: exact slopes, the noise floor, bands that hold the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.model.statespace import StateSpace
from flysid.model.subspace.refinement import SystemFit
from flysid.model.subspace.triangle import subspace
from tests.model_examples import data


@pytest.mark.parametrize("feedthrough", [True, False])
def test_slopes_are_those_of_differences(feedthrough: bool) -> None:
    example = data(2, 2, samples=80, noise=0.05)
    start = subspace([s.u for s in example.segments], [s.y for s in example.segments], 3, past=5)
    start = replace(start, d=start.d if feedthrough else np.zeros_like(start.d))
    problem = SystemFit(example.segments, start, feedthrough)
    theta = 1.01 * problem.theta0
    cost, _, gradient = problem.normal_equations(theta)
    assert cost == pytest.approx(problem.cost(theta))
    steps = 1e-6 * np.eye(len(theta))
    slopes = [(problem.cost(theta + h) - problem.cost(theta - h)) / 2e-6 for h in steps]
    assert 2 * gradient == pytest.approx(slopes, rel=1e-4, abs=1e-6 * np.abs(slopes).max())


def experiment(seed: int, rows: int = 800) -> tuple[FloatArray, FloatArray]:
    """A second-order plant with coloured noise on its output."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], rows // 4), 4)
    noise = np.asarray(lfilter([1.0], [1.0, -0.8], 0.2 * rng.standard_normal(rows)))
    return u, np.asarray(lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u)) + noise


def test_bands_hold_the_truth_in_coloured_noise() -> None:
    """30 experiments at three frequencies."""
    omega = np.array([0.5, 3.0, 8.0])
    z = np.exp(1j * omega * 0.1)
    truth = np.abs((1 / z + 0.5 / z**2) / (1 - 1.5 / z + 0.7 / z**2))
    settings = StateSpace(order=2, method="pbsid", past=10, feedthrough=False, refine=True)
    inside = []
    for seed in range(30):
        response = settings.fit(Dataset.from_arrays(*experiment(seed), 0.1)).frequency_response(omega)
        gap = np.abs(np.abs(response.response[:, 0, 0]) - truth)
        inside.append(gap < 1.96 * response.magnitude_error[:, 0, 0])
    assert np.mean(inside) > 0.85


def test_a_refined_model_free_runs_better_and_carries_bands() -> None:
    u, y = experiment(1, 2000)
    dataset = Dataset.from_arrays(u, y, 0.1)
    settings = StateSpace(order=2, method="moesp", past=5, feedthrough=False)
    plain, refined = (replace(settings, refine=r).fit(dataset) for r in (False, True))
    truth = np.asarray(lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u))[:, None]
    off = [float(np.std((m.simulate(u) - truth)[50:])) for m in (plain, refined)]
    assert off[1] < 1.02 * off[0]
    assert refined.noise is not None
    assert refined.n_parameters < plain.n_parameters
    low, high = refined.simulation_band(u[:, None], draws=50)
    assert (low <= high).all()
    assert np.mean((low <= truth) & (truth <= high)) > 0.5
    bare = replace(plain, covariance=np.zeros((0, 0)))
    with pytest.raises(UsageError, match="carries no covariance"):
        bare.simulation_band(u[:, None])
    assert np.isnan(bare.frequency_response(np.array([1.0])).magnitude_error).all()
    assert "none (fitted from disk" in str(bare)
    with pytest.raises(UsageError, match="Nyquist"):
        plain.frequency_response(np.array([40.0]))


def test_an_estimate_that_is_not_refined_knows_how_far_off_it_is() -> None:
    """MOESP and PBSID of too low an order for coloured noise are biased: their intervals are wide enough."""
    omega = np.array([1.0, 3.0, 6.0])
    inside = []
    z = np.exp(1j * omega * 0.1)
    truth = np.abs(np.polyval([0.5, 1.0, 0.0], 1 / z) / np.polyval([0.7, -1.5, 1.0], 1 / z))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(1000)
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(1000))
        y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + noise
        settings = StateSpace(order=2, method="pbsid", past=10, refine=False, feedthrough=False, nk=1)
        model = settings.fit(Dataset.from_arrays(u, y, 0.1))
        found = model.frequency_response(omega)
        miss = np.abs(found.response[:, 0, 0]) - truth
        inside.append(np.abs(miss) < 1.96 * found.magnitude_error[:, 0, 0])
        assert " +- " in str(model)
    assert np.mean(inside) > 0.9


def test_validation_decides_and_the_note_says_how() -> None:
    note = StateSpace(order=2).fit(Dataset.from_arrays(*experiment(2), 0.1)).notes[-1]
    assert "simulation error" in note
    assert "against" in note


def test_a_slow_pole_does_not_blow_up_the_band() -> None:
    """Whole draws of a pole near one drift away; the free run is known far better than they say."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(size=60), 25)
    clean = np.asarray(lfilter([0.0, 0.02], [1.0, -0.98], u))
    y = clean + 0.05 * rng.normal(size=len(u))
    data = Dataset.from_arrays(u, y, 0.02)
    widths = []
    for model in (StateSpace(order=3).fit(data), ARX(na=1, nb=1, nk=1).fit(data)):
        low, high = model.simulation_band(u[:, None], y[: model.n_init, None], draws=50)
        widths.append(float(np.median(high - low)))
    assert widths[0] < 5.0 * widths[1]
