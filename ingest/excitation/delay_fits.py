"""The error that a model leaves, by its dead time: free runs of second order, or predictions of high order.

The poles of a free run are sought by trial, so only few dead times are fitted. For given poles one
correlation tells what every dead time explains: fixed pairs of poles are looked at first, then those of the
best fit, until none is better. Fits go on to the ends of what is as good, by doubling steps outwards and
halving back; each begins with the poles of its neighbours. The zeros and the starts are a linear problem, so
only two poles are sought (variable projection, Golub and Pereyra 1973). A one-step predictor is linear
throughout: the sums of products of all dead times are made at once.

All errors are those of the same samples: behind the longest dead time, where every model knows its inputs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter
from flysid.lagged import lagged_gram

Piece: TypeAlias = tuple[FloatArray, FloatArray]  # input and output of one segment, without their means

ORDER = 2
ARX_ORDERS = (20, 10)  # of past outputs and inputs


@dataclass(frozen=True, eq=False)
class Fit:
    """A transfer function and the mean squared error it leaves."""

    error: float
    zeros: FloatArray
    poles: FloatArray

    def sign(self, steps: int) -> int:
        """Sign of the step response after `steps` samples."""
        response = apply_filter(self.zeros, self.poles, np.ones(steps + 2))
        return -1 if response[-1] < 0 else 1


def searched_free_runs(pieces: Sequence[Piece], last: int, slack: float) -> dict[int, Fit]:
    """Output error models of the dead times that decide which is best and which are as good.

    Parameters
    ----------
    pieces : inputs and outputs without their means.
    last : longest dead time, samples.
    slack : a dead time whose error is larger by this share at most is as good as the best.

    Returns
    -------
    The best dead time and its neighbours, and the ends of what is as good, are among those tried.
    """
    search = _DelaySearch(pieces, last, slack)
    search.look(_pole_pairs(last))
    seen = -1
    while search.best != seen:
        seen = search.best
        search.look([search.fits[seen].poles])
        for nk in search.likely():
            search.fit(nk)
        for nk in (search.best - 1, search.best + 1):
            search.fit(nk)
        if search.best == seen:
            search.find_end(-1)
            search.find_end(1)
    return search.fits


class _DelaySearch:
    """What is known of the dead times: what poles that were looked at explain, and fits of some."""

    def __init__(self, pieces: Sequence[Piece], last: int, slack: float) -> None:
        self.pieces = pieces
        self.last = last
        self.slack = slack
        self.fits: dict[int, Fit] = {}
        self._explained = np.full(last + 1, -np.inf)
        self._poles = np.zeros((last + 1, ORDER + 1))

    @property
    def best(self) -> int:
        """The dead time that errs least."""
        return min(self.fits, key=lambda nk: self.fits[nk].error)

    @property
    def bound(self) -> float:
        """The largest error that is as good as the best."""
        return self.fits[self.best].error * (1.0 + self.slack)

    def look(self, poles: Iterable[FloatArray]) -> None:
        """What models with these poles explain at every dead time; the best is fitted."""
        for one in poles:
            explained = _explain(self.pieces, one, self.last)
            better = explained > self._explained
            self._explained[better] = explained[better]
            self._poles[better] = one
        self.fit(int(np.argmax(self._explained)))

    def likely(self) -> set[int]:
        """The dead time that is best by what was looked at, and the outermost ones that seem as good."""
        power = sum(float(np.sum(y[self.last + ORDER :] ** 2)) for _, y in self.pieces)
        left = power - self._explained
        good = np.flatnonzero(left <= max(float(left.min()), 0.0) * (1.0 + self.slack))
        return {int(np.argmin(left)), *good[[0, -1]].tolist()}

    def fit(self, nk: int) -> None:
        """Fit the model with this dead time, from its neighbours' poles and the best that were looked at."""
        if nk in self.fits or not 0 <= nk <= self.last:
            return
        known = sorted(self.fits, key=lambda other: abs(other - nk))[:2]
        starts = [self._poles[nk], *(self.fits[other].poles for other in known)]
        runs = (_refine(self.pieces, nk, poles, self.last + ORDER, self.slack) for poles in starts)
        self.fits[nk] = min(runs, key=lambda fit: fit.error)

    def find_end(self, direction: int) -> None:
        """Fit until the outermost dead time that is as good as the best has a worse neighbour outside."""
        step = 1
        while True:
            end = max(
                (nk for nk in self.fits if self.fits[nk].error <= self.bound), key=lambda nk: direction * nk
            )
            outside = [nk for nk in self.fits if direction * (nk - end) > 0]
            if not outside:
                nearest = min(max(end + direction * step, 0), self.last)
                step *= 2
            else:
                nearest = (end + min(outside, key=lambda nk: abs(nk - end))) // 2
            if nearest in self.fits:
                return
            self.fit(nearest)


