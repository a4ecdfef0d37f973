"""A Gauss-Newton matrix with a border: common unknowns, and unknowns that only one segment has.

    H = [ C    B_1  B_2 .. ]
        [ B_1' D_1         ]
        [ B_2'      D_2    ]

Every segment's initial state is seen by that segment alone, so that elimination of the blocks D_s (the Schur
complement) costs O(S p² q) instead of O((p + S q)³): hundreds of short segments are as cheap as a long one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Bordered:
    """corner (p, p), border (S, p, q), blocks (S, q, q); p common unknowns, then S times q own ones."""

    corner: FloatArray
    border: FloatArray
    blocks: FloatArray

    def diagonal(self) -> FloatArray:
        """(p + S q,) the diagonal."""
        inner = np.diagonal(self.blocks, axis1=1, axis2=2).ravel()
        return np.concatenate([np.diagonal(self.corner), inner])

    def is_finite(self) -> bool:
        """Whether every entry is finite."""
        return all(bool(np.isfinite(part).all()) for part in (self.corner, self.border, self.blocks))

    def damped_step(self, scale: FloatArray, damping: float, gradient: FloatArray) -> FloatArray | None:
        """-(H + damping diag(scale²))⁻¹ gradient, or None where that matrix is not positive definite."""
        from scipy.linalg.lapack import dposv

        p = len(self.corner)
        (count, _, q) = self.border.shape
        s = scale[:p]
        inner = scale[p:].reshape(count, q)
        g = gradient[:p] / s
        own = gradient[p:].reshape(count, q) / inner
        corner = self.corner / np.outer(s, s) + damping * np.eye(p)
        border = self.border / (s[None, :, None] * inner[:, None, :])
        blocks = self.blocks / (inner[:, :, None] * inner[:, None, :]) + damping * np.eye(q)
        try:
            lower = np.linalg.cholesky(blocks)
            half = np.linalg.solve(
                lower, np.concatenate([border.transpose(0, 2, 1), own[:, :, None]], axis=2)
            )
        except np.linalg.LinAlgError:
            return None
        flat = half.reshape(count * q, p + 1)
        right = flat[:, :p].T @ flat[:, p] - g
        step = right
        if p:
            _, step, failed = dposv(corner - flat[:, :p].T @ flat[:, :p], right)
            if failed:
                return None
        rest = np.linalg.solve(lower.transpose(0, 2, 1), -half[:, :, p:] - half[:, :, :p] @ step[:, None])
        return np.concatenate([step / s, (rest[:, :, 0] / inner).ravel()])
