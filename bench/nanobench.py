"""Real flights of a nano quadrotor: the vehicle, and predictions up to half a second ahead.

`python -m bench.nanobench [folder] [--train B2,B5,B6,B7] [--test B9]`: trains on the flights of a folder of
NanoBench tables (`*.csv.gz`) whose names begin so, and tests on others. Starts are every five samples in
flight (above 0.3 m, all motors above 5 %), whole from 200 ms before to 500 ms after. Errors are means over
starts, summed over horizons of 1 to 50 samples, and averaged over flights; position m, velocity m/s,
attitude rad, rate rad/s. The last lines say which goals are met.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
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


def flights(paths: Sequence[Path]) -> Dataset:
    """Flights as a dataset of a vehicle."""
    inputs = (*(Signal(f"motor{i}") for i in (1, 2, 3, 4)), Signal("voltage", "V"))
    outputs = tuple(Signal(name) for names in GROUPS.values() for name in names)
    return Dataset(DT_S, inputs, outputs, tuple(table(path) for path in paths))


def starts_of(data: Dataset) -> dict[str, Starts]:
    """Whole starts of every flight that has any."""
    found = {r.flight: whole_starts(r, STEPS, EVERY) for r in flights_of(data, Scale(0.0, FULL)).records}
    return {name: starts for name, starts in found.items() if len(starts.at)}


def judged(tests: Sequence[Starts], predict: Predict) -> FloatArray:
    """(50, 4) errors, averaged over flights."""
    return np.asarray(np.mean([errors(starts, predict(starts)) for starts in tests], axis=0))


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
    asked = parser.parse_args()
    began = time.process_time()
    train = flights(chosen(asked.folder, asked.train))
    test = flights(chosen(asked.folder, asked.test))
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
        alone = Dataset(DT_S, train.inputs, train.outputs, (segment,))
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