def _pole_pairs(last: int) -> list[FloatArray]:
    """Double poles with time constants from none to several times the longest dead time."""
    constants = 2.0 ** np.arange(np.ceil(np.log2(8.0 * last)) + 1.0)
    return [np.array([1.0, -2.0 * r, r * r]) for r in (0.0, *np.exp(-1.0 / constants))]


def _explain(pieces: Sequence[Piece], poles: FloatArray, last: int) -> FloatArray:
    """(last + 1,) squares of the output that two zeros and the starts explain, by the dead time."""
    from scipy.fft import irfft, next_fast_len, rfft

    lags = last + ORDER
    by_starts = 0.0
    with_output = np.zeros(lags)
    own = np.zeros(lags)
    neighbours = np.zeros(last + 1)
    for u, y in pieces:
        starts = _start_responses(poles, len(y) - lags)
        through = apply_filter(np.ones(1), poles, u)
        size = next_fast_len(len(u) + lags, real=True)
        late = np.concatenate([np.zeros((len(starts) + 1, lags)), [*starts, y[lags:]]], axis=1)
        products = irfft(rfft(late, size) * np.conj(rfft(through, size)), size)[:, :lags]
        start_y = starts @ y[lags:]
        share = _solve(starts @ starts.T, np.column_stack([products[:-1], start_y]))
        by_starts += float(start_y @ share[:, -1])
        with_output += products[-1] - start_y @ share[:, :-1]
        by_own, by_neighbours = _band(through, lags, ORDER, lags).T
        own += by_own - np.sum(products[:-1] * share[:, :-1], axis=0)
        neighbours += by_neighbours[:-1] - np.sum(products[:-1, :-1] * share[:, 1:-1], axis=0)
    size = np.sqrt(np.maximum(own, 1e-300))
    alike = neighbours / (size[:-1] * size[1:])
    first = with_output[:-1] / size[:-1]
    second = with_output[1:] / size[1:]
    apart = 1.0 - alike**2
    both = (first**2 + second**2 - 2.0 * alike * first * second) / np.maximum(apart, 1e-10)
    return np.asarray(by_starts + np.where(apart > 1e-10, both, first**2))


def _refine(
    pieces: Sequence[Piece], nk: int, poles: FloatArray, first: int, slack: float, *, steps: int = 12
) -> Fit:
    """Poles moved by Gauss-Newton until the error falls by a small part of what makes dead times alike.

    `steps`: Gauss-Newton steps.
    """
    best, step = _project(pieces, nk, _stable(poles), first)
    for _ in range(steps):
        tried = None
        for share in (1.0, 0.3):
            moved = _stable(np.concatenate([[1.0], best.poles[1:] + share * step]))
            tried = _project(pieces, nk, moved, first)
            if tried[0].error < best.error:
                break
        assert tried is not None
        settled = tried[0].error > best.error * (1.0 - 0.03 * slack)
        if tried[0].error < best.error:
            best, step = tried
        if settled:
            break
    return best


