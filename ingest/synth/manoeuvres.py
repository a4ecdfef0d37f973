"""Excitation: the paper's multisines (13) and (14), and what test pilots and identification experts fly.

Every function takes times in seconds and returns one value per time; amplitudes carry the command's unit.
Random signals take a numpy Generator, so that a seed fixes them. Sources: Jategaonkar, Flight Vehicle System
Identification (2nd ed., 2015), ch. 2 (doublets, 3-2-1-1, sweeps); Pintelon and Schoukens, System
Identification (2nd ed., 2012), ch. 5 (random-phase multisines, crest factor).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError

TRAINING_RAD_S = (0.1, 0.2, 0.3, 0.4, 0.5)
VALIDATION_RAD_S = (0.1, 0.2, 0.3, 0.4)


def paper_training(time_s: npt.ArrayLike) -> FloatArray:
    """Equation (13): sin 0.1t + sin 0.2t + sin 0.3t + sin 0.4t + sin 0.5t."""
    return multisine(time_s, TRAINING_RAD_S)


def paper_validation(time_s: npt.ArrayLike) -> FloatArray:
    """Equation (14): the training signal without its highest frequency."""
    return multisine(time_s, VALIDATION_RAD_S)


def multisine(
    time_s: npt.ArrayLike,
    omega_rad_s: npt.ArrayLike,
    amplitudes: npt.ArrayLike = 1.0,
    phases_rad: npt.ArrayLike = 0.0,
) -> FloatArray:
    """Sum of sines: sum_i a_i sin(omega_i t + phi_i); scalars hold for every line."""
    t = np.asarray(time_s, dtype=np.float64)
    lines = np.broadcast_arrays(np.atleast_1d(omega_rad_s), amplitudes, phases_rad)
    total = np.zeros(t.shape)
    for omega, amplitude, phase in zip(*(np.asarray(v, dtype=np.float64) for v in lines), strict=True):
        total += amplitude * np.sin(omega * t + phase)
    return total


def random_phase_multisine(
    time_s: npt.ArrayLike,
    band_hz: tuple[float, float],
    peak: float,
    rng: np.random.Generator,
    *,
    crest: float = 1.8,
) -> FloatArray:
    """Equal lines at every harmonic of the record inside a band, at random phases made flat.

    From random phases the signal is clipped and its amplitude spectrum restored, again and again, until the
    crest factor is reached (Van der Ouderaa et al., 1988), 200 times at most; a few lines may stay above it.

    `time_s`: (N,) equally spaced times; the record's length is the period.
    `band_hz`: lowest and highest frequency.
    `peak`: largest absolute value.
    `crest`: crest factor aimed at; a large number keeps the phases as drawn.
    Raises UsageError: no harmonic of the record lies in the band.
    """
    t = np.asarray(time_s, dtype=np.float64)
    n = len(t)
    base_hz = 1.0 / (len(t) * (t[1] - t[0]))
    low, high = (edge / base_hz for edge in band_hz)
    lines = np.arange(max(1, int(np.ceil(low - 1e-9))), min(int(high + 1e-9), (n - 1) // 2) + 1)
    if not len(lines):
        raise UsageError(
            f"no harmonic of a {1 / base_hz:g} s record lies between {band_hz[0]:g} and {band_hz[1]:g} Hz",
            hint="a longer flight or a wider band",
        )
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    signal = _unit_lines(lines, phases, n)
    for _ in range(200):
        if crest_factor(signal) <= crest:
            break
        bound = 0.85 * np.abs(signal).max()
        phases = np.angle(np.fft.rfft(np.clip(signal, -bound, bound))[lines])
        signal = _unit_lines(lines, phases, n)
    return np.asarray(peak * signal / np.abs(signal).max(), dtype=np.float64)


def _unit_lines(lines: npt.NDArray[np.int64], phases_rad: FloatArray, n: int) -> FloatArray:
    """(n,) sum of unit cosines at whole multiples of the record's frequency."""
    spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * n * np.exp(1j * phases_rad)
    return np.asarray(np.fft.irfft(spectrum, n=n), dtype=np.float64)


def crest_factor(x: npt.ArrayLike) -> float:
    """Peak over root mean square; sqrt(2) for a sine, 1 for a square wave."""
    values = np.asarray(x, dtype=np.float64)
    return float(np.abs(values).max() / np.sqrt(np.mean(values**2)))


