"""A linear recursion: what a rule is by itself, and what a model of rules is about a place at rest.

    x(k) = sum_j A[j-1] x(k-j) + sum_j B[j] u(k-j) + c

Poles, gains, time constants, delays and answers to a step are asked here, whichever of both it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference, far
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.kernel import Lags, Parameters

ComplexArray = npt.NDArray[np.complex128]

REACHED = 1.0 - np.exp(-1.0)
"""Of a change, when its time is told: what one slow mode has reached after its time constant."""
_SETTLED = 0.002  # of a change that the slowest mode may still lack at the end of an answer
_LONGEST = 20_000  # samples of an answer


class Answer(NamedTuple):
    """What a small lasting step of one input does to one simulated quantity.

    Attributes
    ----------
    gain : final change per unit.
    reached : samples until 63 % of it is reached for the first time, dead time included; NaN: never.
    overshoot, wrong_way : shares of the final change, 0 where there is none.
    """

    gain: float
    reached: float
    overshoot: float
    wrong_way: float


class Recursion(NamedTuple):
    """A (lags, n, n) of past quantities, B (largest lag + 1, n, n_u) of inputs, c (n,)."""

    A: FloatArray
    B: FloatArray
    c: FloatArray

    @classmethod
    def of(cls, lags: Lags, weights: FloatArray, columns: int) -> Recursion:
        """The recursion of weights (n, n_x) on columns of W (N, `columns`) at lags."""
        n = len(weights)
        column, lag = lags.column, lags.lag
        past = (column >= 0) & (column < n)
        given = column >= n
        A = np.zeros((lag[past].max(initial=0), n, n))
        B = np.zeros((lag[given].max(initial=0) + 1, n, columns - n))
        np.add.at(A.transpose(0, 2, 1), (lag[past] - 1, column[past]), weights[:, past].T)
        np.add.at(B.transpose(0, 2, 1), (lag[given], column[given] - n), weights[:, given].T)
        return cls(A, B, weights[:, column < 0].sum(axis=1))

    @property
    def depth(self) -> int:
        """Samples that it looks back."""
        return max(1, len(self.A), len(self.B) - 1)

    @property
    def poles(self) -> ComplexArray:
        """Slowest first."""
        found = np.linalg.eigvals(companion(self.A)).astype(np.complex128)
        return found[np.argsort(-np.abs(found), kind="stable")]

    @property
    def pole_radius(self) -> float:
        """The largest modulus of a pole."""
        return pole_radius(self.A)

    @property
    def gain(self) -> FloatArray:
        """(n, n_u) steady gain; NaN where it integrates."""
        left = np.eye(len(self.c)) - self.A.sum(axis=0)
        if np.linalg.cond(left) > 1.0 / ROUNDING**1.5 or np.abs(left).max() < ROUNDING**1.5:
            return np.full(self.B.shape[1:], np.nan)
        return np.asarray(np.linalg.solve(left, self.B.sum(axis=0)))

    @property
    def gain_fraction(self) -> tuple[FloatArray, float]:
        """Numerators (n, n_u) and denominator of the steady gain: the latter vanishes where it integrates."""
        adjugates, coefficients = _resolvent(self.A.sum(axis=0))
        return adjugates.sum(axis=0) @ self.B.sum(axis=0), 1.0 + float(coefficients.sum())

    def without_hidden(self, n_y: int) -> Recursion:
        """A state space (one past state) as a difference equation of its first n_y quantities.

        A is (n, n_y, n_y) then, a common denominator.
        """
        (step,), drive, offset = self
        adjugates, coefficients = _resolvent(step)
        B = np.zeros((len(step) + len(drive) - 1, n_y, drive.shape[2]))
        for j, adjugate in enumerate(adjugates):
            B[j : j + len(drive)] += (adjugate @ drive)[:, :n_y]
        A = -coefficients[:, None, None] * np.eye(n_y)
        return Recursion(A, B, (adjugates.sum(axis=0) @ offset)[:n_y])

    def delay(self, output: int, moved: int) -> int:
        """Samples before an output can answer an input: the shortest way through lags and quantities."""
        n = len(self.c)
        steps = np.full((n, n), np.inf)
        for lag in range(len(self.A), 0, -1):
            steps[self.A[lag - 1] != 0.0] = lag
        answering = (self.B[:, :, moved] != 0.0).T
        reach = np.where(answering.any(axis=1), answering.argmax(axis=1), np.inf)
        for _ in range(n):
            reach = np.minimum(reach, (steps + reach).min(axis=1))
        return int(reach[output]) if np.isfinite(reach[output]) else 0

    def samples(self) -> int | None:
        """Samples after which it has settled; None: it does not, or too late."""
        radius = self.pole_radius
        if not radius < 1.0:
            return None
        slow = np.log(_SETTLED) / np.log(radius) if radius > 0.0 else 0.0
        count = int(np.ceil(slow)) + 2 * self.depth + 2
        return count if count <= _LONGEST else None

    def answer(self, moved: int, samples: int, output: int) -> Answer:
        """The answer to a lasting step of one input, over so many samples; of what is stable."""
        gains = np.linalg.solve(np.eye(len(self.c)) - self.A.sum(axis=0), self.B.sum(axis=0)[:, moved])
        with np.errstate(all="ignore"):
            share = self.step(moved, samples)[:, output] / gains[output]
        over, wrong = (float(np.maximum(way, 0.0)) for way in (share.max() - 1.0, -share.min()))
        return Answer(float(gains[output]), crossing(share), over, wrong)

    def step(self, moved: int, samples: int) -> FloatArray:
        """(samples, n) what a lasting unit step of one input adds."""
        u = np.zeros((samples, self.B.shape[2]))
        u[:, moved] = 1.0
        law = self._replace(c=np.zeros_like(self.c)).difference
        return law.run(u, np.zeros((law.depth, len(self.c))))

    @property
    def difference(self) -> Difference:
        """The same equation with the newest on the left side."""
        return Difference(np.concatenate([np.eye(len(self.c))[None], -self.A]), self.B, self.c)


def crossing(share: FloatArray) -> float:
    """Samples, interpolated, until 63 % is passed; NaN where it never is."""
    beyond = np.flatnonzero(share >= REACHED)
    if not len(beyond):
        return float("nan")
    k = int(beyond[0])
    return k - 1 + (REACHED - share[k - 1]) / (share[k] - share[k - 1]) if k else 0.0


def _resolvent(step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """M (n, n, n) and a (n,): (z I - step)^-1 = sum M[j] z^(n-1-j) / (z^n + sum a[j] z^(n-1-j)).

    By the Faddeev-LeVerrier recursion.
    """
    n = len(step)
    M = np.eye(n)
    found = []
    for j in range(n):
        product = M @ step
        a = -float(np.trace(product)) / (j + 1)
        found.append((M, a))
        M = product + a * np.eye(n)
    matrices, coefficients = zip(*found, strict=True)
    return np.array(matrices), np.array(coefficients)


def time_constant(radius: float, dt_s: float) -> float:
    """Seconds in which the slowest mode falls to 1/e; inf where it does not fall."""
    if radius >= 1.0 - ROUNDING:
        return float("inf")
    return 0.0 if radius <= 0.0 else float(-dt_s / np.log(radius))


def pole_radius(A: FloatArray) -> float:
    """Largest pole modulus of x(k) = sum A[j-1] x(k-j), A (lags, n, n)."""
    return float(np.abs(np.linalg.eigvals(companion(A))).max()) if len(A) else 0.0


def companion(A: FloatArray) -> FloatArray:
    """(lags n, lags n) one-step matrix of x(k) = sum A[j-1] x(k-j), A (lags, n, n)."""
    lags, n, _ = A.shape
    matrix = np.eye(lags * n, k=-n)
    matrix[:n] = A.transpose(1, 0, 2).reshape(n, lags * n)[: len(matrix)]
    return matrix


def rule_radius(lags: Lags, rule: FloatArray) -> float:
    """Largest pole modulus of one rule's consequents (n, n_x), normalised."""
    return Recursion.of(lags, rule, max(len(rule), int(lags.column.max(initial=0)) + 1)).pole_radius


def drop_held(lags: Lags, par: Parameters) -> Parameters:
    """Parameters for a free run that is cut off at the limits afterwards; `par` where it must be held there.

    Lags held at a limit are not those of the linear model: one of high order at a fast rate, although stable,
    overshoots anew from every step at the limit and stays there for ever, so that one noisy start would end
    its free run. What is linear and stable comes back by itself. Several rules, or a rule that integrates or
    grows, are held.
    """
    if len(par.theta) > 1 or rule_radius(lags, par.theta[0]) >= 1.0:
        return par
    return par._replace(limits=far(par.limits))
