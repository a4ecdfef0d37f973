"""Which pairs of flights can be copies at all: of millions of pairs, the few that `alike` has to judge.

`alike` looks at a few lags of a pair only: where products are largest, and where changes differ least. Here
those lags come from correlations of whole batches of flights of like length, one transform back a pair and
signal. A flight much longer than the other is cut into blocks. At each lag a compiled loop asks what must
hold of a copy:

1. of the noise, what `alike` asks;
2. of the outputs, that a few samples far apart follow from their neighbours in the other flight. What few
   samples leave of a best fit is never more than what all of them leave: no copy is lost by it.

Of very many flights only those pairs are looked at that have a stretch in common (`like_windows`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft
from numba import njit

from flysid.alike import (
    LEAST_CORRELATION,
    LEAST_NOISE,
    LEAST_OVERLAP,
    NEIGHBOURS,
    NOISE_SHARE,
    SAME_OUTPUT,
    SAME_SHARE,
    SIGMAS,
    Grid,
)
from flysid.like_windows import SURE_OVERLAP, pairs_alike
from flysid.stretch import FloatArray

Spectra = npt.NDArray[np.complex128]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

BATCH = 1 << 18  # samples that are moved over others at a time
EVERY_PAIR = 1 << 18  # that many are looked at one by one: some seconds of flights of 300 samples
LONGER = 4  # times as long as the other flight: cut into blocks
FIRST_ROWS = 24  # samples that are asked first: four for each number that is fitted to them
COLUMNS = 7  # a constant, five neighbours, and what they are to explain
ROUNDING = 1e-12  # of a column's squares: less than this left of it is rounding
SLACK = 1.0 + 1e-6  # of a limit: sums here and in `alike` are rounded differently
NOISE, OUTPUT, MOVES, CLOSEST = range(4)  # whose lag it is

compiled = njit(cache=True, error_model="numpy")
summing = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})


def likely_copies(
    train: Sequence[Grid], held: Sequence[Grid], *, every_pair: int = EVERY_PAIR
) -> Iterator[tuple[int, int]]:
    """Numbers of held-out and training flights that `alike` may call copies.

    Of flights of like length, those of each part in their order; the shortest first.

    Parameters
    ----------
    every_pair : up to so many pairs are all looked at, and every copy is among those returned. Of more only
        those are that have a stretch in common, as all copies had that were tried.
    """
    scale = np.array([max(map(_size, column)) or 1.0 for column in zip(*_outputs(train, held), strict=True)])
    theirs, mine = (_Part.of(part, scale) for part in (train, held))
    if len(train) * len(held) <= every_pair:
        yield from _likely(theirs, np.arange(len(train)), mine, np.arange(len(held)))
        return
    by_windows = np.array([mine.holds_windows(i) for i in range(len(held))], dtype=np.bool_)
    yield from _likely(theirs, np.arange(len(train)), mine, np.flatnonzero(~by_windows))
    for i, some in _with_common_windows(theirs, mine, np.flatnonzero(by_windows)):
        yield from _likely(theirs, some, mine, np.array([i]))


def _likely(theirs: _Part, known: Indices, mine: _Part, asked: Indices) -> Iterator[tuple[int, int]]:
    """Of all pairs of these flights, those that may be copies."""
    for some in theirs.batches(known):
        for others in mine.batches(asked):
            lags = _lags_of_pairs(theirs, some, mine, others)
            chosen = np.zeros((len(others), len(some)), dtype=np.bool_)
            _screen(*theirs.arrays(), some, *mine.arrays(), others, mine.spread, lags, chosen)
            for i, k in np.argwhere(chosen):
                yield int(others[i]), int(some[k])


def _with_common_windows(theirs: _Part, mine: _Part, asked: Indices) -> Iterator[tuple[int, Indices]]:
    """Each of these flights with the training flights that share a window with it, or that have gaps."""
    whole = np.array([theirs.is_whole(k) for k in range(len(theirs.flown))], dtype=np.bool_)
    known = np.flatnonzero(whole)
    found: dict[int, set[int]] = {int(i): set(np.flatnonzero(~whole).tolist()) for i in asked}
    for j in range(len(theirs.y)):
        outputs = ([part.output(k, j) for k in some] for part, some in ((theirs, known), (mine, asked)))
        for i, k in pairs_alike(*outputs):
            found[int(asked[i])].add(int(known[k]))
    for i, some in found.items():
        yield i, np.array(sorted(some), dtype=np.int64)


def _outputs(*parts: Sequence[Grid]) -> Iterator[Sequence[FloatArray]]:
    for part in parts:
        for grid in part:
            yield list(grid.y.T)


def _size(x: FloatArray) -> float:
    """The largest magnitude; 0 where nothing is known."""
    return float(np.nanmax(np.abs(x))) if np.isfinite(x).any() else 0.0


# ---------------------------------------------------------------------------------------- one part's flights


@dataclass(frozen=True, eq=False)
class _Part:
    """The flights of a part, one behind the other; NaN in gaps.

    Attributes
    ----------
    start : (flights + 1,) where each begins.
    e : (n_y, N) what the linear model leaves, of each flight in units of its largest.
    y : (n_y, N) outputs less each flight's mean, in units that all flights share.
    samples, flown : (flights,) samples known of e and of y.
    spread : (flights, n_y) standard deviation of y.
    """

    start: Indices
    e: FloatArray
    y: FloatArray
    samples: Indices
    flown: Indices
    spread: FloatArray

    @classmethod
    def of(cls, grids: Sequence[Grid], scale: FloatArray) -> _Part:
        start = np.cumsum([0, *(len(grid.y) for grid in grids)], dtype=np.int64)
        e = np.empty((len(scale), start[-1]))
        y = np.empty_like(e)
        spread = np.zeros((len(grids), len(scale)))
        for i, grid in enumerate(grids):
            own = slice(start[i], start[i + 1])
            for j, unit in enumerate(scale):
                e[j, own] = grid.e[:, j] / (_size(grid.e[:, j]) or 1.0)
                known = grid.y[np.isfinite(grid.y[:, j]), j] / unit
                y[j, own] = grid.y[:, j] / unit - (known.mean() if len(known) else 0.0)
                spread[i, j] = known.std() if len(known) and grid.outputs[j].spread else 0.0
        return cls(
            start,
            e,
            y,
            np.array([grid.samples for grid in grids], dtype=np.int64),
            np.array([grid.flown for grid in grids], dtype=np.int64),
            spread,
        )

    def arrays(self) -> tuple[Indices, FloatArray, FloatArray, Indices, Indices]:
        return self.start, self.e, self.y, self.samples, self.flown

    def lengths(self, flights: Indices) -> Indices:
        return self.start[flights + 1] - self.start[flights]

    def least(self, flights: Indices) -> FloatArray:
        """Moves that must overlap of each."""
        return np.asarray(np.maximum(LEAST_OVERLAP, SAME_SHARE * self.flown[flights]) - 1.0)

    def output(self, flight: int, j: int) -> FloatArray:
        """What is known of an output."""
        own = self.y[j, self.start[flight] : self.start[flight + 1]]
        return own[np.isfinite(own)]

    def is_whole(self, flight: int) -> bool:
        """Whether the outputs are known without gaps."""
        known = np.flatnonzero(np.isfinite(self.y[0, self.start[flight] : self.start[flight + 1]]))
        return bool(len(known) and known[-1] - known[0] + 1 == len(known))

    def holds_windows(self, flight: int) -> bool:
        """Whether whatever a copy of this flight must share with it holds one of its windows."""
        least = NOISE_SHARE * self.samples[flight]
        return bool(self.is_whole(flight) and min(least, SAME_SHARE * self.flown[flight]) >= SURE_OVERLAP)

    def batches(self, flights: Indices) -> Iterator[Indices]:
        """Flights none of which is more than twice as long as another, as many as a batch holds."""
        order = flights[np.argsort(self.lengths(flights), kind="stable")]
        lengths = self.lengths(order)
        first = 0
        for i in range(1, len(order) + 1):
            if i == len(order) or lengths[i] > 2 * lengths[first] or (i - first + 1) * lengths[i] > BATCH:
                yield order[first:i]
                first = i

    def signals(self, flight: int, j: int) -> FloatArray:
        """(6, N) remainder, output, moves, without means; moves, their squares, where they are known."""
        own = slice(self.start[flight], self.start[flight + 1])
        moves = np.append(np.diff(self.y[j, own]), np.nan)
        known = np.isfinite(moves)
        found = np.zeros((6, len(moves)))
        for row, x in zip(found, (self.e[j, own], self.y[j, own], moves), strict=False):
            finite = np.isfinite(x)
            row[finite] = x[finite] - (x[finite].mean() if finite.any() else 0.0)
        found[3, known] = moves[known]
        found[4] = found[3] ** 2
        found[5] = known
        return found

    def known_moves(self, flights: Indices) -> Indices:
        """(flights, 2) where moves are known from and up to; up to 0 where there are gaps between."""
        found = np.zeros((len(flights), 2), dtype=np.int64)
        for row, flight in zip(found, flights, strict=True):
            known = np.flatnonzero(np.isfinite(self.y[0, self.start[flight] : self.start[flight + 1]]))
            if len(known) and known[-1] - known[0] + 1 == len(known):
                row[:] = known[0], known[-1]
        return found


# ------------------------------------------------------------------------------------------------------ lags


def _lags_of_pairs(theirs: _Part, some: Indices, mine: _Part, others: Indices) -> Indices:
    """(others, some, n_y, 4) lags of mine behind theirs at which `alike` looks; the longer flights stay."""
    least = np.repeat(mine.least(others)[:, None], len(some), axis=1)
    if theirs.lengths(some).max() >= mine.lengths(others).max():
        return _lags(theirs, some, mine, others, least)
    return -_lags(mine, others, theirs, some, least.T.copy()).transpose(1, 0, 2, 3)


def _lags(still: _Part, some: Indices, moved: _Part, others: Indices, least: FloatArray) -> Indices:
    """(others, some, n_y, 4) lags of flights that are moved behind flights that are not."""
    lengths = still.lengths(some)
    widths = moved.lengths(others)
    width = int(widths.max())
    every = int(lengths.max()) + width - 1
    if lengths.max() <= LONGER * width:
        size = scipy.fft.next_fast_len(every, real=True)
        step = size
    else:
        size = scipy.fft.next_fast_len(2 * LONGER * width, real=True)
        step = size - width + 1
    blocks = [(k, first) for k in range(len(some)) for first in range(1 - width, int(lengths[k]), step)]
    rows = max(1, BATCH // size)
    n_y = len(still.y)
    lags = np.zeros((len(others), len(some), n_y, 4), dtype=np.int64)
    ends, own_ends = still.known_moves(some), moved.known_moves(others)
    whole = ends[:, 1].all() & (own_ends[:, 1] > 0)
    for j in range(n_y):
        best = np.full((len(others), len(some), 4), -np.inf)
        own = np.conj(_spectra([moved.signals(int(flight), j) for flight in others], size))
        for at in range(0, len(blocks), rows):
            flight, first = np.array(blocks[at : at + rows], dtype=np.int64).T
            blocked = _spectra(_blocks(still, some, j, blocks[at : at + rows], size), size)
            for i in range(len(others)):
                for kind in (NOISE, OUTPUT, MOVES):
                    product = scipy.fft.irfft(blocked[kind] * own[kind, i], size)[:, :step]
                    peak = product.argmax(axis=1)
                    _keep(
                        product[np.arange(len(peak)), peak],
                        first + peak,
                        flight,
                        best[i, :, kind],
                        lags[i, :, j, kind],
                    )
                gap = blocked[4] * own[5, i] + blocked[5] * own[4, i] - 2.0 * blocked[3] * own[3, i]
                apart = scipy.fft.irfft(gap, size)[:, :step]
                count = np.empty((0, 0)) if whole[i] else scipy.fft.irfft(blocked[5] * own[5, i], size)
                nearest, peak = _closest(apart, count, first, ends[flight], own_ends[i], least[i, flight])
                _keep(-nearest, first + peak, flight, best[i, :, CLOSEST], lags[i, :, j, CLOSEST])
    return lags


def _blocks(
    part: _Part, flights: Indices, j: int, blocks: Sequence[tuple[int, int]], size: int
) -> Iterator[FloatArray]:
    """(6, up to `size`) signals of each block; a flight begins that many samples behind its block's start."""
    last = -1
    for k, first in blocks:
        if k != last:
            signals = part.signals(int(flights[k]), j)
            last = k
        cut = signals[:, max(first, 0) : first + size]
        yield np.pad(cut, ((0, 0), (max(-first, 0), 0)))


