"""What a model of rules does about the places at which its vehicle rests, and how sure that is.

Numbers are of tangents (`flysid.model.rules.local_models`) at places spread over what was flown. Their errors
are to first order, the place solved anew for every step: noise, and what the model cannot express, which no
covariance shows. That is what the free run's errors tell of slopes that are missing at the place, in the
sensor and in the law (`flysid.model.rules.lack_of_fit`), or a floor where this is more; and of a time, that a
condition on an input switches all its lags at once, which makes it as unsure as these are apart.
Such an error is the same in every sample and has a bound: it is taken to lie anywhere up to there (JCGM
100:2008, 4.3.7), so that 95 % are within 1.65 standard deviations, not 1.96.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.extras import Extra, extra
from flysid.model.base import OperatingPoint
from flysid.model.covariance import STEP, root_of
from flysid.model.polynomials import CONFIDENCE, Z95
from flysid.model.rules.lack_of_fit import missing_slopes
from flysid.model.rules.local_models import Place, SteadyMap
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.rule_uncertainty import NUDGE, Uncertainty, uncertainty
from flysid.model.rules.vocabulary import Axis
from flysid.model.threads import on_one_thread

_FLOWN = (0.01, 0.99)  # quantiles of signals within which a model is asked
_GRID = 41  # places on the way from one end to the other
_MODEST = (0.1, 0.5, 0.9)  # quantiles that stand for slow, cruise and fast
_FLOOR = 0.03  # of a figure: what orders and sampling cost that no model nearby shows
_LOST = float(-np.log(np.finfo(float).eps))  # half an interval beyond which one end is the other's rounding
_EVENLY = CONFIDENCE * np.sqrt(3.0)  # standard deviations that so many of evenly spread errors are within

M = TypeVar("M", bound=RuleModel)


def describe(model: M, train: Dataset, *, settled: bool = False) -> M:
    """The model with its operating points; with intervals where it is `settled`, a minimum of the error."""
    return replace(model, operating_points=AtRest(partial(_found, model, train, settled)))


class AtRest(Sequence[OperatingPoint]):
    """Operating points, found when they are first read: most models of a search are compared and dropped.

    Parameters
    ----------
    find : finds them.
    """

    def __init__(self, find: Callable[[], tuple[OperatingPoint, ...]]) -> None:
        self._find: Callable[[], tuple[OperatingPoint, ...]] | None = find
        self._points: tuple[OperatingPoint, ...] = ()

    def _known(self) -> tuple[OperatingPoint, ...]:
        if self._find is not None:
            self._points = self._find()
            self._find = None  # and the training data with it
        return self._points

    def __len__(self) -> int:
        return len(self._known())

    def __getitem__(self, at: Any) -> Any:
        return self._known()[at]

    def __reduce__(self) -> tuple[type, tuple[tuple[OperatingPoint, ...]]]:
        return tuple, (self._known(),)


@on_one_thread
def _found(model: RuleModel, train: Dataset, settled: bool) -> tuple[OperatingPoint, ...]:
    """Of the model, which knows none yet."""
    sure = None
    if settled:
        sure = extra(Extra.INTERVALS_AT_REST, partial(_sure, model, train), None, model.structure)
    own = SteadyMap(model.layout, model.parameters)
    return extra(Extra.OPERATING_POINTS, partial(operating_points, own, train, sure), (), model.structure)


def _sure(model: RuleModel, train: Dataset) -> Uncertainty | None:
    """How sure the model is of its numbers; None where there are fewer samples than numbers."""
    with contextlib.suppress(DataError), np.errstate(all="ignore"):
        return uncertainty(model, train)
    return None


def operating_points(
    model: SteadyMap, train: Dataset, sure: Uncertainty | None = None
) -> tuple[OperatingPoint, ...]:
    """For every output: places over what was flown; none where the model comes to no rest (it integrates).

    Parameters
    ----------
    train : data that the model was fitted to.
    sure : how sure the model is of its numbers; None: no intervals.
    """
    outputs = range(len(train.outputs))
    return tuple(p for output in outputs for p in _Asked(model, train, sure, output).points())


@dataclass(frozen=True, eq=False)
class _Asked:
    """One output of one model."""

    model: SteadyMap
    train: Dataset
    sure: Uncertainty | None
    output: int

    def points(self) -> Iterator[OperatingPoint]:
        """What the model does from slow to fast, as far as it rests there within what the input has flown."""
        y = np.concatenate([s.y[:, self.output] for s in self.train.segments])
        u = np.concatenate([s.u[:, self.moved] for s in self.train.segments])
        wanted = _levels(y)
        first, last = np.quantile(y, _FLOWN)
        knots = np.linspace(first, last, _GRID)
        grid = np.unique(np.concatenate([knots, wanted]))
        shift, scale = self.model.layout.shift, self.model.layout.scale
        column = self.model.n + self.moved
        low, high = (np.quantile(u, _FLOWN) - shift[column]) / scale[column]
        found = {
            level: place
            for level, place in walked(self.model, self.output, self.moved, grid).items()
            if low <= place.w[column] <= high and place.tangent.samples() is not None
        }
        levels = np.array(sorted(found))
        nearest = [levels[np.abs(levels - v).argmin()] for v in wanted] if found else []
        chosen = np.unique(nearest)
        lacks = self._lacks(knots, chosen)
        for level, lack in zip(chosen, lacks, strict=True):
            yield self._point(found[level], lack)

    def _lacks(self, knots: FloatArray, levels: FloatArray) -> FloatArray:
        """(L, 2) mean squares of the slopes that are missing at levels, in the sensor and in the law."""
        if self.sure is None or not len(levels):
            return np.full((len(levels), 2), np.nan)
        shift, scale = self.model.layout.shift[self.output], self.model.layout.scale[self.output]
        normal = ((knots - shift) / scale, (levels - shift) / scale)
        return missing_slopes(self.sure, self.output, *normal).T

    @cached_property
    def moved(self) -> int:
        """The input that moves the output most over its own spread, at the mean of training."""
        A, B, _ = self.model.at(np.zeros(len(self.model.layout.scale))).tangent
        gains = np.linalg.pinv(np.eye(self.model.n) - A.sum(axis=0)) @ B.sum(axis=0)
        return int(np.abs(gains[self.output]).argmax())

    def _point(self, place: Place, lack: FloatArray) -> OperatingPoint:
        layout = self.model.layout
        n, n_y = self.model.n, layout.n_y
        dt = self.train.dt_s
        output = self.output
        tangent = place.tangent
        samples = tangent.samples()
        assert samples is not None
        inputs = range(len(layout.inputs))
        answers = [tangent.answer(j, samples, output) for j in inputs]
        figures = np.array([(a.gain, a.reached) for a in answers]).T
        wide = np.minimum(self._half_widths(place, figures, samples, lack), _LOST)
        gain, reached = figures * np.stack(
            [layout.scale[output] / layout.scale[n:], np.full(len(inputs), dt)]
        )
        ends = np.exp(np.stack([-wide, wide], axis=1))  # (2 figures, low and high, inputs)
        at = place.w * layout.scale + layout.shift
        return OperatingPoint(
            output=output,
            outputs=at[:n_y],
            inputs=at[n:],
            gain=gain,
            gain_interval=np.sort(gain * ends[0], axis=0),
            reached_s=reached,
            reached_interval_s=reached * ends[1],
            dead_s=np.array([dt * max(tangent.delay(output, j) - 1, 0) for j in inputs]),
            overshoot=np.array([a.overshoot for a in answers]),
            wrong_way=np.array([a.wrong_way for a in answers]),
            shares=place.shares,
            sample_s=dt,
        )

    def _figures(self, model: SteadyMap, place: Place, samples: int | None) -> FloatArray | None:
        """(2, n_u) gain and samples to 63 % of a model that rests near a place; None where it does not."""
        found = model.resting(place.w, self.output, self.moved)
        return None if found is None or samples is None else self._figures_at(found, samples)

    def _figures_at(self, place: Place, samples: int) -> FloatArray:
        """(2, n_u) gain and samples to 63 % of the tangent at a place."""
        inputs = range(len(self.model.layout.inputs))
        answers = (place.tangent.answer(j, samples, self.output) for j in inputs)
        return np.array([(a.gain, a.reached) for a in answers]).T

    def _half_widths(self, place: Place, figures: FloatArray, samples: int, lack: FloatArray) -> FloatArray:
        """(2, n_u) half 95 % intervals of the logarithms of gain and time; NaN where nothing is known.

        `lack`: (2,) mean squares of the slopes that are missing there, see `_lacks`.
        """
        if self.sure is None:
            return np.full(figures.shape, np.nan)
        noise = np.zeros(figures.shape)
        root = root_of(self.sure.covariance)
        with np.errstate(all="ignore"):  # an answer at once takes no time at all
            for direction in root.T[np.abs(root).max(axis=0) > 0.0]:
                near = (
                    replace(self.model, parameters=self.sure.beside(way * direction)) for way in (STEP, -STEP)
                )
                more, less = (self._figures(model, place, samples) for model in near)
                if more is None or less is None:
                    return np.full(figures.shape, np.nan)
                noise += ((more - less) / (2.0 * STEP * figures)) ** 2
            missing = lack[1] * self._law_moves(place, figures, samples) ** 2
            missing[0] += lack[0]
            missing = np.maximum(missing, _FLOOR**2)
            missing[1] = np.maximum(missing[1], (self._switch() / figures[1]) ** 2)
            return np.asarray(np.hypot(Z95 * np.sqrt(noise), _EVENLY * np.sqrt(missing)))

    def _law_moves(self, place: Place, figures: FloatArray, samples: int) -> FloatArray:
        """(2, n_u) derivatives of logarithms to the weight of the output one sample ago in its equation."""
        A = place.tangent.A
        lasting = np.linalg.inv(np.eye(self.model.n) - A.sum(axis=0))[self.output, self.output]
        small = NUDGE / lasting  # of a fast sampled slow answer less than that moves much
        ends = []
        for way in (small, -small):
            moved = A.copy()
            moved[0, self.output, self.output] += way
            near = replace(place, tangent=place.tangent._replace(A=moved))
            ends.append(self._figures_at(near, samples))
        return np.asarray((ends[0] - ends[1]) / (2.0 * small * figures))

    def _switch(self) -> FloatArray:
        """(n_u,) samples from the first to the last lag of every input that conditions speak of; else 0.

        Such a condition switches the weights of all these lags at once, with one of them, so that how an
        answer is spread over them hangs on the condition. Steady gains do not.
        """
        lags = self.model.layout.lags
        columns = range(self.model.n, len(self.model.layout.scale))
        own = [lags.lag[lags.column == column] for column in columns]
        spoken = [column in lags.z_column and len(lag) > 0 for column, lag in zip(columns, own, strict=True)]
        return np.array([float(np.ptp(lag)) if said else 0.0 for lag, said in zip(own, spoken, strict=True)])


def _levels(y: FloatArray) -> FloatArray:
    """Slow, cruise and fast, either way where both signs were flown.

    Not zero itself: a gain that drag bends changes most there, and few samples tell.
    """
    low, high = np.quantile(y, _FLOWN)
    if not Axis("", "", float(low), float(high)).has_both_signs:
        return np.asarray(np.quantile(y, _MODEST))
    sizes = np.quantile(np.abs(y), _MODEST)
    return np.concatenate([-sizes[::-1], sizes])


def walked(model: SteadyMap, output: int, moved: int, levels: FloatArray) -> dict[float, Place]:
    """Where the model rests at levels (L,) of an output, rising, physical units.

    From the mean of training outwards, each place from the one before, as far as there are such places.
    """
    layout = model.layout
    normal = (levels - layout.shift[output]) / layout.scale[output]
    middle = int(np.abs(normal).argmin())
    found: dict[float, Place] = {}

    def walk(way: Sequence[int], w: FloatArray) -> FloatArray | None:
        first = None
        for at in way:
            w = w.copy()
            w[output] = normal[at]
            place = model.resting(w, output, moved)
            if place is None:
                break
            found[float(levels[at])] = place
            w = place.w
            first = w if first is None else first
        return first

    start = walk(range(middle, len(levels)), np.zeros(len(layout.scale)))
    if start is not None:
        walk(range(middle - 1, -1, -1), start)
    return found
