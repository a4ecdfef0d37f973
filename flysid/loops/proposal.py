"""Gains and D filters of rate loops for the next flight, within a factor of two of the present ones.

The error is that of the last flight: its own sticks, air and gyro. It is made as small as bounds allow that
hold on every plant that the flights leave possible: the largest sensitivity, the noise to the motors, and a
crossover inside the band that the sticks show. Every factor of the filters is tried, and the gains of every
axis are found for each. Filters that axes share move only where all of these axes are designed.

I becomes smaller only where no other gains keep the bounds. What it holds against, wind and an uneven load,
moves too slowly to be seen in the seconds by which errors are measured.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.angle_loops import AngleLoop, angle_loop
from flysid.loops.betaflight import AXES
from flysid.loops.controller import Controller
from flysid.loops.forecast import Forecast, forecast_of
from flysid.loops.gain_bounds import Bounded, RateBounds
from flysid.loops.judged import kind_of
from flysid.loops.known_axis import KnownAxis
from flysid.loops.margins import margins
from flysid.loops.new_settings import with_settings
from flysid.loops.tunable import FACTOR, Setting, list_tunable
from flysid.progress import tell

OF_FILTERS = FACTOR ** np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
STEPS = FACTOR ** np.array([0.5, 0.25, 0.125, 0.0625])
TERMS = ("p", "i", "d")
AS_IT_IS = int(np.flatnonzero(OF_FILTERS == 1.0)[0])
FREE = np.full(len(TERMS), 1.0 / FACTOR)
STEADY = np.array([1.0 / FACTOR, 1.0, 1.0 / FACTOR])
SURE = 0.95
"""Share of the plants that fit with which a proposal must be better."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """What is to be flown next.

    `old`, `new`: settings by name, present and proposed, those that change.
    `axes`: what each axis would do.
    `angles`: the angle loops around them.
    `refused`: axis -> why there is no proposal for it.
    `command_line`: whether names are those of a command line; else of parameters.
    """

    old: Mapping[str, str]
    new: Mapping[str, str]
    axes: tuple[Forecast, ...]
    angles: tuple[AngleLoop, ...]
    refused: Mapping[str, DataError]
    command_line: bool

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "old": dict(self.old),
            "new": dict(self.new),
            "axes": [own.to_dict() for own in self.axes],
            "angles": [own.to_dict() for own in self.angles],
            "refused": {axis: {"why": why.message, "try": why.hint} for axis, why in self.refused.items()},
        }


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis, its settings, and its loop for every factor of the filters."""

    known: KnownAxis
    settings: tuple[Setting, ...]
    loops: tuple[Bounded, ...]


def propose(logs: Sequence[Any], axes: Sequence[str], bounds: RateBounds | None = None) -> Proposal:
    """Settings for the next flight.

    `logs`: flights of one vehicle.
    `axes`: roll, pitch, yaw; those that cannot be designed are refused by name.
    """
    ready: list[_Axis] = []
    refused: dict[str, DataError] = {}
    for axis in axes:
        tell(f"measuring the {axis} loop", log=logs[-1].name)
        try:
            ready.append(_prepare(logs, axis, bounds or RateBounds()))
        except DataError as error:
            refused[axis] = error
    while ready:
        chosen, factors = _search(ready, _filters_move(ready))
        failed: dict[str, DataError] = {}
        changes: dict[str, str] = {}
        found = []
        for one, own in zip(ready, factors, strict=True):
            try:
                own_changes, told = _judge(one, chosen, own)
            except DataError as error:
                failed[one.known.axis] = error
                continue
            found.append(told)
            changes |= own_changes
        if not failed:
            angles = _angles(ready, changes, bounds or RateBounds(), refused)
            moved = [own for own in angles if own.new != own.old]
            changes |= {own.name: f"{own.new:g}" for own in moved}
            present = {own.name: f"{own.value:g}" for one in ready for own in one.settings}
            present |= {own.name: f"{own.old:g}" for own in moved}
            return Proposal(
                {name: present[name] for name in changes},
                changes,
                tuple(found),
                angles,
                refused,
                "Firmware revision" in ready[0].known.last.settings,
            )
        refused |= failed
        ready = [one for one in ready if one.known.axis not in failed]
    return Proposal({}, {}, (), (), refused, False)


def _angles(
    ready: Sequence[_Axis], changes: Mapping[str, str], bounds: RateBounds, refused: dict[str, DataError]
) -> tuple[AngleLoop, ...]:
    """The angle loops of the designed axes, as far as the log states them; why not goes into `refused`."""
    found = []
    for one in ready:
        own = {name: value for name, value in changes.items() if name in {s.name for s in one.settings}}
        try:
            loop = angle_loop(one.known, one.known.law_under(own)[0], bounds)
        except DataError as error:
            refused[f"{one.known.axis} angle"] = error
            continue
        found += [loop] if loop is not None else []
    return tuple(found)


