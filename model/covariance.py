"""Questions to a covariance: its root, to draw with, and the spread of what hangs on the numbers."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray

CONFIDENCE_ROWS = 20_000
"""Samples, the first, whose sensitivities a covariance is computed from."""
STEP = 1e-3
"""Of a standard deviation: a run, and what is told of it, move in proportion to so small a step."""


def root_of(covariance: FloatArray) -> FloatArray:
    """R with R Rᵀ the covariance (p, p); directions of no variance, or of less, are certain."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def spread_of(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    """(...,) standard errors to first order of figures with slopes (..., p), covariance (p, p)."""
    variance = np.einsum("...p,pq,...q->...", slopes, covariance, slopes)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
