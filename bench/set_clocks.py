"""Stations whose clock is set, in made records of known truth: `python -m bench.set_clocks 2000 [SEED]`.

A vehicle sends every 0.02 to 1 s, for a minute at least. Its link delays, holds up for up to 7 s and then
gives all at once, and loses. Half of the clocks are set at some place, by 0.3 to 9.9 s, either way; a fifth
of the records are replays. Found is what is cut within 50 messages of the place.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.common.clock import IntArray, UtcFit, settings

NEAR = 50
START_NS = 1_700_000_000 * 10**9


@dataclass(frozen=True)
class Record:
    """Vehicle time, arrivals; where the clock was set (-1: nowhere), by how much; UTC per vehicle second."""

    vehicle_ns: IntArray
    utc_ns: IntArray
    at: int
    set_s: float
    rate: float

    @property
    def kind(self) -> str:
        """How its clock was set."""
        if self.at < 0:
            return "not set"
        way = "ahead" if self.set_s > 0 else "back"
        return f"{way} by less than 1 s" if abs(self.set_s) < 1.0 else f"{way} by 1 s or more"


def make_record(rng: np.random.Generator) -> Record:
    """One record."""
    step_s = float(rng.choice([0.02, 0.1, 0.25, 1.0]))
    count = max(int(rng.choice([300, 1000, 5000, 20_000])), int(60 / step_s))
    rate = 1.0 if rng.random() < 0.8 else float(rng.uniform(1 / 27, 1.0))
    lost = np.where(rng.random(count) < 0.05, rng.integers(1, 20, count), 1)
    vehicle_s = np.cumsum(step_s * lost)
    drift = rng.normal(0.0, 50e-6) if rate == 1.0 else 0.0
    sent_s = vehicle_s * rate * (1.0 + drift)
    delay_s = rng.exponential(rng.choice([0.002, 0.02, 0.1, 0.3]), count)
    for _ in range(rng.integers(0, 5)):
        first = rng.uniform(0.0, sent_s[-1])
        held = rng.uniform(0.2, 7.0)
        late = (sent_s >= first) & (sent_s < first + held)
        delay_s[late] = np.maximum(delay_s[late], first + held - sent_s[late])
    utc_s = np.maximum.accumulate(sent_s + delay_s)
    at = -1
    set_s = 0.0
    if rng.random() < 0.5:
        at = int(rng.integers(count // 10, count - count // 10))
        set_s = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.3), np.log(9.9))))
        utc_s[at:] += set_s
    return Record(
        (vehicle_s * 1e9).astype(np.int64), START_NS + (utc_s * 1e9).astype(np.int64), at, set_s, rate
    )


def map_error(record: Record) -> float:
    """Seconds by which the map is off at most, over the longer part of the record."""
    fit = UtcFit()
    fit.add(0, record.vehicle_ns, record.utc_ns)
    (clock,) = fit.clocks()
    is_late = 0 <= record.at <= len(record.vehicle_ns) / 2
    part = slice(max(record.at, 0), None) if is_late or record.at < 0 else slice(0, record.at)
    true_ns = START_NS + record.rate * record.vehicle_ns + (record.set_s * 1e9 if is_late else 0.0)
    assert clock.utc_offset_ns is not None
    off_ns = clock.utc_offset_ns + clock.slope * record.vehicle_ns - true_ns
    return float(np.abs(off_ns[part]).max()) / 1e9


def main() -> None:
    """Print what was found of each kind, and how far the maps are off."""
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    counts: dict[str, Counter[str]] = {}
    errors: dict[str, list[float]] = {}
    for _ in range(int(sys.argv[1])):
        record = make_record(rng)
        found = settings(record.vehicle_ns, record.utc_ns)
        near = record.at >= 0 and bool((np.abs(found - record.at) <= NEAR).any())
        what = "found" if near else "cut elsewhere" if len(found) else "not cut"
        counts.setdefault(record.kind, Counter())[what] += 1
        errors.setdefault(record.kind, []).append(map_error(record))
    for kind in sorted(counts):
        middle, high = np.quantile(errors[kind], [0.5, 0.9])
        told = ", ".join(f"{count} {what}" for what, count in sorted(counts[kind].items()))
        print(
            f"{kind}: {counts[kind].total()}: {told}; map off by {middle:.3f} s (median), {high:.3f} s (90 %)"
        )


if __name__ == "__main__":
    main()