def _filters_move(ready: Sequence[_Axis]) -> bool:
    """Whether no axis outside those that are designed has a filter of theirs."""
    stated = ready[0].known.last.settings
    designed = {one.known.axis for one in ready}
    theirs = {own.name for one in ready for own in one.settings if own.part == "filters"}
    others = {own.name for axis in AXES if axis not in designed for own in list_tunable(stated, axis)}
    return not theirs & others


def _prepare(logs: Sequence[Any], axis: str, bounds: RateBounds) -> _Axis:
    """An axis that can be designed. Raises DataError: the flights do not determine its loop."""
    known = KnownAxis.of(logs, axis)
    margins(known.together, known.last.controller.at_rest())
    settings = tuple(list_tunable(known.last.settings, axis))
    loops = tuple(Bounded.of(known, _with_filters(known, settings, factor), bounds) for factor in OF_FILTERS)
    return _Axis(known, settings, loops)


def _with_filters(known: KnownAxis, settings: Sequence[Setting], factor: float) -> Controller:
    """The controller that flew, its filters by a factor."""
    changes = _changes(settings, {"filters": factor})
    conditions = known.last.conditions
    means = conditions.means
    if means is not None and means.lowpass_hz is not None:
        conditions = replace(conditions, means=replace(means, lowpass_hz=factor * means.lowpass_hz))
    other = with_settings(known.last.settings, changes)
    return kind_of(known.log).controller(other, known.axis, conditions)


def _changes(settings: Sequence[Setting], factors: Mapping[str, float]) -> dict[str, str]:
    """Settings whose value a factor changes."""
    moved = ((own, own.times(factors[own.part])) for own in settings if own.part in factors)
    return {own.name: value for own, value in moved if float(value) != own.value}


def _search(ready: Sequence[_Axis], filters_move: bool) -> tuple[int, list[FloatArray]]:
    """Which factor of the filters, and the factors of every axis' gains, that cost least together."""
    found = []
    for k in range(len(OF_FILTERS)) if filters_move else (AS_IT_IS,):
        tell("searching for gains", share=k / len(OF_FILTERS))
        gains = [_gains(one.loops[k], _movable(one)) for one in ready]
        cost = sum(one.loops[k].cost(own) for one, own in zip(ready, gains, strict=True))
        found.append((cost, k, gains))
    _, k, gains = min(found, key=lambda row: row[0])
    return k, gains


def _movable(one: _Axis) -> list[bool]:
    parts = {own.part for own in one.settings}
    return [term in parts for term in TERMS]


def _gains(loop: Bounded, movable: Sequence[bool]) -> FloatArray:
    """(3,) factors of P, I and D."""
    found = _descend(loop, movable, STEADY)
    return found if loop.excess(found) == 0.0 else _descend(loop, movable, FREE)


def _descend(loop: Bounded, movable: Sequence[bool], least: FloatArray) -> FloatArray:
    """(3,) factors above the least ones: from 1 on to the best neighbour, by ever smaller steps."""
    best = np.ones(len(TERMS))
    cost = loop.cost(best)
    ways = [np.array(way) for way in itertools.product(*((-1, 0, 1) if free else (0,) for free in movable))]
    for step in STEPS:
        while True:
            near = [np.clip(best * step**way, least, FACTOR) for way in ways if way.any()]
            costs = [loop.cost(own) for own in near]
            if not costs or min(costs) >= cost:
                break
            cost = min(costs)
            best = near[int(np.argmin(costs))]
    return best


def _judge(one: _Axis, chosen: int, factors: FloatArray) -> tuple[dict[str, str], Forecast]:
    """Settings of an axis by factors, and what it does with them.

    Raises DataError: they pass a bound, or are not surely better.
    """
    loop = one.loops[chosen]
    if loop.excess(factors) > 0.0:
        passed = loop.passed(factors)
        raise _beyond(max(passed, key=lambda name: passed[name]), loop.bounds)
    parts = dict(zip(TERMS, factors, strict=True)) | {"filters": float(OF_FILTERS[chosen])}
    changes = _changes(one.settings, parts)
    told = forecast_of(one.known, changes) if changes else None
    if told is None or told.better < SURE:
        raise DataError(
            "no gains that keep the bounds make the error surely smaller: the present ones are as good",
            hint="keep them; or allow more noise or sensitivity: --noise, --ms",
        )
    return changes, told


def _beyond(bound: str, bounds: RateBounds) -> DataError:
    """Why no gains keep a bound on every plant that the flights leave possible."""
    everywhere = "on every plant that the flights leave possible"
    longer = "fly a minute more of quick stick movements on this axis, in calm air"
    why = {
        "ms": (f"hold Ms below {bounds.ms:g} {everywhere}", f"{longer}; or allow more: --ms"),
        "noise": (f"hold the noise to the motors below {bounds.noise:g} times", "allow more: --noise"),
        "crossover": (
            "cross over where the sticks show the plant well",
            "fly quicker stick movements: steps and flicks, on this axis",
        ),
        "stability": (f"are stable {everywhere}", longer),
    }
    words, hint = why[bound]
    return DataError(f"no gains within a factor of {FACTOR:g} {words}", hint=hint)
