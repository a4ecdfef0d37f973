"""What known places of motors add: inertias over mass, and where the centre of mass lies.

Flights tell torque over inertia. Where the motors sit tells torque over thrust, and the quotient of both is
inertia over thrust. About roll and pitch effects are a straight line over places: its slope is thrust over
inertia, and it crosses zero above the centre of mass.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flysid.errors import DataError, UsageError
from flysid.sixdof.figures import UNDETERMINED, Z95, VehicleNumber, flight_that_tells
from flysid.sixdof.layout import EFFECTS, INERTIA, THRUST
from flysid.stretch import FloatArray

HINT = "a line a motor, in metres forward and left, as 'motor1 = [0.12, -0.10]'"


@dataclass(frozen=True, eq=False)
class Body:
    """Numbers that places add, and motors that act elsewhere than stated, in sentences."""

    numbers: tuple[VehicleNumber, ...]
    doubts: tuple[str, ...]


def read_arms(path: Path) -> FloatArray:
    """(motors, 2) metres forward and left of any point, from a TOML file.

    Raises
    ------
    UsageError : it cannot be read. DataError : it does not place every motor, in their order.
    """
    try:
        rows = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise DataError(f"not a TOML file: {error}", path=path, hint=HINT) from error
    names = [f"motor{i + 1}" for i in range(len(rows))]
    if not rows or set(rows) != set(names):
        raise DataError(
            f"it names {', '.join(rows) or 'nothing'}, not motor1, motor2, ...", path=path, hint=HINT
        )
    try:
        return checked_places([rows[name] for name in names])
    except ValueError as error:
        raise DataError(str(error), path=path, hint=HINT) from error


def checked_places(rows: Sequence[object]) -> FloatArray:
    """(motors, 2) places; ValueError where a row is not two numbers, or motors do not span both axes."""
    try:
        places = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        places = np.zeros(0)
    if places.shape != (len(rows), 2) or not np.isfinite(places).all():
        raise ValueError("a motor's place is two numbers")
    if not np.ptp(places, axis=0).all():
        raise ValueError("all motors lie on one line along an axis")
    return places


def body_of_places(theta: FloatArray, covariance: FloatArray, inside: FloatArray, places: FloatArray) -> Body:
    """Inertias over mass and the centre of mass, with 95 % intervals.

    Parameters
    ----------
    theta, covariance, inside : as of a `FittedVehicle`.
    places : (motors, 2) m, forward and left.
    """
    motors = len(places)
    numbers: list[VehicleNumber] = []
    doubts: list[str] = []
    roll = "", 0.0, np.zeros(len(theta))
    sides = (("roll", places[:, 1], 1.0, "left"), ("pitch", -places[:, 0], -1.0, "forward"))
    for axis, (name, lever, sign, way) in enumerate(sides):
        where = np.arange(EFFECTS + axis * motors, EFFECTS + (axis + 1) * motors)
        effect = theta[where]
        off = lever - lever.mean()
        by = off / (off @ off)
        slope = float(by @ effect)
        spread = Z95 * np.sqrt(np.diag(covariance)[where])
        apart = effect - effect.mean()
        wrong = np.flatnonzero((off * apart < 0.0) & (np.abs(apart) > spread))
        doubts += [
            f"motor {i + 1} acts about {name} as if it were on the other side: check its number and its place"
            for i in wrong
        ]
        moved, turned = np.zeros(len(theta)), np.zeros(len(theta))
        thrust, centre, inertia = float(theta[THRUST]), 0.0, 0.0
        why = "" if inside[where].all() else "the motors' effects are not determined"
        if slope > 0.0:
            centre = sign * (lever.mean() - effect.mean() / slope)
            inertia = thrust / slope
            moved[where] = sign * (effect.mean() / slope**2 * by - 1.0 / (motors * slope))
            turned[THRUST] = 1.0 / slope
            turned[where] = -thrust / slope**2 * by
        else:
            why = "the motors turn it the other way than their places say"
        lifted = why or ("" if inside[THRUST] else "thrust is not determined")
        told = Derived(covariance, f"{name} inertia / mass", inertia, "m^2", inertia)
        numbers.append(told.number(turned, lifted, THRUST if not why else int(where[0])))
        told = Derived(covariance, f"centre of mass {way}", centre, "m", float(np.ptp(lever)))
        numbers.append(told.number(moved, why, int(where[0])))
        if axis == 0:
            roll = lifted, inertia, turned
    why, inertia, turned = roll
    place = INERTIA + 1
    ratio = float(theta[place])
    by_ratio = ratio * turned
    by_ratio[place] += inertia
    why = why or ("" if inside[place] else "the inertia of yaw over that of roll is not determined")
    told = Derived(covariance, "yaw inertia / mass", ratio * inertia, "m^2", ratio * inertia)
    numbers.append(told.number(by_ratio, why, place))
    return Body(tuple(numbers), tuple(doubts))


@dataclass(frozen=True, eq=False)
class Derived:
    """A number that follows from others; half an interval above a share of `scale` leaves it undetermined."""

    covariance: FloatArray
    name: str
    value: float
    unit: str
    scale: float

    def number(self, slopes: FloatArray, why: str, place: int) -> VehicleNumber:
        """It with its interval, by its derivatives; `place` is of the number whose flight would tell it."""
        variance = float(slopes @ self.covariance @ slopes)
        width = Z95 * float(np.sqrt(max(variance, 0.0)))
        wide = "" if width <= UNDETERMINED * self.scale else f"{self.value:.3g} +- {width:.2g} {self.unit}"
        if reason := why or wide:
            flight = flight_that_tells(place)
            return VehicleNumber(
                self.name, self.value, self.unit, float("nan") if why else width, False, reason, flight
            )
        return VehicleNumber(self.name, self.value, self.unit, width, True)
