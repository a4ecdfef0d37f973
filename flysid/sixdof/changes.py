"""What has changed between a vehicle and a later flight of it: a motor, the mass, the drag.

Both are fitted alike. A motor's effects about all axes share one factor, its strength. Thrust of all motors
over mass is one number, and a heavier vehicle has less of it while strengths stay. A change counts where it
is beyond the errors of both fits, over all that is looked at, and beyond what a flight's regression is off
by. What a named change explains is not named again: a weak motor lifts less, and with more mass the same drag
slows less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import CURVE, EFFECTS, LAG, POWER, ROTOR_DRAG, THRUST
from flysid.sixdof.torque_fit import BLOCK_S
from flysid.sixdof.vehicle import Vehicle

LEVEL = 0.01
"""Chance that a flight without a change shows one."""
LEAST = 0.05
"""Share that regression in a loop may be off by: a smaller change is none."""
MASS = "thrust over mass"
LAGGING = "motor lag"
DRAGS = ("drag forward", "drag sideways", "drag along the rotors' axes")


@dataclass(frozen=True)
class Change:
    """One ratio of after to before.

    Attributes
    ----------
    ratio, low, high : with the interval of all that is looked at together.
    is_change : the interval is beyond 1, by more than `LEAST`, and no other change explains it.
    """

    name: str
    ratio: float
    low: float
    high: float
    is_change: bool

    def __str__(self) -> str:
        way = "more" if self.ratio > 1.0 else "less"
        size = 100.0 * abs(self.ratio - 1.0)
        low, high = sorted((100.0 * abs(self.low - 1.0), 100.0 * abs(self.high - 1.0)))
        return f"{self.name}: {size:.0f} % {way} [{low:.0f}, {high:.0f}]{_meaning(self)}"


def _meaning(change: Change) -> str:
    if change.name == MASS:
        return f", as {100.0 * (1.0 / change.ratio - 1.0):+.0f} % of mass would do"
    if change.name.startswith("motor ") and change.name != LAGGING and change.ratio < 1.0:
        return ", look at its propeller and bearing"
    return ""


@dataclass(frozen=True, eq=False)
class Changes:
    """All ratios, and the fit of the later flight."""

    rows: tuple[Change, ...]
    after: FittedVehicle

    @property
    def found(self) -> list[Change]:
        """Those that count."""
        return [row for row in self.rows if row.is_change]

    def lines(self) -> list[str]:
        """For people."""
        names = ", ".join(flight.name for flight in self.after.flights)
        if not self.rows:
            return [f"{names}: nothing that this vehicle has is determined by this flight"]
        if not self.found:
            widest = max(self.rows, key=lambda row: row.high - row.low)
            size = 50.0 * (widest.high - widest.low)
            looked = ", ".join(row.name for row in self.rows)
            return [f"{names}: no change of {looked}; the least certain is {widest.name}, to {size:.0f} %"]
        return [f"{names}: changed", *(f"  {row}" for row in self.found)]

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        rows = [
            {
                "name": row.name,
                "ratio": row.ratio,
                "low": row.low,
                "high": row.high,
                "is_change": row.is_change,
            }
            for row in self.rows
        ]
        return {"flights": [flight.name for flight in self.after.flights], "changes": rows}


def changes_since(vehicle: FittedVehicle, flights: Dataset) -> Changes:
    """Fit later flights as the vehicle was fitted, and compare.

    Raises
    ------
    UsageError : the flights have another number of motors. What `Vehicle.fit` raises.
    """
    free_runs = vehicle.method != "regression"
    after = Vehicle(zero=vehicle.zero, full=vehicle.full, free_runs=free_runs).fit(flights)
    if after.motors != vehicle.motors:
        raise UsageError(f"this vehicle has {vehicle.motors} motors, and these flights {after.motors}")
    return compare(vehicle, after)


def compare(before: FittedVehicle, after: FittedVehicle, level: float = LEVEL) -> Changes:
    """Ratios of the numbers that both fits determine."""
    after = _at_voltage(before, after)
    strengths, others = _strengths(before, after), _single(before, after)
    freedom = max(min(sum(f.seconds for f in v.flights) for v in (before, after)) / BLOCK_S - 1.0, 1.0)
    reach = float(stdtrit(freedom, 1.0 - 0.5 * level / max(len(strengths) + len(others), 1)))
    motors = [_change_of(row, reach) for row in strengths]
    weaker = sum(1.0 - row.ratio for row in motors if row.is_change) / before.motors
    single = [_change_of(row, reach, 1.0 - weaker if row[0] == MASS else 1.0) for row in others]
    mass = next((row for row in single if row.name == MASS and row.is_change), None)
    if mass is not None:  # drag is over mass, too
        single = [
            replace(row, is_change=False) if row.name in DRAGS and row.low < mass.ratio < row.high else row
            for row in single
        ]
    return Changes((*motors, *single), after)


def _change_of(row: tuple[str, float, float], reach: float, expected: float = 1.0) -> Change:
    """A (name, ratio, standard error) as a change, where it is away from what is `expected`."""
    name, ratio, error = row
    low, high = ratio - reach * error, ratio + reach * error
    is_change = not low <= expected <= high and abs(ratio - expected) > LEAST
    return Change(name, ratio, low, high, is_change)


def _at_voltage(before: FittedVehicle, after: FittedVehicle) -> FittedVehicle:
    """The later fit at the voltage of the earlier one, where thrust is proportional to a power of it."""
    if not (np.isfinite(before.reference_v) and np.isfinite(after.reference_v)):
        return after
    theta = after.theta.copy()
    power = float(before.theta[POWER]) * (1.0 + float(before.theta[CURVE]))
    factor = float((before.reference_v / after.reference_v) ** power)
    theta[THRUST] *= factor
    theta[EFFECTS:] *= factor
    return replace(after, theta=theta)


def _strengths(before: FittedVehicle, after: FittedVehicle) -> list[tuple[str, float, float]]:
    """(name, ratio, standard error) of motors whose effects are determined, beside the others' median."""
    motors = before.motors
    found = []
    for i in range(motors):
        own = [EFFECTS + axis * motors + i for axis in range(3)]
        own = [p for p in own if before.numbers[p].is_determined and after.numbers[p].is_determined]
        if own:
            ratio, error = _factor(before, after, own)
            found.append((f"motor {i + 1}", ratio, error))
    if len(found) < 2:
        return []
    beside = []
    for name, ratio, error in found:
        others = [(r, e) for other, r, e in found if other != name]
        middle = float(np.median([r for r, _ in others]))
        theirs = float(np.mean([e**2 for _, e in others])) / len(others)
        beside.append((name, ratio / middle, float(np.sqrt(error**2 + theirs)) / middle))
    return beside


def _factor(before: FittedVehicle, after: FittedVehicle, places: Sequence[int]) -> tuple[float, float]:
    """The one factor between two sets of numbers, by generalised least squares."""
    index = np.ix_(places, places)
    b, a = before.theta[list(places)], after.theta[list(places)]
    weight = np.linalg.pinv(before.covariance[index] + after.covariance[index])
    size = float(b @ weight @ b)
    return float(b @ weight @ a) / size, size**-0.5


def _single(before: FittedVehicle, after: FittedVehicle) -> list[tuple[str, float, float]]:
    """Ratios of thrust over mass, lag and drag, where both determine them."""
    names = {THRUST: MASS, LAG: LAGGING, **{ROTOR_DRAG + k: name for k, name in enumerate(DRAGS)}}
    found = []
    for place, name in names.items():
        if before.numbers[place].is_determined and after.numbers[place].is_determined:
            found.append((name, *_factor(before, after, [place])))
    return found
