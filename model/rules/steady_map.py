"""Where a model of rules comes to rest, and its tangent there: one law for lags and states.

About a place at rest a model is its tangent: the blend of its consequents and, where its conditions speak of
what moves, the slopes of its memberships. A rule by itself is neither: what tells it from the others may
stand in its constant, which no gain shows (Johansen, Shorten and Murray-Smith 2000).

Places are found at given outputs, not at given inputs: of several places at rest for one input each has an
output of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.kernel import Lags, Parameters, strengths
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.regressor_layout import Layout

_NEWTON = 30  # steps to a place at rest


@dataclass(frozen=True, eq=False)
class Place:
    """Constant signals, and what a model does about them, normalised.

    Attributes
    ----------
    w : (n + n_u,) where every column stands.
    tangent : the model's derivative there; its constant is (n,) what the model steps to from there.
    shares : (R,) how loudly each rule speaks.
    """

    w: FloatArray
    tangent: Recursion
    shares: FloatArray

    @property
    def gap(self) -> FloatArray:
        """(n,) how far the next step leads from here; 0 at rest."""
        return self.tangent.c - self.w[: len(self.tangent.c)]


@dataclass(frozen=True, eq=False)
class SteadyMap:
    """Places of a model."""

    layout: Layout
    parameters: Parameters

    @property
    def n(self) -> int:
        """Simulated columns."""
        return self.layout.n

    @cached_property
    def _terms(self) -> Lags:
        """Everything that a step looks back to: regressors, and antecedents."""
        lags = self.layout.lags
        minus = lags.z_minus >= 0
        return lags._replace(
            column=np.concatenate([lags.column, lags.z_column, lags.z_column[minus]]),
            lag=np.concatenate([lags.lag, lags.z_lag, lags.z_minus[minus]]),
        )

    def at(self, w: FloatArray) -> Place:
        """The place where every signal has stood at w for long."""
        lags = self.layout.lags
        par = self.parameters
        own = lags.column >= 0
        x = np.where(own, w[lags.column], 1.0)
        minus = lags.z_minus >= 0
        z = np.where(minus, 0.0, w[lags.z_column]) if len(minus) else np.zeros(0)
        moves = (z > par.z_range[0]) & (z < par.z_range[1])
        lean = (np.clip(z, *par.z_range) - par.centre) / par.width
        shares = strengths(z[None], par)[0]
        part = par.theta @ x
        value = shares @ part
        blend = np.tensordot(shares, par.theta, axes=1)
        slopes = -np.einsum("r,ri,rj->ij", shares, part - value, lean / par.width) * moves
        weights = np.concatenate([blend, slopes, -slopes[:, minus]], axis=1)
        return Place(w, Recursion.of(self._terms, weights, len(w))._replace(c=value), shares)

    def resting(self, start: FloatArray, output: int, moved: int) -> Place | None:
        """Where the model rests while an output stands where `start` has it; None where none is found.

        Parameters
        ----------
        start : (n + n_u,) all other columns of outputs and states are searched from here, inputs stay,
        moved : but this one, which holds the output there.
        """
        free = [*(c for c in range(self.n) if c != output), self.n + moved]
        return self.solved(start, free, range(self.n))

    def solved(self, start: FloatArray, free: Sequence[int], rows: Sequence[int]) -> Place | None:
        """Where the columns `rows` step to themselves, found by moving the columns `free` (Newton)."""
        free, rows = list(free), list(rows)
        place = self.at(start)
        for _ in range(_NEWTON):
            gap = place.gap[rows]
            size = float(np.abs(gap).max(initial=0.0))
            if size < ROUNDING:
                return place
            A, B, _ = place.tangent
            slopes = np.hstack([A.sum(axis=0) - np.eye(self.n), B.sum(axis=0)])
            step = np.linalg.lstsq(slopes[np.ix_(rows, free)], -gap, rcond=None)[0]
            for shorter in 0.5 ** np.arange(8):
                w = place.w.copy()
                w[free] += shorter * step
                tried = self.at(w)
                if np.abs(tried.gap[rows]).max() < size:
                    break
            else:
                return None
            place = tried
        return None
