"""The search for copies of training flights: CPU seconds, memory, what is found, by the number of flights.

    python -m bench.copies [FLIGHTS...] [--samples 300] [--long N]
    python -m bench.copies --recall SEED...

A first-order plant under steps, gusts of 8 % of the output's spread, noise of 3 %; every fourth flight is
held out. Once without a copy, so that all pairs are looked at, and once with a copy of the last third of
the last flight, half a sample later. `--long` adds a training flight of that many samples.

`--recall`, for each seed: copies of flights of 300 to 1,500 samples on three plants by 12 recorders, of a
fifth to all of a flight, ten flights and ten copies at a time; how many are found when all pairs are looked
at, how many of these have no stretch in common, and how many pairs of other flights are called copies.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.filters import apply_filter
from flysid.leakage import copies
from flysid.leakage.copies import find_copy
from flysid.leakage.same_flights import same_flights

DT_S = 0.04
EVERY = 4
TOGETHER = 10
PARTS = (0.2, 0.4, 0.6, 1.0)
PLANTS = (
    ((0.0, 0.1), (1.0, -0.9)),
    ((0.0, 0.1, 0.1), (1.0, -1.5, 0.6)),
    ((0.0, 0.004, 0.004), (1.0, -1.9, 0.908)),
)


def main() -> int:
    """Each number of flights in a process of its own; ends with 1 where a copy is lost or invented."""
    parser = argparse.ArgumentParser(prog="python -m bench.copies")
    parser.add_argument("flights", nargs="*", type=int, default=[100, 1_000, 10_000])
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--long", type=int, default=0)
    parser.add_argument("--recall", nargs="+", type=int, default=[], metavar="SEED")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        inside(options.flights[0], options.samples, options.long)
        return 0
    if options.recall:
        lost = [seed for seed in options.recall if not recall(seed)]
        return 1 if lost else 0
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


def recall(seed: int) -> bool:
    """One round over all plants, recorders and parts; false where a copy has no stretch in common."""
    rng = np.random.default_rng(seed)
    tried = judged = shared = others = 0
    for plant in range(len(PLANTS)):
        for record in RECORDERS.values():
            for part in PARTS:
                rows = rng.integers(300, 1501, size=TOGETHER)
                known = [flight(rng, int(n), f"known {k}", plant) for k, n in enumerate(rows)]
                held = [copied(rng, one, record, part) for one in known]
                theta = copies._linear_model([*known, *held])
                grids = [list(copies._on_grids(some, theta, DT_S).values()) for some in (known, held)]
                every, some = ({pair[:2] for pair in same_flights(*grids, every_pair=n)} for n in (10**9, 0))
                right = {(k, k) for k in range(TOGETHER)}
                tried += TOGETHER
                judged += len(every & right)
                shared += len(some & right)
                others += len(every - right)
    print(
        f"seed {seed}: {tried:,} copies, {judged:,} found, {judged - shared} of these without a stretch in "
        f"common, {others} of {tried * (TOGETHER - 1):,} pairs of other flights called copies",
        flush=True,
    )
    return judged == shared


def copied(rng: np.random.Generator, one: Segment, record: Recorder, part: float) -> Segment:
    """A part of a flight, somewhere in it, as another recorder keeps it."""
    rows = round(part * len(one.y))
    first = int(rng.integers(0, len(one.y) - rows + 1))
    u, y = record(one.u[first : first + rows, 0], one.y[first : first + rows, 0])
    return Segment(u[: len(y), None], y[:, None], flight=f"copy of {one.flight}")


Recorder = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def sampled(every: int, later: float = 0.3) -> Recorder:
    """At a lower rate, brought back to the grid."""
    return lambda u, y: (u, np.interp(np.arange(len(y)) + later, np.arange(0, len(y), every), y[::every]))


def rounded(share: float) -> Recorder:
    """To a share of the output's spread."""
    return lambda u, y: (u, np.round(y / (share * np.std(y))) * (share * np.std(y)))


RECORDERS: Mapping[str, Recorder] = {
    "as it is": lambda u, y: (u, y),
    "half a sample later": lambda u, y: (u, (y[:-1] + y[1:]) / 2.0),
    "a third of a sample later": lambda u, y: (u, (2.0 * y[:-1] + y[1:]) / 3.0),
    "half a sample later, inputs too": lambda u, y: ((u[:-1] + u[1:]) / 2.0, (y[:-1] + y[1:]) / 2.0),
    "another zero": lambda u, y: (u + 0.01, y + 0.05 * np.std(y)),
    "two hundredths larger": lambda u, y: (u, 1.02 * y),
    "smoothed": lambda u, y: (u, apply_filter(np.array([0.5]), np.array([1.0, -0.5]), y)),
    "half the rate": sampled(2),
    "a quarter": sampled(4),
    "rounded to a tenth": rounded(0.1),
    "rounded to three tenths": rounded(0.3),
    "a clock 0.1 % off": lambda u, y: (u, np.interp(np.arange(len(y)) * 1.001, np.arange(len(y)), y)),
}


def flight(rng: np.random.Generator, samples: int, name: str, plant: int = 0) -> Segment:
    """Steps of eight samples through a plant, correlated gusts, white noise."""
    u = np.repeat(rng.normal(size=samples // 8 + 1), 8)[:samples]
    b, a = PLANTS[plant]
    y = apply_filter(np.array(b), np.array(a), u)
    gusts = apply_filter(np.array([np.sqrt(1.0 - 0.95**2)]), np.array([1.0, -0.95]), rng.normal(size=samples))
    y = y + np.std(y) * (0.08 * gusts + 0.03 * rng.normal(size=samples))
    return Segment(u[:, None], y[:, None], flight=name)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    sys.exit(main())
