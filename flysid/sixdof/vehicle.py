"""Vehicle: one model of six degrees of freedom from ordinary flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import FitError, UsageError
from flysid.model.threads import on_one_thread
from flysid.sixdof import layout, rotations, shooting
from flysid.sixdof.actuators import interval_means
from flysid.sixdof.descent import Found
from flysid.sixdof.figures import Z95
from flysid.sixdof.fitted import FittedVehicle, FlightFacts
from flysid.sixdof.layout import (
    ARM,
    CURVE,
    DAMPING,
    DELAY,
    EFFECTS,
    INERTIA,
    LAG,
    LEAN,
    POWER,
    ROTOR_DRAG,
    THRUST,
    TRIM,
)
from flysid.sixdof.record import LEAST_S, Record
from flysid.sixdof.records import Flights, Scale, flights_of
from flysid.sixdof.rigid_body import GRAVITY
from flysid.sixdof.thrust_fit import OWN, Stretch, fit_thrust, force_of, stretches_of
from flysid.sixdof.torque_fit import BAND_HZ, Piece, fit_torques, odds_of_none, pieces_of, trims
from flysid.stretch import FloatArray

PLATE = (1.0, 2.0)
"""Inertia ratios of a flat plate: what is held where flights do not tell them."""
WINDOW_S = 1.0
"""Free runs are tried over windows that a rough start survives,"""
LONG_S = 2.0
"""and then fitted over windows in which an error of torque becomes metres."""
ARM_M = 0.1
"""Free runs start from arms this long."""
TOO_SMALL = "too small for these flights, held at 0"
TRIAL_STEPS = 2000
"""Samples that free runs are tried on before all are taken."""
GROWN = 1.5
"""Factor by which longer windows may leave more: beyond it their search went astray."""
AGREE = 0.2
"""Share by which effects of free runs may differ from those of regression: beyond it gusts bend them."""
SIGNIFICANT = 2.0
"""Standard errors below which a drag, or a damping, is left out."""


@dataclass(frozen=True)
class Vehicle:
    """Settings of the fit of a whole vehicle.

    Parameters
    ----------
    zero, full : a logged motor command is zero + full times its share; None: found from the commands.
    band_hz : angular accelerations are compared between these frequencies.
    calm : hold the wind at zero, as indoors; None: where a flight turns too little to tell it.
    free_runs : refine by free runs where these agree with regression.
    unbalanced : share of the motors' torques about an axis that may be left over on average. In flight they
        nearly cancel: beyond it a motor is not logged, or is none.
    chance : of motors seeming to turn a vehicle that does not follow them, as on the ground.

    Examples
    --------
    A vehicle needs motors and gyro at least; see `flysid recipes sixdof`.

    >>> rng = np.random.default_rng(1)
    >>> motors = np.clip(0.6 + 0.1 * rng.standard_normal((3000, 4)), 0.1, 1.0)
    >>> effects = [[-90.0, -80.0, 15.0], [-90.0, 80.0, -15.0], [90.0, 80.0, 15.0], [90.0, -80.0, -15.0]]
    >>> torque = motors @ np.array(effects)
    >>> rate = lfilter([0.0, 0.01], [1.0, -0.97], torque - torque.mean(axis=0), axis=0)
    >>> names = [f"motor{i}" for i in (1, 2, 3, 4)]
    >>> data = flysid.Dataset.from_arrays(
    ...     motors, rate, dt_s=0.01, inputs=names, outputs=["gyro_x", "gyro_y", "gyro_z"]
    ... )
    >>> vehicle = flysid.Vehicle().fit(data)
    >>> vehicle.motors, vehicle["roll of motor 1"].value < 0.0
    (4, True)
    """

    zero: float | None = None
    full: float | None = None
    band_hz: tuple[float, float] = BAND_HZ
    calm: bool | None = None
    free_runs: bool = True
    unbalanced: float = 0.5
    chance: float = 0.01

    @on_one_thread
    def fit(self, flights: Dataset) -> FittedVehicle:
        """The vehicle of all flights of a dataset, whose signals `flysid.sixdof.records` names.

        Raises
        ------
        UsageError : settings that cannot be; signals that no vehicle has.
        DataError : nothing flies; samples are too slow; a voltage that is not above zero.
        FitError : no start predicts anything finite.
        """
        work = _Work(flights_of(flights, self._scale()), self)
        work.regress()
        if self.free_runs:
            work.shoot()
        return work.finish()

    def _scale(self) -> Scale | None:
        if self.full is None:
            if self.zero is not None:
                raise UsageError("zero needs full", hint="Vehicle(zero=1000, full=1000)")
            return None
        if not self.full > 0.0:
            raise UsageError(f"full is {self.full:g}", hint="full scale of the commands, above 0")
        return Scale(self.zero or 0.0, self.full)


class _Work:
    """A fit in progress: theta, covariance and what is held."""

    def __init__(self, flights: Flights, settings: Vehicle) -> None:
        self.settings = settings
        self.flights = flights
        first = flights.records[0]
        self.motors = first.commands.shape[1]
        self.count = layout.count(self.motors)
        volts = [r.voltage[r.flying] for r in flights.records if r.voltage is not None]
        flown = np.concatenate(volts) if volts else np.zeros(0)
        self.reference_v = float(np.median(flown)) if volts else float("nan")
        self.flown_v = (float(flown.min()), float(flown.max())) if volts else None
        self.has_air = first.velocity is not None and first.attitude is not None
        self.calm = _stays_calm(flights.records) if settings.calm is None else settings.calm
        reference = self.reference_v if volts else 1.0
        self.pieces: list[Piece] = pieces_of(flights.records, reference)
        self.stretches: list[Stretch] = stretches_of(flights.records, reference)
        self.held: dict[int, str] = {}
        self.notes: list[str] = [str(flights.scale)]
        self.theta = np.zeros(self.count)
        self.covariance = np.zeros((self.count, self.count))
        self.inside = np.zeros(self.count, dtype=bool)
        self.winds = np.zeros((len(flights.names), 2))
        self.method = "regression"
        self._start(bool(volts))

    def _start(self, has_volts: bool) -> None:
        """First values, and what no data of these flights can tell."""
        self.theta[[LAG, DELAY]] = 0.04, 0.01
        self.theta[INERTIA : INERTIA + 2] = PLATE
        self._hold([ARM], "damping is sought an axis by itself, held at 0")
        self._hold(range(INERTIA, ARM), f"held at those of a flat plate, {PLATE[0]:g} and {PLATE[1]:g}")
        self.theta[POWER] = 1.0 if has_volts else 0.0
        if not has_volts:
            self._hold([POWER], "no voltage is logged, held at 0")
        if not self.has_air:
            self._hold(range(ROTOR_DRAG, TRIM), "no velocity and attitude are logged, held at 0")
            self._hold(range(LEAN, INERTIA), "no velocity and attitude are logged, held at 0")
        if not self.has_air and self.flights.records[0].force is None:
            self._hold([THRUST], "nothing tells it but hovering: mean thrust is held at 1 g")
            self._hold([CURVE, POWER], "no velocity and no accelerometer are logged, held at 0")

    def _hold(self, places: Sequence[int], why: str) -> None:
        self.held.update(dict.fromkeys(places, why))

    def _take(self, found: Found, places: Sequence[int]) -> None:
        """Take over these numbers, with what is known of their errors."""
        index = np.array(sorted(places))
        self.theta[index] = found.theta[index]
        self.inside[index] = found.inside[index]
        self.covariance[np.ix_(index, index)] = found.covariance[np.ix_(index, index)]

    def regress(self) -> None:
        """Torques, then thrust and drag, twice: each rests on a few numbers of the other."""
        means = [interval_means(p.halves(self.theta)[0]).sum(axis=1).mean() for p in self.pieces]
        self.theta[THRUST] = GRAVITY / float(np.mean(means))
        turning = [LAG, DELAY, *range(DAMPING, DAMPING + 3), *range(EFFECTS, self.count)]
        turning += [] if LEAN in self.held else range(LEAN, INERTIA)
        lifting = [i for i in (THRUST, CURVE, POWER, *range(ROTOR_DRAG, TRIM)) if i not in self.held]
        for again in (False, True):
            torques = fit_torques(
                self.pieces, self.theta, has_air=self.has_air, band_hz=self.settings.band_hz, settled=again
            )
            self._take(torques, turning)
            if lifting and self.stretches:
                lifting = self._lift(lifting)
        self._trim()

    def _lift(self, wanted: list[int]) -> list[int]:
        """Thrust and drag; drags that the flights do not show are held at zero. Returns what is left free."""
        while True:
            found = fit_thrust(self.stretches, self.theta, wanted, self.calm)
            errors = np.sqrt(np.diag(found.covariance))
            drags = [i for i in wanted if ROTOR_DRAG <= i < TRIM]
            weak = [i for i in drags if found.theta[i] < SIGNIFICANT * errors[i] or not found.inside[i]]
            if not weak:
                break
            worst = min(weak, key=lambda i: (found.theta[i] / errors[i] if errors[i] > 0.0 else 0.0, -i))
            wanted = [i for i in wanted if i != worst]
            self.theta[worst] = 0.0
            self._hold([worst], TOO_SMALL)
        self._take(found, wanted)
        own = found.theta[self.count :].reshape(-1, OWN)
        self.winds[: len(own)] = own[:, :2]  # flights behind the last that flies have none
        return wanted

    def _trim(self) -> None:
        mean, error = trims(self.pieces, self.theta)
        place = slice(TRIM, DAMPING)
        self.theta[place] = mean
        self.inside[place] = True
        self.covariance[range(TRIM, DAMPING), range(TRIM, DAMPING)] = np.nan_to_num(error) ** 2

    def shoot(self) -> None:
        """Free runs, if their effects agree with those of regression."""
        try:
            self._shoot()
        except FitError:
            self.notes.append("free runs diverge, so the numbers are those of regression")

    def _shoot(self) -> None:
        windows = shooting.windows_of(self.stretches, LONG_S)
        if not self.has_air or len(windows) < 2:
            return
        damping = range(DAMPING, DAMPING + 3)
        free = [i for i in range(self.count) if i not in self.held or INERTIA <= i < EFFECTS]
        free = [i for i in free if i not in damping]
        start = np.clip(self.theta, *layout.limits(self.motors))
        start[damping] = 0.0
        start[ARM] = ARM_M / float(np.sqrt(np.mean(layout.effects(self.theta)[0] ** 2)))
        flights = len(self.flights.names)
        few = shooting.windows_of(self.stretches, WINDOW_S, TRIAL_STEPS)
        found, left = shooting.fit_windows(few, start, free, flights, self.calm)
        apart = self._apart(found)
        length_s = WINDOW_S
        weak: list[int] = []
        if apart <= AGREE:
            weak = self._weak(found, free)
            free = [i for i in free if i not in weak]
            start = found.theta[: self.count].copy()
            start[weak] = 0.0
            longer, more = shooting.fit_windows(windows, start, free, flights, self.calm)
            if (more <= GROWN * left).all():
                found, left, length_s = longer, more, LONG_S
            else:
                short = shooting.windows_of(self.stretches, WINDOW_S)
                found, left = shooting.fit_windows(short, start, free, flights, self.calm)
            apart = self._apart(found)
        if not apart <= AGREE:
            self.notes.append(
                f"free runs would change the motors' effects by {100.0 * apart:.0f} %: gusts that the "
                "controller answers bend them, so the numbers are those of regression"
            )
            return
        weak += damping
        self.theta[weak] = 0.0
        self.inside[weak] = False
        self.covariance[weak] = 0.0
        self.covariance[:, weak] = 0.0
        self._hold(weak, TOO_SMALL)
        self._hold(damping, "it follows from the rotors' drag at their hubs, held at 0 beside it")
        for place in range(INERTIA, EFFECTS):
            self.held.pop(place, None)
        self._take(found, free)
        self.winds = found.theta[self.count :].reshape(-1, shooting.OWN)[:, :2]
        self.method = "free runs"
        self.notes.append(
            f"free runs over {length_s:g} s leave {1e3 * left[:3].max():.2g} mm, "
            f"{np.degrees(left[6:9].max()):.2g} deg"
        )

    def _weak(self, found: Found, free: Sequence[int]) -> list[int]:
        """Drag, trim, damping and lean that free runs do not tell from nothing."""
        errors = np.sqrt(np.diag(found.covariance))
        small = (*range(ROTOR_DRAG, INERTIA), ARM)
        return [i for i in free if i in small and not abs(found.theta[i]) > SIGNIFICANT * errors[i]]

    def _doubt(self) -> None:
        """Take back what these flights cannot tell, and say what their outputs do not look like."""
        effects = layout.effects(self.theta)
        commands = np.concatenate([piece.commands for piece in self.pieces])
        for i, j in combinations(range(self.motors), 2):
            if np.array_equal(commands[:, i], commands[:, j]):
                places = [EFFECTS + axis * self.motors + motor for axis in range(3) for motor in (i, j)]
                self._withdraw(
                    places,
                    f"motors {i + 1} and {j + 1} are commanded alike, so half of their sum stands here",
                )
        self.notes += [
            f"motor {i + 1} is at full scale for {seconds:.0f} s: it gave no more, whatever was demanded"
            for i, seconds in enumerate(self._seconds_at_full())
            if seconds >= LEAST_S
        ]
        if odds_of_none(self.pieces, self.theta, self.settings.band_hz) > self.settings.chance:
            self._withdraw(range(self.count), "nothing that turns follows these motors")
            self.notes.append(
                "nothing that turns follows these motors: on the ground, or the commands are not theirs. No "
                "number of this vehicle is known"
            )
        interval = self._command_interval()
        if interval > self.theta[LAG] + self.theta[DELAY]:
            self._withdraw(
                [LAG, DELAY], f"commands change every {1e3 * interval:.0f} ms, slower than motors follow"
            )
        mean = np.mean([interval_means(p.halves(self.theta)[0]).mean(axis=0) for p in self.pieces], axis=0)
        for k, (axis, own) in enumerate(zip(layout.AXES[:2], effects, strict=False)):
            places = EFFECTS + k * self.motors + np.arange(self.motors)
            spread = Z95 * np.sqrt(mean @ self.covariance[np.ix_(places, places)] @ mean)
            left = (abs(float(own @ mean)) - float(spread)) / float(np.abs(own) @ mean)
            if self.inside[places].all() and left > self.settings.unbalanced:
                self.notes.append(
                    f"{axis} torques of these motors do not cancel ({100.0 * left:.0f} % is left over): a "
                    "motor is not logged, or one of these outputs is no motor but a servo, as on a plane. "
                    "The effects are then not those of motors: name all motors, and motors alone, in a recipe"
                )

    def _withdraw(self, places: Sequence[int], why: str) -> None:
        """Numbers that came out, but that these flights cannot tell."""
        self._hold(places, why)
        self.inside[places] = False
        self.covariance[places] = 0.0
        self.covariance[:, places] = 0.0

    def _seconds_at_full(self) -> FloatArray:
        """(motors,) how long each is commanded all it has."""
        return np.asarray(sum((p.commands[p.first :] >= 1.0).sum(axis=0) * p.dt_s for p in self.pieces))

    def _command_interval(self) -> float:
        """Seconds from one change of any command to the next, on average."""
        changes = [(np.diff(p.commands, axis=0) != 0.0).any(axis=1) for p in self.pieces]
        seconds = sum(len(changed) * p.dt_s for changed, p in zip(changes, self.pieces, strict=True))
        return seconds / max(sum(int(changed.sum()) for changed in changes), 1)

    def _apart(self, found: Found) -> float:
        """Share by which the effects of motors differ from those of regression."""
        own = layout.effects(self.theta)
        return float(np.linalg.norm(layout.effects(found.theta[: self.count]) - own) / np.linalg.norm(own))

    def finish(self) -> FittedVehicle:
        """The vehicle, with what each flight has of its own."""
        self._doubt()
        facts = []
        for place, damage in enumerate(self.flights.damage):
            records = [r for r in self.flights.records if r.flight == damage.flight]
            if not any(record.stretches for record in records):
                self.notes.append(f"{damage.flight}: no whole second in the air, so it tells nothing")
            facts.append(
                FlightFacts(
                    damage.flight,
                    float(sum((b - a) * r.dt_s for r in records for a, b in r.stretches)),
                    None if self.calm or not self.has_air else tuple(self.winds[place].tolist()),
                    _gyro_bias(records),
                    self._force_bias(records, place),
                    tuple(damage.lines),
                    float(sum(r.lost.sum() * r.dt_s for r in records)),
                )
            )
        return FittedVehicle(
            theta=self.theta,
            covariance=self.covariance,
            inside=self.inside,
            held=self.held,
            zero=self.flights.scale.zero,
            full=self.flights.scale.full,
            reference_v=self.reference_v,
            dt_s=self.flights.records[0].dt_s,
            method=self.method,
            flights=tuple(facts),
            frames=self.flights.frames,
            notes=tuple(self.notes),
            flown_v=self.flown_v,
        )

    def _force_bias(self, records: Sequence[Record], place: int) -> tuple[float, float, float] | None:
        """What the accelerometer reads beyond the vehicle's specific force, on average."""
        if not self.has_air or records[0].force is None:
            return None
        own = [s for s in self.stretches if self.flights.names[s.flight] == records[0].flight]
        left = [_force_left(stretch, self.theta, self.winds[place]) for stretch in own]
        if not left:
            return None
        x, y, z = np.concatenate(left).mean(axis=0)
        return float(x), float(y), float(z)


def _stays_calm(records: Sequence[Record]) -> bool:
    """No flight turns its heading by half a turn, so that wind and a lateral force look alike."""
    for record in records:
        if record.attitude is None or not record.stretches:
            continue
        ahead = rotations.to_world(record.attitude[record.flying], np.array([1.0, 0.0, 0.0]))
        heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
        if np.ptp(heading) > np.pi:
            return False
    return True


def _gyro_bias(records: Sequence[Record]) -> tuple[float, float, float] | None:
    """What the gyro reads beyond the attitude's rate, on average."""
    left = [
        r.gyro[a : b - 1] - rotations.body_rates(r.attitude[a:b], r.dt_s)
        for r in records
        if r.attitude is not None
        for a, b in r.stretches
    ]
    if not left:
        return None
    x, y, z = np.concatenate(left).mean(axis=0)
    return float(x), float(y), float(z)


def _force_left(stretch: Stretch, theta: FloatArray, wind: FloatArray) -> FloatArray:
    """(n - 1, 3) accelerometer less the vehicle's specific force."""
    record = stretch.record
    assert record.force is not None
    part = record.force[stretch.first : stretch.last]
    return np.asarray(0.5 * (part[1:] + part[:-1]) - force_of(stretch, theta, wind))
