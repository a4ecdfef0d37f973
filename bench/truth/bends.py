"""What bends a plant: nonlinearities without memory, and those that have one; what is linear about them.

The truth of a bent record is the best linear approximation at the sizes that were flown (Pintelon and
Schoukens, 2012, System Identification, chapter 3): of a static one the slope of the best line, times the
plant; of one with memory the response that many other noise-free records of the same kind show.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from bench.truth.plants import Plant
from flysid.dataset import FloatArray
from flysid.model.frequency.sampling import sample
from flysid.model.polynomials import ComplexArray

STATIC = ("saturation", "dead zone", "Hammerstein", "Wiener")
MOVING = ("backlash", "drag", "friction", "scheduling")
LEAST_POWER = 1e-9
"""Of the strongest line: below that a response is what the window leaks."""
REALISATIONS = 48
"""Noise-free records whose mean is the truth of a plant with memory."""


def bend(rng: np.random.Generator, kind: str, x: FloatArray) -> tuple[FloatArray, float]:
    """A signal through a nonlinearity without memory, and the slope of the best line through it."""
    if kind == "none":
        return x, 1.0
    size = max(float(x.std()), 1e-300)
    share = float(rng.uniform(0.2, 1.0))
    if kind == "saturation":
        bent = np.clip(x, -2.0 * share * size, 2.0 * share * size)
    elif kind == "dead zone":
        bent = np.sign(x) * np.maximum(np.abs(x) - 0.5 * share * size, 0.0)
    else:
        bent = x + 0.3 * share * x**3 / size**2
    middle = x - x.mean()
    return np.asarray(bent), float(middle @ bent / (middle @ middle))


def moving_plant(kind: str, share: float, plant: Plant, step_s: float) -> Callable[[FloatArray], FloatArray]:
    """From inputs (R, N) of size 1 to outputs (R, N), step by step; `share`: how much of it, 0 to 1.

    Backlash moves the input of the plant; drag, friction and scheduling move a lag of its corner and gain.
    """
    if kind == "backlash":
        a, (b,) = sample(plant.transfer, step_s, "zero")
        return lambda u: np.asarray(lfilter(b, a, _play(u, 0.1 + 0.4 * share)))
    gain = float(np.sign(plant.transfer.numerators[0][-1]))
    quick = plant.corner * step_s

    def respond(u: FloatArray) -> FloatArray:
        y = np.zeros_like(u)
        v = np.zeros(len(u))
        for k in range(1, u.shape[1]):
            force = u[:, k - 1]
            if kind == "drag":
                v = v + quick * (force - 0.3 * v - (0.5 + 2.0 * share) * v * np.abs(v))
            elif kind == "friction":
                v = _rub(v + quick * (force - v), quick * (0.1 + 0.4 * share))
            else:
                v = v + quick * (1.0 + (0.2 + 0.5 * share) * np.tanh(2.0 * v)) * (force - v)
            y[:, k] = v
        return gain * y

    return respond


def _play(u: FloatArray, half: float) -> FloatArray:
    """Behind a play of this half width."""
    held = np.zeros_like(u)
    for k in range(1, u.shape[1]):
        held[:, k] = np.clip(held[:, k - 1], u[:, k] - half, u[:, k] + half)
    return held


def _rub(v: FloatArray, most: float) -> FloatArray:
    """Speeds after dry friction took up to `most` of them."""
    return np.sign(v) * np.maximum(np.abs(v) - most, 0.0)


def best_linear(u: FloatArray, y: FloatArray, dt_s: float) -> Callable[[FloatArray], ComplexArray]:
    """The response at rad/s of the best linear model of records (R, N); NaN where they have no power."""
    window = np.hanning(u.shape[1])
    spectra = [np.fft.rfft((x - x.mean(axis=1, keepdims=True)) * window, axis=1) for x in (u, y)]
    cross = np.sum(spectra[1] * np.conj(spectra[0]), axis=0)
    power = np.sum(np.abs(spectra[0]) ** 2, axis=0)
    three = np.ones(3)
    total = np.convolve(power, three, "same")
    g = np.where(total > LEAST_POWER * total.max(), np.convolve(cross, three, "same"), np.nan) / total
    omega = 2.0 * np.pi * np.fft.rfftfreq(u.shape[1], dt_s)
    return lambda at: np.interp(at, omega, g.real) + 1j * np.interp(at, omega, g.imag)
