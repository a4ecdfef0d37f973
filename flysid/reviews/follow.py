"""How a measurement follows its setpoint: the error, and how late it comes, with an interval.

The lag is the delay of the setpoint that explains most of the measurement. Its interval comes from resampling
blocks of the flight. There is none where the setpoint explains less than half of the motion, nor of that part
of it which is quick beside the lags that are looked for, or where the interval reaches the search's end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.logged import BoolArray, Column
from flysid.reviews.pairs import Pair
from flysid.showing import significant

TURN_DEG = 360.0
DRAWS = 200


@dataclass(frozen=True, eq=False)
class Together:
    """A setpoint and its measurement at the same times.

    `time_s`, `setpoint`, `measured`: (N,); an angle's setpoint lies within half a turn of its measurement.
    `logged`: (N,) whether both were logged.
    `counts`: (N,) whether the vehicle flew, too.
    """

    time_s: FloatArray
    setpoint: FloatArray
    measured: FloatArray
    logged: BoolArray
    counts: BoolArray

    @property
    def error(self) -> FloatArray:
        """(n,) where it counts."""
        return (self.measured - self.setpoint)[self.counts]

    @property
    def runs(self) -> list[slice]:
        """Stretches without a pause."""
        return _stretches(self.logged)

    @property
    def flown(self) -> list[slice]:
        """Stretches without a pause in which it counts."""
        return _stretches(self.counts)

    def during(self, wanted: BoolArray) -> Together:
        """Less of it."""
        return replace(self, counts=self.counts & wanted)


@dataclass(frozen=True)
class Lag:
    """How late a measurement follows, or why that is not known.

    `seconds`, `interval`: NaN and None where it is not determined.
    `explained`: share of the measurement's variance that the delayed setpoint explains.
    `why`: why it is not determined; "" where it is.
    """

    seconds: float = float("nan")
    interval: tuple[float, float] | None = None
    explained: float = float("nan")
    why: str = ""

    @property
    def is_known(self) -> bool:
        return not self.why


def _stretches(holds: BoolArray) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


Counting = Callable[[FloatArray], BoolArray]


def at_rows(pair: Pair, counts: Counting) -> Together:
    """At the measurement's own rows, the setpoint between its own by a straight line."""
    return _at(pair, pair.measured.time_s, pair.measured.values, counts)


def on_grid(pair: Pair, counts: Counting, *, fastest_hz: float = 250.0) -> Together:
    """On an even grid at the rate of the slower of the two; means over its steps where it is much coarser.

    `fastest_hz`: the grid's rate at most.
    """
    period = max(1.0 / pair.rate_hz, 1.0 / fastest_hz)
    first = max(pair.setpoint.time_s[0], pair.measured.time_s[0])
    last = min(pair.setpoint.time_s[-1], pair.measured.time_s[-1])
    time_s = np.arange(first, last, period)
    slow = replace(pair, setpoint=means(pair.setpoint, period), measured=means(pair.measured, period))
    values = np.interp(time_s, slow.measured.time_s, _unwrapped(slow, slow.measured.values))
    found = _at(slow, time_s, values, counts)
    logged = found.logged & _logged(slow.measured, time_s, period)
    return replace(found, logged=logged).during(logged)


def _at(pair: Pair, time_s: FloatArray, measured: FloatArray, counts: Counting) -> Together:
    if not len(time_s):
        none = np.zeros(0, dtype=bool)
        return Together(time_s, time_s, time_s, none, none)
    setpoint = np.interp(time_s, pair.setpoint.time_s, _unwrapped(pair, pair.setpoint.values))
    if pair.loop.is_angle:
        setpoint = measured + _wrapped(setpoint - measured)
    period = max(pair.setpoint.period_s, pair.measured.period_s)
    logged = _logged(pair.setpoint, time_s, period)
    return Together(time_s, setpoint, measured, logged, counts(time_s) & logged)


def _unwrapped(pair: Pair, values: FloatArray) -> FloatArray:
    return np.unwrap(values, period=TURN_DEG) if pair.loop.is_angle else values


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + 0.5 * TURN_DEG) % TURN_DEG - 0.5 * TURN_DEG)


def means(column: Column, period: float) -> Column:
    """Over steps of a grid, where they are coarser than the column's."""
    width = round(period / column.period_s)
    if width < 2:
        return column
    share = np.full(width, 1.0 / width)
    kept = len(column) - width + 1
    if kept < 2:
        return column
    mean = np.convolve(column.values, share, "valid")
    time_s = np.convolve(column.time_s, share, "valid")
    return Column(column.address, column.unit, time_s, mean)


def _logged(column: Column, time_s: FloatArray, period: float, *, periods: float = 4.0) -> BoolArray:
    """(n,) whether times lie between two samples that are no pause apart."""
    after = np.clip(np.searchsorted(column.time_s, time_s), 1, len(column) - 1)
    near = column.time_s[after] - column.time_s[after - 1] <= periods * max(period, column.period_s)
    return np.asarray(near & (time_s >= column.time_s[0]) & (time_s <= column.time_s[-1]))


