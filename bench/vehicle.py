"""Figures of docs/vehicle.md: `python -m bench.vehicle [bode] [accuracy] [floor]`, all by default.

bode: the linearised vehicle beside (10), (11), (12). accuracy: ten seconds against scipy's solve_ivp on the
same compiled equations, and CPU time as a ratio to it. floor: the best linear model's free-run error on
noise-free held-out flights, against the amplitude of the commands.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import flysid
from flysid.dataset import Dataset, FloatArray
from flysid.ingest.synth.plans import MULTISINE, PILOT, STEPS
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.quadrotor import INPUTS
from flysid.ingest.synth.rigid_body import ALL, SimulatedVehicle, closed_loop_rates, fly_vehicle
from flysid.ingest.synth.tuning import BANDWIDTH_RAD_S, compare_loop

PERIOD_S = 0.02
STARTED = 50
SHARES = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0)
FULL = np.array([11.95, 11.95, 0.69])
Flight = tuple[FloatArray, dict[str, FloatArray]]
"""Commands (N, n) and true signals."""


def bode() -> None:
    """Largest deviations, and the deviation at single frequencies."""
    print("| loop | up to, rad/s | gain, dB | phase, deg |\n|---|---|---|---|")
    for loop in LOOPS:
        got = compare_loop(SimulatedVehicle(), loop)
        worst = (np.abs(v).max() for v in (got.gain_db, got.phase_deg))
        print(f"| {loop} | {BANDWIDTH_RAD_S[loop]:g} | " + " | ".join(f"{v:.2f}" for v in worst) + " |")
    at = np.array([0.1, 0.3, 1.0, 3.0, 6.0, 10.0])
    print("\n| loop | " + " | ".join(f"{w:g} rad/s" for w in at) + " |\n|---" + "|---" * len(at) + "|")
    for loop in LOOPS:
        got = compare_loop(SimulatedVehicle(), loop, at)
        cells = (f"{g:+.2f} dB, {p:+.1f}°" for g, p in zip(got.gain_db, got.phase_deg, strict=True))
        print(f"| {loop} | " + " | ".join(cells) + " |")


def accuracy() -> None:
    """Deviation after ten seconds, CPU seconds of ten minutes, and the ratio to solve_ivp."""
    from scipy.integrate import solve_ivp

    vehicle = SimulatedVehicle(effects=replace(ALL, delay=False))
    t = 0.5 * np.arange(21)
    commands = np.column_stack(
        [6 * np.sin(1.1 * t), 5 * np.sin(0.7 * t + 1), 0.5 * np.sin(1.9 * t), 20 * np.sin(0.5 * t)]
    )
    inputs = np.zeros((20, INPUTS))
    inputs[:, :4] = commands[:20] * [np.pi / 180, np.pi / 180, 1, -np.pi / 180]
    flown = fly_vehicle(vehicle, commands, period_s=0.5, record_s=0.5).states[-1]
    scale = np.abs(fly_vehicle(vehicle, commands, period_s=0.5, record_s=0.001).states).max(axis=0)
    physics = vehicle.physics().packed()
    for method, tolerance in (("DOP853", 1e-11), ("RK45", 1e-8)):
        x = vehicle.hover()
        began = time.process_time()
        for u in inputs:
            x = solve_ivp(
                lambda _, y, u=u: closed_loop_rates(y, u, physics), (0, 0.5), x, method=method,
                rtol=tolerance, atol=1e-13 if method == "DOP853" else 1e-10,
            ).y[:, -1]  # fmt: skip
        spent = time.process_time() - began
        if method == "DOP853":
            print(f"largest relative deviation after 10 s: {np.abs((flown - x) / scale).max():.1e}")
        began = time.process_time()
        fly_vehicle(vehicle, np.zeros((30_000, 3)), period_s=PERIOD_S, record_s=PERIOD_S)
        ours = time.process_time() - began
        print(
            f"10 min at 1 ms: {ours:.2f} s CPU; {method} at {tolerance:g}: {60 * spent / ours:.0f} times that"
        )


def flight(share: float, command: int, seed: int, axis: int | None = None) -> Flight:
    """Commands and truth of 60 s of one manoeuvre at a share of the firmware's limits.

    Parameters
    ----------
    axis : the only command that moves; None moves all at once.
    """
    time_s = np.arange(3000, dtype=np.float64) * PERIOD_S
    manoeuvre = (STEPS, MULTISINE, PILOT)[command]
    peaks = share * FULL
    u = manoeuvre.command(time_s, (peaks[0], peaks[1], peaks[2]), np.random.default_rng(seed))
    if axis is not None:
        u = np.where(np.arange(u.shape[1]) == axis, u, 0.0)
    return u, dict(fly_vehicle(SimulatedVehicle(), u).series())


def free_run_error(model: Any, data: Dataset) -> float:
    """RMSE of the free run after the samples that start it, m/s."""
    segment = data.segments[0]
    error = model.simulate(segment.u, segment.y[:STARTED]) - segment.y
    return float(np.sqrt(np.mean(error[STARTED:] ** 2)))


def table_flights(share: float, first_seed: int) -> list[Flight]:
    """Steps, two multisines and a simulated pilot: the four flights of the table."""
    return [flight(share, command, first_seed + k) for k, command in enumerate((0, 1, 1, 2))]


def linear_floor(flights: Sequence[Flight], column: int, output: str) -> tuple[float, float]:
    """RMSE on the fourth flight, and that flight's spread, m/s.

    Of a model trained on the first two, its order chosen on the third.
    """
    us = [u[:, column] for u, _ in flights]
    ys = [y[output] for _, y in flights]
    train, check, test = (
        Dataset.from_arrays(us[a:b], ys[a:b], PERIOD_S) for a, b in ((0, 2), (2, 3), (3, 4))
    )
    models = [flysid.ARX(n, n, 3, refine=True).fit(train, check) for n in (1, 2, 3, 4)]
    best = min(models, key=lambda m: free_run_error(m, check))
    return free_run_error(best, test), float(np.std(test.segments[0].y[STARTED:]))


def floor() -> None:
    """Of every loop, at every size of the commands."""
    print(
        "| loop | " + " | ".join(f"{100 * s:g} %" for s in SHARES) + " |\n|---" + "|---" * len(SHARES) + "|"
    )
    rows: dict[str, list[str]] = {loop: [] for loop in LOOPS}
    for share in SHARES:
        flights = table_flights(share, 1)
        for column, (loop, plant) in enumerate(LOOPS.items()):
            rmse, spread = linear_floor(flights, column, plant.output)
            rows[loop].append(f"{1000 * rmse:.3g} ({100 * rmse / spread:.1f} %)")
            print(f"  {loop} {share:g}: {rows[loop][-1]}", file=sys.stderr)
    for loop, cells in rows.items():
        print(f"| {loop} | " + " | ".join(cells) + " |")


PARTS = {"bode": bode, "accuracy": accuracy, "floor": floor}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        print(f"## {part}\n")
        PARTS[part]()
        print()
