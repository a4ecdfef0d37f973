"""Hidden vehicles in RotorPy: are their numbers found, do intervals hold, do free runs stay near?

`python -m bench.rotorpy_vehicles [vehicles] [first seed] [--rows FILE]`: mass, inertias, arms, lag, k_eta,
k_m and drag are drawn anew. Each vehicle flies two figures under RotorPy's own controller with quick steps on
top, logged at 100 Hz with noise. A third flight, which nothing was fitted to, is flown again for 5 s without
a controller: by the fit, and by RotorPy with the exported parameters. Vehicles whose rows FILE holds are not
flown again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import flysid
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.export.vehicles.rotorpy import rotorpy_parameters
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.records import GROUPS

DT_S = 0.01
FLIGHT_S = 20.0
AHEAD_S = 5.0
SPEED_MAX = 2500.0
NOISE = np.repeat([0.01, 0.05, 0.001, 0.02, 0.005], [3, 3, 4, 3, 3])
"""Of gyro rad/s, accelerometer m/s^2, quaternion, velocity m/s and position m."""
STEP_SHARE = 0.04
"""Of full speed: the steps on top."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight: (N, 4) commands, (N, 16) true signals in the order of `GROUPS`, (N, 4) rotor speeds."""

    commands: FloatArray
    signals: FloatArray
    speeds: FloatArray


class Uniform(Protocol):
    """What draws a number between two."""

    def uniform(self, low: float, high: float, /) -> float:
        """A number from `low` to `high`."""


def draw(rng: Uniform, mass_kg: float | None = None) -> dict[str, Any]:
    """Parameters of a vehicle whose hover takes half the speed, or so; a mass of None is drawn, too."""
    mass = rng.uniform(0.03, 1.5) if mass_kg is None else mass_kg
    arm = 0.05 * (mass / 0.03) ** (1 / 3) * rng.uniform(0.8, 1.2)
    weight = 9.81 * mass
    share = rng.uniform(0.2, 0.4)
    k_eta = weight / 4.0 / (share * SPEED_MAX**2)
    wide = rng.uniform(0.8, 1.2)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / np.sqrt(2.0)
    ixx = mass * arm**2 * rng.uniform(0.2, 0.4)
    iyy = ixx * rng.uniform(0.9, 1.4)
    drag = mass * rng.uniform(0.1, 0.4) / (4.0 * np.sqrt(share) * SPEED_MAX)
    return {
        "mass": mass,
        "Ixx": ixx,
        "Iyy": iyy,
        "Izz": (ixx + iyy) * rng.uniform(0.85, 1.0),
        **dict.fromkeys(("Ixy", "Ixz", "Iyz"), 0.0),
        "num_rotors": 4,
        "rotor_pos": {f"r{i + 1}": np.array([*(arm * signs[i] * [1.0, wide]), 0.0]) for i in range(4)},
        "rotor_directions": np.array([1, -1, 1, -1]),
        "rI": np.zeros(3),
        **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), 0.0),
        "k_eta": k_eta,
        "k_m": k_eta * arm * rng.uniform(0.1, 0.25),
        "k_d": drag,
        "k_z": drag * rng.uniform(0.5, 2.0),
        "k_h": 0.0,
        "k_flap": 0.0,
        "tau_m": rng.uniform(0.01, 0.06),
        "rotor_speed_min": 0.0,
        "rotor_speed_max": SPEED_MAX,
        "motor_noise_std": 0.0,
        "k_w": 1.0,
        "k_v": 10.0,
        "kp_att": 300.0,
        "kd_att": 40.0,
    }