def lag_of(
    together: Together,
    search_s: float,
    *,
    block_s: float = 2.0,
    least_blocks: int = 6,
    explained: float = 0.5,
) -> Lag:
    """How late a measurement follows its setpoint, both on an even grid.

    `search_s`: the longest lag that is looked for; a quarter of it ahead is looked at, too.
    `block_s`: of the blocks that are resampled.
    `least_blocks`: fewer tell no interval.
    `explained`: a smaller share of the variance tells no lag.
    """
    if len(together.time_s) < 2:
        return Lag(why="too few samples in the air")
    period = float(together.time_s[1] - together.time_s[0])
    steps = _Steps(*(max(2, round(share / period)) for share in (search_s, 0.25 * search_s, block_s)))
    sums = _sums(together, steps)
    flown = float(sums[:, -1, 0].sum()) / steps.block if len(sums) else 0.0
    if flown < least_blocks:
        return Lag(why=f"too little flight without a pause: {flown * block_s:.0f} s")
    lags = np.asarray(period * np.arange(steps.back, -steps.ahead - 1, -1), dtype=np.float64)
    whole = _explained(sums.sum(axis=0))
    if not whole.max() > 0.0:
        return Lag(why="the setpoint does not move")
    share = float(whole.max())
    if share < explained:
        share = max(share, float(_explained(_sums(together, steps, quick=True).sum(axis=0)).max()))
    if share < explained:
        return Lag(explained=share, why=f"only {100.0 * share:.0f} % of the motion follows the setpoint")
    counts = np.random.default_rng(0).multinomial(len(sums), np.full(len(sums), 1.0 / len(sums)), DRAWS)
    drawn = np.tensordot(counts.astype(np.float64), sums, axes=1)
    low, high = np.quantile([_peak(lags, _explained(draw)) for draw in drawn], (0.025, 0.975))
    if lags[-1] + period >= low or high >= lags[0] - period:
        return Lag(explained=share, why=f"any lag up to {significant(search_s)} s fits")
    return Lag(_peak(lags, whole), (float(low), float(high)), share)


@dataclass(frozen=True)
class _Steps:
    """Samples of the longest lag, of the longest lead, and of a block."""

    back: int
    ahead: int
    block: int


def _sums(together: Together, steps: _Steps, *, quick: bool = False) -> FloatArray:
    """(blocks, 6, lags) see `_blocks`; of what is faster than twice the longest lag where `quick`."""
    found = []
    for run in together.runs:
        rows = (together.setpoint[run], together.measured[run])
        if quick:
            rows = (_quick(rows[0], 2 * steps.back), _quick(rows[1], 2 * steps.back))
        found += _blocks(*rows, together.counts[run].astype(np.float64), steps)
    return np.array(found)


def _quick(values: FloatArray, size: int) -> FloatArray:
    """What is faster than a moving mean."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(values - uniform_filter1d(values, size, mode="nearest"))


def _blocks(
    setpoint: FloatArray, measured: FloatArray, weight: FloatArray, steps: _Steps
) -> list[FloatArray]:
    """Of every block (6, lags): sums of s, s s, s m, m, m m and 1, the longest lag first."""
    back, ahead, size = steps.back, steps.ahead, steps.block
    found = []
    for at in range(back, len(measured) - ahead - size + 1, size):
        w = weight[at : at + size]
        if not w.any():
            continue
        s = np.lib.stride_tricks.sliding_window_view(setpoint[at - back : at + ahead + size], size)
        m = w * measured[at : at + size]
        level = np.ones(len(s))
        own = (m.sum(), m @ measured[at : at + size], w.sum())
        found.append(np.array([s @ w, (s * s) @ w, s @ m, *(value * level for value in own)]))
    return found


def _explained(sums: FloatArray) -> FloatArray:
    """(lags,) share of the variance that each lag explains, negative where the sign is the wrong one."""
    s, ss, sm, m, mm, n = sums
    both = sm / n - s * m / n**2
    size = (ss / n - (s / n) ** 2) * (mm / n - (m / n) ** 2)
    return np.asarray(np.sign(both) * both**2 / np.maximum(size, np.finfo(float).tiny))


def _peak(lags: FloatArray, share: FloatArray) -> float:
    """Where a curve is largest, between its points by a parabola."""
    k = int(np.argmax(share))
    if not 0 < k < len(share) - 1:
        return float(lags[k])
    before, top, after = share[k - 1 : k + 2]
    bend = before - 2.0 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(lags[k] + shift * (lags[k + 1] - lags[k]))


def telling(together: Together, seconds: float = 15.0) -> slice:
    """The stretch of this length in which the setpoint moves most."""
    if len(together.time_s) < 2:
        return slice(0, len(together.time_s))
    period = float(together.time_s[1] - together.time_s[0])
    size = max(2, round(seconds / period))
    moved = np.where(together.counts, np.gradient(together.setpoint) ** 2, 0.0)
    total = np.concatenate([[0.0], np.cumsum(moved)])
    spans = total[size:] - total[:-size]
    start = int(np.argmax(spans)) if len(spans) else 0
    return slice(start, min(start + size, len(together.time_s)))
