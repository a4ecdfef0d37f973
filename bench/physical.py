"""What the physical model finds of a vehicle whose numbers are known, and what it is worth on real flights.

`python -m bench.physical known [flights] [first seed] [plain|all|battery]`: the simulated AR.Drone, 60 s of
random steps on all commands, motor commands that act 10 ms after their row, 250 rows a second, gyro noise of
0.5 deg/s; errors and how often the 95 % intervals hold, without and with what the model leaves out
(gyroscopic torques, a falling battery); then a battery that loses a tenth of its voltage in the flight and
is measured (0.02 V of noise), so that commands act as the first power of its voltage.
`python -m bench.physical real [px4|blackbox]`: held-out real flights beside ARX and TS (../shared/logs), and
beside the physical model whose free run errs least in training.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.manoeuvres import amplitude_steps
from flysid.ingest.synth.quadrotor import STATES, airframe
from flysid.ingest.synth.rigid_body import ALL, STEP_S, Effects, SimulatedVehicle, fly_vehicle
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.multirotor import FittedMultirotor, Multirotor
from flysid.model.rotorcraft.rotor_axis import DAMPING, FIRST, LAG, TRIM
from flysid.model.ts import TS
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare_models import compare

DT_S = 0.004
LATE_S = 0.010
NOISE_DEG_S = 0.5
COMMAND_S = 0.02
RATES = ("p", "q", "r")
SAG = 0.1
FULL_V = 12.6
VOLT_NOISE = 0.02
POWER = "power of the battery's voltage"
PLAIN = replace(ALL, gyroscopic=False, battery_sag=False)

LOGS = Path("../shared/logs")
REAL = (
    ("px4", "px4-effort", "roll_torque", "ulog/quad_manual_aggressive_80s.ulg"),
    ("px4", "px4-effort", "pitch_torque", "ulog/quad_manual_aggressive_80s.ulg"),
    ("px4", "px4-effort", "yaw_torque", "ulog/quad_manual_aggressive_80s.ulg"),
    ("blackbox", "rotorcraft-motors", "motors_roll", "blackbox/greenreaper_*.bfl"),
    ("blackbox", "rotorcraft-motors", "motors_pitch", "blackbox/greenreaper_*.bfl"),
)
"""Name, recipe, channel and logs."""


def flown(
    seed: int, effects: Effects = PLAIN, seconds: float = 60.0, measured: bool = False
) -> tuple[Dataset, SimulatedVehicle]:
    """Motor commands and body rates of one flight: what its inner loop told the motors, held from row to row.
    With a measured voltage the battery is a small one, empty when the flight ends.

    The inner loop of the simulator has no rows; what it told every 4 ms is therefore flown again, held, late.
    """
    vehicle = SimulatedVehicle(effects=effects)
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds / COMMAND_S)) * COMMAND_S
    sizes = ((0.4, 8.0), (0.4, 8.0), (0.6, 0.5), (0.5, 60.0))
    commands = np.column_stack([amplitude_steps(time_s, hold, peak, rng) for hold, peak in sizes])
    told = fly_vehicle(vehicle, commands, period_s=COMMAND_S, record_s=DT_S).told
    sag = vehicle.airframe.sag / vehicle.airframe.endurance_s if effects.battery_sag else 0.0
    if measured:
        sag = SAG / seconds
    rates = np.empty((len(told), 3))
    replayed(told, round(DT_S / STEP_S), round(LATE_S / STEP_S), sag, vehicle.physics().packed(), rates)
    rates = np.degrees(rates) + NOISE_DEG_S * rng.standard_normal(rates.shape)
    motors = [Signal(f"motor {i}", "rad/s") for i in range(1, 5)]
    outputs = [Signal(name, "deg/s") for name in RATES]
    if measured:
        volts = FULL_V * (1.0 - sag * DT_S * np.arange(len(told)))
        told = np.column_stack([told, volts + VOLT_NOISE * rng.standard_normal(len(told))])
        motors.append(Signal("battery", "V"))
    return Dataset.from_arrays(told, rates, DT_S, inputs=motors, outputs=outputs), vehicle


@njit(cache=True)
def replayed(told, hold, late, sag, physics, out):  # type: ignore[no-untyped-def]
    """out (N, 3) = body rates under commands held for `hold` steps that act `late` steps after their row."""
    keep = math.exp(-0.5 * STEP_S / physics.motor_tau)
    state = np.zeros(STATES)
    rate = np.empty(STATES)
    rotors = told[0].copy()
    for step in range(len(told) * hold):
        if step % hold == 0:
            out[step // hold] = state[9:12]
        wanted = told[max(step - late, 0) // hold] * (1.0 - sag * step * STEP_S)
        halfway = wanted + keep * (rotors - wanted)
        after = wanted + keep * (halfway - wanted)
        total = np.zeros(3)
        first = state[9:12].copy()
        for share, weight, n in (
            (0.0, 1.0, rotors),
            (0.5, 2.0, halfway),
            (0.5, 2.0, halfway),
            (1.0, 1.0, after),
        ):
            if share > 0.0:
                state[9:12] = first + share * STEP_S * rate[9:12]
            airframe(state, n[0], n[1], n[2], n[3], 0.0, 0.0, 0.0, physics, rate)
            total += weight * rate[9:12]
        state[9:12] = first + STEP_S * total / 6.0
        rotors = after


def truth(vehicle: SimulatedVehicle, data: Dataset) -> list[dict[str, float]]:
    """What `figures` should say of every rate."""
    frame = vehicle.airframe
    force = frame.thrust_factor * frame.arm_m
    ixx, iyy, izz = frame.inertia_kg_m2
    twist = frame.torque_factor / izz
    effects = np.array(
        [[0.0, force / ixx, 0.0, -force / ixx], [-force / iyy, 0.0, force / iyy, 0.0], [twist, -twist] * 2]
    )
    u = data.segments[0].u[:, :4]
    sag = frame.sag / frame.endurance_s if vehicle.effects.battery_sag else 0.0
    volts = 1.0 - (0.5 * SAG if len(data.inputs) > 4 else sag * 0.5 * len(u) * DT_S)
    mean = volts**2 * u.mean(axis=0)
    shared = {"motor lag": frame.motor_lag_s, "dead time": LATE_S}
    return [
        shared
        | {"thrust curve (0 straight, 1 square)": 1.0, "drag of the rotors": 0.0, POWER: 1.0}
        | {f"effect of motor {i + 1}": float(np.degrees(2.0 * row[i] * mean[i])) for i in range(4)}
        for row in effects
    ]


def errors(
    seed: int, effects: Effects = PLAIN, measured: bool = False
) -> list[tuple[str, str, float, float, bool]]:
    """(rate, figure, value, truth, held) of everything that the flight determines and that is not zero."""
    data, vehicle = flown(seed, effects, measured=measured)
    model = Multirotor().fit(data)
    found = []
    for i, right in enumerate(truth(vehicle, data)):
        for figure in model.figures(i):
            true = right.get(figure.name, 0.0)
            if true and figure.is_determined:
                held = abs(figure.value - true) <= figure.half_width
                found.append((RATES[i], figure.name, figure.value, true, held))
    return found


def known(flights: int, first: int, only: str = "") -> None:
    """Errors and intervals over flights."""
    kinds = {
        "plain": ("as the model has it", PLAIN, False),
        "all": ("all effects", ALL, False),
        "battery": ("a battery that is measured", PLAIN, True),
    }
    for words, effects, measured in [kinds[only]] if only else kinds.values():
        rows = [row for seed in range(first, first + flights) for row in errors(seed, effects, measured)]
        print(f"{words}, {flights} flights")
        for name in dict.fromkeys((rate, figure) for rate, figure, *_ in rows):
            own = [row for row in rows if row[:2] == name]
            off = 100 * np.array([row[2] / row[3] - 1.0 for row in own])
            print(
                f"  {name[0]} {name[1]:36s} median {np.median(off):+6.2f} %, worst {np.abs(off).max():5.2f} "
                f"%, interval holds {100 * np.mean([row[4] for row in own]):3.0f} % of {len(own)}"
            )
        held = [row[4] for row in rows]
        far = [abs(row[2] / row[3] - 1.0) < 0.05 for row in rows]
        print(f"  held {sum(held)} of {len(held)}, within 5 % {sum(far)} of {len(far)}", flush=True)


def real(names: Sequence[str]) -> None:
    """Free run of held-out parts: PX4's last quarter, the blackbox craft's later flights."""
    for name, recipe, channel, pattern in REAL:
        if names and name not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            logs = find_logs([*sorted(LOGS.glob(pattern))])
            list(ingest_logs(logs, Path(folder) / "data"))
            data = open_lake(Path(folder) / "data").dataset(recipe, channel)
        train, test = data.split(holdout=0.5 if len(data.flights) > 1 else 0.25, seed=7)
        rivals: dict[str, Estimator] = {"ARX": ARX(), "TS": TS(rules=2), "physics": Multirotor()}
        models: dict[str, Fitted] = {label: estimator.fit(train) for label, estimator in rivals.items()}
        physics = models["physics"]
        assert isinstance(physics, FittedMultirotor)
        models["physics, by its free run"] = by_free_run(physics, train)
        compared = compare(models, test, train=train)
        spread = np.concatenate([s.y for s in test.segments]).std(axis=0)[0]
        print(f"{name} {channel} ({len(test.flights)} flights, spread {spread:.3g})")
        for entry in compared.entries:
            shown = ", ".join(f"{m} {s.scores.rmse:.4g}" for m, s in entry.models.items())
            print(f"  {'free run' if entry.horizon == FREE_RUN else f'{entry.horizon} ahead'}: {shown}")
        print(physics)
        print(models["physics, by its free run"])


def by_free_run(model: FittedMultirotor, train: Dataset) -> FittedMultirotor:
    """The model with the lag, drag, trim and torques whose free run errs least in training.

    In a loop that is no estimate: commands answer the disturbances.
    """
    (axis,) = model.axes
    free = [LAG, DAMPING, TRIM, *range(FIRST, len(axis.theta))]
    low = np.full(len(free), -np.inf)
    low[:2] = 1e-3, 0.0

    def with_values(values: FloatArray) -> FittedMultirotor:
        theta = axis.theta.copy()
        theta[free] = values
        return replace(model, axes=(replace(axis, theta=theta, covariance=np.zeros_like(axis.covariance)),))

    def errors_of(values: FloatArray) -> FloatArray:
        tried = with_values(values)
        off = np.concatenate([tried.simulate(s.u, s.y[:1]) - s.y for s in train.segments])
        return np.asarray(off[:, 0] / model.y_scale[0])

    found = []
    for damping in (0.5, 3.0, 10.0):
        start = np.maximum(axis.theta[free], low + 1e-6)
        start[1] = damping
        found.append(least_squares(errors_of, start, bounds=(low, np.inf), x_scale="jac", max_nfev=60))
    return with_values(min(found, key=lambda fit: float(fit.cost)).x)


if __name__ == "__main__":
    kind, *rest = sys.argv[1:] or ["known"]
    if kind == "real":
        real(rest)
    else:
        count, seed_0 = (*map(int, rest[:2]), *(10, 1)[len(rest[:2]) :])
        known(count, seed_0, *rest[2:3])
