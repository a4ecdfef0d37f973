"""Flights in the order they were flown: neighbours that resemble each other, odd flights, flights of one day.

Student's t takes flights as independent. A battery that ages, a season or a repair make neighbours alike, and
ten of them then say as much of other days as two. A rare kind of flight may be missing altogether: up to
16 flights hold one of a kind that makes up one in six with less than 95 % certainty, whatever they show. So a
change is claimed of *another flight* of the vehicle only where KINDS flights or more, of more than a day,
still show it once

- neighbours count by the largest correlation that they may have (95 %): the bias of the estimate is undone
  (Marriott and Pope, 1954, Biometrika 41), and the spread that it hides is given back;
- flights that stand far from the others count by the smallest and the largest share of all flights that they
  may make up (Clopper and Pearson, 1934, Biometrika 26).

Else it is claimed of another flight like these, or of this day. Why so: docs/adr/0031-flights-in-order.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import BEGAN, FloatArray, Segment
from flysid.ingest.align.resample import NORMAL
from flysid.validate.compare.verdict import ALPHA

RARE = 1.0 / 6.0
"""Share of flights that a kind has, which must not be missing where any other flight is spoken of."""
KINDS = int(np.ceil(np.log(ALPHA) / np.log(1.0 - RARE)))
DAY_S = 12 * 3600.0
"""Flights that begin within half a day are of one day, in any time zone."""
FENCE = 3.5
"""Standard deviations (by the median) from which on a flight is odd (Iglewicz and Hoaglin, 1993)."""


def flights_began(segments: Sequence[Segment]) -> dict[str, float]:
    """When flights began, seconds of UTC, by name; {} unless all of them know it."""
    began: dict[str, float] = {}
    for s in segments:
        when = s.marks.get(BEGAN)
        if not isinstance(when, float):
            return {}
        began[s.flight] = min(when, began.get(s.flight, when))
    return began


def are_of_one_day(began: Mapping[str, float]) -> bool:
    """Whether all flights began within half a day; False where the dates are not known."""
    return bool(began) and max(began.values()) - min(began.values()) < DAY_S


def mean_of_neighbours(values: Sequence[float]) -> tuple[float, float]:
    """Half width of the 95 % interval of the mean of n values in order, and the two-sided p-value of zero.

    The widest that the correlation of neighbours allows, as the module says; inf and 1 where it allows any.
    """
    from scipy.special import stdtr, stdtrit

    x = np.asarray(values)
    n = len(x)
    spread = float(np.var(x, ddof=1))
    if spread <= 0.0:
        return 0.0, float(not x.any())
    sums = sum_of_correlations(largest_correlation(x), n)
    if sums >= n:
        return float("inf"), 1.0
    error = np.sqrt(spread * (n - 1) / (n - sums) * sums / n)
    freedom = max(n / sums - 1.0, 1.0)
    p = 2.0 * float(stdtr(freedom, -abs(x.mean()) / error))
    return float(stdtrit(freedom, 1.0 - ALPHA / 2.0) * error), p


def correlation_of_neighbours(values: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Correlation of neighbours in n > 3 values and its standard error, the bias by the mean undone."""
    x = np.asarray(values) - np.mean(values)
    n = len(x)
    raw = float(x[1:] @ x[:-1]) / max(float(x @ x), np.finfo(float).tiny)
    rho = float(np.clip((raw + 1.0 / n) / (1.0 - 3.0 / n), -1.0, 1.0))
    return rho, float(np.sqrt((1.0 - rho**2) / n))


def largest_correlation(values: Sequence[float] | FloatArray) -> float:
    """The upper 95 % bound of the correlation of neighbours, from 0 to 1."""
    from scipy.special import ndtri

    rho, error = correlation_of_neighbours(values)
    return float(np.clip(rho + float(ndtri(1.0 - ALPHA)) * error, 0.0, 1.0))


def sum_of_correlations(rho: float, n: int) -> float:
    """How many of n values count as one: 1 + 2 sum (1 - k/n) rho^k."""
    lags = np.arange(1, n)
    return 1.0 + 2.0 * float(np.sum((1.0 - lags / n) * rho**lags))


def effective_flights(values: Sequence[float]) -> float:
    """As how many independent flights n values count; n where no correlation of neighbours is shown."""
    from scipy.special import ndtri

    n = len(values)
    if n <= 3 or not np.ptp(values):
        return float(n)
    rho, _ = correlation_of_neighbours(values)
    if rho <= float(ndtri(1.0 - ALPHA)) / np.sqrt(n):  # what independent flights show by chance
        return float(n)
    return n / sum_of_correlations(rho, n)


def ends_of_odd(values: Sequence[float]) -> tuple[float, float]:
    """Smallest and largest mean that the share of the odd flights among n values allows (95 %).

    Both are the mean where no flight is odd: nothing is then known of those that may be missing.
    """
    from scipy.special import betaincinv

    x = np.asarray(values)
    n = len(x)
    apart = np.abs(x - np.median(x))
    odd = apart > FENCE * NORMAL * float(np.median(apart))
    count = int(odd.sum())
    if not 0 < count < n - count:
        return float(x.mean()), float(x.mean())
    shares = [
        float(betaincinv(count, n - count + 1, ALPHA / 2.0)),
        float(betaincinv(count + 1, n - count, 1.0 - ALPHA / 2.0)),
    ]
    means = [(1.0 - share) * float(x[~odd].mean()) + share * float(x[odd].mean()) for share in shares]
    return min(means), max(means)