def vehicle_of(parameters: Mapping[str, Any], start: Mapping[str, FloatArray] | None = None) -> Any:
    """RotorPy's vehicle, integrated finely."""
    from rotorpy.vehicles.multirotor import Multirotor

    hover = np.sqrt(9.81 * parameters["mass"] / 4.0 / parameters["k_eta"])
    still = {
        "x": np.array([0.0, 0.0, 2.0]),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    fine = {"method": "RK45", "rtol": 1e-7, "atol": 1e-9}
    return Multirotor(dict(parameters), dict(start or still), "cmd_motor_speeds", integrator_kwargs=fine)


def fly(parameters: Mapping[str, Any], seconds: float, rng: np.random.Generator) -> Flown:
    """A figure in space, yaw turning, with quick steps of all rotors on top of RotorPy's controller."""
    from rotorpy.controllers.quadrotor_control import SE3Control

    vehicle = vehicle_of(parameters)
    control = SE3Control(dict(parameters))
    control.kp_att, control.kd_att = 150.0, 20.0
    state = vehicle.initial_state
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    size = np.array([3.0, 2.0, 1.0])
    pace = np.array([0.9, 1.2, 0.8]) * rng.uniform(0.8, 1.2)
    commands, rows, speeds = [], [], []
    shake = np.zeros(4)
    for i in range(round(seconds / DT_S)):
        t = i * DT_S
        angle = pace * t + phase
        goal = {
            "x": size * np.sin(angle) + [0.0, 0.0, 5.0],
            "x_dot": size * pace * np.cos(angle),
            "x_ddot": -size * pace**2 * np.sin(angle),
            "x_dddot": np.zeros(3),
            "x_ddddot": np.zeros(3),
            "yaw": 0.5 * np.sin(0.6 * t),
            "yaw_dot": 0.3 * np.cos(0.6 * t),
            "yaw_ddot": 0.0,
        }
        if i % 20 == 0:
            shake = STEP_SHARE * SPEED_MAX * rng.choice([-1.0, 0.0, 1.0], 4)
        given = np.clip(control.update(t, state, goal)["cmd_motor_speeds"] + shake, 0.0, SPEED_MAX)
        force = vehicle.statedot(state, {"cmd_motor_speeds": given}, DT_S)["vdot"] + [0.0, 0.0, 9.81]
        q = state["q"][[3, 0, 1, 2]]
        body = flysid_body(q, force)
        commands.append(given)
        rows.append(np.concatenate([state["w"], body, q, state["v"], state["x"]]))
        speeds.append(state["rotor_speeds"].copy())
        state = vehicle.step(state, {"cmd_motor_speeds": given}, DT_S)
    return Flown(np.array(commands), np.array(rows), np.array(speeds))


def flysid_body(q: FloatArray, vector: FloatArray) -> FloatArray:
    """A world's vector in body axes, by SciPy."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(q[[1, 2, 3, 0]]).inv().apply(vector))


def truth(parameters: Mapping[str, Any]) -> dict[str, float]:
    """What the fit is to find, by its names."""
    mass, full = parameters["mass"], SPEED_MAX
    thrust = parameters["k_eta"] * full**2
    found = {
        "motor lag": parameters["tau_m"],
        "thrust curve": 1.0,
        "thrust of a motor": thrust / mass,
        "rotor drag x": parameters["k_d"] * full / mass,
        "rotor drag y": parameters["k_d"] * full / mass,
        "rotor drag z": parameters["k_z"] * full / mass,
        "inertia pitch / roll": parameters["Iyy"] / parameters["Ixx"],
        "inertia yaw / roll": parameters["Izz"] / parameters["Ixx"],
    }
    for i in range(4):
        x, y, _ = parameters["rotor_pos"][f"r{i + 1}"]
        found[f"roll of motor {i + 1}"] = thrust * y / parameters["Ixx"]
        found[f"pitch of motor {i + 1}"] = -thrust * x / parameters["Iyy"]
        yaw = parameters["k_m"] * full**2 / parameters["Izz"]
        found[f"yaw of motor {i + 1}"] = parameters["rotor_directions"][i] * yaw
    return found


def dataset(flights: list[Flown], rng: np.random.Generator) -> Dataset:
    """What a logger keeps of the flights."""
    segments = [
        Segment(f.commands, f.signals + NOISE * rng.standard_normal(f.signals.shape), flight=f"flight-{i}")
        for i, f in enumerate(flights)
    ]
    inputs = tuple(Signal(f"motor{i}") for i in (1, 2, 3, 4))
    outputs = tuple(Signal(name) for names in GROUPS.values() for name in names)
    return Dataset(DT_S, inputs, outputs, tuple(segments))


def apart_m(flown: Flown, vehicle: FittedVehicle, exported: Mapping[str, Any]) -> tuple[float, float]:
    """Metres after 5 s without a controller: of the fit, and of RotorPy with the exported parameters."""
    first = round(2.0 / DT_S)
    steps = round(AHEAD_S / DT_S)
    row = flown.signals[first]
    start = np.concatenate([row[13:16], row[10:13], row[6:10], row[:3]])
    from flysid.sixdof.rigid_body import run

    halves = vehicle.shares(flown.commands[: first + steps + 1], None, DT_S)[2 * first :]
    states = run(start, halves, DT_S, vehicle.theta)
    there = flown.signals[first + steps, 13:16]
    state = {
        "x": row[13:16],
        "v": row[10:13],
        "q": row[6:10][[1, 2, 3, 0]],
        "w": row[:3],
        "wind": np.zeros(3),
        "rotor_speeds": flown.speeds[first],
    }
    other = vehicle_of(exported, state)
    state = other.initial_state
    for i in range(first, first + steps):
        state = other.step(state, {"cmd_motor_speeds": flown.commands[i]}, DT_S)
    return float(np.linalg.norm(states[-1, :3] - there)), float(np.linalg.norm(state["x"] - there))


def try_vehicle(seed: int) -> Row:
    """One hidden vehicle: flown, fitted, compared, flown again."""
    began = time.process_time()
    rng = np.random.default_rng(seed)
    parameters = draw(rng)
    flights = [fly(parameters, FLIGHT_S, rng) for _ in range(2)]
    unseen = fly(parameters, 2.0 + AHEAD_S + 0.1, rng)
    flown_s = time.process_time() - began
    vehicle = flysid.Vehicle(zero=0.0, full=SPEED_MAX, calm=True).fit(dataset(flights, rng))
    numbers = {}
    for name, value in truth(parameters).items():
        found = vehicle[name]
        numbers[name] = (value, found.value, found.half_width if found.is_determined else None)
    arm = float(np.mean([np.linalg.norm(p[:2]) for p in parameters["rotor_pos"].values()]))
    own_m, exported_m = apart_m(unseen, vehicle, rotorpy_parameters(vehicle, parameters["mass"], arm))
    fitted_s = time.process_time() - began - flown_s
    return Row(seed, vehicle.method, numbers, own_m, exported_m, flown_s, fitted_s)


@dataclass(frozen=True)
class Row:
    """What came of one vehicle.

    Attributes
    ----------
    numbers : name -> truth, estimate, half of its 95 % interval; None where it is not determined.
    own_m, exported_m : after 5 s without a controller.
    """

    seed: int
    method: str
    numbers: Mapping[str, tuple[float, float, float | None]]
    own_m: float
    exported_m: float
    flown_s: float
    fitted_s: float

    @property
    def hits(self) -> dict[str, bool]:
        """Of every number that is determined: whether its interval holds the truth."""
        known = ((name, *values) for name, values in self.numbers.items())
        return {name: abs(found - value) <= half for name, value, found, half in known if half is not None}

    def __str__(self) -> str:
        missed = [name for name, hit in self.hits.items() if not hit]
        words = (f"{name} {self.numbers[name][1]:.4g} for {self.numbers[name][0]:.4g}" for name in missed)
        return (
            f"{self.seed}: by {self.method}, {self.own_m:.3f} m, exported {self.exported_m:.3f} m, "
            f"CPU {self.flown_s:.0f} + {self.fitted_s:.0f} s; {'; '.join(words)}"
        )


def kept_rows(file: Path | None) -> dict[int, Row]:
    """Rows of a file by seed; none where there is no file."""
    if file is None or not file.exists():
        return {}
    rows = [Row(**json.loads(line)) for line in file.read_text().splitlines()]
    return {row.seed: row for row in rows}


def summarise(rows: Sequence[Row]) -> None:
    """Print the medians and shares over vehicles."""
    off: dict[str, list[float]] = {}
    for row in rows:
        for name, (value, found, _) in row.numbers.items():
            kind = name.rstrip(" 1234").replace(" of motor", "")
            off.setdefault(kind, []).append(100.0 * abs(found / value - 1.0))
    for kind, values in off.items():
        print(f"{kind:24} off by {np.median(values):.2f} % in the median, {np.max(values):.2f} % at most")
    everything = np.concatenate([*off.values()])
    print(f"all numbers: {np.median(everything):.2f} % in the median, goal 5 %")
    hits = [hit for row in rows for hit in row.hits.values()]
    print(f"intervals hold {100 * np.mean(hits):.1f} % of {len(hits)}, goal 92 to 98 %")
    own, other = np.median([(row.own_m, row.exported_m) for row in rows], axis=0)
    print(f"after {AHEAD_S:g} s without a controller: {own:.3f} m, exported {other:.3f} m, goal 0.1 m")


def main() -> None:
    """Print a line a vehicle, and the medians."""
    parser = argparse.ArgumentParser()
    parser.add_argument("vehicles", nargs="?", type=int, default=20)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--rows", type=Path)
    wanted = parser.parse_args()
    kept = kept_rows(wanted.rows)
    rows = []
    for seed in range(wanted.first, wanted.first + wanted.vehicles):
        row = kept.get(seed) or try_vehicle(seed)
        if wanted.rows is not None and seed not in kept:
            with wanted.rows.open("a") as file:
                file.write(json.dumps(asdict(row)) + "\n")
        print(row, flush=True)
        rows.append(row)
    summarise(rows)


if __name__ == "__main__":
    if find_spec("rotorpy") is None:
        print("rotorpy is not installed: skipped")
        sys.exit(0)
    main()
