"""Free run of a linear difference equation, and the state it starts from.

With A_0 = I:  y(k) = sum_l [B_l u(k-l) - A_l y(k-l)] + c.  The state at time k is z (L, n_y), L the deepest
lag: z_i(k) = sum_{l>i} [B_l u(k+i-l) - A_l y(k+i-l)], what the past still contributes to y(k+i) (the
transposed direct form, so that y(k) = z_0(k) + B_0 u(k) + c).

Diagonal A (one output, or outputs that do not feed each other) runs through a compiled filter; coupled
outputs through a compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter


@dataclass(frozen=True, eq=False)
class Difference:
    """The equation: a (na + 1, n_y, n_y) with a[0] = I, b (nb + 1, n_y, n_u), c (n_y,)."""

    a: FloatArray
    b: FloatArray
    c: FloatArray

    @property
    def depth(self) -> int:
        """L: the deepest lag."""
        return max(len(self.a), len(self.b)) - 1

    @property
    def is_diagonal(self) -> bool:
        """No output feeds another."""
        n = self.a.shape[1]
        return n == 1 or not self.a[:, ~np.eye(n, dtype=bool)].any()

    def drive(self, u: FloatArray) -> FloatArray:
        """(N, n_y) sum_l B_l u(k-l) + c for inputs that were zero before."""
        out = np.empty((len(u), len(self.c)))
        out[:] = self.c
        for i, j in np.ndindex(*self.b.shape[1:]):
            taps = self.b[:, i, j]
            if taps.any():
                out[:, i] += apply_filter(taps, np.ones(1), u[:, j])
        return out

    def state(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(L, n_y) state after the rows of u and y; rows further back were zero."""
        depth = self.depth
        z = np.zeros((depth, self.a.shape[1]))
        for lag in range(1, depth + 1):
            first = max(0, lag - len(y))
            rows = slice(len(y) + first - lag, None)
            if lag < len(self.b):
                z[first:lag] += (self.b[lag] @ u[rows, :, None])[:, :, 0]
            if lag < len(self.a):
                z[first:lag] -= (self.a[lag] @ y[rows, :, None])[:, :, 0]
        return z

    def run(self, u: FloatArray, z: FloatArray) -> FloatArray:
        """(N, n_y) free run from state z; not finite where it overflows."""
        return self.respond(self.drive(u), z)

    def respond(self, drive: FloatArray, z: FloatArray) -> FloatArray:
        """(N, n_y) free run of A y = drive from state z."""
        depth = self.depth
        if depth == 0:
            return drive
        if self.is_diagonal:
            unit = np.eye(1, depth + 1)[0]
            out = np.empty_like(drive)
            for i in range(drive.shape[1]):
                a = np.zeros(depth + 1)
                a[: len(self.a)] = self.a[:, i, i]
                out[:, i] = apply_filter(unit, a, drive[:, i], z[:, i])
            return out
        a = np.zeros((depth + 1, *self.a.shape[1:]))
        a[: len(self.a)] = self.a
        result: FloatArray = _coupled_kernel()(a, drive, z)
        return result

    def state_history(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, L, n_y) states before every row, along inputs and outputs that were zero before."""
        depth = self.depth
        n = len(y)
        z = np.zeros((depth, n + 1, y.shape[1]))
        for i in range(depth - 1, -1, -1):
            lag = i + 1
            if lag < depth:
                z[i, 1:] = z[lag, :-1]
            if lag < len(self.b):
                z[i, 1:] += u @ self.b[lag].T
            if lag < len(self.a):
                z[i, 1:] -= y @ self.a[lag].T
        return np.ascontiguousarray(z[:, :-1].transpose(1, 0, 2))


@cache
def _coupled_kernel() -> Any:
    from flysid.compiling import njit

    @njit(cache=True)
    def coupled(a: FloatArray, drive: FloatArray, z0: FloatArray) -> FloatArray:
        depth, n_y = z0.shape
        z = z0.copy()
        out = np.empty_like(drive)
        for k in range(drive.shape[0]):
            for i in range(n_y):
                out[k, i] = drive[k, i] + z[0, i]
            for lag in range(1, depth + 1):
                for i in range(n_y):
                    value = z[lag, i] if lag < depth else 0.0
                    for j in range(n_y):
                        value -= a[lag, i, j] * out[k, j]
                    z[lag - 1, i] = value
        return out

    return coupled


def far(limits: FloatArray, *, ranges: float = 100.0) -> FloatArray:
    """Limits (2, n_y) so far off that only what grows without end, or an absurd start, gets there.

    `ranges`: ranges between limits.
    """
    margin = ranges * (limits[1] - limits[0])
    return np.stack([limits[0] - margin, limits[1] + margin])


def saturate(y: FloatArray, limits: FloatArray) -> FloatArray:
    """The rows clipped to (2, n_y) limits; after an overflow, the limit last touched.

    Overflow to infinity and then NaN is how an unstable recursion ends.
    """
    out = np.array(y)
    for i in range(y.shape[1]):
        bad = np.flatnonzero(~np.isfinite(y[:, i]))
        if len(bad):
            before = y[bad[0] - 1, i] if bad[0] else 0.0
            out[bad[0] :, i] = limits[1, i] if before > limits[:, i].mean() else limits[0, i]
    return np.clip(out, limits[0], limits[1])
