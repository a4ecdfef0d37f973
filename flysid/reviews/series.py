"""Several flights of one vehicle in order: what changed between them, what that did, what to try next."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flysid.facts.vehicle import label_of, vehicle_of
from flysid.loops.betaflight import AXES
from flysid.loops.contradictions import contradiction_of
from flysid.loops.judged import Judged
from flysid.model.threads import on_one_thread
from flysid.progress import tell
from flysid.reviews.fact import Action, Fact, Table
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.rate_gains import stated_gains
from flysid.reviews.reviewed import Review
from flysid.reviews.series_effects import ONE_EACH, Effect, Figure, effects, scatter_of_equals
from flysid.reviews.series_next import try_next
from flysid.reviews.series_plant import Sameness, compare_plants
from flysid.reviews.series_settings import Difference, differences
from flysid.showing import WIDTH, align, counted, fold, significant

MOST_LINES = 25
"""Of a terminal, for one vehicle."""
LEAST_ROWS = 4
HEAD_LINES = 2
LEAST_LINES = 6
"""Of one vehicle among several."""
LEVEL = ("roll", "pitch")
FIGURES = (
    ("lag", "tracking.{loop}_{axis}_lag", "ms"),
    ("error", "tracking.{loop}_{axis}_rms", ""),
    ("overshoot", "tracking.{loop}_{axis}_overshoot", "%"),
    ("phase margin", "tracking.{axis}_phase_margin", "deg"),
    ("noise", "vibration.gyro_high", "deg/s"),
)
"""Name of a figure, its fact, its unit where facts of it may be missing."""


@dataclass(frozen=True, eq=False)
class Flown:
    """One flight of a series."""

    review: Review
    flight: LoggedFlight

    @property
    def name(self) -> str:
        """Of the log, without its ending."""
        return self.review.name.rpartition(".")[0] or self.review.name

    @cached_property
    def gains(self) -> dict[str, dict[str, float]]:
        """Axis -> gains."""
        return {axis: stated_gains(self.flight, axis) for axis in AXES}

    @property
    def start_ns(self) -> int | None:
        """When it began, UTC; None where the log does not say."""
        facts = getattr(self.flight.log, "facts", None)
        return facts.start_utc_ns if facts is not None else None


@dataclass(frozen=True, eq=False)
class VehicleSeries:
    """The flights of one vehicle, in their order.

    `vehicle`: what people call it.
    `flights`: by date where all have one, else by their names' numbers.
    `by_date`: whether by date.
    """

    vehicle: str
    flights: tuple[Flown, ...]
    by_date: bool

    @property
    def loop(self) -> str:
        """The innermost loop whose lag any flight determines."""
        keys = [f"tracking.{loop}_{axis}_lag" for loop in ("rate", "attitude") for axis in AXES]
        known = next((key for key in keys if any(self._value(f, key) is not None for f in self.flights)), "")
        return "attitude" if "attitude" in known else "rate"

    @staticmethod
    def _value(flown: Flown, key: str) -> float | None:
        fact = flown.review.fact(key)
        return fact.value if fact is not None and isinstance(fact.value, float) else None

    def figure(self, name: str, axis: str) -> Figure:
        """One figure of an axis over the flights."""
        pattern, unit = next((pattern, unit) for key, pattern, unit in FIGURES if key == name)
        key = pattern.format(loop=self.loop, axis=axis)
        facts = [flown.review.fact(key) for flown in self.flights]
        unit = next((fact.unit for fact in facts if fact is not None and fact.unit), unit)
        whose = name if "{axis}" not in pattern else f"{axis} {name}"
        values, halves = (
            np.array(column, dtype=np.float64) for column in zip(*map(_known, facts), strict=True)
        )
        return Figure(name, whose, unit, values, halves)

    @cached_property
    def changed(self) -> tuple[Difference, ...]:
        """Settings that differ between neighbours."""
        return tuple(differences([(flown.name, flown.flight) for flown in self.flights]))

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """What changes of gains did, axis by axis."""
        return tuple(
            effect
            for axis in AXES
            for name, pattern, _ in FIGURES
            if "{axis}" in pattern
            for effect in effects(self.figure(name, axis), [flown.gains[axis] for flown in self.flights])
        )

    @property
    def judged(self) -> tuple[tuple[Flown, Judged], ...]:
        """The loops of every flight, where its log is one whose gains are read."""
        every = ((flown, judged) for flown in self.flights for judged in flown.flight.judged)
        return tuple((flown, judged) for flown, judged in every if judged.loop is not None)

    @cached_property
    @on_one_thread
    def sameness(self) -> tuple[Sameness, ...]:
        """Whether it is the same plant, of every axis of which that is known."""
        found = (
            compare_plants(axis, [(f.name, j.loop) for f, j in self.judged if j.axis == axis and j.loop])
            for axis in AXES
        )
        return tuple(same for same in found if same is not None)

    @cached_property
    def contradictions(self) -> tuple[tuple[str, str], ...]:
        """Axis and sentence of every flight whose loop no plant can have beside that of weaker gains."""
        loops = [judged for _, judged in self.judged]
        found = ((judged.axis, contradiction_of(judged, loops)) for judged in loops)
        return tuple((axis, words) for axis, words in found if words)

    @cached_property
    @on_one_thread
    def actions(self) -> tuple[Action, ...]:
        """What to try next, where all flights are of one plant."""
        found = []
        for same in self.sameness:
            if not same.is_same:
                continue
            own = [(flown, judged) for flown, judged in self.judged if judged.axis == same.axis]
            latest, last = own[-1]
            if latest.gains[same.axis] != self.flights[-1].gains[same.axis] or last.controller is None:
                continue
            loops = [judged.loop for _, judged in own if judged.loop is not None]
            action = try_next(same.axis, loops, self.flights[-1].flight, last.controller)
            found += [action] if action is not None else []
        return tuple(found)

    def settle(self) -> None:
        """Compute all that needs the logs."""
        _ = self.changed, self.effects, self.sameness, self.contradictions, self.actions

    # -------------------------------------------------------------------------------- shown

    @property
    def title(self) -> str:
        """Whose flights, how many, in which order."""
        order = "by date" if self.by_date else "by the numbers in their names"
        return f"{self.vehicle}: {counted(len(self.flights), 'flight')}, {order}"

    @property
    def table(self) -> Table:
        """A row for every flight: gains and figures, those of several axes in one cell."""
        unit = self.figure("error", "roll").unit
        columns = (
            ("lag, ms", "lag", tuple(AXES)),
            (f"error, {unit}", "error", LEVEL),
            ("margin, deg", "phase margin", LEVEL),
            ("noise, deg/s", "noise", ("",)),
        )
        cells = [(heading, self._cells(name, axes)) for heading, name, axes in columns]
        known = [(heading, column) for heading, column in cells if any(cell.strip("/?") for cell in column)]
        headings = ("flight", *LEVEL, *(heading for heading, _ in known))
        rows = tuple(
            (
                flown.name,
                *(_gain_words(flown, axis) for axis in LEVEL),
                *(column[i] for _, column in known),
            )
            for i, flown in enumerate(self.flights)
        )
        return Table(self.title, headings, rows)

    def _cells(self, name: str, axes: Sequence[str]) -> list[str]:
        """Of every flight "12/8.8/9.7"; "?" where a figure is not determined."""
        columns = [self.figure(name, axis).values for axis in axes]
        return ["/".join(map(_cell, values)) for values in zip(*columns, strict=True)]

    @property
    def tables(self) -> tuple[Table, ...]:
        """For a page: the flights, what changed between them, what that did."""
        changed = tuple((d.flight, d.words) for d in self.changed)
        did = tuple((e.figure, e.words, _is_beyond(e)) for e in self.effects)
        alike = (*((same.axis, same.words) for same in self.sameness), *self.contradictions)
        planned = tuple((a.title, ", ".join(c.words for c in a.changes), a.predicted) for a in self.actions)
        every = (
            self.table,
            Table("What changed from flight to flight", ("flight", "settings"), changed),
            Table("What the changes did", ("figure", "change", "beyond the scatter"), did),
            Table("The same vehicle?", ("axis", "answer"), alike),
            Table("What to try next", ("what", "parameters", "predicted"), planned),
        )
        return tuple(table for table in every if table.rows)

    def lines(self, most: int = MOST_LINES) -> list[str]:
        """For a terminal."""
        denied = dict(reversed(self.contradictions))
        below = [
            *(same.words for same in self.sameness),
            *(f"{axis}: {words}" for axis, words in denied.items()),
            *self._effect_lines(),
            *self._action_lines(),
        ]
        below = [part for line in below for part in fold(line).split("\n")]
        room = max(most - len(below) - HEAD_LINES, LEAST_ROWS)
        return [self.title, *self._rows(room), *below][:most]

    def _rows(self, room: int) -> list[str]:
        """The table, with the figures that have room beside each other."""
        names = _without_common_beginning([row[0] for row in self.table.rows])
        rows = [(name, *row[1:]) for name, row in zip(names, self.table.rows, strict=True)]
        shown = [self.table.headings, *_some(rows, room)]
        lines = align(shown)
        while max(map(len, lines)) > WIDTH:
            shown = [row[:-1] for row in shown]
            lines = align(shown)
        return lines

    def _effect_lines(self, most: int = 6) -> Iterator[str]:
        if not any(flown.gains[axis] for flown in self.flights for axis in AXES):
            yield "The logs state no gains: what a change did is not known."
            return
        clear = [effect.words for effect in self.effects if effect.is_clear][:most]
        if clear:
            yield from clear
        elif self.effects and not any(effect.knows_scatter for effect in self.effects):
            yield f"What did a change of gains do? {ONE_EACH[0].upper()}{ONE_EACH[1:]}: fly each set again."
        else:
            yield "No change of a gain did anything beyond the scatter between flights."
        for axis in AXES:
            figure = self.figure("lag", axis)
            sigma, free = scatter_of_equals(figure.values, [flown.gains[axis] for flown in self.flights])
            if free and len({tuple(flown.gains[axis].items()) for flown in self.flights}) == 1:
                mean = significant(float(np.nanmean(figure.values)), 2)
                spread = significant(sigma, 2)
                yield f"{figure.name} {mean} {figure.unit} under the same gains all along, scatter {spread}"

    def _action_lines(self) -> Iterator[str]:
        for action in self.actions:
            changes = ", ".join(change.words for change in action.changes)
            yield f"next: {changes}: {action.reason}"
            yield f"  Predicted: {action.predicted}. Risk: {action.risk}."

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "vehicle": self.vehicle,
            "flights": [
                {"flight": flown.name, "gains": flown.gains, "figures": self._figures(i)}
                for i, flown in enumerate(self.flights)
            ],
            "changed": [difference.to_dict() for difference in self.changed],
            "effects": [effect.to_dict() for effect in self.effects],
            "same": [same.to_dict() for same in self.sameness],
            "contradictions": [{"axis": axis, "words": words} for axis, words in self.contradictions],
            "actions": [action.to_dict() for action in self.actions],
        }

    def _figures(self, i: int) -> dict[str, float | None]:
        found = {}
        for name, pattern, _ in FIGURES:
            for axis in AXES if "{axis}" in pattern else ("",):
                figure = self.figure(name, axis)
                value = float(figure.values[i])
                found[figure.name] = value if np.isfinite(value) else None
        return found


@dataclass(frozen=True, eq=False)
class Series:
    """Flights of one vehicle or several, each vehicle's apart.

    `missing`: a sentence for what could not be compared.
    """

    vehicles: tuple[VehicleSeries, ...]
    missing: tuple[str, ...] = ()

    @property
    def tables(self) -> tuple[Table, ...]:
        """For a page."""
        return tuple(table for own in self.vehicles for table in own.tables)

    def holds(self, review: Review) -> bool:
        """Whether a review is of one of its flights."""
        return any(flown.review is review for own in self.vehicles for flown in own.flights)

    def lines(self, most: int = MOST_LINES) -> list[str]:
        """For a terminal; of vehicles that do not fit, how many there are."""
        if not self.vehicles:
            return []
        each = max(most // len(self.vehicles), LEAST_LINES)
        shown = most // each
        found = [line for own in self.vehicles[:shown] for line in own.lines(each)]
        rest = len(self.vehicles) - shown
        return (
            [*found[: most - 1], f"and {counted(rest, 'vehicle')} more: see the page"] if rest > 0 else found
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"vehicles": [own.to_dict() for own in self.vehicles]}


def series(reviewed: Sequence[tuple[Review, LoggedFlight]]) -> Series:
    """Reviews and their flights, by vehicle and in order; vehicles of a single flight are left out.

    All that needs the logs is computed here: they may be closed afterwards.
    """
    by_vehicle: dict[str, list[Flown]] = {}
    for review, flight in reviewed:
        by_vehicle.setdefault(vehicle_of(flight.info), []).append(Flown(review, flight))
    found = tuple(_ordered(flights) for flights in by_vehicle.values() if len(flights) > 1)
    for own in found:
        tell(f"comparing the flights of {own.vehicle}")
        own.settle()
    return Series(found)


def _ordered(flights: Sequence[Flown]) -> VehicleSeries:
    starts = {flown.start_ns for flown in flights}
    by_date = None not in starts and len(starts) == len(flights)
    if by_date:
        ordered = sorted(flights, key=lambda flown: flown.start_ns or 0)
    else:
        ordered = sorted(flights, key=lambda flown: _by_numbers(flown.name))
    return VehicleSeries(label_of(flights[0].flight.info), tuple(ordered), by_date)


def _by_numbers(name: str) -> list[tuple[int, int, str]]:
    """So that flight9 stands before flight10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]


