"""What a model of rules does about the places at which its vehicle rests, and how sure that is.

Numbers are of tangents (`flysid.model.rules.steady_map`) at places spread over what was flown. Their errors
are to first order, the place solved anew for every step: noise alone. What a model cannot express, no
covariance shows; four things do, and as they speak of one and the same error, the largest of them is added:
what the model with one rule more says there, or where growth ended with one fewer; how much wider errors that
still depend on what is simulated make the noise's share (`flysid.model.rules.lack_of_fit`); that a condition
on an input switches all its lags at once, which makes a time as unsure as these are apart; a floor.
Such an error is the same in every sample and has a bound: it is taken to lie anywhere up to there (JCGM
100:2008, 4.3.7), so that 95 % are within 1.65 standard deviations, not 1.96.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.base import OperatingPoint
from flysid.model.covariance import root_of
from flysid.model.polynomials import Z95
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.lack_of_fit import scale_factor
from flysid.model.rules.regressor_layout import Layout
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.rule_uncertainty import uncertainty
from flysid.model.rules.steady_map import SteadyMap, Tangent
from flysid.model.rules.vocabulary import Axis

_FLOWN = (0.025, 0.975)  # quantiles of an output between which a model is asked
_PUSHED = (0.01, 0.99)  # quantiles of an input within which it must come to rest
_GRID = 41  # places on the way from one end to the other
_MODEST = (0.1, 0.5, 0.9)  # quantiles that stand for slow, cruise and fast
_STEP = 1e-3  # of a standard deviation, for derivatives
_FLOOR = 0.03  # of a figure: what orders and sampling cost that no model nearby shows
_LOST = 20.0  # of a logarithm: half an interval beyond which there is nothing to say, and numbers overflow
_EVENLY = 0.95 * np.sqrt(3.0)  # of a standard deviation: what 95 % of evenly spread errors are within


class NumberSpread(Protocol):
    """The distribution of a model's numbers."""

    @property
    def covariance(self) -> FloatArray: ...
    def centre(self) -> FloatArray: ...
    def parameters_at(self, vector: FloatArray) -> Parameters: ...


class Numbers(NamedTuple):
    """A model as far as it simulates."""

    layout: Layout
    parameters: Parameters


M = TypeVar("M", bound=RuleModel)


