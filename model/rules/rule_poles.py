"""Poles of a linear model over lags; a stable single rule needs no limits to be bounded."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.freerun import far
from flysid.model.rules.kernel import Lags, Parameters


def pole_radius(A: FloatArray) -> float:
    """Largest pole modulus of y(k) = sum A[j-1] y(k-j), A (na, n_y, n_y)."""
    if len(A) == 0:
        return 0.0
    return float(np.abs(np.linalg.eigvals(companion(A))).max())


def companion(A: FloatArray) -> FloatArray:
    """(na n_y, na n_y) one-step matrix of the lags of y(k) = sum A[j-1] y(k-j), A (na, n_y, n_y)."""
    na, n_y, _ = A.shape
    matrix = np.eye(na * n_y, k=-n_y)
    matrix[:n_y] = np.hstack(list(A)) if na else np.zeros((0, 0))
    return matrix


def output_lags(lags: Lags, rule: FloatArray) -> FloatArray:
    """(na, n_y, n_y) of one rule's consequents (n_y, n_x): what past outputs weigh, normalised."""
    n_y = len(rule)
    own = [m for m, column in enumerate(lags.column) if 0 <= column < n_y]
    A = np.zeros((max((int(lags.lag[m]) for m in own), default=0), n_y, n_y))
    for m in own:
        A[lags.lag[m] - 1, :, lags.column[m]] = rule[:, m]
    return A


def unheld(lags: Lags, par: Parameters) -> Parameters:
    """Parameters for a free run that is cut off at the limits afterwards; `par` where it must be held there.

    Lags held at a limit are not those of the linear model: one of high order at a fast rate, although stable,
    overshoots anew from every step at the limit and stays there for ever, so that one noisy start would end
    its free run. What is linear and stable comes back by itself. Several rules, or a rule that integrates or
    grows, are held.
    """
    if len(par.theta) > 1 or pole_radius(output_lags(lags, par.theta[0])) >= 1.0:
        return par
    return par._replace(limits=far(par.limits))
