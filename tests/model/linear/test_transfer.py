"""Continuous transfer functions: the plant's own, with errors that hold it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError, UsageError
from flysid.model.arx import ARX
from flysid.model.frequency.transfer import continuous
from flysid.model.oe import OE

PLANTS = {
    "longitudinal": ([0.7995], [1.0, 4.1881, 7.1429]),
    "lateral": ([0.11624, 0.0672488], [1.0, 0.982664, 0.301338]),
    "vertical": ([17.6902, 37.7142, 422.62], [1.0, 11.6091, 68.394, 257.0, 684.244]),
}


def experiment(plant: str, dt_s: float, noise: float, delay: int = 0) -> Dataset:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 600), round(0.2 / dt_s))
    b, a, _ = cont2discrete(PLANTS[plant], dt_s, "zoh")
    y = np.asarray(lfilter(np.append(np.zeros(delay), b.ravel()), a.ravel(), u))
    y = y + noise * rng.standard_normal(len(u))
    return Dataset.from_arrays(u, y, dt_s, inputs=["theta"], outputs=["v_x"])


def aligned(short: FloatArray, length: int) -> FloatArray:
    return np.append(np.zeros(length - len(short)), short)


@pytest.mark.parametrize("plant", PLANTS)
def test_without_noise_the_plant_comes_back(plant: str) -> None:
    num, den = PLANTS[plant]
    n = len(den) - 1
    found = continuous(ARX(na=n, nb=n, nk=1, refine=False).fit(experiment(plant, 0.05, 0.0)))
    assert found.denominator == pytest.approx(np.array(den), rel=1e-4)
    expected = aligned(np.array(num), len(found.numerator))
    assert found.numerator == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    assert found.dead_time_s == 0.0


def test_intervals_hold_the_plant() -> None:
    found = continuous(OE(na=2, nb=2, nk=1).fit(experiment("longitudinal", 0.02, 0.02)))
    num, den = PLANTS["longitudinal"]
    miss = np.append(found.numerator - [0.0, *num], found.denominator[1:] - den[1:])
    error = np.append(found.numerator_error, found.denominator_error[1:])
    assert (np.abs(miss) < 4 * error).all()
    assert (error > 0).all()
    assert found.denominator_error[0] == 0.0


def test_a_dead_time_and_the_printed_form() -> None:
    found = continuous(OE(na=2, nb=2, nk=4).fit(experiment("longitudinal", 0.02, 0.001, delay=3)))
    assert found.dead_time_s == pytest.approx(0.06)
    text = str(found)
    for part in ("v_x / theta = e^(-0.06 s)", "s^2 + 4.", "+-", "rad/s, damping 0.7"):
        assert part in text


def test_models_without_a_continuous_counterpart() -> None:
    data = experiment("longitudinal", 0.05, 0.01)
    with pytest.raises(UsageError, match="coefficients of B"):
        continuous(ARX(na=1, nb=4, nk=1, refine=False).fit(data))
    alternating = np.random.default_rng(1).standard_normal(500)
    y = np.asarray(lfilter([0.0, 1.0], [1.0, 0.5], alternating))
    with pytest.raises(FitError, match="faster"):
        continuous(ARX(na=1, nb=1, nk=1, refine=False).fit(Dataset.from_arrays(alternating, y, 0.1)))
