"""Margins of simulated loops against the truth.

`python -m bench.gain_margins [FLIGHTS] [FIRMWARE] [OUTER] [FIRST] [law] [still]`

Every flight has a vehicle of its own and lasts one to three minutes. How often the truth lies in the 95 %
interval, and how often a figure was stated at all. FIRMWARE is betaflight (a record of 500 Hz), px4 or
ardupilot (logs of 100 Hz as they keep them, parameters read from the log); OUTER, 1/s, closes an angle loop
around the rate loop of the last two. FIRST is the first seed. The truth of the
last two is that of the controller as it is simulated, in steps of a millisecond; with `law` that of the
continuous law. With `still` the flights of betaflight meet no gusts, and their gyro has a hundredth of the
noise.
"At least" counts figures of which a lower end alone is stated, and how often the truth exceeds it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.judged import judge
from flysid.loops.margins import Margins, margins
from flysid.loops.stick_response import ComplexArray, Loop
from tests.flysid.loops.autopilots import ARDUPILOT, PX4, STEP_S, ardupilot_log, px4_log
from tests.flysid.loops.simulated import PID, Vehicle, fly, truth
from tests.flysid.loops.test_autopilots import LAWS

STILL = {"disturbance": 0.0, "noise": 0.02}
Found = tuple[Margins | None, dict[str, float]]


def betaflight_flight(air: Mapping[str, float]) -> Callable[[int, float], Found]:
    """Vehicles of gain 45 to 100, lag 12 to 30 ms, delay 2 to 6 ms."""

    def flown(seed: int, _outer: float) -> Found:
        rng = np.random.default_rng(10_000 + seed)
        vehicle = Vehicle(rng.uniform(45, 100), rng.uniform(0.012, 0.03), int(rng.integers(4, 13)))
        record = fly(vehicle, PID, rng.uniform(60.0, 180.0), seed, **air)
        try:
            return margins(Loop.of([record]), PID), truth(vehicle, PID)
        except DataError:
            return None, {}

    return flown


@dataclass(frozen=True)
class Sampled:
    """The vehicle as it is simulated, step by step of a millisecond (`tests.flysid.loops.autopilots`)."""

    vehicle: Vehicle

    def response(self, f: FloatArray) -> ComplexArray:
        """(F,) from the controller's output to the rate."""
        v = self.vehicle
        back = np.exp(-2j * np.pi * f * STEP_S)
        whole = (1.0 - (1.0 - STEP_S / v.lag_s) * back) * (1.0 - back)
        return np.asarray(v.gain * STEP_S**2 / v.lag_s * back ** (1 + v.delay_steps // 2) / whole)


@dataclass(frozen=True)
class Flown:
    """The controller as it is simulated, step by step."""

    firmware: str

    def feedback(self, f: FloatArray) -> ComplexArray:
        """(F,) from the rate to the output, sign turned."""
        back = np.exp(-2j * np.pi * f * STEP_S)
        unit = np.pi / 180.0 * 1000.0
        slope = (1.0 - back) / STEP_S
        g, cut = (PX4, 30.0) if self.firmware == "px4" else (ARDUPILOT, ARDUPILOT["FLTD"])
        keep = np.exp(-2.0 * np.pi * cut * STEP_S)
        filtered = (1.0 - keep) / (1.0 - keep * back)
        return np.asarray(unit * (g["P"] + g["I"] * STEP_S / (1.0 - back) + g["D"] * slope * filtered))


def autopilot_flight(firmware: str, continuous: bool) -> Callable[[int, float], Found]:
    """Vehicles of gain 8 to 15, lag 25 to 50 ms, delay 2 to 6 ms, judged from their logs."""
    log = px4_log if firmware == "px4" else ardupilot_log
    controller = LAWS[firmware][1] if continuous else Flown(firmware)

    def flown(seed: int, outer: float) -> Found:
        rng = np.random.default_rng(20_000 + seed)
        vehicle = Vehicle(rng.uniform(8, 15), rng.uniform(0.025, 0.05), 2 * int(rng.integers(2, 7)))
        record = log(rng.uniform(60.0, 180.0), 30_000 + seed, vehicle=vehicle, outer=outer)
        return judge([record], ["roll"])[0].margins, truth(Sampled(vehicle), controller)

    return flown


def main(arguments: list[str]) -> int:
    """Print the shares."""
    count = int(arguments[0]) if arguments else 200
    firmware = arguments[1] if len(arguments) > 1 else "betaflight"
    outer = float(arguments[2]) if len(arguments) > 2 else 0.0
    first = int(arguments[3]) if len(arguments) > 3 else 0
    flown = (
        betaflight_flight(STILL if "still" in arguments else {})
        if firmware == "betaflight"
        else autopilot_flight(firmware, "law" in arguments)
    )
    held: dict[str, list[bool]] = {}
    least: dict[str, list[bool]] = {}
    errors: dict[str, list[tuple[float, float]]] = {}
    refused = 0
    for seed in range(first, first + count):
        found, true = flown(seed, outer)
        refused += found is None
        for name, value in true.items() if found is not None else ():
            figure = getattr(found, name)
            if figure.value is not None:
                held.setdefault(name, []).append(figure.low <= value <= figure.high)
                errors.setdefault(name, []).append((figure.value - value, (figure.high - figure.low) / 3.92))
            elif np.isfinite(figure.low):
                least.setdefault(name, []).append(figure.low <= value)
    print(f"{firmware}, outer loop {outer:g} 1/s: {count} flights, {refused} refused")
    for name, rows in held.items():
        away, width = np.array(errors[name]).T
        told = f"median error {np.median(away):+.3g}, 95 % within {np.quantile(np.abs(away), 0.95):.3g}"
        told += f", scatter {np.sqrt(np.mean((away / width) ** 2)):.2f} of what is stated"
        print(f"  {name:14s} stated {len(rows)}, truth inside {100.0 * np.mean(rows):.1f} %; {told}")
    for name, rows in least.items():
        print(f"  {name:14s} at least, {len(rows)}: truth above {100.0 * np.mean(rows):.1f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
