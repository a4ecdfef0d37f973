"""How sure: the change in error on another flight, or on these flights, with a 95 % interval.

*Another flight like these*: every held-out flight gives one number, l = log(RMSE_b / RMSE_a), and Student's t
an interval of its mean, the change on a typical flight. Where some flights suit one model and some the other,
l stands in two heaps, few flights are often all of one, and their spread is then far too small. So every
flight answers a second question: how far the truth lies from the middle of the two predictions, in distances
between them, w = (|e_a|^2 - |e_b|^2) / (2 |e_a - e_b|^2). It has the sign of -l, and no heaps: the vehicle of
a flight lies anywhere between the models, or beyond one. A tenth of the mean of both squared errors is added
to the squared distance, so that flights in which the models agree decide little. A change is shown only where
t of w shows it too, else the interval reaches to no change. Few w that are spread evenly look alike more
often than Student's t expects (7 to 8 % with two to five): theirs is asked for.

*Another flight of this day* is the same where all flights began within half a day. *Another flight* of this
vehicle is claimed only where many flights still show the change once their order and the odd ones among them
are counted in (`flysid.validate.compare.neighbours`).

Where flights are judged in turn, by models that have not seen them, those models are not the compared ones:
fitted to other flights, they may even have ended in another minimum. How far they are shows on the flights
that both have seen, as the mean difference of l and of w there, and is taken off.

*These flights*: the held-out parts are of flights that the models trained on, or there is one flight only:
*this flight* where there is no other, *the held-out flight* where others were trained on.
The units are 4 to 12 blocks of time, with t on their log ratios (Ibragimov & Mueller 2010), which needs no
equal variances. Where the time is shorter than 25 correlation lengths of the errors, blocks are not
independent; the interval then also covers that of an F ratio of two variances.

Measured coverage: docs/measured/verdicts.md; why so: docs/adr/0014-verdicts-from-few-flights.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from flysid.dataset import FloatArray
from flysid.validate.compare.neighbours import (
    KINDS,
    are_of_one_day,
    effective_flights,
    ends_of_odd,
    mean_of_neighbours,
)
from flysid.validate.compare.verdict import ALPHA, outcome_of_interval

FEW = 4  # flights, which say little of how unlike they are
STILL = 0.1  # of the mean of both squared errors, added to the squared distance of the predictions
STRETCH = 1.2  # of an interval of cross-fitted flights, whose models share their training data
EVENLY = dict(
    enumerate((1.495, 1.333, 1.210, 1.133, 1.087, 1.057, 1.040, 1.030, 1.024, 1.019, 1.017), start=2)
)
"""What 5 % of the t's of so few evenly spread numbers exceed, over Student's t."""
BLOCKS = (4, 12)
BLOCK_LENGTHS = 15.0  # correlation lengths in a block
LONG = 25.0  # correlation lengths from which on blocks alone suffice
LOST = 2.0  # lengths by which a record seems to hold too many
SLOW = 10.0  # correlation lengths below which only a large difference can be seen
_TINY = 1e-300


class Scope(StrEnum):
    """What a verdict speaks of."""

    ANOTHER = "another flight"
    LIKE = "another flight like these"
    DAY = "another flight of this day"
    THESE = "these flights"
    HELD = "the held-out flight"
    THIS = "this flight"

    @property
    def is_unseen(self) -> bool:
        """Whether it is of flights that the models have not seen, with flights as units."""
        return self in (Scope.ANOTHER, Scope.LIKE, Scope.DAY)


@dataclass(frozen=True)
class Interval:
    """A change of error in percent, its 95 % interval and the two-sided p-value of no change."""

    change_pct: float
    low_pct: float
    high_pct: float
    p: float


@dataclass(frozen=True)
class ErrorChange:
    """What held-out errors say of the change from a baseline to a model.

    Attributes
    ----------
    scope : what it is a change on.
    units : flights or blocks of time that it rests on.
    block : samples per block; 0 where the units are flights.
    interval : None where an error is zero.
    by_flight : 100 (RMSE_b / RMSE_a - 1) of every flight, by name.
    slow : the errors change slower than these flights last.
    apart : where every flight was left out once: how far the change of the models of the others, which judged
        it, is from that of the compared ones, in percent by flight.
    effective : as how many independent flights the flights count, where neighbours are shown to be alike.
    """

    scope: Scope
    units: int
    block: int
    interval: Interval | None
    by_flight: dict[str, float]
    slow: bool = False
    apart: Mapping[str, float] = field(default_factory=dict)
    effective: float | None = None

    @property
    def rotated(self) -> bool:
        """Every flight was left out once, and judged by models of the others."""
        return bool(self.apart)


def change(
    ea: Sequence[FloatArray],
    eb: Sequence[FloatArray],
    flights: Sequence[str],
    seen: Collection[str] = (),
    *,
    apart: Mapping[str, tuple[float, float]] | None = None,
    began: Mapping[str, float] | None = None,
) -> ErrorChange:
    """The change from the errors of a baseline (ea) to those of a model (eb), one array per segment.

    `flights`: of every segment.
    `seen`: flights that the models were trained on; of those that are here, other parts than these.
    `apart`: every flight was left out once and judged by models of the others: how far these are from the
        compared models (`distance`), by flight.
    `began`: when flights began, seconds of UTC; without it they were flown in the order they stand in.
    """
    ea, eb = _scale(ea, eb)
    rotated = apart is not None
    off = apart or dict.fromkeys(flights, (0.0, 0.0))
    logs = {name: value - off[name][0] for name, value in flight_logs(ea, eb, flights).items()}
    by_flight = {name: _percent(value) for name, value in logs.items()}
    lost = not (any(e.any() for e in ea) and any(e.any() for e in eb))
    if len(logs) > 1 and not set(logs) & set(seen):
        sides = {name: value - off[name][1] for name, value in flight_sides(ea, eb, flights).items()}
        order = sorted(logs, key=began.__getitem__) if began else list(logs)
        pair = [logs[name] for name in order], [sides[name] for name in order]
        scope, found = _claim(*pair, are_of_one_day(began or {}), rotated=rotated)
        count = effective_flights(pair[1])
        return ErrorChange(
            scope,
            len(logs),
            0,
            None if lost else found,
            by_flight,
            apart={name: _percent(log) for name, (log, _) in (apart or {}).items()},
            effective=None if count == len(logs) else count,
        )
    scope = Scope.THESE if len(logs) > 1 else Scope.HELD if set(seen) - set(logs) else Scope.THIS
    if lost:
        return ErrorChange(scope, 0, 0, None, by_flight)
    whole_a = np.concatenate(ea)
    whole_b = np.concatenate(eb)
    a = whole_a**2
    b = whole_b**2
    tau = _Lengths.of(whole_a, whole_b)
    blocks = int(np.clip(len(a) / (BLOCK_LENGTHS * tau.longest), *BLOCKS))
    return ErrorChange(
        scope,
        blocks,
        len(a) // blocks,
        within_flights(a, b, blocks, tau),
        by_flight,
        slow=len(a) < SLOW * tau.longest,
    )


def flight_logs(
    ea: Sequence[FloatArray], eb: Sequence[FloatArray], flights: Sequence[str]
) -> dict[str, float]:
    """log(RMSE_b / RMSE_a) of every flight."""
    return {name: 0.5 * _log_ratio(b, a) for name, (a, b, _) in _squares(ea, eb, flights).items()}


def flight_sides(
    ea: Sequence[FloatArray], eb: Sequence[FloatArray], flights: Sequence[str]
) -> dict[str, float]:
    """How far every flight lies from the middle of two predictions, in distances between them.

    0.5 is where the second one is, -0.5 the first (the weights of Granger and Ramanathan, 1984, less a half),
    both drawn a little to 0 by STILL.
    """
    return {
        name: (a - b) / max(2.0 * apart + STILL * (a + b), _TINY)
        for name, (a, b, apart) in _squares(ea, eb, flights).items()
    }


def distance(
    one: tuple[Sequence[FloatArray], Sequence[FloatArray]],
    other: tuple[Sequence[FloatArray], Sequence[FloatArray]],
    flights: Sequence[str],
) -> tuple[float, float]:
    """How far a pair of models is from another: mean differences of `flight_logs` and of `flight_sides`.

    `one`, `other`: errors of a baseline and of a model, as `change` takes them.
    """
    logs, sides = (
        [float(np.mean(list(of(*_scale(*pair), flights).values()))) for pair in (one, other)]
        for of in (flight_logs, flight_sides)
    )
    return logs[0] - logs[1], sides[0] - sides[1]


def _squares(
    ea: Sequence[FloatArray], eb: Sequence[FloatArray], flights: Sequence[str]
) -> dict[str, tuple[float, float, float]]:
    """Sums of squares over every flight: both errors, and their difference."""
    sums: dict[str, FloatArray] = {name: np.zeros(3) for name in flights}
    for a, b, name in zip(ea, eb, flights, strict=True):
        sums[name] += (a @ a, b @ b, (a - b) @ (a - b))
    return {name: (float(s[0]), float(s[1]), float(s[2])) for name, s in sums.items()}


def _claim(
    logs: Sequence[float], sides: Sequence[float], one_day: bool, *, rotated: bool
) -> tuple[Scope, Interval]:
    """The widest scope in which flights in order show what they show among themselves, and its interval."""
    near = across_flights(logs, sides, rotated=rotated)
    if one_day:
        return Scope.DAY, near
    if len(logs) < KINDS:
        return Scope.LIKE, near
    wide = across_days(logs, sides, near)
    outcomes = [outcome_of_interval(i.low_pct, i.high_pct, i.p)[0] for i in (near, wide)]
    return (Scope.ANOTHER, wide) if outcomes[0] is outcomes[1] else (Scope.LIKE, near)


def across_days(logs: Sequence[float], sides: Sequence[float], near: Interval) -> Interval:
    """The interval `near` of `across_flights`, widened by what neighbours and odd flights leave open.

    `logs`, `sides`: as `flight_logs` and `flight_sides` have them, of KINDS flights or more, in their order.
    """
    mean = float(np.mean(logs))
    half, p_log = mean_of_neighbours(logs)
    _, p_side = mean_of_neighbours(sides)
    odd = ends_of_odd(logs)
    low = min(mean - half, odd[0])
    high = max(mean + half, odd[1])
    p = max(near.p, p_log, p_side, float(odd[0] <= 0.0 <= odd[1]))
    if p >= ALPHA:
        low = min(low, 0.0)
        high = max(high, 0.0)
    return Interval(near.change_pct, min(_percent(low), near.low_pct), max(_percent(high), near.high_pct), p)


def across_flights(logs: Sequence[float], sides: Sequence[float], *, rotated: bool = False) -> Interval:
    """The mean of log ratios of flights, as a change in percent: a typical flight (the geometric mean).

    `logs`, `sides`: as `flight_logs` and `flight_sides` have them, of two flights and more.
    `rotated`: the intervals are stretched, as folds share training flights.
    """
    stretch = STRETCH if rotated else 1.0
    mean, half, p = _students(logs, stretch)
    side, _, p_side = _students(sides, max(stretch, EVENLY.get(len(sides), 1.0)))
    p = max(p, p_side) if mean * side < 0.0 else 1.0
    low = mean - half
    high = mean + half
    if p >= ALPHA:
        low = min(low, 0.0)
        high = max(high, 0.0)
    return Interval(_percent(mean), _percent(low), _percent(high), p)


def _students(values: Sequence[float], stretch: float) -> tuple[float, float, float]:
    """Mean, half width of its 95 % interval, and the two-sided p-value of zero."""
    from scipy.special import stdtr, stdtrit

    n = len(values)
    mean = float(np.mean(values))
    error = stretch * float(np.std(values, ddof=1)) / float(np.sqrt(n))
    p = 2.0 * float(stdtr(n - 1, -abs(mean) / error)) if error > 1e-12 else float(abs(mean) < 1e-9)
    return mean, float(stdtrit(n - 1, 1.0 - ALPHA / 2.0)) * error, min(p, 1.0)


@dataclass(frozen=True)
class _Lengths:
    """Correlation lengths, in samples, of two squared errors.

    No shorter than the errors' own correlation makes them.
    """

    a: float
    b: float

    @classmethod
    def of(cls, ea: FloatArray, eb: FloatArray) -> _Lengths:
        return cls(*(max(correlation_length(e**2), length_of_square(e)) for e in (ea, eb)))

    @property
    def longest(self) -> float:
        return max(self.a, self.b)


def within_flights(a: FloatArray, b: FloatArray, blocks: int, tau: _Lengths) -> Interval:
    """The change of the RMSE over these very samples' process, from blocks of time.

    `a`, `b`: (N,) squared errors of baseline and model, in the order of time, flight after flight.
    """
    from scipy.special import stdtr, stdtrit

    theta = 0.5 * _log_ratio(b.mean(), a.mean())
    pairs = zip(np.array_split(a, blocks), np.array_split(b, blocks), strict=True)
    logs = np.array([0.5 * _log_ratio(y.mean(), x.mean()) for x, y in pairs])
    error = float(logs.std(ddof=1)) / np.sqrt(blocks)
    centres = sorted((float(logs.mean()), theta))
    half = float(stdtrit(blocks - 1, 0.975)) * error
    low = centres[0] - half
    high = centres[1] + half
    nearest = min(map(abs, centres)) if centres[0] * centres[1] > 0.0 else 0.0
    p = 2.0 * float(stdtr(blocks - 1, -nearest / error)) if error > 1e-12 else float(nearest < 1e-9)
    if len(a) < LONG * tau.longest and error > 1e-12:
        wide = _ratio_of_variances(a, b, theta, tau)
        low = min(low, wide[0])
        high = max(high, wide[1])
        p = max(p, wide[2])
    return Interval(_percent(theta), _percent(low), _percent(high), min(p, 1.0))


def _ratio_of_variances(
    a: FloatArray, b: FloatArray, theta: float, tau: _Lengths
) -> tuple[float, float, float]:
    """Low and high end of theta and its p-value, from the F distribution of two variances of so few lengths.

    What both errors share cancels in their ratio, so that the spread is scaled by that of their difference.
    A slow error's length is found too short, by about two in the number of lengths (Kendall 1954).
    """
    from scipy.special import fdtr, fdtri

    x = a / a.mean()
    y = b / b.mean()
    own = float(np.var(x)) * tau.a + float(np.var(y)) * tau.b
    scale = min(1.0, float(np.sqrt(np.var(y - x) * tau.longest / max(own, _TINY))))
    freedom = [max(1.0, len(a) / length - LOST) for length in (tau.b, tau.a)]
    ends = [theta - 0.5 * scale * float(np.log(fdtri(*freedom, q))) for q in (0.975, 0.025)]
    below = float(fdtr(*freedom, np.exp(np.clip(2.0 * theta / max(scale, 1e-9), -600.0, 600.0))))
    return ends[0], ends[1], 2.0 * min(below, 1.0 - below)


def correlation_length(x: FloatArray) -> float:
    """Integrated autocorrelation time of a series (N,) in samples, 1 + 2 sum rho(k).

    Summed over pairs of lags while their sum is positive (Geyer 1992), so noise in the tail does not add up.
    """
    covariance = _autocovariance(x - x.mean())
    if covariance[0] <= 0.0:
        return 1.0
    rho = covariance / covariance[0]
    pairs = rho[: 2 * (len(x) // 2)].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(pairs <= 0.0)
    kept = pairs[: stop[0]] if len(stop) else pairs
    return max(1.0, 2.0 * float(kept.sum()) - 1.0)


def length_of_square(e: FloatArray) -> float:
    """Correlation length of the square of errors (N,) about zero, from their own correlation rho.

    1 + 2 sum rho(k)^2, as for normal numbers, up to the first rho below zero. Of a slow error it tells more
    than the square itself, whose mean has to be taken off.
    """
    covariance = _autocovariance(e)
    if covariance[0] <= 0.0:
        return 1.0
    rho = covariance / covariance[0]
    below = np.flatnonzero(rho <= 0.0)
    kept = rho[: below[0]] if len(below) else rho
    return max(1.0, 2.0 * float(kept @ kept) - 1.0)


def _autocovariance(x: FloatArray) -> FloatArray:
    """(N,) sum_i x(i) x(i+k), by FFT."""
    size = 1 << (2 * len(x) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(x, size)) ** 2
    covariance: FloatArray = np.fft.irfft(spectrum, size)[: len(x)]
    return covariance


def _scale(ea: Sequence[FloatArray], eb: Sequence[FloatArray]) -> tuple[list[FloatArray], list[FloatArray]]:
    """All errors divided by the largest one, so that their squares neither overflow nor vanish."""
    largest = max(max(float(np.max(np.abs(e))) for e in (*ea, *eb)), _TINY)
    return [e / largest for e in ea], [e / largest for e in eb]


def _log_ratio(b: float, a: float) -> float:
    return float(np.log(max(b, _TINY) / max(a, _TINY)))


def _percent(theta: float) -> float:
    return 100.0 * float(np.expm1(min(theta, 300.0)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's (1979) adjusted p-values, in the given order."""
    order = np.argsort(p_values, kind="stable")
    adjusted = [0.0] * len(p_values)
    running = 0.0
    for rank, i in enumerate(order):
        running = max(running, min(1.0, (len(p_values) - rank) * float(p_values[i])))
        adjusted[i] = running
    return adjusted
