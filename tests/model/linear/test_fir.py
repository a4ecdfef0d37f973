"""Regularised FIR: close to the true impulse response where plain least squares is not; honest bands."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.fir import FIR

TRUTH = np.asarray(lfilter([0.0, 0.1, 0.08], [1.0, -1.6, 0.7], np.eye(1, 60)[0]))


def experiment(seed: int, noise: float = 0.3, samples: int = 250) -> Dataset:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = np.convolve(u, TRUTH)[:samples] + noise * rng.standard_normal(samples)
    return Dataset.from_arrays(u, np.asarray(y) + 2.0, 0.1)


def plain(data: Dataset, taps: int) -> FloatArray:
    u = data.segments[0].u[:, 0]
    y = data.segments[0].y[:, 0]
    rows = [np.append(u[k - taps + 1 : k + 1][::-1], 1.0) for k in range(taps - 1, len(u))]
    return np.asarray(np.linalg.lstsq(np.array(rows), y[taps - 1 :], rcond=None)[0][:taps])


def test_regularisation_pays() -> None:
    ours = []
    theirs = []
    for seed in range(5):
        data = experiment(seed)
        taps = FIR(taps=60).fit(data).system.b[:, 0, 0]
        ours.append(np.linalg.norm(taps - TRUTH))
        theirs.append(np.linalg.norm(plain(data, 60) - TRUTH))
    assert np.mean(ours) < 0.5 * np.mean(theirs)


def test_bands_hold_the_truth() -> None:
    inside = []
    for seed in range(20):
        model = FIR(taps=60).fit(experiment(seed))
        inside.append(np.abs(model.system.b[:, 0, 0] - TRUTH) <= 1.96 * model.standard_errors[:60])
    assert np.mean(inside) > 0.9


def test_without_noise_it_simulates_to_a_thousandth() -> None:
    model = FIR(taps=60).fit(experiment(0, noise=0.0))
    held = experiment(1, noise=0.0).segments[0]
    miss = model.simulate(held.u, held.y[: model.n_init]) - held.y
    assert np.abs(miss).max() < 1e-3 * np.ptp(held.y)


def test_taps_that_cannot_be() -> None:
    with pytest.raises(UsageError, match="taps"):
        FIR(taps=0).fit(experiment(0))
