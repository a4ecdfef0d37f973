"""Continuous-time transfer functions with intervals, in the style flight-test engineers print them.

A fitted discrete model behind a zero-order hold is turned into the continuous one with the same samples
(the inverse of step-invariant sampling; Åström & Wittenmark, 1997, Computer-Controlled Systems, 2.3); delays
beyond one sample become a dead time. Standard errors follow from the model's covariance (delta method).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError, UsageError
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.linear.difference_equation import FittedLinear


def continuous(
    model: FittedLinear, output: int = 0, source: int = 0, *, relative_step: float = 1e-5
) -> ContinuousTransfer:
    """The continuous transfer function behind a fitted model.

    `output`, `source`: which output and which input.
    Raises UsageError: coupled outputs; feed-through with a delay structure that no proper transfer function
    has. Raises FitError: a pole on the negative real axis of z or at zero: faster than the sampling can show.
    """
    if not model.system.is_diagonal:
        raise UsageError("coupled outputs have no transfer functions", hint="fit with refine=True")
    flat = model.flat
    own = _own_parameters(model, output, source)
    delay = _delay(model, output, source)
    numerator, denominator = inverse_hold(*_polynomials(model, flat, output, source), delay, model.dt_s)
    slopes = []
    for index in own:
        step = relative_step * max(model.standard_errors[index], 1e-9 * abs(flat[index]), 1e-300)
        moved = flat.copy()
        moved[index] += step
        top, bottom = inverse_hold(*_polynomials(model, moved, output, source), delay, model.dt_s)
        slopes.append(np.concatenate([top - numerator, (bottom - denominator)[1:], [0.0]]) / step)
    return ContinuousTransfer(
        numerator=numerator,
        denominator=denominator,
        covariance=_covariance(model, own, slopes, len(numerator) + len(denominator)),
        dead_time_s=max(delay - 1, 0) * model.dt_s,
        input=model.inputs[source].name,
        output=model.outputs[output].name,
    )


def _polynomials(
    model: FittedLinear, flat: FloatArray, output: int, source: int
) -> tuple[FloatArray, FloatArray]:
    """b and a of one channel from a flat parameter vector."""
    s = model.system
    a_size = s.a[1:].size
    a = np.concatenate([[1.0], flat[:a_size].reshape(s.a[1:].shape)[:, output, output]])
    return flat[a_size : a_size + s.b.size].reshape(s.b.shape)[:, output, source], a


def _own_parameters(model: FittedLinear, output: int, source: int) -> list[int]:
    """Indices in flat order of the estimated coefficients of one channel."""
    marks = np.zeros(len(model.flat))
    s = model.system
    a_size = s.a[1:].size
    marks[:a_size].reshape(s.a[1:].shape)[:, output, output] = 1
    marks[a_size : a_size + s.b.size].reshape(s.b.shape)[:, output, source] = 1
    return [i for i in model.free if marks[i]]


def _delay(model: FittedLinear, output: int, source: int) -> int:
    taps = np.flatnonzero(model.system.b[:, output, source])
    if not len(taps):
        raise UsageError(f"input {model.inputs[source].name!r} has no effect in this model")
    return int(taps[0])


def inverse_hold(b: FloatArray, a: FloatArray, delay: int, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Numerator and monic denominator in s whose step-invariant samples are b / a (delay taken out).

    Raises UsageError: more coefficients in b than a transfer function of this order has samples.
    Raises FitError: a pole is faster than the sampling can show.
    """
    from scipy.linalg import logm

    a = np.trim_zeros(a, "b")
    n = len(a) - 1
    taps = b[max(delay - 1, 0) :] if delay else b
    taps = np.trim_zeros(taps, "b")
    if len(taps) > n + 1:
        raise UsageError(
            f"{len(taps) - 1} coefficients of B on an order of {n} have no continuous transfer function",
            hint="fit with nb not above na (na + 1 where nk = 0)",
        )
    taps = np.concatenate([taps, np.zeros(n + 1 - len(taps))])
    phi = np.eye(n, k=1)
    phi[:, 0] -= a[1:]
    gamma = taps[1:] - a[1:] * taps[0]
    through = taps[0]
    poles = np.linalg.eigvals(phi)
    if (np.abs(poles) < 1e-8).any() or ((poles.real < 0) & (np.abs(poles.imag) < 1e-9)).any():
        raise FitError(
            "a pole is faster than the sampling can show: there is no continuous model",
            hint="choose a lower order, or sample faster",
        )
    joint = np.zeros((n + 1, n + 1))
    joint[:n, :n] = phi
    joint[:n, n] = gamma
    joint[n, n] = 1.0
    with warnings.catch_warnings():
        # SciPy doubts the last three digits, which no fit has
        warnings.filterwarnings("ignore", "logm result may be inaccurate", RuntimeWarning)
        generator = np.real(np.asarray(logm(joint))) / dt_s
    big_a = generator[:n, :n]
    big_b = generator[:n, n]
    row = np.eye(1, n)
    denominator = np.real(np.poly(big_a))
    numerator = np.real(np.poly(big_a - np.outer(big_b, row[0]))) - denominator + through * denominator
    if through == 0.0:
        numerator = numerator[1:]
    return numerator, denominator


def _covariance(
    model: FittedLinear, own: Sequence[int], slopes: Sequence[FloatArray], size: int
) -> FloatArray:
    """(size, size) of [numerator, denominator without its 1, dead time]."""
    if not own:
        return np.full((size, size), np.nan)
    place = [model.free.index(i) for i in own]
    matrix = np.stack(slopes, axis=1)
    return np.asarray(matrix @ model.covariance[np.ix_(place, place)] @ matrix.T)
