"""Data compatibility: are injected faults found, and clean flights left alone?

`python -m bench.kinematics faults [flights] [first seed]`: the simulated AR.Drone flown by a simulated pilot
for 60 s, PX4's topics; a gyro bias of 0.5 deg/s, an accelerometer bias of 0.1 m/s^2, scales off by 5 % and
lags of 30 ms, all at once; how often each is within two of its standard deviations, and found.
`python -m bench.kinematics clean [flights] [first seed]`: the same without faults.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from flysid.dataset import FloatArray
from flysid.flight import BOOT, TIME, Flight, Source
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.kinematics.compatibility import Parameter, compatibility
from flysid.ingest.synth.manoeuvres import pilot
from flysid.ingest.synth.rigid_body import SimulatedVehicle, fly_vehicle

COMMAND_S = 0.02
TRUTH_S = 0.001
PEAKS = (10.0, 10.0, 0.6, 60.0)
"""deg, deg, m/s, deg/s."""
FLIP = np.array([1.0, -1.0, -1.0])
"""From forward, left, up to forward, right, down."""


@dataclass(frozen=True)
class Faults:
    """What is wrong with the instruments: biases in SI units, scales, lags in seconds, lever arm in m."""

    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gyro_lag_s: float = 0.0
    force_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    force_lag_s: float = 0.0
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    speed_lag_s: float = 0.0


INJECTED = Faults(
    gyro_bias=(np.radians(0.5), 0.0, np.radians(-0.5)),
    gyro_scale=(1.0, 1.05, 1.0),
    gyro_lag_s=0.03,
    force_bias=(0.1, -0.1, 0.0),
    force_scale=(1.0, 1.05, 1.0),
    force_lag_s=0.03,
    arm_m=(0.05, 0.0, -0.03),
    speed_scale=(0.95, 1.0, 1.05),
    speed_lag_s=0.03,
)


@dataclass(frozen=True)
class Instruments:
    """Rates in Hz and white noise, SI units."""

    imu_hz: float = 200.0
    estimate_hz: float = 50.0
    gyro: float = np.radians(0.3)
    force: float = 0.1
    attitude: float = np.radians(0.1)
    speed: float = 0.02
    position: float = 0.01


def flown(seed: int, faults: Faults, seconds: float = 60.0) -> Flight:
    """One flight, as PX4 would log it."""
    seen = Instruments()
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds / COMMAND_S)) * COMMAND_S
    commands = np.column_stack([pilot(time_s, peak, rng) for peak in PEAKS])
    states = fly_vehicle(SimulatedVehicle(), commands, period_s=COMMAND_S, record_s=TRUTH_S).states
    psi, phi, theta = states[:, 8], states[:, 6], states[:, 7]
    turned = Rotation.from_euler("ZXY", np.column_stack([psi, phi, theta]))
    speed = states[:, 3:6] * FLIP
    place = states[:, 0:3] * FLIP
    rates = states[:, 9:12] * FLIP
    felt = np.gradient(states[:, 3:6], TRUTH_S, axis=0) + np.array([0.0, 0.0, 9.81])
    force = turned.inv().apply(felt) * FLIP
    quaternion = turned.as_quat()[:, [3, 0, 1, 2]] * np.array([1.0, 1.0, -1.0, -1.0])
    arm = np.array(faults.arm_m)
    rising = np.gradient(rates, TRUTH_S, axis=0)
    force = force + np.cross(rising, arm) + np.cross(rates, np.cross(rates, arm))
    truth_s = np.arange(len(states)) * TRUTH_S

    def at(values: FloatArray, hz: float, lag_s: float, noise: float) -> FloatArray:
        when = np.arange(int(truth_s[-1] * hz)) / hz
        exact = np.column_stack([np.interp(when - lag_s, truth_s, column) for column in values.T])
        return exact + noise * rng.standard_normal(exact.shape)

    gyro = at(rates * faults.gyro_scale + faults.gyro_bias, seen.imu_hz, faults.gyro_lag_s, seen.gyro)
    acceleration = at(
        force * faults.force_scale + faults.force_bias, seen.imu_hz, faults.force_lag_s, seen.force
    )
    shaken = at(quaternion, seen.estimate_hz, 0.0, 0.0)
    errors = Rotation.from_rotvec(seen.attitude * rng.standard_normal((len(shaken), 3)))
    noisy = (Rotation.from_quat(shaken[:, [1, 2, 3, 0]]) * errors).as_quat()[:, [3, 0, 1, 2]]
    moved = at(speed * faults.speed_scale, seen.estimate_hz, faults.speed_lag_s, seen.speed)
    places = at(place, seen.estimate_hz, 0.0, seen.position)
    tables = {
        "vehicle_attitude": _table(seen.estimate_hz, {f"q[{i}]": noisy[:, i] for i in range(4)}),
        "vehicle_angular_velocity": _table(seen.imu_hz, {f"xyz[{i}]": gyro[:, i] for i in range(3)}),
        "sensor_combined": _table(
            seen.imu_hz, {f"accelerometer_m_s2[{i}]": acceleration[:, i] for i in range(3)}
        ),
        "vehicle_local_position": _table(
            seen.estimate_hz,
            {name: moved[:, i] for i, name in enumerate(("vx", "vy", "vz"))}
            | {name: places[:, i] for i, name in enumerate("xyz")},
        ),
    }
    return Flight(Source(f"simulated-{seed}.ulg", "ulog", 0, ""), tables)


def _table(hz: float, columns: Mapping[str, FloatArray]) -> pa.Table:
    """Columns with times; those named NAME[i] become one list."""
    count = len(next(iter(columns.values())))
    times = np.round(1e9 + np.arange(count) * 1e9 / hz).astype(np.int64)
    made: dict[str, pa.Array] = {TIME: pa.array(times), BOOT: pa.array(np.zeros(count, dtype=np.int32))}
    lists = dict.fromkeys(name.partition("[")[0] for name in columns if "[" in name)
    for name in lists:
        rows = np.column_stack([v for n, v in columns.items() if n.startswith(f"{name}[")])
        made[name] = pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), rows.shape[1])
    made |= {name: pa.array(v) for name, v in columns.items() if "[" not in name}
    return pa.table(made)


def truth_of(faults: Faults, parameter: Parameter) -> float:
    """What was injected."""
    axis = {"p": 0, "q": 1, "r": 2, "f_x": 0, "f_y": 1, "f_z": 2, "v_north": 0, "v_east": 1, "v_down": 2}
    own = {"gyro": "gyro", "accelerometer": "force", "velocity": "speed"}[parameter.instrument]
    if parameter.kind == "lag":
        return float(getattr(faults, f"{own}_lag_s"))
    if parameter.kind.startswith("arm"):
        return faults.arm_m[("forward", "right", "down").index(parameter.kind.removeprefix("arm "))]
    values = getattr(faults, f"{own}_{parameter.kind}", (0.0, 0.0, 0.0))
    return float(values[axis[parameter.signal]])


def campaign(faults: Faults, flights: int, first: int) -> None:
    """Share of flights in which each parameter is within two standard deviations of the truth, and found."""
    held: dict[tuple[str, str, str], list[bool]] = {}
    found: dict[tuple[str, str, str], list[bool]] = {}
    widths: dict[tuple[str, str, str], list[float]] = {}
    errors: dict[tuple[str, str, str], list[float]] = {}
    alarms = 0
    for seed in range(first, first + flights):
        seen = compatibility(FlightLog(flown(seed, faults)))
        alarms += bool(seen.findings)
        for p in (p for c in seen.comparisons for p in c.parameters if p.kind != "offset"):
            key = (p.instrument, p.signal, p.kind)
            off = p.value - truth_of(faults, p)
            held.setdefault(key, []).append(abs(off) <= 2.0 * p.sd)
            found.setdefault(key, []).append(p.found)
            widths.setdefault(key, []).append(p.sd)
            errors.setdefault(key, []).append(off)
    print("instrument     axis     kind         within 2 sd  found  sd (median)  mean error")
    for key, inside in held.items():
        print(
            f"{key[0]:14} {key[1]:8} {key[2]:12} {sum(inside):4} of {len(inside):3}  {sum(found[key]):5}"
            f"  {np.median(widths[key]):11.2g}  {np.mean(errors[key]):10.2g}"
        )
    print(f"flights with a finding: {alarms} of {flights}")


def main(words: list[str]) -> None:
    """See the module's docstring."""
    what = words[0] if words else ""
    flights = int(words[1]) if len(words) > 1 else 100
    first = int(words[2]) if len(words) > 2 else 1000
    if what == "faults":
        campaign(INJECTED, flights, first)
    elif what == "clean":
        campaign(Faults(), flights, first)
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
