"""Autoregressive models of what a simulation leaves over: for prediction, and for coloured covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter

HIGHEST_ORDER = 12


def burg(errors: Sequence[FloatArray], order: int) -> list[tuple[FloatArray, float]]:
    """Autoregressions of orders 0..order by Burg's method (1975), pooled over segments; always stable.

    Returns
    -------
    (d, variance) per order: d (p + 1,) monic, variance of the innovation.
    """
    forward = [np.asarray(e, dtype=np.float64) for e in errors]
    backward = list(forward)
    samples = sum(len(e) for e in forward)
    variance = sum(float(e @ e) for e in forward) / max(samples, 1)
    d = np.ones(1)
    found = [(d, variance)]
    for _ in range(order):
        f = [e[1:] for e in forward]
        b = [e[:-1] for e in backward]
        energy = sum(float(x @ x) for x in f) + sum(float(x @ x) for x in b)
        if not energy > 0.0:
            break
        k = -2.0 * sum(float(x @ z) for x, z in zip(f, b, strict=True)) / energy
        forward = [x + k * z for x, z in zip(f, b, strict=True)]
        backward = [z + k * x for x, z in zip(f, b, strict=True)]
        d = np.append(d, 0.0) + k * np.append(d, 0.0)[::-1]
        variance *= 1.0 - k * k
        found.append((d, variance))
    return found


def noise_model(errors: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """The autoregression of lowest BIC, and the variance of its innovation."""
    samples = sum(len(e) for e in errors)
    shortest = min((len(e) for e in errors), default=0)
    found = burg(errors, min(HIGHEST_ORDER, samples // 20, max(shortest - 2, 0)))
    tiny = np.finfo(float).tiny
    bic = [samples * np.log(max(v, tiny)) + (len(d) - 1) * np.log(max(samples, 2)) for d, v in found]
    return found[int(np.argmin(bic))]


def coloured_covariance(jacobians: Sequence[FloatArray], d: FloatArray, variance: float) -> FloatArray:
    """(n, n) covariance of a least-squares estimate whose residuals are coloured as 1/D.

    The sandwich (JᵀJ)⁻¹ Jᵀ R J (JᵀJ)⁻¹, R the covariance of the noise: Jᵀ R J is the Gram of J filtered
    backwards in time with 1/D (Söderström & Stoica, 1989, System Identification, 7.5).
    """
    n = jacobians[0].shape[1]
    lengths = np.sqrt(sum(np.einsum("ij,ij->j", j, j) for j in jacobians))
    scale = np.where(lengths > 0, lengths, 1.0)
    scaled = [jacobian / scale for jacobian in jacobians]
    try:
        inverse = np.linalg.inv(sum((j.T @ j for j in scaled), np.zeros((n, n))))
    except np.linalg.LinAlgError:
        return np.full((n, n), np.nan)
    covariance: FloatArray = variance * (inverse @ coloured_gram(scaled, d) @ inverse)
    covariance /= np.outer(scale, scale)
    return covariance


def coloured_gram(jacobians: Sequence[FloatArray], d: FloatArray) -> FloatArray:
    """(n, n) Jᵀ R J for noise that is white noise of variance 1 through 1/D: J filtered backwards in time."""
    backwards = (apply_filter(np.ones(1), d, jacobian[::-1]) for jacobian in jacobians)
    n = jacobians[0].shape[1]
    return np.asarray(sum((b.T @ b for b in backwards), np.zeros((n, n))))


def noise_models(errors: Sequence[FloatArray]) -> FloatArray:
    """(p + 1, n_y) monic autoregression of lowest BIC per column of (N, n_y) errors, padded with zeros."""
    found = [noise_model([e[:, j] for e in errors])[0] for j in range(errors[0].shape[1])]
    noise = np.zeros((max(len(d) for d in found), len(found)))
    for j, d in enumerate(found):
        noise[: len(d), j] = d
    return noise


def output_error_ahead(free: FloatArray, y: FloatArray, noise: FloatArray, k: int) -> FloatArray:
    """(N, n_y) k-step prediction: the free run, and what the noise model foresees of its error.

    `free`, `y`: (N, n_y) free run and measured outputs.
    `noise`: (p + 1, n_y) monic autoregression of y - free per output.
    """
    coloured = np.stack([np.diag(row) for row in noise])
    return free + k_step_ahead(coloured, y - free, np.zeros_like(y), k)


def k_step_ahead(
    a: FloatArray,
    y: FloatArray,
    drive: FloatArray,
    k: int,
    ma: FloatArray | None = None,
    e: FloatArray | None = None,
) -> FloatArray:
    """(N, n_y) k-step predictions of A y = drive + C e from measured y; early rows lean on zeros.

    Row t of `ahead[j]` holds the prediction of y(t + j) at time t; every step is one pass over all t.

    `ma`, `e`: (q + 1, n_y) C and (N, n_y) innovations; C = 1 where they are None.
    """
    blank = np.zeros((1, y.shape[1]))  # so that row k - 1 exists
    y = np.concatenate([blank, y])
    drive = np.concatenate([blank, drive])
    e = None if e is None else np.concatenate([blank, e])
    n = len(y)
    ahead: list[FloatArray] = []
    for j in range(1, k + 1):
        value = np.zeros_like(y)
        value[: n - j] = drive[j:]
        for lag in range(1, min(len(a), n + j)):  # a record may be shorter than the polynomials
            if lag < j:
                value -= ahead[j - lag - 1] @ a[lag].T
            else:
                back = lag - j
                value[back:] -= y[: n - back] @ a[lag].T
        if ma is not None and e is not None:
            for lag in range(j, min(len(ma), n + j)):
                value[lag - j :] += e[: n - lag + j] * ma[lag]
        ahead.append(value)
    out = np.full((n - 1, y.shape[1]), np.nan)
    out[k - 1 :] = ahead[-1][: n - k]
    return out
