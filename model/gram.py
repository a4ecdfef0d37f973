"""Streaming least squares: one pass over the data, bounded memory, honest about its condition.

The data matrix [Phi Y 1] is reduced to its triangle R (RᵀR = [Phi Y 1]ᵀ[Phi Y 1]); every regression on a
subset of its columns is then a small problem on R, without another pass. Two ways lead to R:

1. the Gram matrix (`flysid.lagged`) and its Cholesky factor: fastest, but the condition enters squared;
2. TSQR (Demmel et al., 2012, SIAM J. Sci. Comput. 34): QR of each chunk stacked under the R so far.

`reduce_data` takes the first where the scaled Gram's condition leaves at least six digits, else the second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.lagged import CHUNK_ROWS, lagged_gram
from flysid.model.arguments import none_longer
from flysid.model.stream import Blocks, windows

Pieces = Callable[[], Iterable[tuple[FloatArray, FloatArray]]]


@dataclass(frozen=True)
class Triangle:
    """The triangle of [Phi Y 1].

    `r`: (n + m + 1, n + m + 1) upper triangular.
    `n`: columns of Phi.
    `m`: columns of Y.
    `rows`: samples behind it.
    `method`: "gram" or "tsqr".
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

    `theta`: (p,) coefficients in the order of the columns asked for.
    `rss`: residual sum of squares.
    `rows`: samples behind it.
    `rank`: numerical rank; below p the columns are collinear and theta is the shortest solution.
    `condition`: of the column-scaled regressors.
    `unscaled_covariance`: (p, p) (PhiᵀPhi)⁻¹; times the residual variance it is theta's covariance.
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


def reduce_data(pieces: Pieces, gram: FloatArray | None = None) -> Triangle:
    """The triangle of all pieces (Phi, Y), by the Gram where its condition allows, else by TSQR.

    `pieces`: called for every pass over the data.
    `gram`: of [Phi Y 1], where it is known already (see `lagged_gram`).
    """
    first = next(iter(pieces()))
    rows = 0
    n = first[0].shape[1]
    m = first[1].shape[1]
    if gram is None:
        gram, rows = _add_up(pieces())
    rows = rows or round(float(gram[-1, -1]))
    r = triangle_of(gram)
    if r is not None:
        return Triangle(r, n, m, rows, "gram")
    return Triangle(_by_tsqr(pieces(), n + m + 1), n, m, rows, "tsqr")


def triangle_of(gram: FloatArray, *, largest_condition: float = 1e10) -> FloatArray | None:
    """The Cholesky factor R of a Gram, or None where its condition, columns scaled, is too large.

    `largest_condition`: of the column-scaled Gram (that of Phi squared), up to which six digits are kept.
    """
    scale = np.sqrt(np.diag(gram))
    if not (scale > 0).all():
        return None
    scaled = gram / np.outer(scale, scale)
    values = np.linalg.eigvalsh(scaled)
    if not values[0] * largest_condition > values[-1]:
        return None
    r: FloatArray = np.linalg.cholesky(scaled).T * scale
    return r


def lagged_triangle(
    blocks: Blocks, depth: int, scale: FloatArray, pick: Sequence[int] | None = None, targets: int = 0
) -> Triangle:
    """The triangle of lagged signals (over their scale) and of a constant, in one pass and bounded memory.

    By the Gram where its condition allows, else by TSQR.

    `pick`: columns of `lagged_gram` but the constant, in the order wanted; all of them when None.
    `targets`: how many of them, the last, are the Triangle's Y.
    Raises DataError: no segment is longer than `depth`.
    """
    gram = lagged_gram(windows(blocks(), depth), depth)
    if len(gram) == 1:
        raise none_longer(depth)
    pick = range(len(gram) - 1) if pick is None else pick
    rows = round(float(gram[-1, -1]))
    factor = np.append(np.repeat(scale, depth + 1)[list(pick)], 1.0)
    gram = gram[np.ix_([*pick, -1], [*pick, -1])] / np.outer(factor, factor)
    n = len(pick) - targets
    r = triangle_of(gram)
    if r is not None:
        return Triangle(r, n, targets, rows, "gram")
    none = np.zeros((0, 0))
    pieces = ((phi / factor[:-1], none) for phi in _lagged_rows(blocks, depth, pick))
    return Triangle(_by_tsqr(pieces, len(gram)), n, targets, rows, "tsqr")


def _lagged_rows(blocks: Blocks, depth: int, pick: Sequence[int]) -> Iterator[FloatArray]:
    """Rows of some lags of the signals, in pieces that are tall against their width."""
    places = [divmod(column, depth + 1) for column in pick]
    size = max(CHUNK_ROWS // 4, 4 * len(pick))
    for _, window in windows(blocks(), depth):
        for start in range(depth, window.shape[1], size):
            stop = min(start + size, window.shape[1])
            yield np.stack([window[signal, start - lag : stop - lag] for signal, lag in places], axis=1)


def _add_up(pieces: Iterable[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, int]:
    gram = np.zeros((0, 0))
    rows = 0
    for phi, y in pieces:
        block = np.column_stack([phi, y, np.ones(len(y))])
        gram = block.T @ block if not rows else gram + block.T @ block
        rows += len(block)
    return gram, rows


def _by_tsqr(pieces: Iterable[tuple[FloatArray, FloatArray]], columns: int) -> FloatArray:
    blocks = ([phi, y, np.ones(len(phi))] if y.size else [phi, np.ones(len(phi))] for phi, y in pieces)
    return tsqr((np.column_stack(parts) for parts in blocks), columns)


def tsqr(blocks: Iterable[FloatArray], columns: int) -> FloatArray:
    """The triangle R of all blocks stacked, its diagonal not negative; blocks may be triangles themselves.

    Parameters
    ----------
    blocks : (any, columns) rows.

    Returns
    -------
    (columns, columns) upper triangular, RᵀR = the sum of the blocks' BᵀB.
    """
    r = np.zeros((0, columns))
    for block in blocks:
        r = np.asarray(np.linalg.qr(np.vstack([r, block]), mode="r"))
    full = np.zeros((columns, columns))
    full[: len(r)] = r
    return np.where(np.diag(full) < 0.0, -1.0, 1.0)[:, None] * full


def residuals_of(
    triangle: Triangle, columns: Sequence[int], *, tolerance: float = 1e-15
) -> FloatArray | None:
    """(m,) residual sums of squares of all columns of Y on the given columns; None where these are collinear.

    Cheaper than `solve` by several times: for grids.
    """
    p = len(columns)
    pick = [*columns, *range(triangle.n, triangle.n + triangle.m)]
    r = np.asarray(np.linalg.qr(triangle.r[:, pick], mode="r"))
    lengths = np.linalg.norm(r[:, :p], axis=0)
    if p > len(r) or (np.abs(np.diag(r)[:p]) <= tolerance * lengths).any():
        return None
    rest: FloatArray = np.einsum("ij,ij->j", r[p:, p:], r[p:, p:])
    return rest


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
