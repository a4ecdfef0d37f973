"""Bands: what the covariance says is what repeated experiments show."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.model.linear.difference_equation import FittedLinear

A = [1.0, -1.5, 0.7]
B = [0.0, 1.0, 0.5]
OMEGA = np.array([0.0, 0.5, 3.0, 8.0])


def experiment(seed: int, samples: int = 400) -> Dataset:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = lfilter(B, A, u) + lfilter([1.0], A, 0.3 * rng.standard_normal(samples))
    return Dataset.from_arrays(u, np.asarray(y), 0.1)


def fitted(seed: int) -> FittedLinear:
    return ARX(na=2, nb=2, nk=1, refine=False, offset=False).fit(experiment(seed))


def test_the_response_is_that_of_the_polynomials() -> None:
    model = fitted(0)
    _, expected = freqz(model.system.b[:, 0, 0], model.system.a[:, 0, 0], OMEGA * 0.1)
    assert model.frequency_response(OMEGA).response[:, 0, 0] == pytest.approx(expected)


def test_standard_errors_are_those_of_repeated_experiments() -> None:
    responses = [fitted(seed).frequency_response(OMEGA) for seed in range(60)]
    sizes = np.std([np.abs(r.response[:, 0, 0]) for r in responses], axis=0)
    phases = np.std([np.unwrap(np.angle(r.response[:, 0, 0])) for r in responses], axis=0)
    promised = np.mean([r.magnitude_error[:, 0, 0] for r in responses], axis=0)
    assert sizes == pytest.approx(promised, rel=0.35)
    assert phases[1:] == pytest.approx(
        np.mean([r.phase_error[1:, 0, 0] for r in responses], axis=0), rel=0.35
    )


def test_the_simulation_band_holds_the_truth() -> None:
    u = np.repeat([0.0, 1.0, -1.0], 20)
    truth = np.asarray(lfilter(B, A, u))
    inside = []
    for seed in range(20):
        low, high = fitted(seed).simulation_band(u, draws=60)
        inside.append((low[5:, 0] <= truth[5:]) & (truth[5:] <= high[5:, 0]))
    assert 0.85 < np.mean(inside) < 0.999


def test_frequencies_beyond_nyquist() -> None:
    with pytest.raises(UsageError, match="Nyquist"):
        fitted(0).frequency_response(np.array([40.0]))
