"""Fly vehicles through flight plans, and turn the flights into recordings that the writers take.

Everything is fixed by the seed, times included: flights start at `EPOCH_NS`, ten minutes apart, so that the
same command writes the same bytes on every day.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.dryden import Gust, Wind
from flysid.ingest.synth.plans import GENTLE, Manoeuvre, plan_named
from flysid.ingest.synth.sensors import SENSORS, Sensor, observe, velocity_sensor
from flysid.ingest.synth.telemetry import MS_NS, Recording, Telemetry
from flysid.ingest.synth.vehicles import CHANGES, VEHICLES, Air

EPOCH_NS = 1_767_225_600 * SECOND_NS  # 2026-01-01T00:00:00Z
APART_NS = 600 * SECOND_NS
TAKE_OFF_NS = 12 * SECOND_NS  # vehicle time of the first sample: boot, arm, climb
PERIOD_NS = 20 * MS_NS  # commands go out at 50 Hz


def _writer(module: str, function: str) -> Callable[[Recording], bytes]:
    """A writer that is imported when it is first used."""

    def write(recording: Recording) -> bytes:
        encode: Callable[[Recording], bytes] = getattr(
            importlib.import_module(f"flysid.ingest.synth.writers.{module}"), function
        )
        return encode(recording)

    return write


WRITERS: Mapping[str, tuple[str, Callable[[Recording], bytes]]] = {
    "tlog": (".tlog", _writer("mavlink", "tlog_bytes")),
    "mcap": (".mcap", _writer("mcap", "mcap_bytes")),
    "dataflash": (".bin", _writer("dataflash", "dataflash_bytes")),
    "blackbox": (".bbl", _writer("blackbox", "blackbox_bytes")),
    "ulog": (".ulg", _writer("ulog", "ulog_bytes")),
    "mcap-ros1": (".ros1.mcap", _writer("ros_messages", "ros1_bytes")),
    "mcap-ros2": (".ros2.mcap", _writer("ros_messages", "ros2_bytes")),
    "navdata": (".navdata", _writer("ardrone", "navdata_bytes")),
    "pcap": (".pcap", _writer("ardrone", "pcap_bytes")),
}


@dataclass(frozen=True)
class Change:
    """Something of a vehicle is `factor` times what it was, from a flight on.

    `vehicle`, `flight`: counted from 1, in the fleet and in the plan.
    `name`: of `vehicles.CHANGES`.
    `factor`: above 0.
    """

    vehicle: int
    flight: int
    name: str
    factor: float

    def __post_init__(self) -> None:
        if self.name not in CHANGES:
            raise UsageError(f"no change {self.name!r}", hint="one of " + ", ".join(CHANGES))
        if self.vehicle < 1 or self.flight < 1 or not 0.0 < self.factor < np.inf:
            raise UsageError("vehicles and flights of a change count from 1, its factor is above 0")


@dataclass(frozen=True)
class Order:
    """What is to be flown.

    `plant`: a name of `vehicles.VEHICLES`.
    `plan`: a name of `plans.PLANS`.
    `duration_s`: of each flight.
    `noise`: standard deviation of the velocities' noise, m/s, of the sensor "telemetry".
    `seed`: fixes signals, noise, wind, dispersion and jitter.
    `amplitude`: multiplies the plan's amplitudes (the paper's own signals keep theirs).
    `dropouts_s`: (start, length) of silent stretches of the link, seconds from the first sample.
    `sensor`: a name of `sensors.SENSORS`.
    `wind_m_s`: steady wind with its turbulence, for plants that feel it.
    `fleet`: number of vehicles; from the second on their parameters are dispersed.
    `gusts`: for plants that feel wind.
    `altitude_m`: above ground at the start, for plants that have a ground.
    `without`: effects to switch off, names of `rigidbody.Effects`, for plants that have them.
    `changes`: what happens to vehicles, for plants that have effects.
    `step_s`: of the integration, for plants that are integrated.
    """

    plant: str = "ardrone-linear"
    plan: str = "mixed"
    duration_s: float = 120.0
    noise: float = 0.02
    seed: int = 1
    amplitude: float = 1.0
    dropouts_s: tuple[tuple[float, float], ...] = ()
    sensor: str = "telemetry"
    wind_m_s: float = 0.0
    fleet: int = 1
    gusts: tuple[Gust, ...] = ()
    altitude_m: float = 20.0
    without: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    step_s: float = 0.001

    def __post_init__(self) -> None:
        for kind, name, known in (("plant", self.plant, VEHICLES), ("sensor", self.sensor, SENSORS)):
            if name not in known:
                raise UsageError(f"no {kind} {name!r}", hint="one of " + ", ".join(known))
        plan_named(self.plan)
        if not 1.0 <= self.duration_s <= 86400.0:
            raise UsageError(f"a flight of {self.duration_s:g} s", hint="between 1 s and 86400 s")
        if not 0.0 <= self.noise < np.inf:
            raise UsageError(f"a noise of {self.noise:g} m/s", hint="0 or more")
        if not 0.0 < self.amplitude < np.inf:
            raise UsageError(f"{self.amplitude:g} times the plan's amplitudes", hint="a factor above 0")
        if self.seed < 0:
            raise UsageError(f"a seed of {self.seed}", hint="0 or more")
        for start, length in self.dropouts_s:
            if not 0.0 <= start < self.duration_s or length <= 0.0:
                raise UsageError(
                    f"a dropout at {start:g} s of {length:g} s in a flight of {self.duration_s:g} s",
                    hint="a start inside the flight, a length above 0 s",
                )
        if not 1 <= self.fleet <= 250:
            raise UsageError(f"a fleet of {self.fleet}", hint="1 to 250 vehicles")
        if (self.wind_m_s or self.gusts or self.without or self.changes) and not VEHICLES[self.plant].effects:
            raise UsageError(f"the plant {self.plant!r} has neither wind nor effects", hint="--plant ardrone")
        for change in self.changes:
            if change.vehicle > self.fleet:
                raise UsageError(f"no vehicle {change.vehicle} in a fleet of {self.fleet}")
        for name in self.without:
            if name not in VEHICLES[self.plant].effects:
                raise UsageError(
                    f"no effect {name!r}", hint="one of " + ", ".join(VEHICLES[self.plant].effects)
                )
        if not 0.2 <= self.altitude_m <= 1000.0:
            raise UsageError(f"an altitude of {self.altitude_m:g} m", hint="0.2 to 1000 m")


def flight_names(order: Order) -> list[str]:
    """The names of the order's flights: vehicle (in a fleet), number in the plan, manoeuvre, seed."""
    plan = plan_named(order.plan)
    return [
        (f"v{vehicle + 1:03d}-" if order.fleet > 1 else "") + f"{i:02d}-{manoeuvre.name}-seed{order.seed}"
        for vehicle in range(order.fleet)
        for i, manoeuvre in enumerate(plan, start=1)
    ]