def chirp(time_s: npt.ArrayLike, band_hz: tuple[float, float], amplitude: float) -> FloatArray:
    """Exponential frequency sweep from the band's lower to its upper edge over the whole record."""
    t = np.asarray(time_s, dtype=np.float64)
    low, high = band_hz
    length = float(t[-1] - t[0])
    rate = np.log(high / low)
    phase = 2.0 * np.pi * low * length / rate * (np.exp(rate * (t - t[0]) / length) - 1.0)
    return np.asarray(amplitude * np.sin(phase), dtype=np.float64)


def steps(time_s: npt.ArrayLike, levels: Sequence[float], start_s: float, unit_s: float) -> FloatArray:
    """Levels held for `unit_s` each from `start_s` on, zero before and after."""
    t = np.asarray(time_s, dtype=np.float64)
    # the small lead keeps an edge on its sample when the division rounds down
    index = np.floor((t - start_s) / unit_s + 1e-9).astype(np.int64)
    inside = (index >= 0) & (index < len(levels))
    table = np.asarray(levels, dtype=np.float64)
    return np.where(inside, table[np.clip(index, 0, len(levels) - 1)], 0.0)


def doublet(time_s: npt.ArrayLike, start_s: float, pulse_s: float, amplitude: float) -> FloatArray:
    """One pulse up and one down; most power near 0.4 / pulse_s Hz."""
    return steps(time_s, (amplitude, -amplitude), start_s, pulse_s)


def three_two_one_one(time_s: npt.ArrayLike, start_s: float, unit_s: float, amplitude: float) -> FloatArray:
    """Pulses of 3, 2, 1 and 1 units with alternating sign (Jategaonkar, 2015, sec. 2.3)."""
    signs = (1, 1, 1, -1, -1, 1, -1)
    return steps(time_s, [amplitude * s for s in signs], start_s, unit_s)


def prbs(time_s: npt.ArrayLike, hold_s: float, amplitude: float, rng: np.random.Generator) -> FloatArray:
    """Two levels, drawn anew every `hold_s` (a random binary sequence)."""
    t = np.asarray(time_s, dtype=np.float64)
    index = np.floor((t - t[0]) / hold_s + 1e-9).astype(np.int64)
    levels = rng.choice(np.array([-amplitude, amplitude]), size=int(index[-1]) + 1)
    return np.asarray(levels[index], dtype=np.float64)


def amplitude_steps(
    time_s: npt.ArrayLike, hold_s: float, peak: float, rng: np.random.Generator
) -> FloatArray:
    """Levels uniform in [-peak, peak], drawn anew every `hold_s`: the whole range, not only its edges."""
    t = np.asarray(time_s, dtype=np.float64)
    index = np.floor((t - t[0]) / hold_s + 1e-9).astype(np.int64)
    return np.asarray(rng.uniform(-peak, peak, int(index[-1]) + 1)[index], dtype=np.float64)


def amplitude_sweep(time_s: npt.ArrayLike, frequency_hz: float, peak: float) -> FloatArray:
    """A sine whose amplitude grows linearly from zero to `peak` over the record."""
    t = np.asarray(time_s, dtype=np.float64)
    growth = (t - t[0]) / (t[-1] - t[0])
    return np.asarray(peak * growth * np.sin(2.0 * np.pi * frequency_hz * (t - t[0])), dtype=np.float64)


def pilot(time_s: npt.ArrayLike, peak: float, rng: np.random.Generator) -> FloatArray:
    """A person on the sticks: targets held 0.5 to 3 s, one in four back to centre, hands with a 0.15 s lag.

    The lag is a critically damped second-order filter, the usual neuromuscular model (McRuer and Jex, 1967).
    """
    t = np.asarray(time_s, dtype=np.float64)
    dt_s = float(t[1] - t[0])
    target = np.zeros(len(t))
    at = 0
    while at < len(t):
        until = at + max(1, round(rng.uniform(0.5, 3.0) / dt_s))
        target[at:until] = 0.0 if rng.random() < 0.25 else peak * rng.uniform(-1.0, 1.0)
        at = until
    pole = np.exp(-dt_s / 0.15)
    return _lag(_lag(target, pole), pole)


def _lag(x: FloatArray, pole: float) -> FloatArray:
    """First-order low pass from rest: y[k] = pole y[k-1] + (1 - pole) x[k]."""
    y = np.empty(len(x))
    state = 0.0
    for k, value in enumerate(x):
        state = pole * state + (1.0 - pole) * float(value)
        y[k] = state
    return y
