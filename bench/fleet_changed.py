"""`python -m bench.fleet_changed SEEDS [--wind 0,2]`: which changed vehicles `flysid fleet changed` finds.

For each seed and wind 100 simulated vehicles fly 4 flights of 40 s; five have changed from the third flight
on. Then the same fleet is judged without changes: the ten flights that differ are flown again. Flights
stay in memory, as the tables that the ULog reader makes of their logs (a test holds them equal), and go
through the same alignment, triangles and tests as ingested ones.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from flysid.fleet.models.changed import compare_parts
from flysid.fleet.models.common_grid import Sampling, choose_sampling, spread
from flysid.fleet.models.differences import FlightPart, JudgedChannel
from flysid.fleet.models.gather import PILOTS
from flysid.fleet.models.triangles import triangle_of
from flysid.flight import BOOT, TIME, Flight, Source
from flysid.ingest.align.align import align, segments_of
from flysid.ingest.align.recipe import Recipe, load_recipe
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.synth.synth import Change, Order, flight_names, fly_one
from flysid.ingest.synth.telemetry import Recording
from flysid.ingest.synth.writers import ulog
from flysid.model.threads import on_one_thread

CHANGES = (
    Change(10, 3, "drag", 0.6),
    Change(30, 3, "drag", 1.6),
    Change(50, 3, "lag", 2.5),
    Change(70, 3, "mass", 1.25),
    Change(90, 3, "thrust", 0.8),
)
CHANNELS = {"px4-velocity": ("v_x", "v_y", "v_z"), "px4-effort": ("throttle_climb", "pitch_torque")}
STEP_S = 0.004
RATE = 0.05


def flight_of(recording: Recording) -> FlightLog:
    """A recording as the reader of its ULog would give it."""
    tables = {name: table_of(rows) for name, rows in ulog.topics(recording).items()}
    source = Source(recording.name, "ulog", 0, "")
    return FlightLog(Flight(source, tables, info=ulog.facts(recording)), recording.name)


def table_of(rows: np.ndarray) -> pa.Table:
    """A topic's rows as a table; arrays are lists of fixed size."""
    columns: dict[str, pa.Array] = {
        TIME: pa.array(rows["timestamp"].astype(np.int64) * 1000),
        BOOT: pa.array(np.zeros(len(rows), dtype=np.int32)),
    }
    for name in rows.dtype.names or ():
        values = np.ascontiguousarray(rows[name])
        flat = pa.array(values.ravel())
        columns[name] = flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return pa.table(columns)


@dataclass(frozen=True)
class Fleet:
    """Flights of one seed and wind, and those flown again without the changes, by number."""

    flights: list[FlightLog]
    unchanged: Mapping[int, FlightLog]
    systems: list[int]
    starts: list[int]


def fly_fleet(order: Order) -> Fleet:
    """All flights of an order, and again those that its changes are in."""
    recordings = [fly_one(order, i) for i in range(len(flight_names(order)))]
    each = len(recordings) // order.fleet
    plain = replace(order, changes=())
    again = [
        (change.vehicle - 1) * each + i for change in order.changes for i in range(change.flight - 1, each)
    ]
    return Fleet(
        [flight_of(r) for r in recordings],
        {i: flight_of(fly_one(plain, i)) for i in again},
        [r.system for r in recordings],
        [r.boot_utc_ns for r in recordings],
    )


@on_one_thread
def parts_of(
    fleet: Fleet, recipe: Recipe, channel: str
) -> tuple[Sampling, list[FlightPart], list[FlightPart]]:
    """The channel's grid, and its parts with the changes and without."""
    pilots = spread([str(i) for i in range(len(fleet.flights))], PILOTS)
    sampling = choose_sampling(align([fleet.flights[int(i)] for i in pilots], recipe, channel).dataset)

    def part(i: int, log: FlightLog) -> FlightPart:
        _, segments = segments_of(log, recipe, channel, sampling.dt_s)
        triangle = triangle_of(segments, sampling)
        return FlightPart(log.name, f"v{fleet.systems[i]:03d}", "", fleet.starts[i], triangle)

    parts = [part(i, log) for i, log in enumerate(fleet.flights)]
    without = [part(i, fleet.unchanged[i]) if i in fleet.unchanged else p for i, p in enumerate(parts)]
    return sampling, parts, without


def flags(judged: Sequence[JudgedChannel]) -> dict[str, list[str]]:
    """Flagged vehicle -> what was flagged."""
    found: dict[str, list[str]] = {}
    for test in (t for j in judged for t in j.tests if t.flagged):
        found.setdefault(test.vehicle, []).append(f"{test.channel} {test.question} p {test.p:.1g}")
    return found


def main() -> None:
    """Print one line for each fleet and recipe, and the totals."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("seeds", help="e.g. 11,12 or 11-20")
    parser.add_argument("--wind", default="0,2", help="m/s")
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--plan", default="routine")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    seeds = range(int(first), int(last) + 1) if last else [int(s) for s in options.seeds.split(",")]
    for wind in (float(w) for w in options.wind.split(",")):
        found: Counter[str] = Counter()
        total: Counter[str] = Counter()
        for seed in seeds:
            one(seed, wind, options.vehicles, options.plan, found, total)
        print(f"\n## wind {wind:g} m/s, {len(seeds)} seeds\n")
        for name in found | total:
            print(f"{name}: {found[name]}{f' of {total[name]}' if total[name] else ''}")
        print(flush=True)


def one(seed: int, wind: float, vehicles: int, plan: str, found: Counter[str], total: Counter[str]) -> None:
    """One fleet, with its changes and without; counts go into `found` and `total`."""
    began = time.process_time()
    changes = tuple(c for c in CHANGES if c.vehicle <= vehicles)
    order = Order("ardrone", plan, 40.0, seed=seed, sensor="autopilot", wind_m_s=wind, fleet=vehicles,
                  changes=changes, step_s=STEP_S)  # fmt: skip
    fleet = fly_fleet(order)
    names = {f"v{c.vehicle:03d}": c for c in changes}
    for name, channels in CHANNELS.items():
        recipe = load_recipe(name)
        made = {channel: parts_of(fleet, recipe, channel) for channel in channels}
        samplings = {channel: sampling for channel, (sampling, _, _) in made.items()}
        judged, skipped = compare_parts(recipe, samplings, {c: m[1] for c, m in made.items()}, RATE)
        nothing, _ = compare_parts(recipe, samplings, {c: m[2] for c, m in made.items()}, RATE)
        with_changes = flags(judged)
        without = flags(nothing)
        for vehicle, change in names.items():
            label = f"{name}: {change.name} x{change.factor:g} found"
            total[label] += 1
            found[label] += vehicle in with_changes
        false = {v: why for v, why in with_changes.items() if v not in names}
        tests = [t for j in judged for t in j.tests if t.flagged]
        found[f"{name}: flags"] += len(tests)
        found[f"{name}: false flags"] += sum(t.vehicle not in names for t in tests)
        total[f"{name}: fleets without change, none flagged"] += 1
        found[f"{name}: fleets without change, none flagged"] += not without
        print(f"seed {seed} wind {wind:g} {name}: found {sorted(v for v in with_changes if v in names)}; "
              f"false {false}; without change {without}; skipped {skipped}", flush=True)  # fmt: skip
    print(f"  {time.process_time() - began:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    main()