def flights(order: Order) -> list[Recording]:
    """Fly the whole order, one flight after the other."""
    return [fly_one(order, index) for index in range(len(flight_names(order)))]


def fly_one(order: Order, index: int) -> Recording:
    """Fly one flight of the order; independent of the others, so they can be flown in any order."""
    plan = plan_named(order.plan)
    vehicle = index // len(plan)
    manoeuvre = plan[index % len(plan)]
    rng = np.random.default_rng([order.seed, index])
    period_s = PERIOD_NS * 1e-9
    time_s = np.arange(round(order.duration_s / period_s), dtype=np.float64) * period_s
    command = commands(order, manoeuvre, time_s, rng)
    time_ns = TAKE_OFF_NS + PERIOD_NS * np.arange(len(time_s), dtype=np.int64)
    air = Air(
        Wind(order.wind_m_s, gusts=order.gusts),
        np.random.default_rng([order.seed, index, 1]),
        vehicle,
        order.seed,
        order.altitude_m,
        order.without,
        tuple(
            (change.name, change.factor)
            for change in order.changes
            if change.vehicle == vehicle + 1 and index % len(plan) + 1 >= change.flight
        ),
        order.step_s,
    )
    truth = VEHICLES[order.plant].fly(command, period_s, air)
    return Recording(
        name=flight_names(order)[index],
        boot_utc_ns=EPOCH_NS + index * APART_NS,
        command=Telemetry(time_ns, dict(zip(("theta_in", "phi_in", "vz_in"), command.T, strict=True))),
        state=observe(Telemetry(time_ns, truth), sensor_of(order), rng),
        truth=Telemetry(time_ns, truth),
        seed=order.seed * 1000 + index,
        lost=tuple(_interval_ns(start, length) for start, length in order.dropouts_s),
        system=vehicle + 1,
        start_height_m=order.altitude_m,
    )


def sensor_of(order: Order) -> Sensor:
    """The order's sensor; telemetry has the requested noise."""
    telemetry = order.sensor == "telemetry"
    return velocity_sensor(50.0, order.noise) if telemetry else SENSORS[order.sensor]


def commands(order: Order, manoeuvre: Manoeuvre, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 3) theta_in (deg), phi_in (deg), vz_in (m/s)."""
    theta, phi, climb = (order.amplitude * s * g for s, g in zip(manoeuvre.scale, GENTLE, strict=True))
    return manoeuvre.command(time_s, (theta, phi, climb), rng)


def _interval_ns(start_s: float, length_s: float) -> tuple[int, int]:
    start = TAKE_OFF_NS + round(start_s * SECOND_NS)
    return start, start + round(length_s * SECOND_NS)