def _spectra(signals: Sequence[FloatArray] | Iterator[FloatArray], size: int) -> Spectra:
    """(6, flights, size // 2 + 1), each filled up with zeros."""
    return np.stack([scipy.fft.rfft(x, size) for x in signals], axis=1)


@compiled
def _keep(value: FloatArray, lag: Indices, flight: Indices, best: FloatArray, lags: Indices) -> None:
    """Keep the lags of blocks that are better than what is known of their flights."""
    for r in range(len(value)):
        if value[r] > best[flight[r]]:
            best[flight[r]] = value[r]
            lags[flight[r]] = lag[r]


@compiled
def _closest(
    apart: FloatArray, count: FloatArray, first: Indices, ends: Indices, own: Indices, least: FloatArray
) -> tuple[FloatArray, Indices]:
    """Of each block the least mean gap where enough overlaps, and where; `count` is empty without gaps."""
    nearest = np.full(len(apart), np.inf)
    at = np.zeros(len(apart), dtype=np.int64)
    for r in range(len(apart)):
        for i in range(apart.shape[1]):
            lag = first[r] + i
            if count.size:
                n = count[r, i]
            else:
                n = float(min(ends[r, 1], lag + own[1]) - max(ends[r, 0], lag + own[0]))
            if n > least[r] - 0.5 and apart[r, i] < nearest[r] * max(n, 1.0):
                nearest[r] = apart[r, i] / max(n, 1.0)
                at[r] = i
    return nearest, at


