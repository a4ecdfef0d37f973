"""Flights that are left out judge a vehicle: at 0.1, 0.5, 1 and 5 s, beside predictors that need none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.showing import counted
from flysid.sixdof.axiswise import fit_axis_wise
from flysid.sixdof.far import fit_far, habits, with_commands, with_vehicle
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import KINDS, Ahead, Starts, errors, fly_ahead, hold, whole_starts
from flysid.sixdof.records import Scale, flights_of
from flysid.sixdof.rest import find_rules
from flysid.sixdof.rules import HingeRule
from flysid.sixdof.vehicle import Vehicle
from flysid.stretch import FloatArray

HORIZONS_S = (0.1, 0.5, 1.0, 5.0)
HELD = "constant velocity"
BLIND = "no inputs"
AXES = "axis by axis"
BOX = "black box"
ALONE = "vehicle alone"
RULED = "vehicle with rules"
LOOP = "vehicle in its loop"
NAMED = {
    HELD: "constant velocity",
    BLIND: "the predictor without inputs",
    AXES: "the axis-wise models",
    BOX: "the black box",
}
"""In sentences."""
EVERY_S = 0.05
"""Between starts."""
OUT = 3
"""Of so many flights one judges; of a single flight, so much of its time."""
UNITS = ("m", "m/s", "rad", "rad/s")

Predict = Callable[[Starts], Ahead]


@dataclass(frozen=True, eq=False)
class Judgement:
    """Errors on flights that the judged vehicle was not fitted to.

    Attributes
    ----------
    table : predictor -> (horizons, 4) mean errors of position, velocity, attitude and rate; NaN: no starts.
    starts : of every horizon.
    tested : flights, or the part of the only one, in words.
    rules : on what physics leaves, found on the flights that the judged vehicle was fitted to.
    """

    table: Mapping[str, FloatArray]
    starts: tuple[int, ...]
    tested: str
    rules: tuple[HingeRule, ...] = ()

    def lines(self) -> list[str]:
        """For people: position and attitude, and the answer in words."""
        shown = [i for i, count in enumerate(self.starts) if count]
        head = "".join(f"{HORIZONS_S[i]:>9g} s" for i in shown)
        lines = ["", f"judged on {self.tested}: mean errors ahead, {self._counts(shown)}"]
        for kind, name, factor in ((0, "position, m", 1.0), (2, "attitude, deg", 180.0 / np.pi)):
            lines.append(f"{name:20}{head}")
            for predictor, rows in self.table.items():
                cells = "".join(f"{factor * rows[i, kind]:>11.3g}" for i in shown)
                lines.append(f"  {predictor:18}{cells}")
        return [*lines, *self.words()]

    def _counts(self, shown: Sequence[int]) -> str:
        return ", ".join(f"{self.starts[i]} starts for {HORIZONS_S[i]:g} s" for i in shown)

    @property
    def led(self) -> tuple[float, ...]:
        """Horizons in seconds, from the first on, at which physics alone predicts best."""
        return self._led_by(ALONE)

    def _led_by(self, name: str) -> tuple[float, ...]:
        own = self._size(name)
        others = [self._size(other) for other in NAMED]
        led = takewhile(lambda i: all(own[i] < size[i] for size in others), self._known)
        return tuple(HORIZONS_S[i] for i in led)

    @property
    def leads_all(self) -> bool:
        """Whether physics alone predicts best at every horizon that has starts."""
        return len(self.led) == len(self._known)

    @property
    def stands(self) -> bool:
        """Whether physics, alone or with rules, predicts best at the first horizon."""
        return bool(self.led or (self.kept and self._led_by(RULED)))

    @property
    def answer(self) -> str:
        """What these flights take: "physics", "physics with rules" or "rules alone"."""
        if not self.stands:
            return "rules alone"
        return "physics with rules" if self.kept else "physics"

    @property
    def kept(self) -> tuple[HingeRule, ...]:
        """Rules with which physics predicts the left-out flights better."""
        gains = self._gains_by_rules
        return self.rules if gains.size and gains.mean() > 0.0 else ()

    @property
    def _gains_by_rules(self) -> FloatArray:
        """(horizons, 4) share of errors that rules take away, as far ahead as physics tells anything."""
        if RULED not in self.table:
            return np.zeros((0, len(KINDS)))
        told = self._size(ALONE) < 1.0
        return np.asarray(1.0 - (self.table[RULED] / self.table[ALONE])[told])

    @property
    def _known(self) -> list[int]:
        """Horizons that have starts."""
        return [int(i) for i in np.flatnonzero(np.isfinite(self._size(ALONE)))]

    def words(self) -> list[str]:
        """How far physics alone leads, what predicts best behind it, and what rules add."""
        first = HORIZONS_S[self._known[0]]
        gain = 1.0 - self._size(LOOP)[self._known[0]] / self._size(BLIND)[self._known[0]]
        return [
            self._about_physics(),
            f"physics and the habits of its loop together: {100 * gain:.0f} % below the predictor without "
            f"inputs at {first:g} s",
            self._about_rules(),
        ]

    def _about_physics(self) -> str:
        known = self._known
        until = self.led
        if self.leads_all:
            return "physics alone is enough: it predicts best at every horizon"
        behind = known[len(until)]
        best = NAMED[min(NAMED, key=lambda name: self._size(name)[behind])]
        if until:
            return (
                f"physics alone predicts best up to {max(until):g} s. At {HORIZONS_S[behind]:g} s "
                f"{best} is better: that far ahead, what the controller does decides"
            )
        if self.kept and (ruled := self._led_by(RULED)):
            return f"physics with rules predicts best up to {max(ruled):g} s, physics alone does not"
        return (
            f"physics alone is not the best at {HORIZONS_S[known[0]]:g} s: {best} predicts "
            "better. Trust no number of this vehicle that has no other proof"
        )

    def _about_rules(self) -> str:
        if not self.rules:
            return "no rule on what physics leaves holds on flights that are left out in turn"
        if not self.kept:
            return "rules on what physics leaves do not predict left-out flights better, and are not kept"
        gains = self._gains_by_rules
        at, kind = np.unravel_index(np.argmax(gains), gains.shape)
        return (
            f"rules on what physics leaves take up to {100.0 * gains[at, kind]:.0f} % off errors of "
            f"{KINDS[kind]}, at {HORIZONS_S[at]:g} s. "
            f"Kept: {'; '.join(map(str, self.kept))}. They are for prediction, and are not exported"
        )

    def _size(self, name: str) -> FloatArray:
        """(horizons,) errors as shares of those of constant velocity, averaged over the four kinds."""
        return np.asarray((self.table[name] / self.table[HELD]).mean(axis=1))

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        table = {
            name: [[None if np.isnan(x) else float(x) for x in row] for row in rows]
            for name, rows in self.table.items()
        }
        kinds = [f"{kind} {unit}" for kind, unit in zip(KINDS, UNITS, strict=True)]
        return {
            "tested": self.tested,
            "horizons_s": list(HORIZONS_S),
            "starts": list(self.starts),
            "kinds": kinds,
            "errors": table,
            "answer": self.answer,
            "rules": [asdict(rule) | {"words": str(rule)} for rule in self.kept],
            "words": self.words(),
        }


def judge_vehicle(settings: Vehicle, flights: Dataset, vehicle: FittedVehicle) -> Judgement | None:
    """A vehicle that is fitted anew to some of the flights, judged on the others.

    Parameters
    ----------
    settings : of the fit.
    vehicle : the fit to all flights, which says what commands are shares of.

    Returns
    -------
    None where position, velocity or attitude is not measured, or nothing is left to judge on.
    """
    known, unseen, tested = _parted(flights)
    scale = Scale(vehicle.zero, vehicle.full)
    own = replace(settings, zero=vehicle.zero, full=vehicle.full)
    learnt = _starts(known, scale)
    tests = _starts(unseen, scale)
    if not learnt[0] or not tests[0]:
        return None
    fitted = own.fit(known)
    rules = find_rules([starts.record for starts in learnt[0]], fitted)
    table: dict[str, list[FloatArray]] = {}
    for here, there in zip(learnt, tests, strict=True):
        for name, predict in _predictors(here, fitted, rules).items():
            parts = [errors_at_end(starts, predict(starts)) for starts in there] if here else []
            table.setdefault(name, []).append(
                np.mean(parts, axis=0) if parts else np.full(len(KINDS), np.nan)
            )
    counts = tuple(
        sum(len(s.at) for s in there) if here else 0 for here, there in zip(learnt, tests, strict=True)
    )
    return Judgement({name: np.array(rows) for name, rows in table.items()}, counts, tested, rules)


def errors_at_end(starts: Starts, ahead: Ahead) -> FloatArray:
    """(4,) mean errors at the horizon."""
    last = Ahead(ahead.position[-1:], ahead.velocity[-1:], ahead.attitude[-1:], ahead.rate[-1:])
    here = replace(starts, at=starts.at + starts.steps - 1, steps=1)
    return np.asarray(errors(here, last)[0])


def _predictors(
    flights: Sequence[Starts], vehicle: FittedVehicle, rules: Sequence[HingeRule]
) -> Mapping[str, Predict]:
    names = (HELD, BLIND, AXES, BOX, ALONE, *([RULED] if rules else []), LOOP)
    if not flights:
        return dict.fromkeys(names, hold)
    found: dict[str, Predict] = {
        HELD: hold,
        BLIND: fit_far(flights, habits).predict,
        AXES: fit_axis_wise(flights, vehicle).predict,
        BOX: fit_far(flights, with_commands).predict,
        ALONE: lambda starts: fly_ahead(starts, vehicle),
        RULED: lambda starts: fly_ahead(starts, vehicle, rules),
        LOOP: fit_far(flights, with_vehicle(vehicle)).predict,
    }
    return {name: found[name] for name in names}


def _parted(flights: Dataset) -> tuple[Dataset, Dataset, str]:
    """Flights to fit to, those that judge, and these in words."""
    names = list(flights.flights)
    if len(names) > 1:
        out = names[OUT - 1 :: OUT] or names[-1:]
        known = [s for s in flights.segments if s.flight not in out]
        unseen = [s for s in flights.segments if s.flight in out]
        words = f"{counted(len(out), 'flight')} left out ({', '.join(out)})"
        return flights.with_segments(known), flights.with_segments(unseen), words
    total = sum(len(s) for s in flights.segments)
    kept = total - total // OUT
    known, unseen, before = [], [], 0
    for segment in flights.segments:
        cut = min(max(kept - before, 0), len(segment))
        known += [segment.slice(0, cut, flights.dt_s)] if cut else []
        unseen += [segment.slice(cut, len(segment), flights.dt_s)] if cut < len(segment) else []
        before += len(segment)
    return flights.with_segments(known), flights.with_segments(unseen), f"the last third of {names[0]}"


def _starts(flights: Dataset, scale: Scale) -> list[list[Starts]]:
    """Of every horizon, the whole starts of all records; none where an instrument is missing."""
    try:
        records = flights_of(flights, scale).records
    except DataError:
        records = ()
    found = []
    for horizon in HORIZONS_S:
        rows = []
        for record in records:
            if record.position is None or record.velocity is None or record.attitude is None:
                continue
            steps = max(round(horizon / record.dt_s), 1)
            starts = whole_starts(record, steps, max(round(EVERY_S / record.dt_s), 1))
            starts = replace(starts, at=starts.at[record.flying[starts.at + steps]])
            rows += [starts] if len(starts.at) else []
        found.append(rows)
    return found
