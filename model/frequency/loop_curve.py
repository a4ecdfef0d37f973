"""A measured response as a smooth curve, with draws of it: what figures are read off as a whole.

ln G over ln omega is smoothed by parabolas over its neighbours, by least squares with the points' errors.
Draws of the smooth curve have those errors and their correlation, and are smoothed alike, so that a figure of
a draw goes through all that the figure itself went through: which crossing is taken, where a peak lies.
Around the draws the interval is turned over (the basic bootstrap: Davison & Hinkley, 1997, Bootstrap Methods
and their Application, 5.2): the largest value of a noisy curve is too large, that of a draw of it again, and
by about as much. Beside the scatter counts what one more power of the curve changes, as how it bends is not
known either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.polynomials import CONFIDENCE, Z95, ComplexArray

NEIGHBOURS = 5
"""Points of a curve's stretch, at least."""
POWERS = 3
DRAWS = 400
LEAST_ERROR = 1e-9
Stretch = tuple[int, int]


@dataclass(frozen=True, eq=False)
class LoopCurve:
    """Trusted points of ln G, its phase without jumps.

    `x`: (M,) ln omega.
    `every`: (2 + D, M) the smooth curve, the one with one more power, and the draws.
    """

    x: FloatArray
    every: ComplexArray

    @classmethod
    def of(cls, measured: MeasuredResponse, source: int) -> LoopCurve | str:
        """Or why there is none."""
        inside = np.flatnonzero(measured.trusted(source))
        if len(inside) < NEIGHBOURS:
            return "no band can be trusted"
        g = measured.response[inside, source]
        phase = np.unwrap(np.angle(g))
        # the branch in which the first point lies between -270 and 90 degrees
        phase -= 2.0 * np.pi * np.ceil((phase[0] - np.pi / 2) / (2.0 * np.pi))
        x = np.log(measured.omega[inside])
        raw = np.log(np.abs(g)) + 1j * phase
        error = np.maximum(measured.half_width()[inside, source] / Z95, LEAST_ERROR)
        smooth = _smoother(x, error, POWERS)
        own = smooth @ raw
        away = _scatter(error, measured.correlation[source][np.ix_(inside, inside)])
        away = away + _turned(measured.omega[inside] * measured.late_s)
        other = _smoother(x, error, POWERS + 1) @ raw
        return cls(x, np.vstack([own, other, own + away @ smooth.T]))

    @property
    def own(self) -> ComplexArray:
        """(M,) the smooth curve."""
        return np.asarray(self.every[0])

    def through(self, function: Callable[[ComplexArray], ComplexArray]) -> LoopCurve:
        """The curve of a function of all curves (K, M)."""
        return replace(self, every=function(self.every))

    def fall(self, values: FloatArray, *, last: bool) -> Stretch | None:
        """Where values (K, M) over the curves fall through 0, and stay below.

        First and last index of a stretch. The first fall may begin where the curve is not clearly above 0 any
        more; the last one (`last`) ends where it stays clearly below. Between, noise may cross 0 again and
        again.
        """
        clear = Z95 * np.maximum(values[2:].std(axis=0), LEAST_ERROR)
        above = np.flatnonzero(values[0] > clear)
        below = np.flatnonzero(values[0] < -clear)
        if not len(above) or not len(below) or below[-1] < above[0]:
            return None
        if last:
            doubt = np.flatnonzero(values[0] >= -clear)
            return (
                None if below[-1] < above[-1] else (int(above[-1]), int(min(doubt[-1] + 1, len(clear) - 1)))
            )
        stop = below[below > above[0]][0]
        doubt = above[0] + np.flatnonzero(values[0, above[0] : stop + 1] <= clear[above[0] : stop + 1])
        return int(doubt[0] - 1), int(stop)

    def place(self, values: FloatArray, stretch: Stretch) -> FloatArray:
        """(K,) x at which values (K, M) fall through 0 in a stretch: its length in which they are above."""
        start, stop = stretch
        before = values[:, start:stop]
        after = values[:, start + 1 : stop + 1]
        size = np.abs(before) + np.abs(after)
        above = np.where(
            size > 0.0,
            (np.maximum(before, 0.0) + np.maximum(after, 0.0)) / np.where(size > 0.0, size, 1.0),
            0.5,
        )
        return np.asarray(self.x[start] + above @ np.diff(self.x[start : stop + 1]))

    def at(self, values: FloatArray, x: FloatArray) -> FloatArray:
        """(K,) of values (K, M) at one x (K,) each."""
        k = np.clip(np.searchsorted(self.x, x) - 1, 0, len(self.x) - 2)
        share = (x - self.x[k]) / (self.x[k + 1] - self.x[k])
        rows = np.arange(len(values))
        return np.asarray((1.0 - share) * values[rows, k] + share * values[rows, k + 1])

    def highest(self, values: FloatArray) -> FloatArray:
        """(K,) the largest of values (K, M), by a parabola through its neighbours; NaN at an edge."""
        top = np.argmax(values, axis=1)
        inside = np.clip(top, 1, len(self.x) - 2)
        rows = np.arange(len(values))
        before, middle, after = (values[rows, inside + k] for k in (-1, 0, 1))
        bend = np.minimum(before - 2.0 * middle + after, -1e-12)
        apex = middle - (after - before) ** 2 / (8.0 * bend)
        return np.where(top == inside, apex, np.nan)


def interval(values: FloatArray) -> tuple[float, float, float] | None:
    """(value, low, high) of a figure of all curves (K,), as `LoopCurve.every` has them; None where the figure
    of one draw in twenty cannot be had."""
    own, other = values[:2]
    draws = values[2:][np.isfinite(values[2:])]
    if not np.isfinite(own) or len(draws) < CONFIDENCE * (len(values) - 2):
        return None
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, middle, high = np.quantile(draws, [tail, 0.5, 1.0 - tail])
    value = 2.0 * own - middle
    bend = abs(other - own) if np.isfinite(other) else 0.0
    return (
        float(value),
        float(value - np.hypot(high - middle, bend)),
        float(value + np.hypot(middle - low, bend)),
    )


def _smoother(x: FloatArray, error: FloatArray, powers: int, *, window: float = 0.12) -> FloatArray:
    """(M, M) from points to the values of their curves.

    `window`: half width of a curve's stretch in ln omega, at least.
    """
    # of its neighbours: by its own scatter a point would be preferred for its error
    weight = 1.0 / _median_of(error) ** 2
    found = np.zeros((len(x), len(x)))
    for k, middle in enumerate(x):
        away = np.abs(x - middle)
        near = np.flatnonzero(away <= max(window, float(np.sort(away)[NEIGHBOURS - 1])))
        basis = ((x[near] - middle) / window)[:, None] ** np.arange(min(powers, NEIGHBOURS))
        root = np.sqrt(weight[near] / weight[near].max())
        found[k, near] = np.linalg.pinv(basis * root[:, None])[0] * root
    return found


def _median_of(error: FloatArray) -> FloatArray:
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(error, NEIGHBOURS, mode="nearest"))


def _turned(turn: FloatArray) -> ComplexArray:
    """(D, M) what draws of a delay that all points share do to ln G; `turn`: (M,) its standard error, rad."""
    return np.asarray(1j * np.random.default_rng(1).standard_normal((DRAWS, 1)) * turn)


def _scatter(error: FloatArray, correlation: FloatArray) -> ComplexArray:
    """(D, M) draws of the points' errors."""
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(0)
    white = rng.standard_normal((DRAWS, len(error))) + 1j * rng.standard_normal((DRAWS, len(error)))
    return np.asarray((white @ root.T) * error)