# ------------------------------------------------------------------------------------------------- the screen


@compiled
def _screen(
    start_a: Indices,
    e_a: FloatArray,
    y_a: FloatArray,
    samples_a: Indices,
    flown_a: Indices,
    some: Indices,
    start_b: Indices,
    e_b: FloatArray,
    y_b: FloatArray,
    samples_b: Indices,
    flown_b: Indices,
    others: Indices,
    spread: FloatArray,
    lags: Indices,
    chosen: Flags,
) -> None:
    """Mark the pairs that may be copies."""
    for i in range(len(others)):
        b = others[i]
        mine = slice(start_b[b], start_b[b + 1])
        for k in range(len(some)):
            a = some[k]
            theirs = slice(start_a[a], start_a[a + 1])
            if min(samples_a[a], samples_b[b]) >= LEAST_NOISE and _may_share_noise(
                e_a[:, theirs], e_b[:, mine], lags[i, k, :, NOISE], NOISE_SHARE * samples_b[b]
            ):
                chosen[i, k] = True
            elif min(flown_a[a], flown_b[b]) >= LEAST_OVERLAP:
                chosen[i, k] = _may_share_outputs(
                    y_a[:, theirs],
                    y_b[:, mine],
                    lags[i, k, :, OUTPUT:],
                    SAME_SHARE * flown_b[b],
                    spread[b],
                )


