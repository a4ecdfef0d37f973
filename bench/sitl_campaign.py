"""Loops of Betaflight's own firmware, predicted from one flight and flown.

    python -m bench.sitl_campaign OUT [--vehicles 20] [--sets 5]

Every vehicle (inertia, motors' lag and gyro noise drawn, unknown to the fit) flies the firmware's own gains
first. From that flight's plant the response from setpoint to rate is predicted under other sets of gains,
which are then flown. The firmware runs on wall time, and the campaign resumes: flights in OUT are kept.

Printed: the share of lines between 1 and 30 Hz, as far as both flights know them, within 2 dB and 10 deg, for
the prediction and for "nothing changed". The loop of the firmware runs at the pace that the machine allows,
and the law takes the pace of the flight that it predicts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.sitl import Vehicle, fly
from flysid.errors import DataError
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.workers import Bounds
from flysid.loops.betaflight import betaflight
from flysid.loops.blackbox_loops import record_of, settings_of
from flysid.loops.controller import Controller
from flysid.loops.margins import least_off, trusted_band
from flysid.loops.stick_response import ComplexArray, Loop

SETS: Sequence[Sequence[str]] = (
    (),
    ("set p_roll = 60", "set p_pitch = 62"),
    ("set d_roll = 45", "set d_pitch = 50", "set d_max_roll = 55", "set d_max_pitch = 60"),
    ("set p_roll = 34", "set i_roll = 110", "set p_pitch = 36", "set i_pitch = 110"),
    ("set dterm_lpf1_dyn_min_hz = 0", "set dterm_lpf1_static_hz = 50", "set p_roll = 55", "set p_pitch = 57"),
)
REFERENCE_S, OTHER_S = 60.0, 40.0
WITHIN_DB, WITHIN_DEG = 2.0, 10.0
FROM_HZ, TO_HZ = 1.0, 30.0
STICKS = 180.0
"""us of the steps of the sticks."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What one flight shows of an axis: Hz, the plant there, and the law that flew."""

    f: npt.NDArray[np.float64]
    plant: ComplexArray
    law: Controller

    def response(self, f: npt.NDArray[np.float64], law: Controller) -> ComplexArray:
        """From setpoint to rate under a law."""
        g = np.interp(f, self.f, np.log(np.abs(self.plant))) + 1j * np.interp(
            f, self.f, np.unwrap(np.angle(self.plant))
        )
        own = np.exp(g)
        return np.asarray(own * law.reference(f) / (1.0 + own * law.feedback(f)))


def drawn(seed: int) -> Vehicle:
    """A vehicle: mass, inertia, lag, noise and battery of its own.

    Inertia is 0.6 to 1.6 of the usual one, mass 0.85 to 1.2; the motors' lag 15 to 60 ms; noise up to twice,
    and half. In a minute the battery costs up to a tenth of the thrust.
    """
    rng = np.random.default_rng(seed)
    usual = Vehicle()
    size = rng.uniform(0.6, 1.6)
    inertia = tuple(size * rng.uniform(0.95, 1.05) * own for own in usual.inertia)
    noise = usual.noise * 2.0 ** rng.uniform(-1.0, 1.0)
    return Vehicle(
        mass=usual.mass * rng.uniform(0.85, 1.2),
        inertia=(inertia[0], inertia[1], inertia[2]),
        lag_s=rng.uniform(0.015, 0.06),
        noise=noise,
        battery=rng.uniform(0.0, 0.1),
    )


def seen(log: Any, axis: str) -> Seen:
    """The plant of a flight where its sticks tell it, and its law."""
    settings = settings_of(log)
    record, conditions = record_of(log, axis, settings)
    loop = Loop.of([record])
    low, high = trusted_band(loop)
    at = (loop.f >= low) & (loop.f <= high)
    centre, _, _ = least_off(loop, at)
    return Seen(loop.f[at], centre, betaflight(settings, axis, conditions))


def compare(reference: Seen, later: Seen) -> dict[str, float]:
    """Shares of lines inside the bounds: of the prediction, and of the reference's own response."""
    low = max(FROM_HZ, reference.f[0], later.f[0])
    high = min(TO_HZ, reference.f[-1], later.f[-1])
    f = later.f[(later.f >= low) & (later.f <= high)]
    true = later.response(f, later.law)
    found = {"lines": float(len(f)), "to_hz": float(high)}
    for name, law in (("predicted", later.law), ("unchanged", reference.law)):
        off = reference.response(f, law) / true
        inside = (np.abs(20.0 * np.log10(np.abs(off))) <= WITHIN_DB) & (
            np.abs(np.degrees(np.angle(off))) <= WITHIN_DEG
        )
        found[name] = float(inside.mean())
    return found


def read(path: Path, folder: Path) -> Any:
    """A log as flysid reads it."""
    if not (folder / "data").is_dir():
        list(ingest_logs(find_logs([path], Bounds()), folder / "data", bounds=Bounds()))
    (log,) = open_lake(folder / "data").logs
    return log


def main() -> None:
    """Fly what is not flown yet, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--sets", type=int, default=len(SETS))
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for seed in range(options.vehicles):
        flights = []
        for k, settings in enumerate(SETS[: options.sets]):
            folder = options.out / f"vehicle-{seed:02d}" / f"set-{k}"
            known = sorted(folder.glob("LOG*.BF"))
            seconds = OTHER_S if k else REFERENCE_S
            path = known[-1] if known else fly(folder, seconds, 100 * seed + k, settings, drawn(seed), STICKS)
            flights.append(read(path, folder))
        for axis in ("roll", "pitch"):
            for k, other in enumerate(flights[1:], 1):
                row: dict[str, Any] = {"vehicle": seed, "axis": axis, "set": k}
                try:
                    row |= compare(seen(flights[0], axis), seen(other, axis))
                    rows.append(row)
                except DataError as error:
                    row["refused"] = error.message
                print(json.dumps(row), flush=True)
    lines = sum(float(row["lines"]) for row in rows)
    for name in ("predicted", "unchanged"):
        share = sum(float(row["lines"]) * float(row[name]) for row in rows) / max(lines, 1.0)
        print(
            f"{name}: {100.0 * share:.0f} % of {lines:.0f} lines within {WITHIN_DB} dB and {WITHIN_DEG} deg"
        )


if __name__ == "__main__":
    main()
