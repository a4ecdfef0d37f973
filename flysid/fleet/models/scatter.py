"""How far responses scatter from flight to flight: learned of the whole fleet, no vehicle has enough flights.

Two flights of a vehicle tell next to nothing of their scatter, two hundred of a fleet do. What is pooled is
the ratio K of the scatter between flights to what white residuals would give, as a matrix: a vehicle that
flew gently is less sure, and its own white covariance P = G Gᵀ knows by how much. A group's is G K Gᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.linalg import solve_triangular

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.fleet.models.groups import Response


@dataclass(frozen=True, eq=False)
class Scatter:
    """(p, p) ratio K of the true covariance to the white one, and the degrees of freedom behind it."""

    ratio: FloatArray
    freedom: int

    def covariance(self, response: Response) -> FloatArray:
        """(p, p) of a group's response."""
        root = response.root
        return np.asarray(root @ self.ratio @ root.T)

    def p_value(self, statistic: float, size: int) -> float:
        """Of Hotelling's T²: the chance of a larger one where nothing differs."""
        left = self.freedom - size + 1
        return float(stats.f.sf(statistic * left / (self.freedom * size), size, left))

    def critical(self, p: float, size: int) -> float:
        """The T² that is exceeded with probability p."""
        left = self.freedom - size + 1
        return float(stats.f.isf(p, size, left)) * self.freedom * size / left


def pooled(responses: Sequence[Response], channel: str) -> Scatter:
    """K of groups in each of which the vehicle was the same.

    Raises
    ------
    DataError : too few groups have several flights.
    """
    several = [r for r in responses if r.flights > 1]
    freedom = sum(r.flights - 1 for r in several)
    size = len(responses[0].value) if responses else 0
    if freedom < 2 * size + 1:
        raise DataError(
            f"channel {channel!r}: the scatter between flights is not known from {freedom} repeated flights; "
            f"{2 * size + 1} are needed",
            hint="more vehicles, or more flights of each",
        )
    whitened = [solve_triangular(r.root, r.influences.T, lower=True) for r in several]
    total = sum((w @ w.T for w in whitened), np.zeros((size, size)))
    return Scatter(total / len(several), freedom)
