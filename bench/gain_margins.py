"""Margins of simulated loops against the truth: `python -m bench.gain_margins [FLIGHTS]`.

Every flight has a vehicle of its own (gain 45 to 100, lag 12 to 30 ms, delay 2 to 6 ms) and lasts one to
three minutes. How often the truth lies in the 95 % interval, and how often a figure was stated at all.
"""

from __future__ import annotations

import sys

import numpy as np

from flysid.errors import DataError
from flysid.loops.margins import margins
from flysid.loops.stick_response import Loop
from tests.flysid.loops.simulated import PID, Vehicle, fly, truth


def main(arguments: list[str]) -> int:
    """Print the shares."""
    count = int(arguments[0]) if arguments else 200
    held: dict[str, list[bool]] = {}
    errors: dict[str, list[float]] = {}
    refused = 0
    for seed in range(count):
        rng = np.random.default_rng(10_000 + seed)
        vehicle = Vehicle(rng.uniform(45, 100), rng.uniform(0.012, 0.03), int(rng.integers(4, 13)))
        record = fly(vehicle, PID, rng.uniform(60.0, 180.0), seed)
        try:
            found = margins(Loop.of([record]), PID)
        except DataError:
            refused += 1
            continue
        for name, value in truth(vehicle, PID).items():
            figure = getattr(found, name)
            if figure.value is not None:
                held.setdefault(name, []).append(figure.low <= value <= figure.high)
                errors.setdefault(name, []).append(figure.value - value)
    print(f"{count} flights, {refused} refused")
    for name, rows in held.items():
        away = np.array(errors[name])
        told = f"median error {np.median(away):+.3g}, 95 % within {np.quantile(np.abs(away), 0.95):.3g}"
        print(f"  {name:14s} stated {len(rows)}, truth inside {100.0 * np.mean(rows):.1f} %; {told}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
