"""Whether two flights on one grid of time are the same flight: tests 2 and 3 of `copies`, at given lags.

Both are compiled: of many flights millions of pairs are judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
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
COLUMNS = 2 * NEIGHBOURS + 3  # a sample and its neighbours, a constant, and what they are to explain
FIRST_ROWS = 4 * (COLUMNS - 1)  # samples that are compared first: four for each number that is fitted to them
ROUNDING = 1e-12  # of a column's squares: less than this left of it is rounding

Indices = npt.NDArray[np.int64]

compiled = njit(cache=True, error_model="numpy")
summing = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})


@dataclass(frozen=True, eq=False)
class Grid:
    """One flight on a grid of time: (N, n_u) inputs, (N, n_y) outputs and what the model leaves of them, NaN
    in gaps."""

    u: FloatArray
    y: FloatArray
    e: FloatArray

    @cached_property
    def samples(self) -> int:
        """How many of the remainder are known."""
        return int(np.isfinite(self.e[:, 0]).sum())

    @cached_property
    def flown(self) -> int:
        """Samples in which the outputs move."""
        return int(np.isfinite(self.y[:, 0]).sum())


@compiled
def same_noise(e_a: FloatArray, e_b: FloatArray, lags: Indices, least: float) -> tuple[int, float]:
    """How many samples of (n_y, N) remainders overlap where they share their noise, and its correlation.

    `lags`: (n_y,) of b behind a. `least`: samples that must overlap.
    """
    # the largest of so many lags by chance, in standard deviations
    limit = np.sqrt(2.0 * np.log(float(e_a.shape[1] + e_b.shape[1]))) + SIGMAS
    for j in range(len(lags)):
        x, z = _overlapping(e_a[j], e_b[j], lags[j])
        if len(x) < max(LEAST_NOISE, least):
            continue
        rho = _correlation(x, z)
        if rho > LEAST_CORRELATION and rho * np.sqrt(float(len(x))) > limit:
            return len(x), rho
    return 0, 0.0


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
def same_output(
    a: tuple[FloatArray, FloatArray],
    b: tuple[FloatArray, FloatArray],
    lag: int,
    least: float,
    spread: FloatArray,
) -> int:
    """How many samples overlap where all outputs agree, and the inputs roughly; 0 where they do not.

    `a`, `b`: (n_u, N) inputs and (n_y, N) outputs. `least`: samples that must overlap.
    `spread`: (n_y,) standard deviation of b's outputs; 0 of what stands still.
    """
    (u_a, y_a), (u_b, y_b) = a, b
    fewest = 0
    for j in range(len(spread)):
        if spread[j] == 0.0:
            continue
        x, z = _overlapping(y_a[j], y_b[j], lag)
        if len(x) < max(LEAST_OVERLAP, least) or _apart(x, z, SAME_OUTPUT * spread[j]):
            return 0
        fewest = len(x) if fewest == 0 else min(fewest, len(x))
    for j in range(len(u_b) if fewest else 0):
        x, z = _overlapping(u_a[j], u_b[j], lag)
        # a step may be a sample late, where values are held
        if np.any(x != z) and _apart(x, z, SAME_INPUT * float(np.std(z))):
            return 0
    return fewest


@compiled
def _apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    """Whether two records differ by more than `limit` (RMS), one of them filtered as suits them best.

    Another recorder has its own zero and rounds its factors, samples at other times, and smooths: a constant
    and five neighbours of each sample take all that out. Which of them it did that to is not known. What few
    samples leave of a best fit is never more than what all of them leave: these are compared first.
    """
    rows = len(x) - 2 * NEIGHBOURS
    squares = limit**2 * max(rows - COLUMNS + 1, 1)
    step = max(1, rows // FIRST_ROWS)
    if step > 1 and _left(x, z, step)[0] > squares and _left(z, x, step)[0] > squares:
        return True
    return _differs(_left(x, z, 1), squares) and _differs(_left(z, x, 1), squares)


@compiled
def _differs(left: tuple[float, float], squares: float) -> bool:
    """Whether too much is left, or one flight is larger or smaller, not another's factor."""
    return left[0] > squares or abs(left[1] - 1.0) > SAME_GAIN


@compiled
def _left(x: FloatArray, z: FloatArray, step: int) -> tuple[float, float]:
    """What a constant and neighbours in z leave of the squares of every step-th x, and their factor.

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
    return _fit(gram)


@compiled
def _fit(gram: FloatArray) -> tuple[float, float]:
    """What a best fit leaves of the last column's squares, and the weight of the second column.

    Columns that are but rounding explain nothing; what stands still has no factor.
    """
    last = len(gram) - 1
    whole = np.diag(gram).copy()
    used = np.zeros(last, dtype=np.bool_)
    for c in range(last):
        used[c] = gram[c, c] > ROUNDING * whole[c]
        for p in range(c + 1, last + 1 if used[c] else 0):
            share = gram[p, c] / gram[c, c]
            for q in range(c + 1, p + 1):
                gram[p, q] -= share * gram[q, c]
    weights = np.zeros(last)
    for c in range(last - 1, 0, -1):
        if used[c]:
            rest = gram[last, c]
            for p in range(c + 1, last):
                rest -= weights[p] * gram[p, c]
            weights[c] = rest / gram[c, c]
    return float(gram[last, last]), weights[1] if used[1] else 1.0


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
