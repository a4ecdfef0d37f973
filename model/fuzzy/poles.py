"""Poles of a linear model over lags; a stable single rule needs no limits to be bounded."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.freerun import far
from flysid.model.fuzzy.kernel import Lags, Parameters


def pole_radius(A: FloatArray) -> float:
    """Largest pole modulus of y(k) = sum A[j-1] y(k-j), A (na, n_y, n_y)."""
    na, n_y, _ = A.shape
    if na == 0:
        return 0.0
    companion = np.zeros((na * n_y, na * n_y))
    companion[:n_y] = np.hstack(list(A))
    companion[n_y:, :-n_y] = np.eye((na - 1) * n_y)
    return float(np.abs(np.linalg.eigvals(companion)).max())


def unheld(lags: Lags, par: Parameters) -> Parameters:
    """Parameters for a free run that is cut off at the limits afterwards; `par` where it must be held there.

    Lags held at a limit are not those of the linear model: one of high order at a fast rate, although stable,
    overshoots anew from every step at the limit and stays there for ever, so that one noisy start would end
    its free run. What is linear and stable comes back by itself. Several rules, or a rule that integrates or
    grows, are held.
    """
    if len(par.theta) > 1 or pole_radius(_coefficients(lags, par.theta[0])) >= 1.0:
        return par
    return par._replace(limits=far(par.limits))


def _coefficients(lags: Lags, theta: FloatArray) -> FloatArray:
    """(na, n_y, n_y) weights of the outputs' lags in one rule's consequents, theta (n_y, n_x)."""
    n_y = len(theta)
    own = [m for m, column in enumerate(lags.column) if 0 <= column < n_y]
    A = np.zeros((max((int(lags.lag[m]) for m in own), default=0), n_y, n_y))
    for m in own:
        A[lags.lag[m] - 1, :, lags.column[m]] = theta[:, m]
    return A
