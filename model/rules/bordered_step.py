"""Compiled: a damped Gauss-Newton step where every run has unknowns of its own beside the common ones.

The same elimination as `flysid.model.bordered`, for the compiled descent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import compiled


class Normal(NamedTuple):
    """A Gauss-Newton matrix with a border (`flysid.model.bordered`), and half the gradient.

    Attributes
    ----------
    corner : (C, C); border : (S, C, q); blocks : (S, q, q); slope : (C + S q,).
    """

    corner: FloatArray
    border: FloatArray
    blocks: FloatArray
    slope: FloatArray

    def is_finite(self) -> bool:
        """Whether no number has overflowed."""
        return math.isfinite(sum(float(np.abs(part).sum()) for part in self))

    def diagonal(self) -> FloatArray:
        """(C + S q,) of the Gauss-Newton matrix."""
        own = np.diagonal(self.blocks, axis1=1, axis2=2)
        return np.concatenate([np.diagonal(self.corner), own.ravel()])


@compiled
def _cholesky(A, n):  # type: ignore[no-untyped-def]
    """The factor L of the leading (n, n) of A = L L' in its lower triangle; False where there is none."""
    for j in range(n):
        total = A[j, j]
        for k in range(j):
            total -= A[j, k] * A[j, k]
        if not total > 0.0:
            return False
        A[j, j] = math.sqrt(total)
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / A[j, j]
    return True


@compiled
def damped_step(normal, scale, damping, step):  # type: ignore[no-untyped-def]
    """-(H + damping diag(scale²))^-1 gradient into `step`; False where that matrix is not positive definite.

    The blocks are eliminated first (the Schur complement): many short runs are as cheap as a long one.
    """
    corner, border, blocks, slope = normal
    free = corner.shape[0]
    runs = border.shape[0]
    q = border.shape[2]
    C = np.empty((free, free))
    right = np.empty(free)
    lower = np.empty((runs, q, q))
    half = np.empty((runs, q, free + 1))
    for i in range(free):
        right[i] = -slope[i] / scale[i]
        for j in range(i + 1):
            C[i, j] = corner[i, j] / (scale[i] * scale[j])
        C[i, i] += damping
    for s in range(runs):
        at = free + s * q
        D = lower[s]
        for i in range(q):
            for j in range(i + 1):
                D[i, j] = blocks[s, i, j] / (scale[at + i] * scale[at + j])
            D[i, i] += damping
        if not _cholesky(D, q):
            return False
        for i in range(q):
            for c in range(free + 1):
                value = slope[at + i] if c == free else border[s, c, i] / scale[c]
                half[s, i, c] = value / scale[at + i]
            for k in range(i):
                for c in range(free + 1):
                    half[s, i, c] -= D[i, k] * half[s, k, c]
            for c in range(free + 1):
                half[s, i, c] /= D[i, i]
        for k in range(q):
            for i in range(free):
                f = half[s, k, i]
                right[i] += f * half[s, k, free]
                for j in range(i + 1):
                    C[i, j] -= f * half[s, k, j]
    if not _cholesky(C, free):
        return False
    for i in range(free):
        for k in range(i):
            right[i] -= C[i, k] * right[k]
        right[i] /= C[i, i]
    for i in range(free - 1, -1, -1):
        for k in range(i + 1, free):
            right[i] -= C[k, i] * right[k]
        right[i] /= C[i, i]
        step[i] = right[i] / scale[i]
    for s in range(runs):
        at = free + s * q
        for i in range(q - 1, -1, -1):
            value = -half[s, i, free]
            for c in range(free):
                value -= half[s, i, c] * right[c]
            for k in range(i + 1, q):
                value -= lower[s, k, i] * step[at + k]
            step[at + i] = value / lower[s, i, i]
        for i in range(q):
            step[at + i] /= scale[at + i]
    total = 0.0
    for i in range(step.size):
        total += abs(step[i])
    return math.isfinite(total)
