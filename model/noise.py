"""Autoregressive models of what a simulation leaves over, and what its colour does to the covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray

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
        f, b = [e[1:] for e in forward], [e[:-1] for e in backward]
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
    from scipy.signal import lfilter

    n = jacobians[0].shape[1]
    plain, coloured = np.zeros((n, n)), np.zeros((n, n))
    lengths = np.sqrt(sum(np.einsum("ij,ij->j", j, j) for j in jacobians))
    scale = np.where(lengths > 0, lengths, 1.0)
    for jacobian in jacobians:
        scaled = jacobian / scale
        backwards = lfilter([1.0], d, scaled[::-1], axis=0)
        plain += scaled.T @ scaled
        coloured += backwards.T @ backwards
    try:
        inverse = np.linalg.inv(plain)
    except np.linalg.LinAlgError:
        return np.full((n, n), np.nan)
    covariance: FloatArray = variance * (inverse @ coloured @ inverse) / np.outer(scale, scale)
    return covariance
