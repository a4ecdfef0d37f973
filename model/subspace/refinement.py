"""State space fitted to the simulation error: all matrices at once, with exact sensitivities.

The free run of x(k+1) = A x + B u + drift, y = C x + D u + level is brought closest to the measurement by
Levenberg-Marquardt over the full matrices. The choice of coordinates leaves n² directions without effect; the
damping holds the search still along them (McKelvey, Helmersson & Ribarits, 2004, Automatica 40). The first
state of every segment is eliminated (Golub & Pereyra, 1973).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.filters import apply_filter
from flysid.model.covariance import CONFIDENCE_ROWS
from flysid.model.noise import noise_model, noise_models
from flysid.model.polynomials import NEARLY_ONE
from flysid.model.refine import NormalEquations, Refinement, levenberg_marquardt
from flysid.model.regressors import CHUNK_ROWS
from flysid.model.subspace.triangle import Realisation


@dataclass(frozen=True, eq=False)
class SystemFit:
    """The least-squares problem: segments in scaled deviations, and the system to begin with.

    `feedthrough`: D is free; else it stays zero.
    """

    segments: Sequence[Segment]
    start: Realisation
    feedthrough: bool

    @property
    def theta0(self) -> FloatArray:
        """(p,) the start as unknowns: A, B, C, drift, level and, where it is free, D, row by row."""
        s = self.start
        parts = [s.a, s.b, s.c, s.drift, s.level, *([s.d] if self.feedthrough else [])]
        return np.concatenate([p.ravel() for p in parts])

    def system(self, theta: FloatArray) -> Realisation:
        """A realisation without noise of these parameters."""
        s = self.start
        at = 0
        found: list[FloatArray] = []
        for like in (s.a, s.b, s.c, s.drift, s.level, *([s.d] if self.feedthrough else [])):
            found.append(theta[at : at + like.size].reshape(like.shape))
            at += like.size
        a, b, c, drift, level = found[:5]
        d = found[5] if self.feedthrough else np.zeros_like(s.d)
        return replace(s, a=a, b=b, c=c, d=d, drift=drift, level=level, k=np.zeros_like(s.k))

    def settled(self, theta: FloatArray) -> Realisation:
        """The system with the spread of its states and of the errors that are left."""
        runs = list(self.runs(theta))
        errors, states = (np.concatenate([run[part] for run in runs]) for part in (0, 1))
        innovation = np.diag(np.mean(errors**2, axis=0))
        return replace(self.system(theta), innovation=innovation, state=states.T @ states / len(states))

    def noise(self, theta: FloatArray) -> FloatArray:
        """(p + 1, n_y) autoregressions of the errors that are left."""
        return noise_models([e for e, _ in self.runs(theta)])

    def refine(self, max_iterations: int) -> Refinement:
        """Levenberg-Marquardt from the start. Raises FitError: the start's simulation is not finite."""
        return levenberg_marquardt(
            self.normal_equations,
            self.theta0,
            cost=self.cost,
            max_iterations=max_iterations,
            tolerance=1e-5,
        )

    def cost(self, theta: FloatArray) -> float:
        """Sum of squared simulation errors from the best first states; inf where the system grows."""
        system = self.system(theta)
        if not np.abs(np.linalg.eigvals(system.a)).max() < self._radius:
            return np.inf
        total = 0.0
        for segment in self._usable():
            gram = _gram_of(system, segment, np.zeros(system.order), sensitive=False)
            total += float(_eliminate(gram, 0, system.order)[0, 0])
        return total

    def normal_equations(self, theta: FloatArray) -> NormalEquations:
        """Cost, JᵀJ and Jᵀr, first states eliminated (Kaufman's approximation)."""
        system = self.system(theta)
        p = len(theta)
        total = 0.0
        jtj = np.zeros((p, p))
        jtr = np.zeros(p)
        for segment in self._usable():
            first = self.first_state(system, segment)
            gram = _gram_of(system, segment, first, sensitive=True, feedthrough=self.feedthrough)
            left = _eliminate(gram, p, system.order)
            total = total + float(left[-1, -1])
            jtj = jtj + left[:-1, :-1]
            jtr = jtr + left[:-1, -1]
        return total, jtj, jtr

    def first_state(self, system: Realisation, segment: Segment) -> FloatArray:
        """The state that a segment's free run starts from best."""
        n = system.order
        gram = _gram_of(system, segment, np.zeros(n), sensitive=False)
        found: FloatArray = -_solve(gram[:n, :n], gram[:n, -1])
        return found

    def runs(self, theta: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """(N, n_y) simulation errors and (N, n) states of every usable segment."""
        from flysid.model.subspace.kalman import free_states, output_of

        system = self.system(theta)
        for segment in self._usable():
            states = free_states(system, segment.u, self.first_state(system, segment))
            yield segment.y - output_of(system, states, segment.u), states

    def covariance(self, theta: FloatArray) -> FloatArray:
        """(p, p) of theta for the coloured errors that are left, zero along the choice of coordinates.

        The sandwich of `noise.coloured_covariance`, outputs taken as independent of each other.
        """
        system = self.system(theta)
        p = len(theta)
        errors = [e for e, _ in self.runs(theta)]
        models = [noise_model([e[:, o] for e in errors]) for o in range(len(system.c))]
        plain = np.zeros((p, p))
        coloured = np.zeros((p, p))
        rows = 0
        for segment in self._usable():
            if rows >= CONFIDENCE_ROWS:
                break
            part = segment.slice(0, min(len(segment), CONFIDENCE_ROWS - rows), 1.0)
            first = self.first_state(system, segment)
            whole = np.concatenate([j for _, j in _swept(system, part, first, self.feedthrough)])
            basis = np.linalg.qr(whole[:, :, p:].reshape(-1, system.order))[0]
            jacobian = whole[:, :, :p].reshape(-1, p)
            jacobian = (jacobian - basis @ (basis.T @ jacobian)).reshape(len(part), -1, p)
            for o, (d, variance) in enumerate(models):
                backwards = apply_filter(np.ones(1), d, jacobian[::-1, o])
                plain += jacobian[:, o].T @ jacobian[:, o]
                coloured += variance * backwards.T @ backwards
            rows += len(part)
        size = np.sqrt(np.maximum(np.diag(plain), np.finfo(float).tiny))
        inverse = np.linalg.pinv(plain / np.outer(size, size), rcond=1e-9, hermitian=True)
        inverse = inverse / np.outer(size, size)
        share = rows / sum(len(s) for s in self._usable())
        found: FloatArray = share * inverse @ coloured @ inverse
        return found

    def spread(self, theta: FloatArray) -> FloatArray:
        """(p, p) of an estimate that is not refined: the covariance, and its distance to the refined one.

        Both estimates are of the same system; how far one Gauss-Newton step would go tells what the estimate
        is biased by, which no covariance knows.
        """
        _, jtj, jtr = self.normal_equations(theta)
        assert isinstance(jtj, np.ndarray)
        step = _solve(jtj, jtr)
        found: FloatArray = self.covariance(theta) + np.outer(step, step)
        return found

    @property
    def _radius(self) -> float:
        """Poles stay inside the unit circle, or no further out than they were."""
        return max(1.0, float(np.abs(np.linalg.eigvals(self.start.a)).max()) + 1e-9)

    def _usable(self) -> list[Segment]:
        return [s for s in self.segments if len(s) > 2 * self.start.order + 1]


def mirror(system: Realisation) -> Realisation:
    """The system with its poles outside the unit circle reflected into it; in the same coordinates.

    Where A has no full set of eigenvectors, all poles are drawn in alike.
    """
    values, vectors = np.linalg.eig(system.a)
    size = np.abs(values)
    if np.linalg.cond(vectors) > 1e10:
        return replace(system, a=system.a * NEARLY_ONE / float(size.max()))
    inside = np.where(size > NEARLY_ONE, np.minimum(NEARLY_ONE, 1.0 / size) * values / size, values)
    return replace(system, a=np.real(vectors @ np.diag(inside) @ np.linalg.inv(vectors)))


def _eliminate(gram: FloatArray, p: int, n: int) -> FloatArray:
    """Of the Gram of [J E r], that of [J r] with the columns E projected out."""
    e = slice(p, p + n)
    rest = [*range(p), p + n]
    inner = gram[np.ix_(rest, rest)]
    cross = gram[e][:, rest]
    with np.errstate(invalid="ignore", over="ignore"):
        left: FloatArray = inner - cross.T @ _solve(gram[e, e], cross)
    left[-1, -1] = max(left[-1, -1], 0.0) if np.isfinite(left[-1, -1]) else np.inf
    return left


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The shortest solution; NaN where the matrix is not finite."""
    if not np.isfinite(matrix).all() or not np.isfinite(right).all():
        return np.full(right.shape, np.nan)
    size = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-12, hermitian=True)
    found: FloatArray = scaled @ (right.T / size).T
    return np.asarray((found.T / size).T)


def _gram_of(
    system: Realisation, segment: Segment, first: FloatArray, *, sensitive: bool, feedthrough: bool = False
) -> FloatArray:
    """The Gram of [J E r] of one segment (of [E r] unless `sensitive`), piece by piece."""
    total: FloatArray | None = None
    n = system.order
    for error, jacobian in _swept(system, segment, first, feedthrough, sensitive=sensitive):
        block = np.concatenate([jacobian.reshape(-1, jacobian.shape[2]), error.reshape(-1, 1)], axis=1)
        part = block.T @ block
        total = part if total is None else total + part
    return np.zeros((n + 1, n + 1)) if total is None else total


def _swept(
    system: Realisation,
    segment: Segment,
    first: FloatArray,
    feedthrough: bool,
    *,
    sensitive: bool = True,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Errors (simulated minus measured) and their derivatives (rows, n_y, p + n), in pieces."""
    n = system.order
    (n_y, n_u) = system.d.shape
    p = n * n + n * n_u + n_y * n + n + n_y + (n_y * n_u if feedthrough else 0)
    columns = p if sensitive else 0
    size = max(CHUNK_ROWS // (4 * (columns + n)), 64)
    x = first.copy()
    slopes = np.zeros((n, columns + n))
    slopes[:, columns:] = np.eye(n)
    kernel = _kernel()
    for start in range(0, len(segment), size):
        u = segment.u[start : start + size]
        y = segment.y[start : start + size]
        matrices = (system.a, system.b, system.c, system.d, system.drift, system.level)
        error, jacobian, x, slopes = kernel(matrices, u, y, x, slopes, sensitive, feedthrough)
        yield error, jacobian


@cache
def _kernel() -> Any:
    from flysid.compiling import njit

    @njit(cache=True)
    def run(
        matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
        u: FloatArray,
        y: FloatArray,
        x: FloatArray,
        slopes: FloatArray,
        sensitive: bool,
        feedthrough: bool,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        a, b, c, d, drift, level = matrices
        rows, n_u = u.shape
        n_y, n = c.shape
        columns = slopes.shape[1]
        error = np.empty((rows, n_y))
        jacobian = np.zeros((rows, n_y, columns))
        at_b = n * n
        at_c = n * n + n * n_u
        at_drift = at_c + n_y * n
        at_level = at_drift + n
        at_d = at_drift + n + n_y
        following = np.empty_like(x)
        moved = np.empty_like(slopes)
        for k in range(rows):
            for o in range(n_y):
                value = level[o] - y[k, o]
                for j in range(n):
                    value += c[o, j] * x[j]
                    for q in range(columns):
                        jacobian[k, o, q] += c[o, j] * slopes[j, q]
                for j in range(n_u):
                    value += d[o, j] * u[k, j]
                error[k, o] = value
                if sensitive:
                    for j in range(n):
                        jacobian[k, o, at_c + o * n + j] += x[j]
                    jacobian[k, o, at_level + o] += 1.0
                    if feedthrough:
                        for j in range(n_u):
                            jacobian[k, o, at_d + o * n_u + j] += u[k, j]
            for i in range(n):
                value = drift[i]
                for q in range(columns):
                    moved[i, q] = 0.0
                for j in range(n):
                    value += a[i, j] * x[j]
                    for q in range(columns):
                        moved[i, q] += a[i, j] * slopes[j, q]
                for j in range(n_u):
                    value += b[i, j] * u[k, j]
                following[i] = value
                if sensitive:
                    for j in range(n):
                        moved[i, i * n + j] += x[j]
                    for j in range(n_u):
                        moved[i, at_b + i * n_u + j] += u[k, j]
                    moved[i, at_drift + i] += 1.0
            x, following = following, x
            slopes, moved = moved, slopes
        return error, jacobian, x.copy(), slopes.copy()

    return run
