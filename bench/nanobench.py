"""Real flights of a nano quadrotor: the vehicle, and predictions up to half a second ahead.

`python -m bench.nanobench [folder] [--train B2,B5,B6,B7] [--test B9] [--perturb KIND,...] [--seed N]`:
trains on the flights of a folder of NanoBench tables (`*.csv.gz`) whose names begin so, and tests on others.
Starts are every five samples in flight (above 0.3 m, all motors above 5 %), whole from 200 ms before to 500
ms after. Errors are means over starts, summed over horizons of 1 to 50 samples, and averaged over flights;
position m, velocity m/s, attitude rad, rate rad/s. The last lines say which goals are met.

Every flight is perturbed first by the kinds named: `part` keeps 80 % of it, `rate` every second sample,
`battery` reads voltages up to 5 % off, `damage` loses the link over a tenth of it, `clock` lets the on-board
clock drift by up to 1 %, at most 0.1 s, and swing by 20 ms.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import flysid
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import KINDS, Ahead, Starts, errors, fly_ahead, hold, whole_starts
from flysid.sixdof.in_loop import blind, fit_in_loop
from flysid.sixdof.records import GROUPS, Scale, flights_of

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "benchmarks" / "nanobench"
FULL = 65535.0
STEPS = 50
EVERY = 5
DT_S = 0.01
STANDARD_GRAVITY = 9.81
GOALS = {"sum": 22.0, "position and velocity": 5.0, "rate": 14.0, "rate at 50 ms by physics": 0.175}
LEAST_GAIN = 0.1
MOST_S = 60.0
SIGNS = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
"""Of roll, pitch and yaw by motors 1 to 4 of a Crazyflie, axes forward, left, up."""
Predict = Callable[[Starts], Ahead]


def table(path: Path) -> Segment:
    """One flight: angles are rad, the accelerometer reads in g."""
    rows = pd.read_csv(path)
    motors = rows[[f"motor_motor_m{i}" for i in (1, 2, 3, 4)]].to_numpy()
    gyro = rows[[f"imu_gyro_{axis}" for axis in "xyz"]].to_numpy()
    force = STANDARD_GRAVITY * rows[[f"imu_acc_{axis}" for axis in "xyz"]].to_numpy()
    pose = rows[["qw", "qx", "qy", "qz", "vx", "vy", "vz", "px", "py", "pz"]].to_numpy()
    volts = np.maximum(rows["pwr_pm_vbat"].to_numpy(), np.finfo(float).eps)
    return Segment(
        np.column_stack([motors, volts]), np.hstack([gyro, force, pose]), flight=path.name.split(".")[0]
    )


def keep_part(segment: Segment, rng: np.random.Generator) -> Segment:
    """80 % of a flight, from anywhere."""
    kept = len(segment) * 4 // 5
    first = int(rng.integers(0, len(segment) - kept + 1))
    return segment.slice(first, first + kept, DT_S)


def halve_rate(segment: Segment, _: np.random.Generator) -> Segment:
    """Every second sample."""
    return Segment(segment.u[::2], segment.y[::2], flight=segment.flight)


def change_battery(segment: Segment, rng: np.random.Generator) -> Segment:
    """Voltages up to 5 % off."""
    u = segment.u.copy()
    u[:, -1] *= rng.uniform(0.95, 1.05)
    return replace(segment, u=u)


def lose_link(segment: Segment, rng: np.random.Generator) -> Segment:
    """Straight lines over a tenth of a flight, 80 ms to 1 s each, and motors at up to 70 times full scale."""
    u, y = segment.u.copy(), segment.y.copy()
    lost = 0
    while lost < len(u) // 10:
        length = int(rng.integers(8, 100))
        first = int(rng.integers(1, len(u) - length - 1))
        share = np.arange(length)[:, None] / (length - 1)
        u[first : first + length, :4] += share * rng.uniform(0.0, 70.0) * FULL
        for signals in (u, y):
            ends = signals[first], signals[first + length - 1]
            signals[first : first + length] = (1.0 - share) * ends[0] + share * ends[1]
        lost += length
    return replace(segment, u=u, y=y)


def bend_clock(segment: Segment, rng: np.random.Generator) -> Segment:
    """What is on board (motors, voltage, gyro, accelerometer) by a clock that drifts and swings."""
    time_s = DT_S * np.arange(len(segment))
    late = rng.uniform(-0.01, 0.01) * (time_s - time_s.mean())
    late += 0.02 * np.sin(2.0 * np.pi * time_s / rng.uniform(8.0, 20.0))
    late = np.clip(late, -0.1, 0.1)

    def at(values: FloatArray) -> FloatArray:
        return np.stack([np.interp(time_s + late, time_s, column) for column in values.T], axis=1)

    return replace(segment, u=at(segment.u), y=np.hstack([at(segment.y[:, :6]), segment.y[:, 6:]]))


PERTURB: Mapping[str, Callable[[Segment, np.random.Generator], Segment]] = {
    "part": keep_part,
    "battery": change_battery,
    "clock": bend_clock,
    "damage": lose_link,
    "rate": halve_rate,
}
"""In the order in which they act."""


def perturb(data: Dataset, kinds: Sequence[str], seed: int) -> Dataset:
    """The flights, each perturbed by a draw of its own."""
    segments = []
    for place, segment in enumerate(data.segments):
        rng = np.random.default_rng([seed, place])
        for kind in (kind for kind in PERTURB if kind in kinds):
            segment = PERTURB[kind](segment, rng)
        segments.append(segment)
    dt_s = 2.0 * DT_S if "rate" in kinds else DT_S
    return Dataset(dt_s, data.inputs, data.outputs, tuple(segments))


def flights(paths: Sequence[Path]) -> Dataset:
    """Flights as a dataset of a vehicle."""
    inputs = (*(Signal(f"motor{i}") for i in (1, 2, 3, 4)), Signal("voltage", "V"))
    outputs = tuple(Signal(name) for names in GROUPS.values() for name in names)
    return Dataset(DT_S, inputs, outputs, tuple(table(path) for path in paths))


def starts_of(data: Dataset) -> dict[str, Starts]:
    """Whole starts of every flight that has any."""
    steps = round(STEPS * DT_S / data.dt_s)
    every = max(round(EVERY * DT_S / data.dt_s), 1)
    found = {r.flight: whole_starts(r, steps, every) for r in flights_of(data, Scale(0.0, FULL)).records}
    return {name: starts for name, starts in found.items() if len(starts.at)}


def judged(tests: Sequence[Starts], predict: Predict) -> FloatArray:
    """(50, 4) errors, averaged over flights; at a slower rate those between are interpolated."""
    mean = np.mean([errors(starts, predict(starts)) for starts in tests], axis=0)
    steps = STEPS // len(mean) * np.arange(len(mean) + 1)
    rows = np.vstack([np.zeros(mean.shape[1]), mean])
    return np.stack([np.interp(np.arange(1, STEPS + 1), steps, column) for column in rows.T], axis=1)


def is_physical(vehicle: FittedVehicle) -> bool:
    """Signs of torques are those of the airframe, nothing acts before its command, thrust lifts."""
    signs = bool((np.sign(layout.effects(vehicle.theta)) == SIGNS).all())
    return signs and vehicle.theta[layout.DELAY] >= 0.0 and vehicle.theta[layout.THRUST] > 0.0


def chosen(folder: Path, families: str) -> list[Path]:
    """The flights of some families, by the beginning of their names."""
    wanted = tuple(families.split(","))
    return sorted(path for path in folder.glob("*.csv*") if path.name.startswith(wanted))


def main() -> None:
    """Print the table and the goals."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    parser.add_argument("--train", default="B2,B5,B6,B7")
    parser.add_argument("--test", default="B9")
    parser.add_argument("--perturb", default="")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    kinds = [kind for kind in asked.perturb.split(",") if kind]
    if not set(kinds) <= set(PERTURB):
        parser.error(f"kinds of --perturb are {', '.join(PERTURB)}")
    began = time.process_time()
    train = perturb(flights(chosen(asked.folder, asked.train)), kinds, asked.seed)
    test = perturb(flights(chosen(asked.folder, asked.test)), kinds, asked.seed + 1)
    vehicle = flysid.Vehicle(zero=0.0, full=FULL, calm=True).fit(train)
    print(vehicle)
    known = list(starts_of(train).values())
    tests = list(starts_of(test).values())
    print(f"{sum(len(s.at) for s in tests)} whole starts in {len(tests)} test flights")
    in_loop = fit_in_loop(known, vehicle)
    without = fit_in_loop(known, blind(vehicle))
    rows: dict[str, FloatArray] = {
        "constant velocity": judged(tests, hold),
        "no inputs": judged(tests, without.predict),
        "vehicle alone": judged(tests, lambda starts: fly_ahead(starts, vehicle)),
        "in the loop": judged(tests, in_loop.predict),
    }
    seconds = time.process_time() - began
    head = "".join(f"{kind:>10}" for kind in (*KINDS, "sum"))
    print(f"{'':20}{head}   rate at 10, 30, 50, 100 ms")
    for name, table_ in rows.items():
        sums = table_.sum(axis=0)
        early = ", ".join(f"{table_[h - 1, 3]:.3f}" for h in (1, 3, 5, 10))
        print(f"{name:20}{''.join(f'{x:10.2f}' for x in (*sums, sums.sum()))}   {early}")
    sums = rows["in the loop"].sum(axis=0)
    reached = {
        "sum": sums.sum(),
        "position and velocity": sums[0] + sums[1],
        "rate": sums[3],
        "rate at 50 ms by physics": rows["vehicle alone"][4, 3],
    }
    for name, value in reached.items():
        print(f"{name}: {value:.3g}, goal {GOALS[name]:g}: {'met' if value < GOALS[name] else 'missed'}")
    gain = 1.0 - sums.sum() / rows["no inputs"].sum()
    met = "met" if gain >= LEAST_GAIN else "missed"
    print(f"below the predictor without inputs by {100 * gain:.1f} %, goal {100 * LEAST_GAIN:.0f} %: {met}")
    each = {}
    for segment in (*train.segments, *test.segments):
        alone = Dataset(train.dt_s, train.inputs, train.outputs, (segment,))
        try:
            each[segment.flight] = is_physical(
                flysid.Vehicle(zero=0.0, full=FULL, calm=True, free_runs=False).fit(alone)
            )
        except flysid.DataError as error:
            print(f"{segment.flight}: {error.message}")
    unphysical = [name for name, good in each.items() if not good]
    good = len(each) - len(unphysical)
    print(
        f"signs, delay and thrust are physical on {good} of {len(each)} flights {unphysical or ''}".rstrip()
    )
    print(f"{seconds:.0f} s of CPU, goal {MOST_S:g}: {'met' if seconds <= MOST_S else 'missed'}")


if __name__ == "__main__":
    main()