@compiled
def _may_share_noise(e_a: FloatArray, e_b: FloatArray, lags: Indices, least: float) -> bool:
    limit = (np.sqrt(2.0 * np.log(float(e_a.shape[1] + e_b.shape[1]))) + SIGMAS) / SLACK
    for j in range(len(lags)):
        x, z = _overlapping(e_a[j], e_b[j], lags[j])
        n = len(x)
        if n < max(LEAST_NOISE, least):
            continue
        rho = _correlation(x, z)
        if rho * SLACK > LEAST_CORRELATION and rho * np.sqrt(float(n)) > limit:
            return True
    return False


@summing
def _correlation(x: FloatArray, z: FloatArray) -> float:
    """0 where one of them stands still."""
    middle, other = np.mean(x), np.mean(z)
    xx = zz = xz = 0.0
    for k in range(len(x)):
        a = x[k] - middle
        b = z[k] - other
        xx += a * a
        zz += b * b
        xz += a * b
    both = np.sqrt(xx * zz)
    return xz / both if both > 0.0 else 0.0


@compiled
def _may_share_outputs(
    y_a: FloatArray, y_b: FloatArray, lags: Indices, least: float, spread: FloatArray
) -> bool:
    tried = lags.ravel()
    for t in range(len(tried)):
        known = False
        for before in range(t):
            known |= tried[before] == tried[t]
        if not known and _may_agree(y_a, y_b, tried[t], least, spread):
            return True
    return False


