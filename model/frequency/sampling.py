"""A transfer function in s behind a hold, sampled exactly, dead time to fractions of a sample.

The response to one held sample is made of step (zero-order hold) or ramp responses (first-order hold: the
input runs straight between samples), each delayed by the dead time; multiplied by A(q) they end after a few
lags and are B(q). Åström & Wittenmark (1997), Computer-Controlled Systems, 2.3 and 3.2; computed in time
units of one sample.
"""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.frequency.rational import Hold, Rational
from flysid.model.polynomials import ComplexArray


def sample(rational: Rational, dt_s: float, hold: Hold) -> tuple[FloatArray, list[FloatArray]]:
    """a (n + 1,) monic and one b per input, in rising powers of q⁻¹, from lag 0.

    `hold`: "zero" or "first"; "none" (band-limited) is sampled like "first".
    """
    n = len(rational.denominator) - 1
    power = dt_s ** np.arange(n + 1, dtype=np.float64)
    bottom = rational.denominator * power
    a = np.real(np.poly(np.exp(np.roots(bottom)))) if n else np.ones(1)
    b = []
    for top, dead in zip(rational.numerators, rational.dead_time_s, strict=True):
        scaled = np.zeros(n + 1)
        scaled[n + 1 - len(top) :] = top * power[n + 1 - len(top) :]
        b.append(_numerator(a, bottom, scaled, float(dead) / dt_s, hold))
    return np.asarray(a), b


def sampled_response(rational: Rational, omega: FloatArray, dt_s: float, hold: Hold) -> ComplexArray:
    """(F, n_u) response of the sampled transfer functions; with hold "none", of the continuous ones."""
    if hold == "none":
        return rational.at(omega)
    a, b = sample(rational, dt_s, hold)
    delay = np.exp(-1j * omega * dt_s)[:, None] ** np.arange(max(len(a), *(len(t) for t in b)))
    bottom = delay[:, : len(a)] @ a
    return np.stack([delay[:, : len(t)] @ t / bottom for t in b], axis=1)


def _numerator(a: FloatArray, bottom: FloatArray, top: FloatArray, dead: float, hold: Hold) -> FloatArray:
    """b from lag 0 to the last one that counts; time in samples."""
    n = len(a) - 1
    whole = int(np.floor(dead + 1e-9))
    lags = np.arange(whole, whole + n + 2)
    if hold == "zero":
        step = _responses(bottom, top, lags[0] - 1 - dead, n + 3, order=1)
        response = np.diff(step)
    else:
        ramp = _responses(bottom, top, lags[0] - 1 - dead, n + 4, order=2)
        response = np.diff(ramp, 2)
    taps = np.convolve(a, response)[: n + 2]
    if abs(dead - whole) < 1e-9:
        taps = taps[: n + 1]  # what follows is rounding
    return np.concatenate([np.zeros(whole), taps])


def _responses(bottom: FloatArray, top: FloatArray, start: float, count: int, order: int) -> FloatArray:
    """Step (order 1) or ramp (order 2) response at start, start + 1, ...; 0 before time 0.

    The state [x, u, u'] of the companion form grows by its matrix exponential.
    """
    from scipy.linalg import expm

    n = len(bottom) - 1
    through = top[0]
    generator = np.zeros((n + 2, n + 2))
    if n:
        generator[:n, :n] = np.eye(n, k=1)
        generator[n - 1, :n] = -bottom[1:][::-1]
        generator[n - 1, n] = 1.0
    generator[n, n + 1] = 1.0
    row = np.concatenate([(top[1:] - through * bottom[1:])[::-1], [through, 0.0]])
    state = np.zeros(n + 2)
    state[n + order - 1] = 1.0
    out = np.zeros(count)
    first = int(np.ceil(-start - 1e-9))
    state = expm(generator * max(start + first, 0.0)) @ state
    once = expm(generator)
    for k in range(first, count):
        out[k] = row @ state
        state = once @ state
    return out
