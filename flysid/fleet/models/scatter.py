"""Scatter of responses from flight to flight, pooled over the fleet: one vehicle has too few flights.

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
from scipy.optimize import minimize

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.fleet.models.groups import Response

PER_NUMBER = 3
"""Vehicles for every number that is compared, below which their spread is not known well enough."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """(p, p) ratio K of the true covariance to the white one, and the degrees of freedom behind it."""

    ratio: FloatArray
    freedom: int

    def covariance(self, response: Response) -> FloatArray:
        """(p, p) of a group's response."""
        root = response.root
        return np.asarray(root @ self.ratio @ root.T)


@dataclass(frozen=True)
class Tail:
    """How T² over p numbers spreads where nothing has changed: T² / (p scale) as F(p, freedom)."""

    scale: float
    freedom: float

    def p_value(self, statistic: float, size: int) -> float:
        """The chance of a larger T²."""
        return float(stats.f.sf(statistic / (size * self.scale), size, self.freedom))


def tail_of(statistics: Sequence[float], size: int, freedom: float) -> Tail:
    """The tail of T² from vehicles' flights divided so that no change can show: likelihood's choice.

    Wind blows along one flight and across the next: what one vehicle meets is not what all meet,
    and T² strays further than Hotelling's. It is never taken to stray less.

    `statistics`: one for each vehicle; Hotelling's own tail is taken where they are too few.
    `freedom`: behind the scatter.
    """
    left = freedom - size + 1
    nominal = freedom / left
    if len(statistics) <= PER_NUMBER * size:
        return Tail(nominal, left)
    values = np.array(statistics) / size

    def unlikely(logs: FloatArray) -> float:
        scale, few = np.exp(logs)
        return -float(np.sum(stats.f.logpdf(values / scale, size, few)) - len(values) * logs[0])

    bounds = [(np.log(nominal), None), (np.log(2.0), np.log(max(left, 3.0)))]
    found = minimize(unlikely, np.array([np.log(nominal), np.log(max(left, 3.0)) / 2.0]), bounds=bounds)
    return Tail(*np.exp(found.x).tolist())


def pool(responses: Sequence[Response], channel: str) -> Scatter:
    """K of groups in each of which the vehicle was the same.

    Raises DataError: too few groups have several flights.
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
