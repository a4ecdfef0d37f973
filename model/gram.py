"""Streaming least squares: one pass over the data, bounded memory, honest about its condition.

The data matrix [Phi Y 1] is reduced to its triangle R (RᵀR = [Phi Y 1]ᵀ[Phi Y 1]); every regression on a
subset of its columns is then a small problem on R, without another pass. Two ways lead to R:

1. the Gram matrix, chunk by chunk, and its Cholesky factor: fastest, but the condition enters squared;
2. TSQR (Demmel et al., 2012, SIAM J. Sci. Comput. 34): QR of each chunk stacked under the R so far.

`reduce_data` takes the first where the scaled Gram's condition leaves at least six digits, else the second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray

LARGEST_GRAM_CONDITION = 1e10
"""Condition of the column-scaled Gram (that of Phi squared) up to which Cholesky keeps six digits."""

Pieces = Callable[[], Iterable[tuple[FloatArray, FloatArray]]]


@dataclass(frozen=True)
class Triangle:
    """The triangle of [Phi Y 1].

    Attributes
    ----------
    r : (n + m + 1, n + m + 1) upper triangular.
    n : columns of Phi.
    m : columns of Y.
    rows : samples behind it.
    method : "gram" or "tsqr".
    """

    r: FloatArray
    n: int
    m: int
    rows: int
    method: str

    @property
    def constant(self) -> int:
        """Index of the column of ones."""
        return self.n + self.m


@dataclass(frozen=True)
class LeastSquares:
    """A regression on some columns of a Triangle.

    Attributes
    ----------
    theta : (p,) coefficients in the order of the columns asked for.
    rss : residual sum of squares.
    rows : samples behind it.
    rank : numerical rank; below p the columns are collinear and theta is the shortest solution.
    condition : of the column-scaled regressors.
    unscaled_covariance : (p, p) (PhiᵀPhi)⁻¹; times the residual variance it is theta's covariance.
    """

    theta: FloatArray
    rss: float
    rows: int
    rank: int
    condition: float
    unscaled_covariance: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """(p, p) covariance of theta for white residuals."""
        freedom = max(self.rows - len(self.theta), 1)
        return self.unscaled_covariance * (self.rss / freedom)


def reduce_data(pieces: Pieces) -> Triangle:
    """The triangle of all pieces, by the Gram where its condition allows, else by TSQR (a second pass)."""
    triangle = _by_gram(pieces())
    return _by_tsqr(pieces()) if triangle is None else triangle


def solve(
    triangle: Triangle, columns: Sequence[int], target: int, *, tolerance: float = 1e-15
) -> LeastSquares:
    """Least squares of Y's column `target` on the given columns of [Phi Y 1].

    `tolerance` is the ratio of singular values (columns scaled to length one) below which a direction counts
    as not excited.
    """
    chosen = triangle.r[:, list(columns)]
    goal = triangle.r[:, triangle.n + target]
    lengths = np.linalg.norm(chosen, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    left, sigma, right = np.linalg.svd(chosen / scale, full_matrices=False)
    largest = float(sigma[0]) if len(sigma) else 0.0
    kept = sigma > tolerance * largest
    inverse = np.where(kept, 1.0 / np.where(kept, sigma, 1.0), 0.0)
    theta = (right.T @ (inverse * (left.T @ goal))) / scale
    residual = goal - chosen @ theta
    half = (right.T * inverse) / scale[:, None]
    smallest = float(sigma[-1]) if len(sigma) else 1.0
    return LeastSquares(
        theta=theta,
        rss=float(residual @ residual),
        rows=triangle.rows,
        rank=int(kept.sum()),
        condition=largest / smallest if smallest > 0 else np.inf,
        unscaled_covariance=half @ half.T,
    )


def _bordered(pieces: Iterable[tuple[FloatArray, FloatArray]]) -> Iterator[tuple[FloatArray, int, int]]:
    for phi, y in pieces:
        yield np.column_stack([phi, y, np.ones(len(y))]), phi.shape[1], y.shape[1]


def _by_gram(pieces: Iterable[tuple[FloatArray, FloatArray]]) -> Triangle | None:
    """The Cholesky factor of the Gram, or None where its condition is too large."""
    gram, rows, n, m = np.zeros((0, 0)), 0, 0, 0
    for block, n, m in _bordered(pieces):  # noqa: B007
        gram = block.T @ block if not rows else gram + block.T @ block
        rows += len(block)
    scale = np.sqrt(np.diag(gram))
    if not (scale > 0).all():
        return None
    scaled = gram / np.outer(scale, scale)
    values = np.linalg.eigvalsh(scaled)
    if not values[0] * LARGEST_GRAM_CONDITION > values[-1]:
        return None
    return Triangle(np.linalg.cholesky(scaled).T * scale, n, m, rows, "gram")


def _by_tsqr(pieces: Iterable[tuple[FloatArray, FloatArray]]) -> Triangle:
    r, rows, n, m = np.zeros((0, 0)), 0, 0, 0
    for block, n, m in _bordered(pieces):  # noqa: B007
        below = block if not rows else np.vstack([r, block])
        r = np.asarray(np.linalg.qr(below, mode="r"))
        rows += len(block)
    full = np.zeros((n + m + 1, n + m + 1))
    full[: len(r)] = r
    return Triangle(full, n, m, rows, "tsqr")