@compiled
def _may_agree(y_a: FloatArray, y_b: FloatArray, lag: int, least: float, spread: FloatArray) -> bool:
    """Whether outputs may agree at a lag: each of the few samples asked first, then of all."""
    for j in range(len(spread)):
        if spread[j] == 0.0:
            continue
        x, z = _overlapping(y_a[j], y_b[j], lag)
        if len(x) < max(LEAST_OVERLAP, least):
            return False
        rows = len(x) - 2 * NEIGHBOURS
        limit = (SAME_OUTPUT * spread[j] * SLACK) ** 2 * max(rows - COLUMNS + 1, 1)
        step = max(1, rows // FIRST_ROWS)
        if _left(x, z, step, limit) and _left(z, x, step, limit):
            return False
        if step > 1 and _left(x, z, 1, limit) and _left(z, x, 1, limit):
            return False
    return True


@compiled
def _left(x: FloatArray, z: FloatArray, step: int, limit: float) -> bool:
    """Whether a constant and neighbours in z leave more than `limit` of the squares of every step-th x.

    The neighbours stand as differences: where they change slowly, they are nearly alike.
    """
    gram = np.zeros((COLUMNS, COLUMNS))
    row = np.empty(COLUMNS)
    for k in range(NEIGHBOURS, len(x) - NEIGHBOURS, step):
        before = z[k - 1] + z[k + 1]
        after = z[k + 1] - z[k - 1]
        row[0] = 1.0
        row[1] = z[k]
        row[2] = after
        row[3] = before - 2.0 * z[k]
        row[4] = z[k + 2] - z[k - 2] - 2.0 * after
        row[5] = z[k + 2] + z[k - 2] - 4.0 * before + 6.0 * z[k]
        row[6] = x[k]
        for p in range(COLUMNS):
            for q in range(p + 1):
                gram[p, q] += row[p] * row[q]
    return _last_pivot(gram) > limit


@compiled
def _last_pivot(gram: FloatArray) -> float:
    """What a best fit leaves of the last column's squares; columns that are but rounding explain nothing."""
    size = len(gram)
    whole = np.diag(gram).copy()
    for c in range(size - 1):
        if gram[c, c] <= ROUNDING * whole[c]:
            continue
        for p in range(c + 1, size):
            share = gram[p, c] / gram[c, c]
            for q in range(c + 1, p + 1):
                gram[p, q] -= share * gram[q, c]
    return float(gram[size - 1, size - 1])


@compiled
def _overlapping(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    """The samples of a and of b moved by `lag` that both have."""
    first = max(lag, 0)
    other = max(-lag, 0)
    common = max(0, min(len(a) - first, len(b) - other))
    x = a[first : first + common]
    z = b[other : other + common]
    n = 0
    last = 0
    for k in range(common):
        if not np.isnan(x[k] + z[k]):
            n += 1
            last = k + 1
    if n == 0 or np.all(np.isfinite(x[last - n : last] + z[last - n : last])):
        return x[last - n : last], z[last - n : last]
    both = np.isfinite(x + z)
    return x[both], z[both]
