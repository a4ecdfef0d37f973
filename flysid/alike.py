"""Whether two flights on one grid of time are the same flight: tests 2 and 3 of `copies`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.stretch import FloatArray

LEAST_NOISE = 40  # samples whose noise is compared
LEAST_OVERLAP = 15  # samples whose outputs are compared
LEAST_CORRELATION = 0.3  # of the remainders of one flight recorded twice, at rates up to ten times apart
NOISE_SHARE = 0.2  # of a flight whose noise is found in another: the two overlap
SAME_OUTPUT = 0.02  # of its spread
SAME_GAIN = 0.1  # of an output: by how much the factors of two recorders may differ
NEIGHBOURS = 2  # samples on either side of one that another recorder may have mixed into it
SAME_SHARE = 0.5  # of a flight whose outputs agree so well
SAME_INPUT = 0.5  # of its spread: steps fall between the samples of the other recorder
SIGMAS = 3.5  # of a correlation beyond the largest that chance makes over all lags


@dataclass(frozen=True, eq=False)
class Record:
    """(N,) one signal of a flight; NaN in gaps, which count as 0 in its spectrum."""

    x: FloatArray

    @cached_property
    def size(self) -> float:
        """The largest magnitude: squares of huge units would overflow."""
        return float(np.nanmax(np.abs(self.x))) or 1.0

    @cached_property
    def spread(self) -> float:
        """The standard deviation, in units of `size`."""
        return float(np.nanstd(self.x / self.size))

    def without_mean(self) -> FloatArray:
        """0 in gaps."""
        known = np.isfinite(self.x)
        mean = self.x[known].mean() if known.any() else 0.0
        return np.where(known, self.x - mean, 0.0)

    def powers(self) -> FloatArray:
        """(3, N) where it is known, itself, its square; in units of its size."""
        known = np.isfinite(self.x)
        x = np.where(known, self.x / self.size, 0.0)
        return np.stack([known, x, x**2])


@dataclass(frozen=True, eq=False)
class Grid:
    """One flight on a grid of time: (N, n_u) inputs, (N, n_y) outputs and what the model leaves of them, NaN
    in gaps."""

    u: FloatArray
    y: FloatArray
    e: FloatArray

    @cached_property
    def samples(self) -> int:
        return int(np.isfinite(self.e[:, 0]).sum())

    @cached_property
    def outputs(self) -> tuple[Record, ...]:
        return tuple(Record(column) for column in self.y.T)

    @cached_property
    def moves(self) -> tuple[Record, ...]:
        """How the outputs change from sample to sample."""
        return tuple(Record(column) for column in np.diff(self.y, axis=0).T)

    @cached_property
    def remainders(self) -> tuple[Record, ...]:
        return tuple(Record(column) for column in self.e.T)

    @cached_property
    def flown(self) -> int:
        """Samples in which the outputs move."""
        return int(np.isfinite(self.y[:, 0]).sum())


def same_noise(theirs: Grid, mine: Grid) -> str:
    """How two flights share their noise, or ''."""
    if min(theirs.samples, mine.samples) < LEAST_NOISE:
        return ""
    for a, b in zip(theirs.remainders, mine.remainders, strict=True):
        x, z = _overlapping(a.x, b.x, _best_lag(a, b))
        if len(x) < max(LEAST_NOISE, NOISE_SHARE * mine.samples):
            continue
        x = x - x.mean()
        z = z - z.mean()
        if not (x.any() and z.any()):
            continue
        # squares of tiny units would vanish
        x = x / np.abs(x).max()
        z = z / np.abs(z).max()
        rho = float(x @ z / np.sqrt((x @ x) * (z @ z)))
        # the largest of so many lags, in standard deviations
        chance = np.sqrt(2.0 * np.log(len(a.x) + len(b.x)))
        if rho > LEAST_CORRELATION and rho * np.sqrt(len(x)) > chance + SIGMAS:
            share = 100.0 * len(x) / mine.samples
            return f"its noise is the same over {share:.0f} % of it (correlation {rho:.2f})"
    return ""


def same_output(theirs: Grid, mine: Grid) -> str:
    """How the outputs of two flights agree, or ''; their inputs must agree roughly."""
    if min(theirs.flown, mine.flown) < LEAST_OVERLAP:
        return ""
    pairs = [*zip(theirs.outputs, mine.outputs, strict=True), *zip(theirs.moves, mine.moves, strict=True)]
    lags = dict.fromkeys(_best_lag(a, b) for a, b in pairs)  # a part of a flight shows by its moves
    least = max(LEAST_OVERLAP, SAME_SHARE * mine.flown) - 1  # of samples, so of moves
    lags.update(
        dict.fromkeys(_closest_lag(a, b, least) for a, b in zip(theirs.moves, mine.moves, strict=True))
    )
    share = max((_share_of_same(theirs, mine, lag) for lag in lags), default=0.0)
    return (
        f"its outputs are the same to within {100.0 * SAME_OUTPUT:.0f} % over {100.0 * share:.0f} % of it"
        if share
        else ""
    )


def _share_of_same(theirs: Grid, mine: Grid, lag: int) -> float:
    """The share of a flight whose outputs agree with another's at some lag; 0 where one of them does not."""
    shares = list[float]()
    for a, b in zip(theirs.outputs, mine.outputs, strict=True):
        if b.spread == 0.0:
            continue
        x, z = _overlapping(a.x, b.x, lag)
        if len(x) < max(LEAST_OVERLAP, SAME_SHARE * mine.flown):
            return 0.0
        if _apart(x / b.size, z / b.size, SAME_OUTPUT * b.spread):
            return 0.0
        shares.append(len(x) / mine.flown)
    alike = all(_alike(*_overlapping(a, b, lag)) for a, b in zip(theirs.u.T, mine.u.T, strict=True))
    return min(1.0, *shares) if shares and alike else 0.0


