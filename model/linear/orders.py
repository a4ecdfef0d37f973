"""Orders and delays of equation-error models: whole grids from one pass over the data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.lagged import lagged_gram
from flysid.model.arguments import none_longer
from flysid.model.gram import LeastSquares, Triangle, lagged_triangle, residuals_of, solve
from flysid.model.regressors import LagTerms, RegressorTransform
from flysid.model.stream import Source, blocks_of, windows

ROUNDING = float(np.finfo(float).eps) ** 2
"""Mean square, relative to the output's, below which a one-step residual is rounding."""


@dataclass(frozen=True)
class OrderChoice:
    """Orders of an ARX model: na for all outputs, nb and nk per input."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]

    def lags(self, n_y: int) -> LagTerms:
        """The lags of every output's equation."""
        return LagTerms.arx((self.na,) * n_y, self.nb, self.nk)

    def __str__(self) -> str:
        def one(values: tuple[int, ...]) -> str:
            return str(values[0]) if len(set(values)) == 1 else str(values)

        return f"na = {self.na}, nb = {one(self.nb)}, nk = {one(self.nk)}"


@dataclass(frozen=True, eq=False)
class Grid:
    """A Triangle over all lags that any choice needs: y lags 1..na, u lags 0..last_u."""

    triangle: Triangle
    n_y: int
    n_u: int
    na: int
    last_u: int
    offset: bool

    @staticmethod
    def lags(n_y: int, n_u: int, na: int, last_u: int) -> LagTerms:
        """The columns of the grid."""
        return LagTerms.arx((na,) * n_y, (last_u + 1,) * n_u, (0,) * n_u)

    def columns(self, choice: OrderChoice) -> list[int]:
        """Columns of the triangle that a choice regresses on, the constant last."""
        found = [j * self.na + lag - 1 for j in range(self.n_y) for lag in range(1, choice.na + 1)]
        base = self.n_y * self.na
        for j, (count, delay) in enumerate(zip(choice.nb, choice.nk, strict=True)):
            found += [base + j * (self.last_u + 1) + lag for lag in range(delay, delay + count)]
        return found + ([self.triangle.constant] if self.offset else [])

    def fit(self, choice: OrderChoice) -> list[LeastSquares]:
        """One regression per output."""
        columns = self.columns(choice)
        return [solve(self.triangle, columns, i) for i in range(self.n_y)]

    def bic(self, choice: OrderChoice) -> float:
        """Bayesian information criterion (Schwarz, 1978) of the one-step residuals; inf where collinear."""
        columns = self.columns(choice)
        rss = residuals_of(self.triangle, columns)
        if rss is None:
            return np.inf
        targets = self.triangle.r[:, self.triangle.n : self.triangle.n + self.n_y]
        floor = np.maximum(ROUNDING * np.sum(targets**2, axis=0), np.finfo(float).tiny)
        rows = self.triangle.rows
        fit = rows * float(np.sum(np.log(np.maximum(rss, floor) / rows)))
        return fit + self.n_y * len(columns) * float(np.log(rows))


def grid_triangle(data: Source, lags: LagTerms, transform: RegressorTransform | None = None) -> Triangle:
    """The triangle of [Phi Y 1] for the lags of a Grid, from memory or from disk.

    Raises DataError: no segment is longer than the deepest lag.
    """
    origin, scale = _units(lags, transform)
    return lagged_triangle(blocks_of(data, origin), lags.depth, scale, _columns(lags), len(lags.y))


def grid_gram(data: Source, lags: LagTerms, transform: RegressorTransform | None = None) -> FloatArray:
    """The Gram of [Phi Y 1]; see `grid_triangle`.

    Raises DataError: no segment is longer than the deepest lag.
    """
    origin, scale = _units(lags, transform)
    full = lagged_gram(windows(blocks_of(data, origin)(), lags.depth), lags.depth)
    if len(full) == 1:
        raise none_longer(lags.depth)
    pick = _columns(lags)
    factor = np.append(np.repeat(scale, lags.depth + 1)[pick], 1.0)
    found: FloatArray = full[np.ix_([*pick, -1], [*pick, -1])] / np.outer(factor, factor)
    return found


def _units(lags: LagTerms, transform: RegressorTransform | None) -> tuple[FloatArray, FloatArray]:
    if transform is None:
        return np.zeros(len(lags.y) + len(lags.u)), np.ones(len(lags.y) + len(lags.u))
    return (
        np.concatenate([transform.y_origin, transform.u_origin]),
        np.concatenate([transform.y_scale, transform.u_scale]),
    )


def _columns(lags: LagTerms) -> list[int]:
    """Where [Phi Y] stands among all lags 0..depth of all signals."""
    step = lags.depth + 1
    pick = [j * step + lag for j, own in enumerate((*lags.y, *lags.u)) for lag in own]
    return pick + [j * step for j in range(len(lags.y))]


def best_of(grid: Grid, choices: Iterable[OrderChoice]) -> OrderChoice | None:
    """The choice of lowest BIC; None when all are collinear."""
    scored = [(grid.bic(c), c) for c in choices]
    scored = [s for s in scored if np.isfinite(s[0])]
    return min(scored, key=lambda s: s[0])[1] if scored else None


def best_per_order(
    grid: Grid, nas: Sequence[int], nbs: Sequence[tuple[int, ...]], nks: Sequence[Sequence[int]]
) -> list[OrderChoice]:
    """For every na the best nb and nk by BIC, simplest first.

    `nbs`: coefficients per input, every combination to try; those beyond na + 1 are passed over, because a
        long B on a short A fits an input's spectrum, not the plant.
    `nks`: delays to try, per input. Delays of several inputs are searched one input at a time.
    """
    found = []
    for na in nas:
        fitting = [nb for nb in nbs if max(nb) <= na + 1] or list(nbs)
        nk = tuple(options[0] for options in nks)
        for _ in range(1 if len(nks) == 1 else 2):
            for j, options in enumerate(nks):
                tries = (OrderChoice(na, nb, (*nk[:j], d, *nk[j + 1 :])) for nb in fitting for d in options)
                best = best_of(grid, tries)
                if best is not None:
                    nk = best.nk
        best = best_of(grid, (OrderChoice(na, nb, nk) for nb in fitting))
        if best is not None:
            found.append(best)
    return found
