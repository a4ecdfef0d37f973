"""The measured frequency response: right, with intervals that hold the plant as often as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.frequency.response import METHODS, MeasuredResponse, Method, measure_response
from flysid.model.polynomials import DB, ComplexArray

DT_S = 0.02
PLANT = ([0.7995], [1.0, 4.1881, 7.1429])
B, A, _ = cont2discrete(PLANT, DT_S, "zoh")


def truth(omega: FloatArray, b: FloatArray = B, a: FloatArray = A) -> ComplexArray:
    z = np.exp(1j * omega * DT_S)
    return np.asarray(np.polyval(b.ravel(), z) / np.polyval(a, z))


def chirp(n: int, low_hz: float, high_hz: float) -> FloatArray:
    """Frequency rising exponentially, 3 s of rest on both sides."""
    rest = round(3.0 / DT_S)
    t = np.arange(n - 2 * rest) * DT_S
    k = np.log(high_hz / low_hz) / t[-1]
    sweep = np.sin(2 * np.pi * low_hz * (np.exp(k * t) - 1) / k)
    return np.concatenate([np.zeros(rest), sweep, np.zeros(rest)])


def steps(n: int, rng: np.random.Generator, hold: int = 10) -> FloatArray:
    return np.repeat(rng.standard_normal(n // hold + 1), hold)[:n]


def flown(u: FloatArray, noise: float, rng: np.random.Generator) -> FloatArray:
    coloured = lfilter([1.0], [1.0, -0.9], noise * rng.standard_normal(len(u)))
    return np.asarray(lfilter(B.ravel(), A, u) + coloured)


def experiment(seed: int, excitation: str, noise: float = 0.002, n: int = 4000) -> Dataset:
    rng = np.random.default_rng(seed)
    u = chirp(n, 0.1, 3.0) if excitation == "chirp" else steps(n, rng)
    return Dataset.from_arrays(u, flown(u, noise, rng), DT_S, inputs=["theta"], outputs=["v"])


@pytest.mark.parametrize("excitation", ["chirp", "steps"])
def test_intervals_hold_the_plant_as_often_as_they_say(excitation: str) -> None:
    """Gain and phase at every trusted frequency of 40 flights; a fixed band, so that luck is not selected."""
    gain = []
    phase = []
    for seed in range(40):
        m = measure_response(experiment(seed, excitation), points=24, band=(1.0, 8.0))
        g = truth(m.omega)
        apart = m.gain_db[:, 0] / DB - np.log(np.abs(g))
        gain.append(np.abs(apart) < m.half_width()[:, 0])
        phase.append(np.abs(np.angle(m.response[:, 0] / g)) < m.half_width()[:, 0])
    for inside in (gain, phase):
        assert 0.90 < np.mean(inside) < 0.985


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_plant(method: Method) -> None:
    """Averaged windows leak at a record's edges: they may be 10 % off where local polynomials are not."""
    m = measure_response(experiment(0, "steps", noise=1e-4, n=12000), method=method, band=(1.0, 8.0))
    miss = np.abs(m.response[:, 0] / truth(m.omega) - 1.0)
    assert miss.max() < (0.02 if method == "local" else 0.25)
    assert m.coherence.min() > 0.9
    assert (m.error < 0.2).all()


def test_the_error_is_the_one_of_the_textbook() -> None:
    m = measure_response(experiment(0, "steps"))
    g2 = m.coherence[:, 0]
    n_d = m.averages[:, 0]
    assert m.error[:, 0] == pytest.approx(np.sqrt(1 - g2) / (np.sqrt(g2) * np.sqrt(2 * n_d)))


def test_the_band_ends_where_the_noise_begins() -> None:
    quiet = measure_response(experiment(0, "steps", noise=0.0005)).band()
    loud = measure_response(experiment(0, "steps", noise=0.01)).band()
    assert quiet is not None
    assert loud is not None
    assert loud[1] < 0.7 * quiet[1]
    rng = np.random.default_rng(0)
    nothing = Dataset.from_arrays(rng.standard_normal(3000), rng.standard_normal(3000), DT_S)
    assert measure_response(nothing).band() is None


def test_two_inputs_are_told_apart() -> None:
    """The second input follows the first in part; each keeps its own response (conditioning)."""
    rng = np.random.default_rng(1)
    n = 8000
    first = steps(n, rng)
    other = steps(n, rng)
    second = 0.6 * first + other
    b2, a2, _ = cont2discrete(([2.0], [1.0, 3.0]), DT_S, "zoh")
    y = lfilter(B.ravel(), A, first) + lfilter(b2.ravel(), a2, second) + 1e-3 * rng.standard_normal(n)
    data = Dataset.from_arrays(np.column_stack([first, second]), y, DT_S)
    m = measure_response(data, band=(0.5, 5.0))
    assert 0.1 < m.shared < 0.5
    for j, (b, a) in enumerate([(B, A), (b2, a2)]):
        assert np.abs(m.response[:, j] / truth(m.omega, b, a) - 1.0).max() < 0.05
        assert m.coherence[:, j].min() > 0.8
    alone = measure_response(Dataset.from_arrays(first, y, DT_S), band=(0.5, 5.0))
    assert np.abs(alone.response[:, 0] / truth(alone.omega) - 1.0).max() > 1.0