def _apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    """Whether two records differ by more than `limit` (RMS), one of them filtered as suits them best.

    Another recorder has its own zero and rounds its factors, samples at other times, and smooths: a constant
    and five neighbours of each sample take all that out. Which of them it did that to is not known.
    """
    return _filtered_apart(x, z, limit) and _filtered_apart(z, x, limit)


def _filtered_apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    """Whether samples of z around each one of x leave more than `limit` of it, or are larger or smaller."""
    rows = len(x) - 2 * NEIGHBOURS
    near = [z[k : k + rows] for k in range(2 * NEIGHBOURS + 1)]
    columns = np.stack([np.ones(rows), *near, x[NEIGHBOURS : NEIGHBOURS + rows]], axis=1)
    (triangle, _) = np.linalg.qr(columns, "raw")  # transposed
    rest = abs(triangle[-1, columns.shape[1] - 1])
    if rest > limit * np.sqrt(max(rows - columns.shape[1] + 1, 1)):
        return True
    weights = np.linalg.lstsq(columns[:, :-1], columns[:, -1], rcond=None)[0]
    return bool(abs(weights[1:].sum() - 1.0) > SAME_GAIN)  # larger or smaller flights, not another's factor


def _alike(x: FloatArray, z: FloatArray) -> bool:
    """Whether two records of an input are: a step may be a sample late, where values are held."""
    return not _apart(x, z, SAME_INPUT * float(np.std(z))) or not np.any(x != z)


def _best_lag(theirs: Record, mine: Record) -> int:
    """The lag of mine behind theirs at which their product is largest; NaN counts as 0."""
    size = 1 << int(np.ceil(np.log2(len(theirs.x) + len(mine.x))))
    a, b = (np.fft.rfft(s.without_mean(), size) for s in (theirs, mine))
    at = int(np.argmax(np.fft.irfft(a * np.conj(b), size)))
    return at if at < len(theirs.x) else at - size


def _closest_lag(theirs: Record, mine: Record, least: float) -> int:
    """The lag of mine behind theirs at which they differ least, where at least so many samples overlap."""
    size = 1 << int(np.ceil(np.log2(len(theirs.x) + len(mine.x))))
    a = np.fft.rfft(theirs.powers(), size)
    b = np.conj(np.fft.rfft(mine.powers(), size))
    larger = max(theirs.size, mine.size)
    p, q = theirs.size / larger, mine.size / larger
    apart = p**2 * a[2] * b[0] + q**2 * a[0] * b[2] - 2.0 * p * q * a[1] * b[1]
    count, gap = np.fft.irfft([a[0] * b[0], apart], size)
    mean = np.where(count > least - 0.5, gap / np.maximum(count, 1.0), np.inf)
    at = int(np.argmin(mean))
    return at if at < len(theirs.x) else at - size


def _overlapping(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    """The samples of a and of b moved by `lag` that both have."""
    mine = a[max(lag, 0) :]
    theirs = b[max(-lag, 0) :]
    common = min(len(mine), len(theirs))
    mine = mine[:common]
    theirs = theirs[:common]
    both = np.isfinite(mine) & np.isfinite(theirs)
    return mine[both], theirs[both]
