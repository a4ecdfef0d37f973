"""The simulation error of a polynomial NARX model: its curvature, the descent, what terms would gain.

Unknowns are the coefficients and, of every run, the outputs before the first computed row: they are measured
with noise like all others, and estimated along (Ljung 1999, section 10.5). They belong to one run each, so
that the matrix has a border (`flysid.model.bordered`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.bordered import Bordered
from flysid.model.narx.free_run_kernel import TermTable, free_run, sweep
from flysid.model.refine import levenberg_marquardt
from flysid.model.regressors import CHUNK_ROWS

_ALIKE = 1e-6
"""Of a candidate's sensitivity, what the others leave: a term that has less says what they say."""


@dataclass(frozen=True, eq=False)
class TermFit:
    """Runs, terms, and what does not move.

    `runs`: normalised W (N, n_y + n_u) of every run, longer than `depth`.
    `limits`: (2, n_y) normalised limits of outputs.
    `depth`: first row that is computed.
    `memory`: rows before it whose outputs are looked back at.
    """

    runs: tuple[FloatArray, ...]
    terms: TermTable
    limits: FloatArray
    depth: int
    memory: int

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return int(self.limits.shape[1])

    @property
    def own(self) -> int:
        """Unknowns that one run has for itself."""
        return self.memory * self.n_y

    @cached_property
    def measured_starts(self) -> FloatArray:
        """(S own,) the outputs before the first computed row, as measured."""
        first = self.depth - self.memory
        return np.concatenate([W[first : self.depth, : self.n_y].ravel() for W in self.runs])

    def _start(self, p: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Of every run W to run in, and its start's distance from what was measured."""
        gaps = p[len(self.terms.equation) :] - self.measured_starts
        for W, gap in zip(self.runs, gaps.reshape(len(self.runs), self.own), strict=True):
            run = W.copy()
            run[self.depth - self.memory : self.depth, : self.n_y] += gap.reshape(self.memory, self.n_y)
            yield run, gap

    def cost(self, p: FloatArray) -> float:
        """Sum of squared errors of the free runs; infinite where one is held at a limit."""
        theta = p[: len(self.terms.equation)]
        total = 0.0
        for W, (run, gap) in zip(self.runs, self._start(p), strict=True):
            if free_run(run, self.depth, self.terms, theta, self.limits):
                return np.inf
            error = (run - W)[self.depth :, : self.n_y]
            total += float(np.vdot(error, error) + gap @ gap)
        return total

    def normal_equations(self, p: FloatArray) -> tuple[float, Bordered, FloatArray]:
        """Cost, Gauss-Newton matrix and half the gradient."""
        count = len(self.terms.equation)
        q = self.own
        corner = np.zeros((count, count))
        border = np.zeros((len(self.runs), count, q))
        blocks = np.tile(np.eye(q), (len(self.runs), 1, 1))
        own = np.zeros((len(self.runs), q))
        common = np.zeros(count)
        total = 0.0
        for s, (W, (run, gap)) in enumerate(zip(self.runs, self._start(p), strict=True)):
            own[s] = gap
            total += float(gap @ gap)
            for error, J in self._pieces(W, run, p[:count]):
                H = J.T @ J
                g = J.T @ error
                corner += H[:count, :count]
                border[s] += H[:count, count:]
                blocks[s] += H[count:, count:]
                common += g[:count]
                own[s] += g[count:]
                total += float(error @ error)
        return total, Bordered(corner, border, blocks), np.concatenate([common, own.ravel()])

    def _pieces(
        self, W: FloatArray, run: FloatArray, theta: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Errors (M,) and sensitivities (M, count + own) of pieces of one run, run on in place."""
        n_y = self.n_y
        count = len(theta)
        deep = max(self.memory, 1)
        past = np.zeros((deep, n_y, count + self.own))
        for place in range(self.own):
            row, i = divmod(place, n_y)
            past[row, i, count + place] = 1.0
        for first in range(self.depth, len(W), CHUNK_ROWS):
            last = min(first + CHUNK_ROWS, len(W))
            S = np.zeros((deep + last - first, *past.shape[1:]))
            S[:deep] = past
            sweep(run, (first, last), self.terms, theta, self.limits, S)
            past = S[-deep:].copy()
            error = (run - W)[first:last, :n_y]
            yield error.ravel(), S[deep:].reshape(error.size, -1)

    def descend(self, begin: FloatArray, iterations: int) -> tuple[FloatArray, float]:
        """Unknowns of least simulation error from `begin`, and that error; infinite where that is held."""
        cost = self.cost(begin)
        if not np.isfinite(cost):
            return begin, np.inf
        found = levenberg_marquardt(
            self.normal_equations, begin, cost=self.cost, max_iterations=iterations, tolerance=1e-5
        )
        return found.theta, found.cost

    def inverse_curvature(self, p: FloatArray) -> FloatArray:
        """(T, T) inverse of the Gauss-Newton matrix of the coefficients, the starts following them.

        Scaled first: a change from sample to sample is a small number beside the signal's own.
        """
        _, matrix, _ = self.normal_equations(p)
        border = matrix.border
        inner = np.linalg.solve(matrix.blocks, border.transpose(0, 2, 1))
        curvature = matrix.corner - np.einsum("spq,sqr->pr", border, inner)
        size = np.sqrt(np.maximum(np.diag(curvature), np.finfo(float).tiny))
        return np.asarray(
            np.linalg.pinv(curvature / np.outer(size, size), hermitian=True) / np.outer(size, size)
        )

    def covariance(self, p: FloatArray, block: int) -> FloatArray:
        """(T, T) of the coefficients, errors being alike over up to `block` rows.

        The sandwich of sums over blocks (Liang & Zeger 1986): errors of a free run are correlated, and the
        usual formula for white ones would be far too sure. Terms count as given, not as searched for.
        """
        count = len(self.terms.equation)
        scores = []
        for W, (run, _) in zip(self.runs, self._start(p), strict=True):
            for error, J in self._pieces(W, run, p[:count]):
                along = J[:, :count] * error[:, None]
                cuts = max(round(len(error) / (block * self.n_y)), 1)
                scores += [piece.sum(axis=0) for piece in np.array_split(along, cuts)]
        pulls = np.array(scores)
        if len(pulls) <= count:
            return np.full((count, count), np.nan)
        inverse = self.inverse_curvature(p)
        return np.asarray(inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / (len(pulls) - count))

    def certainty(self, p: FloatArray, block: int) -> tuple[FloatArray, int]:
        """(T,) coefficients in standard errors, and the number of blocks of about `block` rows they are from.

        As `covariance`, but one by one, the others being fitted again: blocks may be fewer than terms.
        """
        count = len(self.terms.equation)
        pulls = []
        curvature = np.zeros((count, count))
        for W, (run, _) in zip(self.runs, self._start(p), strict=True):
            for error, J in self._pieces(W, run, p[:count]):
                curvature += J[:, :count].T @ J[:, :count]
                along = J[:, :count] * error[:, None]
                cuts = max(round(len(error) / (block * self.n_y)), 1)
                pulls += [piece.sum(axis=0) for piece in np.array_split(along, cuts)]
        size = np.sqrt(np.maximum(np.diag(curvature), np.finfo(float).tiny))
        curvature /= np.outer(size, size)
        own = np.array(pulls) / size
        sure = np.zeros(count)
        for t in range(count):
            rest = np.arange(count) != t
            weights = np.linalg.lstsq(curvature[np.ix_(rest, rest)], curvature[rest, t], rcond=1e-12)[0]
            left = max(float(curvature[t, t] - curvature[t, rest] @ weights), 0.0)
            alone = own[:, t] - own[:, rest] @ weights
            spread = float(np.sqrt(len(alone)) * np.std(alone, ddof=1)) if len(alone) > 1 else np.inf
            sure[t] = abs(p[t]) * size[t] * left / max(spread, np.finfo(float).tiny)
        return sure, len(own)

    def gains(self, p: FloatArray, present: int) -> FloatArray:
        """(C,) fall of the squared error by every term after the first `present`, these following it.

        The orthogonal least squares of Chen, Billings & Luo (1989) on the sensitivities of the free run
        instead of one-step regressors: to first order, but of the error that counts.
        """
        count = len(self.terms.equation)
        across = np.zeros((present, count))
        slope = np.zeros(count)
        size = np.zeros(count)
        for W, (run, _) in zip(self.runs, self._start(p), strict=True):
            for error, J in self._pieces(W, run, p[:count]):
                across += J[:, :present].T @ J[:, :count]
                slope += error @ J[:, :count]
                size += np.einsum("kt,kt->t", J[:, :count], J[:, :count])
        length = np.sqrt(np.maximum(size, np.finfo(float).tiny))
        across /= np.outer(length[:present], length)
        slope /= length
        right = np.column_stack([across[:, present:], slope[:present]])
        weights = np.linalg.lstsq(across[:, :present], right, rcond=1e-12)[0]
        left = 1.0 - np.einsum("tc,tc->c", across[:, present:], weights[:, :-1])
        pull = slope[present:] - across[:, present:].T @ weights[:, -1]
        found = np.where(left > _ALIKE, pull**2 / np.maximum(left, _ALIKE), 0.0)
        return np.where(np.isfinite(found), found, 0.0)
