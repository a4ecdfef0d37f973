"""Bounded least squares over blocks of residuals, and the covariance that blocks show.

Residuals within a block may hang together as they like (gusts, a controller's reaction): the covariance sums
the gradients of whole blocks (a sandwich clustered by blocks; Cameron & Miller, 2015).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.errors import FitError
from flysid.stretch import FloatArray

Block = tuple[FloatArray, FloatArray]
"""(K,) residuals, measured less predicted, and (K, P) derivatives of the predictions."""
Places = npt.NDArray[np.intp]
Blocks = Callable[[FloatArray], Sequence[Block]]


@dataclass(frozen=True, eq=False)
class Found:
    """A minimum.

    Attributes
    ----------
    theta : (P,) all parameters.
    inside : (P,) bool, estimated and away from their limits.
    covariance : (P, P); 0 for what is not inside.
    cost : mean square of the residuals.
    blocks : how many.
    """

    theta: FloatArray
    inside: npt.NDArray[np.bool_]
    covariance: FloatArray
    cost: float
    blocks: int


def robust(residuals: FloatArray) -> FloatArray:
    """Square roots of weights that bend the square into a line beyond two spreads (a soft L1)."""
    scale = 1.4826 * float(np.median(np.abs(residuals)))
    if not scale > 0.0:
        return np.ones_like(residuals)
    return np.asarray((1.0 + (residuals / (2.0 * scale)) ** 2) ** -0.25)


def descend(
    blocks_at: Blocks,
    theta: FloatArray,
    free: Sequence[int],
    limits: tuple[FloatArray, FloatArray],
    prior: FloatArray | None = None,
    *,
    steps: int = 40,
    enough: float = 1e-7,
) -> Found:
    """Levenberg-Marquardt; steps are cut at the limits.

    Parameters
    ----------
    free : indices of parameters that are sought.
    prior : (P,) inverse variances of parameters around 0, in the unit of the residuals; None: none.
    enough : share of the cost that a step must win for another one.

    Raises
    ------
    FitError : the start predicts nothing finite.
    """
    low, high = limits
    index = np.array(sorted(free))
    pull = np.zeros(len(theta)) if prior is None else prior
    theta = np.clip(theta, low, high)
    blocks = blocks_at(theta)
    cost = _cost(blocks, theta, pull)
    if not np.isfinite(cost):
        raise FitError("the start of the vehicle predicts nothing finite", hint="check units and axes")
    damp = 1e-4
    for _ in range(steps):
        gram, back = _normal(blocks, theta, pull, index)
        stuck = ((theta[index] <= low[index]) & (back < 0.0)) | ((theta[index] >= high[index]) & (back > 0.0))
        gram[stuck] = 0.0
        gram[:, stuck] = 0.0
        back = np.where(stuck, 0.0, back)
        size = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        size[stuck] = 1.0
        scaled = gram / np.outer(size, size)
        won = 0.0
        while damp < 1e6:
            step = np.linalg.solve(scaled + damp * np.eye(len(index)), back / size) / size
            other = theta.copy()
            other[index] = np.clip(theta[index] + step, low[index], high[index])
            new = blocks_at(other)
            new_cost = _cost(new, other, pull)
            if new_cost < cost:
                won = cost - new_cost
                theta, blocks, cost = other, new, new_cost
                damp = max(damp / 10.0, 1e-10)
                break
            damp *= 10.0
        if won <= enough * cost:
            break
    return _judge(blocks, theta, pull, index, limits)


def _cost(blocks: Sequence[Block], theta: FloatArray, pull: FloatArray) -> float:
    return sum(float(r @ r) for r, _ in blocks) + float(pull @ theta**2)


def _normal(
    blocks: Sequence[Block], theta: FloatArray, pull: FloatArray, index: Places
) -> tuple[FloatArray, FloatArray]:
    gram = np.diag(pull[index])
    back = -pull[index] * theta[index]
    for residuals, slopes in blocks:
        own = slopes[:, index]
        gram += own.T @ own
        back += own.T @ residuals
    return gram, back


def _judge(
    blocks: Sequence[Block],
    theta: FloatArray,
    pull: FloatArray,
    index: Places,
    limits: tuple[FloatArray, FloatArray],
) -> Found:
    """The minimum with what its blocks say of its covariance."""
    inside = np.zeros(len(theta), dtype=bool)
    inside[index] = (theta[index] > limits[0][index]) & (theta[index] < limits[1][index])
    own = np.flatnonzero(inside)
    gram, _ = _normal(blocks, theta, pull, own)
    size = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    bread = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True)
    scores = np.array([slopes[:, own].T @ residuals for residuals, slopes in blocks]) / size
    middle = scores.T @ scores + np.diag(pull[own] / size**2)
    count = len(blocks)
    middle *= count / max(count - 1, 1)
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(own, own)] = bread @ middle @ bread / np.outer(size, size)
    samples = sum(len(r) for r, _ in blocks)
    return Found(theta, inside, covariance, _cost(blocks, theta, pull) / max(samples, 1), count)
