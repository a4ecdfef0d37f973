"""Where a model of rules comes to rest, and how it answers small steps there: one law for lags and states.

About a place at rest a model is its tangent: the blend of its consequents and, where its conditions speak of
what moves, the slopes of its memberships. A rule by itself is neither: what tells it from the others may
stand in its constant, which no gain shows (Johansen, Shorten and Murray-Smith 2000). The tangent is linear,
one rule over the same lags, and the compiled free run answers the step.

Places are found at given outputs, not at given inputs: of several places at rest for one input each has an
output of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import Lags, Parameters, free_run
from flysid.model.rules.rule_poles import companion

_NEWTON = 30  # steps to a place at rest
_AT_REST = 1e-10  # spreads of the signals
_SETTLED = 0.002  # of a change that the slowest mode may still lack at the end of an answer
_LONGEST = 20_000  # samples of an answer
_REACHED = 1.0 - np.exp(-1.0)


class LaidOut(Protocol):
    """What a layout of lags or states tells here."""

    @property
    def lags(self) -> Lags: ...
    @property
    def scale(self) -> FloatArray: ...


class Answer(NamedTuple):
    """What a small lasting step of one input does to every simulated quantity.

    Attributes
    ----------
    gain : (n,) final change per unit; NaN where none is final.
    reached : (n,) samples until 63 % of it is reached for the first time, dead time included.
    overshoot, wrong_way : (n,) shares of the final change, 0 where there is none.
    """

    gain: FloatArray
    reached: FloatArray
    overshoot: FloatArray
    wrong_way: FloatArray


@dataclass(frozen=True, eq=False)
class Tangent:
    """A model's derivative at constant signals.

    Attributes
    ----------
    value : (n,) what it steps to from there.
    weights : (n, M) of the terms of `SteadyMap.terms`.
    shares : (R,) how loudly each rule speaks.
    """

    value: FloatArray
    weights: FloatArray
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class SteadyMap:
    """Rests and tangents of models of one layout, normalised; w (n + n_u,) is a value for every column."""

    layout: LaidOut

    @cached_property
    def terms(self) -> Lags:
        """Everything that a step looks back to: regressors but the constant, and antecedents."""
        lags = self.layout.lags
        own = self.layout.lags.column >= 0
        minus = lags.z_minus >= 0
        empty = np.zeros(0, dtype=np.int64)
        return Lags(
            np.concatenate([lags.column[own], lags.z_column, lags.z_column[minus]]),
            np.concatenate([lags.lag[own], lags.z_lag, lags.z_minus[minus]]),
            *(empty, empty, empty),
        )

    def tangent(self, par: Parameters, w: FloatArray) -> Tangent:
        """The derivative where every signal has stood at w for long."""
        lags = self.layout.lags
        own = lags.column >= 0
        x = np.where(own, w[lags.column], 1.0)
        minus = lags.z_minus >= 0
        z = np.where(minus, 0.0, w[lags.z_column]) if len(minus) else np.zeros(0)
        moves = (z > par.z_range[0]) & (z < par.z_range[1])
        lean = (np.clip(z, *par.z_range) - par.centre) / par.width
        loud = -0.5 * (lean * lean).sum(axis=1)
        shares = np.exp(loud - loud.max())
        shares /= shares.sum()
        part = par.theta @ x
        value = shares @ part
        blend = np.tensordot(shares, par.theta, axes=1)[:, own]
        slopes = -np.einsum("r,ri,rj->ij", shares, part - value, lean / par.width) * moves
        return Tangent(value, np.concatenate([blend, slopes, -slopes[:, minus]], axis=1), shares)

    def summed(self, tangent: Tangent) -> FloatArray:
        """(n, n + n_u) the tangent's weight of every column, over its lags."""
        found = np.zeros((len(tangent.value), self._columns))
        np.add.at(found.T, self.terms.column, tangent.weights.T)
        return found

    def pole_radius(self, tangent: Tangent) -> float:
        """Of the tangent."""
        n = len(tangent.value)
        past = self.terms.column < n
        A = np.zeros((int(self.terms.lag[past].max(initial=0)), n, n))
        for m in np.flatnonzero(past):
            A[self.terms.lag[m] - 1, :, self.terms.column[m]] += tangent.weights[:, m]
        return float(np.abs(np.linalg.eigvals(companion(A))).max(initial=0.0)) if len(A) else 0.0

    def at_rest(self, par: Parameters, start: FloatArray, output: int, moved: int) -> FloatArray | None:
        """w at which the model rests while an output stands where `start` has it; None where none is found.

        Parameters
        ----------
        start : (n + n_u,) all other columns of outputs and states are searched from here, inputs stay,
        moved : but this one, which holds the output there.
        """
        n = par.theta.shape[1]
        free = [*(c for c in range(n) if c != output), n + moved]
        return self._solved(par, start, free, range(n))

    def resting(self, par: Parameters, start: FloatArray, hidden: Sequence[int]) -> FloatArray | None:
        """w at which some of the simulated columns rest beside all others; None where none is found."""
        return self._solved(par, start, hidden, hidden)

    def _solved(
        self, par: Parameters, start: FloatArray, free: Sequence[int], rows: Sequence[int]
    ) -> FloatArray | None:
        """w from which the columns `rows` step to themselves, found by moving the columns `free` (Newton)."""
        n = par.theta.shape[1]
        rows = list(rows)
        w = start.copy()
        for _ in range(_NEWTON):
            tangent = self.tangent(par, w)
            gap = (tangent.value - w[:n])[rows]
            size = float(np.abs(gap).max(initial=0.0))
            if size < _AT_REST:
                return w
            slopes = self.summed(tangent)
            slopes[:, :n] -= np.eye(n)
            step = np.linalg.lstsq(slopes[np.ix_(rows, free)], -gap, rcond=1e-12)[0]
            for shorter in 0.5 ** np.arange(8):
                tried = w.copy()
                tried[list(free)] += shorter * step
                if np.abs(self.tangent(par, tried).value - tried[:n])[rows].max() < size:
                    break
            else:
                return w if size < 1e3 * _AT_REST else None
            w = tried
        return None

    def samples(self, radius: float) -> int | None:
        """Samples after which a tangent of this pole radius has settled; None: it does not, or too late."""
        if not radius < 1.0:
            return None
        slow = np.log(_SETTLED) / np.log(radius) if radius > 0.0 else 0.0
        count = int(np.ceil(slow)) + 2 * self._depth + 2
        return count if count <= _LONGEST else None

    def answer(self, tangent: Tangent, moved: int, samples: int) -> Answer:
        """The tangent's answer to a step of one input, over so many samples."""
        n = len(tangent.value)
        depth = self._depth
        W = np.zeros((depth + samples, self._columns))
        W[depth:, n + moved] = 1.0
        nothing = np.zeros((1, 0))
        far = np.full(n, 1e300)
        par = Parameters(
            np.ascontiguousarray(tangent.weights[None]),
            nothing,
            nothing,
            np.zeros((2, 0)),
            np.stack([-far, far]),
        )
        free_run(W, depth, self.terms, par)
        whole = self.summed(tangent)
        gain = np.linalg.solve(np.eye(n) - whole[:, :n], whole[:, n + moved])  # it is stable: no pole at one
        with np.errstate(all="ignore"):
            share = W[depth:, :n] / gain
        reached = np.array([_crossing(share[:, i]) for i in range(n)])
        over = np.maximum(share.max(axis=0) - 1.0, 0.0)
        return Answer(np.asarray(gain, dtype=np.float64), reached, over, np.maximum(-share.min(axis=0), 0.0))

    def delay(self, tangent: Tangent, output: int, moved: int) -> int:
        """Samples before an output can answer an input: the shortest way through lags and states."""
        n = len(tangent.value)
        reach = np.full(n, np.inf)
        for _ in range(n):
            for m, (column, lag) in enumerate(zip(self.terms.column, self.terms.lag, strict=True)):
                before = 0.0 if column == n + moved else reach[column] if column < n else np.inf
                found = tangent.weights[:, m] != 0.0
                reach[found] = np.minimum(reach[found], before + float(lag))
        return int(reach[output]) if np.isfinite(reach[output]) else 0

    @cached_property
    def _depth(self) -> int:
        return max(1, int(self.terms.lag.max(initial=1)))

    @property
    def _columns(self) -> int:
        return len(self.layout.scale)


def _crossing(share: FloatArray) -> float:
    """Samples, interpolated, until 63 % is passed; NaN where it never is."""
    beyond = np.flatnonzero(share >= _REACHED)
    if not len(beyond):
        return float("nan")
    k = int(beyond[0])
    if k == 0:
        return 0.0
    return float(k - 1 + (_REACHED - share[k - 1]) / (share[k] - share[k - 1]))
