"""Which of many pairs of flights are the same flight, as `alike` judges it.

`alike` looks at a few lags of a pair only: where products of remainders, of outputs or of their changes are
largest, and where changes differ least. These come from correlations of whole batches of flights of like
length, one transform back a pair and signal. Of very many flights only those pairs are looked at that have
a stretch in common (`like_windows`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from flysid.leakage.alike import (
    LEAST_OVERLAP,
    NOISE_SHARE,
    SAME_OUTPUT,
    SAME_SHARE,
    Grid,
    compiled,
    same_noise,
    same_output,
)
from flysid.leakage.like_windows import pairs_alike, sure_overlap
from flysid.stretch import FloatArray

Spectra = npt.NDArray[np.complex128]
Indices = npt.NDArray[np.int64]

BATCH = 1 << 18  # samples that are moved over others at a time
EVERY_PAIR = 1 << 18  # that many are looked at one by one: some seconds of flights of 300 samples
NOISE, OUTPUT, MOVES, CLOSEST = range(4)  # whose lag it is


def same_flights(
    train: Sequence[Grid], held: Sequence[Grid], *, every_pair: int = EVERY_PAIR
) -> Iterator[tuple[int, int, str]]:
    """Numbers of held-out and training flights that are the same, and the evidence.

    Of flights of like length, those of each part in their order; the shortest first.

    `every_pair`: up to so many pairs are all looked at. Of more only those are that have a stretch in common,
        as all copies had that were tried.
    """
    units = [_units(x, train, held) for x in ("u", "y")]
    theirs, mine = (_Part.of(part, *units) for part in (train, held))
    if len(train) * len(held) <= every_pair:
        yield from _same(theirs, np.arange(len(train)), mine, np.arange(len(held)))
        return
    by_windows = np.array([mine.holds_windows(i) for i in range(len(held))], dtype=np.bool_)
    yield from _same(theirs, np.arange(len(train)), mine, np.flatnonzero(~by_windows))
    for i, some in _with_common_windows(theirs, mine, np.flatnonzero(by_windows)):
        yield from _same(theirs, some, mine, np.array([i]))


def _same(theirs: _Part, known: Indices, mine: _Part, sought: Indices) -> Iterator[tuple[int, int, str]]:
    """Of all pairs of these flights, those that are the same."""
    for some in theirs.batches(known):
        for others in mine.batches(sought):
            size = _transform_size(theirs, some, mine, others)
            rows = max(1, BATCH // size)
            for a in np.array_split(some, -(-len(some) // rows)):
                spectra = theirs.spectra(a, size)
                for b in np.array_split(others, -(-len(others) // rows)):
                    lags = _lags(spectra, mine.spectra(b, size), size, mine.least(b))
                    lags = np.where(lags < theirs.lengths(a)[:, None, None], lags, lags - size)
                    overlap, rho = _judge(theirs.arrays(), a, mine.arrays(), b, mine.spread, lags)
                    for i, k in np.argwhere(overlap):
                        yield int(b[i]), int(a[k]), _how(mine, b[i], overlap[i, k], rho[i, k])


def _how(mine: _Part, flight: int, overlap: int, rho: float) -> str:
    """How two flights are the same."""
    if rho:
        share = 100.0 * overlap / mine.samples[flight]
        return f"its noise is the same over {share:.0f} % of it (correlation {rho:.2f})"
    share = min(100.0, 100.0 * overlap / mine.flown[flight])
    return f"its outputs are the same to within {100.0 * SAME_OUTPUT:.0f} % over {share:.0f} % of it"


def _with_common_windows(theirs: _Part, mine: _Part, sought: Indices) -> Iterator[tuple[int, Indices]]:
    """Each of these flights with the training flights that share a window with it, or that have gaps."""
    whole = np.array([theirs.is_whole(k) for k in range(len(theirs.flown))], dtype=np.bool_)
    known = np.flatnonzero(whole)
    found: dict[int, set[int]] = {int(i): set(np.flatnonzero(~whole).tolist()) for i in sought}
    for j in range(len(theirs.y)):
        outputs = ([part.output(k, j) for k in some] for part, some in ((theirs, known), (mine, sought)))
        for i, k in pairs_alike(*outputs):
            found[int(sought[i])].add(int(known[k]))
    for i, some in found.items():
        yield i, np.array(sorted(some), dtype=np.int64)


def _units(name: str, *parts: Sequence[Grid]) -> FloatArray:
    """(n,) the largest magnitude of each input or output over all flights; 1 where it is 0."""
    sizes = [[_size(column) for column in getattr(grid, name).T] for part in parts for grid in part]
    largest = np.max(sizes, axis=0)
    return np.asarray(np.where(largest > 0.0, largest, 1.0), dtype=np.float64)


def _size(x: FloatArray) -> float:
    """The largest magnitude; 0 where nothing is known."""
    return float(np.nanmax(np.abs(x))) if np.isfinite(x).any() else 0.0


# ---------------------------------------------------------------------------------------- one part's flights

Arrays = tuple[Indices, FloatArray, FloatArray, FloatArray, Indices, Indices]


@dataclass(frozen=True, eq=False)
class _Part:
    """The flights of a part, one behind the other; NaN in gaps.

    `start`: (flights + 1,) where each begins.
    `e`: (n_y, N) what the linear model leaves, of each flight in units of its largest.
    `u`, `y`: (n_u, N), (n_y, N) inputs; outputs less each flight's mean; in units that all flights share.
    `samples`, `flown`: (flights,) samples known of e and of y.
    `spread`: (flights, n_y) standard deviation of y; 0 of what stands still.
    """

    start: Indices
    e: FloatArray
    u: FloatArray
    y: FloatArray
    samples: Indices
    flown: Indices
    spread: FloatArray

    @classmethod
    def of(cls, grids: Sequence[Grid], unit_u: FloatArray, unit_y: FloatArray) -> _Part:
        start = np.cumsum([0, *(len(grid.y) for grid in grids)], dtype=np.int64)
        u = np.concatenate([grid.u / unit_u for grid in grids]).T.copy()
        y = np.empty((len(unit_y), start[-1]))
        e = np.empty_like(y)
        spread = np.zeros((len(grids), len(unit_y)))
        for i, grid in enumerate(grids):
            own = slice(start[i], start[i + 1])
            for j, unit in enumerate(unit_y):
                e[j, own] = grid.e[:, j] / (_size(grid.e[:, j]) or 1.0)
                known = grid.y[np.isfinite(grid.y[:, j]), j] / unit
                y[j, own] = grid.y[:, j] / unit - (known.mean() if len(known) else 0.0)
                spread[i, j] = known.std() if len(known) and np.ptp(known) else 0.0
        samples = np.array([grid.samples for grid in grids], dtype=np.int64)
        flown = np.array([grid.flown for grid in grids], dtype=np.int64)
        return cls(start, e, u, y, samples, flown, spread)

    def arrays(self) -> Arrays:
        return self.start, self.e, self.u, self.y, self.samples, self.flown

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
        least = min(NOISE_SHARE * self.samples[flight], SAME_SHARE * self.flown[flight])
        return bool(self.is_whole(flight) and least >= sure_overlap())

    def batches(self, flights: Indices) -> Iterator[Indices]:
        """Flights none of which is more than twice as long as another, as many as a batch holds."""
        order = flights[np.argsort(self.lengths(flights), kind="stable")]
        lengths = self.lengths(order)
        first = 0
        for i in range(1, len(order) + 1):
            if i == len(order) or lengths[i] > 2 * lengths[first] or (i - first + 1) * lengths[i] > BATCH:
                yield order[first:i]
                first = i

    def spectra(self, flights: Indices, size: int) -> Spectra:
        """(n_y, 6, flights, size // 2 + 1) of each output's signals, filled up with zeros."""
        found = np.empty((len(self.y), 6, len(flights), size // 2 + 1), dtype=np.complex128)
        for j in range(len(self.y)):
            for i, flight in enumerate(flights):
                found[j, :, i] = scipy.fft.rfft(self._signals(int(flight), j), size)
        return found

    def _signals(self, flight: int, j: int) -> FloatArray:
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


# ------------------------------------------------------------------------------------------------------ lags


def _transform_size(theirs: _Part, some: Indices, mine: _Part, others: Indices) -> int:
    """In which any two of these flights can be moved past each other."""
    longest = int(theirs.lengths(some).max() + mine.lengths(others).max())
    return int(scipy.fft.next_fast_len(longest - 1, real=True))


def _lags(theirs: Spectra, mine: Spectra, size: int, least: FloatArray) -> Indices:
    """(others, some, n_y, 4) lags of mine behind theirs at which `alike` looks; below 0 they are `size` more.

    `least` : moves that must overlap of mine.
    """
    n_y, _, some, _ = theirs.shape
    others = mine.shape[2]
    lags = np.empty((others, some, n_y, 4), dtype=np.int64)
    for j in range(n_y):
        for i in range(others):
            own = np.conj(mine[j, :, i])
            for kind in (NOISE, OUTPUT, MOVES):
                lags[i, :, j, kind] = scipy.fft.irfft(theirs[j, kind] * own[kind], size).argmax(axis=1)
            gap = theirs[j, 4] * own[5] + theirs[j, 5] * own[4] - 2.0 * theirs[j, 3] * own[3]
            apart, count = (scipy.fft.irfft(x, size) for x in (gap, theirs[j, 5] * own[5]))
            lags[i, :, j, CLOSEST] = _closest(apart, count, least[i])
    return lags


@compiled
def _closest(apart: FloatArray, count: FloatArray, least: float) -> Indices:
    """(flights,) where the mean gap is least, of where at least so many samples overlap."""
    found = np.zeros(len(apart), dtype=np.int64)
    for r in range(len(apart)):
        nearest = np.inf
        for i in range(apart.shape[1]):
            if count[r, i] > least - 0.5 and apart[r, i] < nearest * max(count[r, i], 1.0):
                nearest = apart[r, i] / max(count[r, i], 1.0)
                found[r] = i
    return found


# -------------------------------------------------------------------------------------------------- the judge


@compiled
def _judge(
    theirs: Arrays, some: Indices, mine: Arrays, others: Indices, spread: FloatArray, lags: Indices
) -> tuple[Indices, FloatArray]:
    """(others, some) samples over which two flights are the same, 0 where they are not, and the correlation
    of their noise, 0 where it is the outputs that agree."""
    start_a, e_a, u_a, y_a, _, _ = theirs
    start_b, e_b, u_b, y_b, samples, flown = mine
    overlap = np.zeros((len(others), len(some)), dtype=np.int64)
    rho = np.zeros((len(others), len(some)))
    for i in range(len(others)):
        b = others[i]
        own = slice(start_b[b], start_b[b + 1])
        for k in range(len(some)):
            a = slice(start_a[some[k]], start_a[some[k] + 1])
            at = lags[i, k]
            overlap[i, k], rho[i, k] = same_noise(
                e_a[:, a], e_b[:, own], at[:, NOISE], NOISE_SHARE * samples[b]
            )
            if overlap[i, k] == 0:
                tried = at[:, OUTPUT:].copy().ravel()
                for t in range(len(tried)):
                    if not np.any(tried[:t] == tried[t]):
                        found = same_output(
                            (u_a[:, a], y_a[:, a]),
                            (u_b[:, own], y_b[:, own]),
                            tried[t],
                            SAME_SHARE * flown[b],
                            spread[b],
                        )
                        overlap[i, k] = max(overlap[i, k], found)
    return overlap, rho
