"""A fitted vehicle: its numbers with intervals, free runs, and the file that keeps it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flysid.errors import DataError, StoreError, UsageError
from flysid.files import write_atomically, writing_to
from flysid.foreign import inner_path, read_object, shaped
from flysid.showing import counted, fold
from flysid.sixdof import layout
from flysid.sixdof.actuators import shares
from flysid.sixdof.arms import Body, body_of_places, checked_places
from flysid.sixdof.figures import VehicleNumber, figures_of
from flysid.sixdof.rigid_body import STATES, run
from flysid.stretch import FloatArray

FORMAT = "flysid vehicle"
VERSION = 1
HINT = "flysid vehicle LOG... -o DIR writes one"
MOST_MOTORS = 32
"""More in a file is a mistake."""


@dataclass(frozen=True)
class FlightFacts:
    """What one flight has of its own.

    Attributes
    ----------
    wind : m/s, where the air moves to, along the world's x and y; None where it was held at zero.
    gyro_bias : rad/s; force_bias : m/s^2 of the accelerometer; None where nothing tells them.
    seconds : of whole flight that were used.
    damage : what is wrong with its telemetry, in words.
    lost_s : seconds of its telemetry that are damaged, and left out; None where a file states none.
    """

    name: str
    seconds: float
    wind: tuple[float, float] | None = None
    gyro_bias: tuple[float, float, float] | None = None
    force_bias: tuple[float, float, float] | None = None
    damage: tuple[str, ...] = ()
    lost_s: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class FittedVehicle:
    """One model of six degrees of freedom.

    Attributes
    ----------
    theta : (P,) numbers in the order of `flysid.sixdof.layout`, which has the equations.
    covariance : (P, P); 0 for what is held.
    inside : (P,) bool, what was estimated and is away from its limits.
    held : place of a number -> why it was not sought.
    zero, full : a logged motor command is zero + full times its share of full thrust.
    reference_v : the voltage that thrust is stated at; NaN where none is measured.
    dt_s : sample time of the flights, seconds.
    method : "regression", or "free runs" where these agree with it and are more accurate.
    notes, frames : what was decided, and how the log's axes were turned, in words.
    flown_v : least and largest voltage in the air; None where none is measured, or a file states none.
    places : of motors in m, forward and left of any point; None where nobody stated them.
    """

    theta: FloatArray
    covariance: FloatArray
    inside: FloatArray
    held: Mapping[int, str]
    zero: float
    full: float
    reference_v: float
    dt_s: float
    method: str
    flights: tuple[FlightFacts, ...]
    frames: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)
    flown_v: tuple[float, float] | None = None
    places: tuple[tuple[float, float], ...] | None = None

    @property
    def motors(self) -> int:
        """How many."""
        return (len(self.theta) - layout.EFFECTS) // 3

    @cached_property
    def numbers(self) -> tuple[VehicleNumber, ...]:
        """All of them, with units and 95 % intervals."""
        return figures_of(self.theta, self.covariance, self.inside, dict(self.held))

    @cached_property
    def body(self) -> Body | None:
        """What the places of motors add; None where these are not stated."""
        if self.places is None:
            return None
        return body_of_places(self.theta, self.covariance, self.inside, np.array(self.places))

    @property
    def arm_m(self) -> float | None:
        """Mean distance of motors from the centre of mass, from above; None without their places."""
        if self.places is None:
            return None
        centre = [self["centre of mass forward"].value, self["centre of mass left"].value]
        return float(np.mean(np.linalg.norm(np.array(self.places) - centre, axis=1)))

    def placed(self, places: FloatArray) -> FittedVehicle:
        """The same vehicle whose motors sit at these (motors, 2) m forward and left of any point.

        Raises
        ------
        UsageError : they are of another number of motors.
        """
        if len(places) != self.motors:
            raise UsageError(f"places of {len(places)} motors: this vehicle has {self.motors}")
        return replace(self, places=tuple((float(x), float(y)) for x, y in places))

    def __getitem__(self, name: str) -> VehicleNumber:
        """A number by its name, as "motor lag"; KeyError where there is none."""
        return {number.name: number for number in self._every}[name]

    @property
    def _every(self) -> tuple[VehicleNumber, ...]:
        """All numbers, those that places add included."""
        return (*self.numbers, *(self.body.numbers if self.body is not None else ()))

    @property
    def correlation(self) -> FloatArray:
        """(P, P) of the estimates; 0 for what is held."""
        size = np.sqrt(np.diag(self.covariance))
        safe = np.where(size > 0.0, size, 1.0)
        return np.asarray(self.covariance / np.outer(safe, safe))

    def shares(self, commands: FloatArray, voltage: FloatArray | None, dt_s: float) -> FloatArray:
        """(2N - 1, motors) thrust shares at half samples of logged commands (N, motors) and voltage (N,)."""
        given = np.asarray(commands, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != self.motors:
            raise UsageError(
                f"commands are {given.shape}: this vehicle has {self.motors} motors, a column each"
            )
        log_voltage = np.zeros(len(given))
        if voltage is not None and np.isfinite(self.reference_v):
            log_voltage = np.log(np.asarray(voltage, dtype=np.float64) / self.reference_v)
        scaled = np.clip((given - self.zero) / self.full, 0.0, 1.0)
        return shares(scaled, log_voltage, dt_s, self.theta)[0]

    def simulate(
        self,
        start: FloatArray,
        commands: FloatArray,
        dt_s: float,
        voltage: FloatArray | None = None,
        wind: FloatArray | None = None,
    ) -> FloatArray:
        """(N, 13) position, velocity, quaternion w x y z and body rate in free run, SI units.

        Parameters
        ----------
        start : (13,) at the first sample; motors are settled at its commands.
        commands : (N, motors) as they are logged, held from sample to sample.
        voltage : (N,) V; None: the reference's.
        wind : (3,) m/s, where the air moves to; None: it is calm.

        Raises
        ------
        UsageError : shapes that do not fit this vehicle.
        """
        first = np.asarray(start, dtype=np.float64)
        if first.shape != (STATES,):
            raise UsageError(f"a start has {STATES} numbers, not {first.shape}")
        return run(first, self.shares(commands, voltage, dt_s), dt_s, self.theta, wind)

    def lines(self) -> list[str]:
        """For people."""
        known = [number for number in self._every if number.is_determined]
        rows = [(n.name, f"{n.value:.4g}", f"+- {n.half_width:.2g}", n.unit) for n in known]
        widths = [max((len(cell) for cell in column), default=0) for column in zip(*rows, strict=True)]
        seconds = sum(flight.seconds for flight in self.flights)
        title = (
            f"vehicle with {self.motors} motors, {counted(len(self.flights), 'flight')}, {seconds:.0f} s, "
            f"by {self.method}; intervals are of 95 %"
        )
        lined = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows]
        said = [title, *("  ".join(cells).rstrip() for cells in lined)]
        lacking: dict[tuple[str, str], list[str]] = {}
        for number in self._every:
            if not number.is_determined:
                lacking.setdefault((number.reason, number.flight), []).append(number.name)
        if lacking:
            said += ["", "not determined"]
        for (reason, flight), names in lacking.items():
            said.append(f"- {', '.join(names)}: {reason}. To find it, {flight}.")
        said += self.close_pairs()
        said += self.body.doubts if self.body is not None else ()
        said += [f"{own.name}: {word}" for own in self.flights for word in own.damage]
        return [*said, *self.frames, *self.notes]

    def close_pairs(self, least: float = 0.95) -> list[str]:
        """Numbers whose errors hang together, in sentences: those with a correlation above `least`."""
        together = np.triu(np.abs(self.correlation), 1)
        names = [number.name for number in self.numbers]
        return [
            f"{names[i]} and {names[j]} are hard to tell apart: correlation {self.correlation[i, j]:.2f}"
            for i, j in np.argwhere(together > least)
            if self.numbers[i].is_determined and self.numbers[j].is_determined
        ]

    def __repr__(self) -> str:
        return "\n".join(fold(line) for line in self.lines())

    def to_dict(self) -> dict[str, Any]:
        """As JSON: `FittedVehicle.from_dict` makes the same of it."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "motors": self.motors,
            "numbers": [_number_row(number) for number in self.numbers],
            "covariance": self.covariance.tolist(),
            "inside": [bool(x) for x in self.inside],
            "held": {str(place): why for place, why in self.held.items()},
            "command_zero": self.zero,
            "command_full": self.full,
            "reference_v": None if np.isnan(self.reference_v) else self.reference_v,
            "dt_s": self.dt_s,
            "method": self.method,
            "flights": [
                {
                    "name": f.name,
                    "seconds": f.seconds,
                    "wind": f.wind,
                    "gyro_bias": f.gyro_bias,
                    "force_bias": f.force_bias,
                    "damage": list(f.damage),
                    "lost_s": f.lost_s,
                }
                for f in self.flights
            ],
            "frames": list(self.frames),
            "notes": list(self.notes),
            "flown_v": None if self.flown_v is None else list(self.flown_v),
            "places": None if self.places is None else [list(place) for place in self.places],
            "body": None if self.body is None else [_number_row(number) for number in self.body.numbers],
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> FittedVehicle:
        """The vehicle of a document.

        Raises
        ------
        DataError : a key is missing or its value is not what belongs there.
        """
        try:
            return cls._read(document)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            what = f"no {error}" if isinstance(error, KeyError) else str(error)
            raise DataError(f"not a vehicle: {what}", hint=HINT) from None

    @classmethod
    def _read(cls, document: Mapping[str, Any]) -> FittedVehicle:
        if document["format"] != FORMAT or document["version"] != VERSION:
            raise ValueError(f"{document['format']!r}, version {document['version']!r}")
        motors = int(document["motors"])
        if not 2 <= motors <= MOST_MOTORS:
            raise ValueError(f"{motors} motors")
        theta = np.array([row["value"] for row in document["numbers"]], dtype=np.float64)
        size = layout.count(motors)
        covariance = np.array(document["covariance"], dtype=np.float64)
        inside = np.array(document["inside"], dtype=bool)
        if theta.shape != (size,) or covariance.shape != (size, size) or inside.shape != (size,):
            raise ValueError(f"{motors} motors have {size} numbers")
        if not (np.isfinite(theta).all() and np.isfinite(covariance).all()):
            raise ValueError("a number is not finite")
        low, high = layout.limits(motors)
        if not ((theta >= low) & (theta <= high)).all():
            worst = int(np.flatnonzero((theta < low) | (theta > high))[0])
            raise ValueError(f"{layout.numbers(motors)[worst].name} is {theta[worst]:g}")
        volts = document["reference_v"]
        flown = document.get("flown_v")
        found = cls(
            theta=theta,
            covariance=covariance,
            inside=inside,
            held={int(place): str(why) for place, why in document["held"].items()},
            zero=float(document["command_zero"]),
            full=float(document["command_full"]),
            reference_v=float("nan") if volts is None else float(volts),
            dt_s=float(document["dt_s"]),
            method=str(document["method"]),
            flights=shaped(document["flights"], tuple[FlightFacts, ...]),
            frames=shaped(document["frames"], tuple[str, ...]),
            notes=shaped(document["notes"], tuple[str, ...]),
            flown_v=None if flown is None else shaped(flown, tuple[float, float]),
        )
        if (places := document.get("places")) is not None:
            found = found.placed(checked_places(shaped(places, tuple[tuple[float, float], ...])))
        if not (np.isfinite(found.zero) and np.isfinite(found.full) and found.full != 0.0):
            raise ValueError(f"commands from {found.zero:g} over {found.full:g}")
        if not 0.0 < found.dt_s < np.inf:
            raise ValueError(f"a sample time of {found.dt_s:g} s")
        if found.reference_v <= 0.0:
            raise ValueError(f"a reference of {found.reference_v:g} V")
        if not set(found.held) <= set(range(size)):
            raise ValueError(f"{motors} motors have {size} numbers")
        return found

    def save(self, path: str | Path) -> None:
        """Write `to_dict` to a file; WriteError where that fails."""
        target = Path(path)
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        with writing_to(target):
            write_atomically(target, text.encode())


def _number_row(number: VehicleNumber) -> dict[str, Any]:
    """A number as JSON."""
    return {
        "name": number.name,
        "value": number.value,
        "unit": number.unit,
        "half_width_95": None if np.isnan(number.half_width) else number.half_width,
        "is_determined": number.is_determined,
        "reason": number.reason,
        "flight": number.flight,
    }


def load_vehicle(path: str | Path) -> FittedVehicle:
    """The vehicle of a file, or of the folder that `flysid vehicle -o` wrote.

    Raises
    ------
    UsageError : no such file. StoreError : it cannot be read, or holds no vehicle.

    Examples
    --------
    >>> vehicle = flysid.load_vehicle("vehicle.json")  # written by `FittedVehicle.save`
    >>> vehicle.motors
    4
    """
    given = Path(path)
    place = inner_path(given, FILE, given) if given.is_dir() else given
    if not place.is_file():
        raise UsageError("no vehicle here", path=place, hint=HINT)
    document = read_object(place, "a vehicle", HINT)
    try:
        return FittedVehicle.from_dict(document)
    except DataError as error:
        raise StoreError(error.message, path=place, hint=error.hint) from error


FILE = "vehicle.json"
"""In the folder of a vehicle."""
