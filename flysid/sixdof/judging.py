"""Flights that are left out judge a vehicle: at 0.1, 0.5, 1 and 5 s, beside predictors that need none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from flysid.sixdof.vehicle import Vehicle
from flysid.stretch import FloatArray

HORIZONS_S = (0.1, 0.5, 1.0, 5.0)
HELD = "constant velocity"
BLIND = "no inputs"
AXES = "axis by axis"
BOX = "black box"
ALONE = "vehicle alone"
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
    """

    table: Mapping[str, FloatArray]
    starts: tuple[int, ...]
    tested: str

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
        alone = self._size(ALONE)
        others = [self._size(name) for name in NAMED]
        led = []
        for i in self._known:
            if not all(alone[i] < size[i] for size in others):
                break
            led.append(HORIZONS_S[i])
        return tuple(led)

    @property
    def leads_all(self) -> bool:
        """Whether physics alone predicts best at every horizon that has starts."""
        return len(self.led) == len(self._known)

    @property
    def _known(self) -> list[int]:
        """Horizons that have starts."""
        return [int(i) for i in np.flatnonzero(np.isfinite(self._size(ALONE)))]

    def words(self) -> list[str]:
        """How far physics alone leads, and what predicts best behind it."""
        others = {name: self._size(name) for name in NAMED}
        known = self._known
        until = self.led
        said = []
        if not until:
            best = min(others, key=lambda name: others[name][known[0]])
            said.append(
                f"physics alone is not the best at {HORIZONS_S[known[0]]:g} s: {NAMED[best]} predicts "
                "better. Trust no number of this vehicle that has no other proof"
            )
        elif self.leads_all:
            said.append("physics alone is enough: it predicts best at every horizon")
        else:
            behind = known[len(until)]
            best = min(others, key=lambda name: others[name][behind])
            said.append(
                f"physics alone predicts best up to {max(until):g} s. At {HORIZONS_S[behind]:g} s "
                f"{NAMED[best]} is better: that far ahead, what the controller does decides"
            )
        gain = 1.0 - self._size(LOOP)[known[0]] / others[BLIND][known[0]]
        said.append(
            f"physics and the habits of its loop together: {100 * gain:.0f} % below the predictor without "
            f"inputs at {HORIZONS_S[known[0]]:g} s"
        )
        return said

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
    table: dict[str, list[FloatArray]] = {}
    for here, there in zip(learnt, tests, strict=True):
        for name, predict in _predictors(here, fitted).items():
            parts = [errors_at_end(starts, predict(starts)) for starts in there] if here else []
            table.setdefault(name, []).append(
                np.mean(parts, axis=0) if parts else np.full(len(KINDS), np.nan)
            )
    counts = tuple(
        sum(len(s.at) for s in there) if here else 0 for here, there in zip(learnt, tests, strict=True)
    )
    return Judgement({name: np.array(rows) for name, rows in table.items()}, counts, tested)


def errors_at_end(starts: Starts, ahead: Ahead) -> FloatArray:
    """(4,) mean errors at the horizon."""
    last = Ahead(ahead.position[-1:], ahead.velocity[-1:], ahead.attitude[-1:], ahead.rate[-1:])
    here = replace(starts, at=starts.at + starts.steps - 1, steps=1)
    return np.asarray(errors(here, last)[0])


def _predictors(flights: Sequence[Starts], vehicle: FittedVehicle) -> Mapping[str, Predict]:
    names = (HELD, BLIND, AXES, BOX, ALONE, LOOP)
    if not flights:
        return dict.fromkeys(names, hold)
    predictors = (
        hold,
        fit_far(flights, habits).predict,
        fit_axis_wise(flights, vehicle).predict,
        fit_far(flights, with_commands).predict,
        lambda starts: fly_ahead(starts, vehicle),
        fit_far(flights, with_vehicle(vehicle)).predict,
    )
    return dict(zip(names, predictors, strict=True))


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