def described(model: M, train: Dataset, neighbour: Stage | None = None) -> M:
    """The model with its operating points.

    With intervals where it stands at a minimum of the simulation error and another one is known beside it:
    noise alone is half of what such numbers are off by.
    """
    sure: NumberSpread | None = None
    misfit = 1.0
    if neighbour is not None:
        with contextlib.suppress(DataError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            misfit = scale_factor(model, train)
            sure = uncertainty(model, train)
    more = (
        None if neighbour is None else Numbers(neighbour.layout, neighbour.problem.parameters(neighbour.body))
    )
    points = operating_points(Numbers(model.layout, model.parameters), train, sure, more, misfit)
    return replace(model, operating_points=points)


@dataclass(frozen=True, eq=False)
class Place:
    """A place at rest: signals w (n + n_u,), the tangent there, samples until it has settled."""

    w: FloatArray
    tangent: Tangent
    samples: int


def operating_points(
    numbers: Numbers,
    train: Dataset,
    sure: NumberSpread | None = None,
    neighbour: Numbers | None = None,
    misfit: float = 1.0,
) -> tuple[OperatingPoint, ...]:
    """For every output: places over what was flown; none where the model comes to no rest (it integrates).

    Parameters
    ----------
    train : data that the model was fitted to.
    sure : how sure the model is of its numbers; None: no intervals.
    neighbour : the model with one rule more, or one fewer where growth ended: what it says otherwise widens
        the intervals.
    misfit : by how much the noise's standard errors are too small (`scale_factor`).
    """
    found: list[OperatingPoint] = []
    for output in range(len(train.outputs)):
        found += _of_output(_Asked(numbers, train, sure, neighbour, misfit, output))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Asked:
    """One output of one model."""

    numbers: Numbers
    train: Dataset
    sure: NumberSpread | None
    neighbour: Numbers | None
    misfit: float
    output: int

    @property
    def map(self) -> SteadyMap:
        return SteadyMap(self.numbers.layout)


def _of_output(asked: _Asked) -> Iterable[OperatingPoint]:
    numbers = asked.numbers
    output = asked.output
    y = np.concatenate([s.y[:, output] for s in asked.train.segments])
    low, high = np.quantile(y, _FLOWN)
    wanted = _levels(y)
    moved = _main_input(numbers, output)
    grid = np.unique(np.concatenate([np.linspace(low, high, _GRID), wanted]))
    places = _flown(walked(numbers, output, moved, grid), numbers, asked.train, moved)
    if not places:
        return
    levels = np.array(sorted(places))
    for level in np.unique([levels[np.abs(levels - v).argmin()] for v in wanted]):
        yield _point(asked, places[level], moved)


def _levels(y: FloatArray) -> FloatArray:
    """Slow, cruise and fast, either way where both signs were flown.

    Not zero itself: a gain that drag bends changes most there, and few samples tell.
    """
    low, high = np.quantile(y, _FLOWN)
    if not Axis("", "", float(low), float(high)).has_both_signs:
        return np.asarray(np.quantile(y, _MODEST))
    sizes = np.quantile(np.abs(y), _MODEST)
    return np.concatenate([-sizes[::-1], sizes])


def _main_input(numbers: Numbers, output: int) -> int:
    """The input that moves the output most over its own spread, at the mean of training."""
    steady = SteadyMap(numbers.layout)
    n = numbers.parameters.theta.shape[1]
    whole = steady.summed(steady.tangent(numbers.parameters, np.zeros(len(numbers.layout.scale))))
    gains = np.linalg.pinv(np.eye(n) - whole[:, :n]) @ whole[:, n:]
    return int(np.abs(gains[output]).argmax())


def walked(
    numbers: Numbers, output: int, moved: int, levels: FloatArray
) -> dict[float, tuple[FloatArray, Tangent]]:
    """Where the model rests at levels (L,) of an output, physical units: level -> signals and tangent.

    From the mean of training outwards, each place from the one before, as far as there are such places.
    """
    layout = numbers.layout
    par = numbers.parameters
    steady = SteadyMap(layout)
    found: dict[float, tuple[FloatArray, Tangent]] = {}
    normal = (levels - layout.shift[output]) / layout.scale[output]
    middle = int(np.abs(normal).argmin())
    for way in (range(middle, len(levels)), range(middle - 1, -1, -1)):
        w = (
            np.zeros(len(layout.scale))
            if way.start == middle
            else found.get(float(levels[middle]), (None,))[0]
        )
        for at in way:
            if w is None:
                break
            w = w.copy()
            w[output] = normal[at]
            w = steady.at_rest(par, w, output, moved)
            if w is not None:
                found[float(levels[at])] = (w, steady.tangent(par, w))
    return found


def _flown(
    found: Mapping[float, tuple[FloatArray, Tangent]], numbers: Numbers, train: Dataset, moved: int
) -> dict[float, Place]:
    """Of the places those that are stable and within what the input has flown."""
    layout = numbers.layout
    steady = SteadyMap(numbers.layout)
    column = numbers.parameters.theta.shape[1] + moved
    u = np.concatenate([s.u[:, moved] for s in train.segments])
    low, high = (np.quantile(u, _PUSHED) - layout.shift[column]) / layout.scale[column]
    places = {}
    for level, (w, tangent) in found.items():
        samples = steady.samples(steady.pole_radius(tangent))
        if samples is not None and low <= w[column] <= high:
            places[level] = Place(w, tangent, samples)
    return places


def _point(asked: _Asked, place: Place, moved: int) -> OperatingPoint:
    layout = asked.numbers.layout
    n = asked.numbers.parameters.theta.shape[1]
    n_y = len(asked.train.outputs)
    dt = asked.train.dt_s
    inputs = range(len(asked.train.inputs))
    output = asked.output
    steady = asked.map
    answers = [steady.answer(place.tangent, j, place.samples) for j in inputs]
    at = place.w * layout.scale + layout.shift
    figures = _figures(steady, asked.numbers.parameters, place, output, moved)
    assert figures is not None
    wide = np.minimum(_half_widths(asked, place, moved, figures), _LOST)
    unit = layout.scale[output] / layout.scale[n:]
    gain = figures[0] * unit
    reached = figures[1] * dt
    ends = np.stack([-wide, wide], axis=1)  # (2 figures, low and high, inputs)
    gains = np.sort(gain * np.exp(ends[0]), axis=0)
    return OperatingPoint(
        output=output,
        outputs=at[:n_y],
        inputs=at[n:],
        gain=gain,
        gain_interval=gains,
        reached_s=reached,
        reached_interval_s=reached * np.exp(ends[1]),
        dead_s=np.array([dt * max(steady.delay(place.tangent, output, j) - 1, 0) for j in inputs]),
        overshoot=np.array([float(a.overshoot[output]) for a in answers]),
        wrong_way=np.array([float(a.wrong_way[output]) for a in answers]),
        shares=place.tangent.shares,
    )


def _figures(steady: SteadyMap, par: Parameters, place: Place, output: int, moved: int) -> FloatArray | None:
    """(2, n_u) gain and samples to 63 % of parameters that rest near a place, over as many samples as it."""
    w = steady.at_rest(par, place.w, output, moved)
    if w is None:
        return None
    tangent = steady.tangent(par, w)
    n = len(tangent.value)
    answers = (steady.answer(tangent, j, place.samples) for j in range(len(w) - n))
    return np.array([(a.gain[output], a.reached[output]) for a in answers]).T


def _half_widths(asked: _Asked, place: Place, moved: int, figures: FloatArray) -> FloatArray:
    """(2, n_u) half 95 % intervals of the logarithms of gain and time; NaN where nothing is known."""
    sure = asked.sure
    if sure is None:
        return np.full(figures.shape, np.nan)
    steady = asked.map
    centre = sure.centre()
    noise = np.zeros(figures.shape)
    root = root_of(sure.covariance)
    with np.errstate(all="ignore"):  # an answer at once takes no time at all
        for direction in root.T[np.abs(root).max(axis=0) > 0.0]:
            ends = [
                _figures(steady, sure.parameters_at(centre + way * direction), place, asked.output, moved)
                for way in (_STEP, -_STEP)
            ]
            if ends[0] is None or ends[1] is None:
                return np.full(figures.shape, np.nan)
            noise += ((ends[0] - ends[1]) / (2.0 * _STEP * figures)) ** 2
        lack = np.maximum((asked.misfit**2 - 1.0) * noise, _of_neighbour(asked, place, moved, figures) ** 2)
        lack = np.maximum(lack, _FLOOR**2)
        lack[1] = np.maximum(lack[1], (_switched(asked.numbers) / figures[1]) ** 2)
        return np.asarray(np.hypot(Z95 * np.sqrt(noise), _EVENLY * np.sqrt(lack)))


def _switched(numbers: Numbers) -> FloatArray:
    """(n_u,) samples from the first to the last lag of every input that conditions speak of; else 0.

    Such a condition switches the weights of all these lags at once, with one of them, so that how an answer
    is spread over them hangs on the condition. Steady gains do not.
    """
    lags = numbers.layout.lags
    n = numbers.parameters.theta.shape[1]
    apart = np.zeros(len(numbers.layout.scale) - n)
    for j in range(len(apart)):
        own = lags.lag[lags.column == n + j]
        if len(own) and n + j in lags.z_column:
            apart[j] = np.ptp(own)
    return apart


def _of_neighbour(asked: _Asked, place: Place, moved: int, figures: FloatArray) -> FloatArray:
    """(2, n_u) logarithms of what the neighbour says there over what this one does; 0 without one."""
    if asked.neighbour is None:
        return np.zeros(figures.shape)
    own = asked.numbers.layout
    other = asked.neighbour.layout
    level = place.w[asked.output] * own.scale[asked.output] + own.shift[asked.output]
    mean = float(own.shift[asked.output])
    found = walked(
        asked.neighbour,
        asked.output,
        moved,
        np.linspace(mean, level, 8) if level != mean else np.array([level]),
    )
    if level not in found:
        return np.full(figures.shape, np.inf)
    w, tangent = found[level]
    steady = SteadyMap(other)
    samples = steady.samples(steady.pole_radius(tangent))
    if samples is None:
        return np.full(figures.shape, np.inf)
    said = _figures(steady, asked.neighbour.parameters, Place(w, tangent, samples), asked.output, moved)
    if said is None:
        return np.full(figures.shape, np.inf)
    n = asked.numbers.parameters.theta.shape[1]
    m = asked.neighbour.parameters.theta.shape[1]
    units = (other.scale[asked.output] / other.scale[m:]) / (own.scale[asked.output] / own.scale[n:])
    ratio = said / figures
    ratio[0] *= units
    return np.where(ratio > 0.0, np.log(ratio), np.inf)