def _without_common_beginning(names: Sequence[str]) -> list[str]:
    """What tells names apart: "flight14" of "greenreaper_flight14" where all begin alike."""
    cut = 0
    for at, letters in enumerate(zip(*names, strict=False), 1):
        if len(set(letters)) > 1:
            break
        cut = at if letters[0] in "_- " else cut
    return [name[cut:] for name in names]


def _known(fact: Fact | None) -> tuple[float, float]:
    if fact is None or not isinstance(fact.value, float):
        return float("nan"), float("nan")
    half = 0.5 * (fact.interval[1] - fact.interval[0]) if fact.interval else float("nan")
    return fact.value, half


def _is_beyond(effect: Effect) -> str:
    """Whether an effect is beyond the scatter between flights, for a table."""
    if not effect.knows_scatter:
        return "not known"
    return "yes" if effect.is_clear else "no"


def _gain_words(flown: Flown, axis: str) -> str:
    """ "46/45/25"."""
    return "/".join(significant(value) for value in flown.gains[axis].values()) or "?"


def _cell(value: float) -> str:
    return significant(float(value), 2) if np.isfinite(value) else "?"


def _some(rows: Sequence[tuple[str, ...]], most: int) -> list[tuple[str, ...]]:
    """All rows, or the first and the last of them."""
    if len(rows) <= most:
        return list(rows)
    first = most // 2
    gone = (f"... {len(rows) - most + 1} more", *[""] * (len(rows[0]) - 1))
    return [*rows[:first], gone, *rows[len(rows) - (most - first - 1) :]]
