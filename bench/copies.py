"""The search for copies of training flights: CPU seconds, memory, what is found, by the number of flights.

    python -m bench.copies [FLIGHTS...] [--samples 300] [--long N]

A first-order plant under steps, gusts of 8 % of the output's spread, noise of 3 %; every fourth flight is
held out. Once without a copy, so that all pairs are looked at, and once with a copy of the last third of
the last flight, half a sample later. `--long` adds a training flight of that many samples.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

import numpy as np

from flysid.copies import find_copy
from flysid.dataset import Segment
from flysid.filters import filtered

DT_S = 0.04
EVERY = 4


def main() -> int:
    """Each number of flights in a process of its own; ends with 1 where a copy is lost or invented."""
    parser = argparse.ArgumentParser(prog="python -m bench.copies")
    parser.add_argument("flights", nargs="*", type=int, default=[100, 1_000, 10_000])
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--long", type=int, default=0)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        inside(options.flights[0], options.samples, options.long)
        return 0
    right = True
    for count in options.flights:
        words = ["--samples", str(options.samples), "--long", str(options.long), "--inside"]
        command = [sys.executable, "-m", "bench.copies", str(count), *words]
        answer = subprocess.run(command, check=True, capture_output=True, text=True)
        found = json.loads(answer.stdout)
        right &= found["none"] is None and found["copy"] == ["copy", str(count - 1)]
        print(
            f"{count:6,} flights: {found['cpu_s']:7.1f} s of CPU, {found['peak_mb']:5.0f} MB "
            f"({found['data_mb']:.0f} MB before the search), without a copy {found['none']}, "
            f"with one {found['copy']} after {found['copy_s']:.1f} s",
            flush=True,
        )
    return 0 if right else 1


def inside(count: int, samples: int, long: int) -> None:
    """Measure one number of flights."""
    rng = np.random.default_rng(17)
    flights = [flight(rng, samples, str(k)) for k in range(count)]
    held, train = flights[::EVERY], [f for k, f in enumerate(flights) if k % EVERY]
    if long:
        train.append(flight(rng, long, "long"))
    whole = train[-2:] if long else train[-1:]
    last = whole[0]
    third = slice(len(last.y) - len(last.y) // 3, len(last.y))
    u, y = last.u[third], last.y[third]
    copy = Segment(u[:-1], (y[:-1] + y[1:]) / 2.0, flight="copy")
    find_copy(train[:1], held[:1], DT_S)  # compiled
    before_mb = peak_mb()
    at = time.process_time()
    none = find_copy(train, held, DT_S)
    spent = time.process_time() - at
    peak = peak_mb()
    at = time.process_time()
    found = find_copy(train, [*held, copy], DT_S)
    answer = {
        "cpu_s": spent,
        "peak_mb": peak,
        "data_mb": before_mb,
        "none": none and [none.held_out, none.training],
        "copy": found and [found.held_out, found.training],
        "copy_s": time.process_time() - at,
    }
    print(json.dumps(answer))


def flight(rng: np.random.Generator, samples: int, name: str) -> Segment:
    """Steps of eight samples through a first-order plant, correlated gusts, white noise."""
    u = np.repeat(rng.normal(size=samples // 8 + 1), 8)[:samples]
    y = filtered(np.array([0.0, 0.1]), np.array([1.0, -0.9]), u)
    gusts = filtered(np.array([np.sqrt(1.0 - 0.95**2)]), np.array([1.0, -0.95]), rng.normal(size=samples))
    y = y + np.std(y) * (0.08 * gusts + 0.03 * rng.normal(size=samples))
    return Segment(u[:, None], y[:, None], flight=name)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    sys.exit(main())