def test_many_short_segments_count_together() -> None:
    whole = experiment(0, "steps")
    pieces = [whole.segments[0].slice(k, k + 400, DT_S) for k in range(0, 4000, 400)]
    m = measure_response(whole.with_segments(pieces), band=(2.0, 8.0))
    assert np.abs(m.response[:, 0] / truth(m.omega) - 1.0).max() < 0.25
    assert m.coherence.min() > 0.8


def test_a_drift_is_taken_out_on_request() -> None:
    data = experiment(0, "steps")
    drifting = Dataset.from_arrays(
        data.segments[0].u, data.segments[0].y + 0.05 * DT_S * np.arange(4000)[:, None], DT_S
    )
    misses = [
        np.abs(m.response[:, 0] / truth(m.omega) - 1.0).mean()
        for m in (measure_response(drifting, trend=t, band=(0.5, 2.0)) for t in ("none", "remove"))
    ]
    assert misses[1] < misses[0]
    assert misses[1] < 0.1


def test_a_narrow_resonance_is_held() -> None:
    """Parabolas over a quarter of the frequency cut its top off, and no residual showed it under noise."""
    dt_s = 0.05
    a = np.real(np.poly(np.exp(6.0 * dt_s * np.array([-0.05 + 0.99875j, -0.05 - 0.99875j]))))
    b = np.array([0.0, a.sum()])
    off = []
    half = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        u = steps(1200, rng, 4)
        y = lfilter(b, a, u)
        noisy = y + 0.02 * y.std() * rng.standard_normal(len(y))
        m = measure_response(Dataset.from_arrays(u, noisy, dt_s), points=40, band=(4.5, 8.0))
        z = np.exp(1j * m.omega * dt_s)
        right = np.polyval(np.append(b, 0.0), z) / np.polyval(a, z)
        off.append(np.abs(np.log(np.abs(m.response[:, 0] / right))))
        half.append(m.half_width()[:, 0])
    assert np.mean(np.array(off) < half) > 0.93
    assert np.median(np.max(off, axis=1)) < 0.27


def test_bad_data_is_named() -> None:
    rng = np.random.default_rng(0)
    moving = rng.standard_normal(500)
    with pytest.raises(DataError, match="input 'u' never changes"):
        measure_response(Dataset.from_arrays(np.full(500, 7.0), moving, DT_S))
    with pytest.raises(DataError, match="output 'y' never changes"):
        measure_response(Dataset.from_arrays(moving, np.zeros(500), DT_S))
    for method in METHODS:
        with pytest.raises(DataError, match=r"too (short|few)"):
            measure_response(Dataset.from_arrays(moving[:10], moving[:10], DT_S), method=method)
    with pytest.raises(DataError, match="move together"):
        measure_response(Dataset.from_arrays(np.column_stack([moving, 2 * moving]), moving, DT_S))
    with pytest.raises(UsageError, match="between"):
        measure_response(Dataset.from_arrays(moving, moving, DT_S), band=(5.0, 1.0))
    with pytest.raises(UsageError, match="method"):
        measure_response(Dataset.from_arrays(moving, moving, DT_S), method="fft")  # type: ignore[arg-type]


def test_noise_free_data_have_no_error_and_finite_figures() -> None:
    m: MeasuredResponse = measure_response(experiment(0, "steps", noise=0.0))
    assert np.isfinite(m.response).all()
    assert np.isfinite(m.gain_db).all()
    assert np.isfinite(m.half_width()).all()
    assert np.median(m.error) < 0.01


def test_a_band_does_not_rest_on_neighbours_alone() -> None:
    """A dip between two peaks is above one half in the mean of three, and not by itself."""
    measured = measure_response(experiment(1, "steps"))
    coherence = np.full(measured.coherence.shape, 0.1)
    coherence[20:23, 0] = (0.95, 0.3, 0.95)
    assert replace(measured, coherence=coherence).band() is None
    coherence[22, 0] = 0.3
    coherence[40:44, 0] = 0.9
    low, high = replace(measured, coherence=coherence).band() or (0.0, 0.0)
    assert (low, high) == (measured.omega[40], measured.omega[43])