def _project(pieces: Sequence[Piece], nk: int, poles: FloatArray, first: int) -> tuple[Fit, FloatArray]:
    """The best zeros and starts for these poles, and the (2,) Gauss-Newton step of the poles."""
    gram = np.zeros((ORDER, ORDER))
    right = np.zeros(ORDER)
    prepared = []
    for u, y in pieces:
        starts = _start_responses(poles, len(u) - first)
        through = apply_filter(np.ones(1), poles, u)
        late = [through[first - nk - i : len(u) - nk - i] for i in range(ORDER)]
        rows = np.concatenate([starts, late])
        products = rows @ rows.T
        with_y = rows @ y[first:]
        s = len(starts)
        share = _solve(products[:s, :s], np.column_stack([products[:s, s:], with_y[:s]]))
        gram += products[s:, s:] - products[s:, :s] @ share[:, :-1]
        right += with_y[s:] - products[s:, :s] @ share[:, -1]
        prepared.append((rows, share, products))
    zeros = _solve(gram, right)
    normal = np.zeros((2 * ORDER, 2 * ORDER))
    slope = np.zeros(2 * ORDER)
    squares = 0.0
    for (_, y), (rows, share, products) in zip(pieces, prepared, strict=True):
        s = len(share)
        model = np.concatenate([share[:, -1] - share[:, :-1] @ zeros, zeros]) @ rows
        left = y[first:] - model
        squares += float(left @ left)
        by_pole = _late_rows(apply_filter(-np.ones(1), poles, model), 1)
        crossed = rows @ by_pole.T
        free = _solve(products[:s, :s], np.column_stack([crossed[:s], products[:s, s:]]))
        own = np.block([[by_pole @ by_pole.T, crossed[s:].T], [crossed[s:], products[s:, s:]]])
        normal += own - np.concatenate([crossed[:s].T, products[s:, :s]]) @ free
        with_left = rows @ left
        slope += np.concatenate([by_pole @ left, with_left[s:]])
        slope -= free.T @ with_left[:s]
    fit = Fit(squares / sum(len(y) - first for _, y in pieces), np.concatenate([np.zeros(nk), zeros]), poles)
    return fit, _solve(normal, slope)[:ORDER]


def _start_responses(poles: FloatArray, samples: int) -> FloatArray:
    """(3, N) of norm 1: responses to the two initial states and to a constant input."""
    impulse = np.zeros(samples)
    impulse[0] = 1.0
    first = apply_filter(np.ones(1), poles, impulse)
    rows = np.concatenate([_late_rows(first, 0), np.cumsum(first)[None]])
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _late_rows(x: FloatArray, samples: int) -> FloatArray:
    """(2, N): x delayed by so many samples and by one more, zeros before it."""
    rows = np.zeros((ORDER, len(x)))
    for i in range(ORDER):
        rows[i, samples + i :] = x[: len(x) - samples - i]
    return rows


def _solve(gram: FloatArray, right: FloatArray, least: float = 1e-10) -> FloatArray:
    """Least squares from sums of products, columns scaled alike; what the data do not tell stays 0."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    wide = scale if right.ndim == 1 else scale[:, None]
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    inverse = np.where(values > least * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    spread = inverse if right.ndim == 1 else inverse[:, None]
    return np.asarray((vectors @ (spread * (vectors.T @ (right / wide)))) / wide)


def _stable(poles: FloatArray) -> FloatArray:
    """A polynomial whose roots outside radius 0.9999 are mirrored or pulled inside."""
    roots = np.roots(poles)
    size = np.abs(roots)
    inside = np.where(size > 1.0, roots / np.maximum(size, 1e-12) ** 2, roots)
    inside = inside * np.minimum(1.0, 0.9999 / np.maximum(np.abs(inside), 1e-12))
    return np.asarray(np.real(np.poly(inside)))


def predictors(pieces: Sequence[Piece], last: int) -> dict[int, Fit]:
    """ARX of high order with every dead time up to `last`, all over the same samples."""
    na, nb = ARX_ORDERS
    first = max(na, last + nb - 1)
    gram = lagged_gram(((i, np.stack([y, u])) for i, (u, y) in enumerate(pieces)), first)
    rows = round(float(gram[-1, -1]))
    past = np.arange(1, na + 1)
    fits: dict[int, Fit] = {}
    for nk in range(last + 1):
        columns = np.concatenate([past, first + 1 + nk + np.arange(nb)])
        own = gram[np.ix_(columns, columns)]
        right = gram[columns, 0]
        theta = _solve(own, right, 1e-12)
        error = max(0.0, float(gram[0, 0]) - float(theta @ (2 * right - own @ theta))) / max(rows, 1)
        zeros = np.concatenate([np.zeros(nk), theta[na:]])
        fits[nk] = Fit(error, zeros, np.concatenate([[1.0], -theta[:na]]))
    return fits


def _band(u: FloatArray, lags: int, width: int, first: int) -> FloatArray:
    """(lags, width) sums of u[k - i] u[k - i - m] over k >= first, at [i, m]; 0 where i + m is no lag."""
    band = np.zeros((lags, width))
    for m in range(width):
        sums = np.concatenate([np.zeros(m + 1), np.cumsum(u[m:] * u[: len(u) - m])])
        i = np.arange(lags - m)
        band[i, m] = sums[len(u) - i] - sums[first - i]
    return band
