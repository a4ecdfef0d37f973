"""Reviews of logs that lack streams, are thin or cut, and hold sentinels: none breaks or states nonsense."""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pyarrow as pa

from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import Flight as Flown
from bench.faulty_quadrotor import Quadrotor
from bench.faulty_ulog import ulog_bytes
from bench.review_faults import draw
from flysid.flight import BOOT, TIME, Flight
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import find_format
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.review import review_flight
from flysid.reviews.reviewed import Review

KINDS = ("dataflash", "ulog")
VEHICLES = 8
SENTINELS = (float("nan"), float("inf"), 0.0, -1.0, 65535.0, 4294967.5, 1e30)
KEPT = ("parameters", "PARM", "FMT", "FMTU", "UNIT", "MULT")
"""Streams that are whole: without them a log is of another kind."""


def vehicles(seed: int) -> list[Quadrotor]:
    """With faults and without."""
    return [trial.vehicle for trial in draw(seed, VEHICLES // 2)]


def logged(kind: str, flown: Flown) -> Flight:
    """A simulated flight, as a format holds it."""
    write = dataflash_bytes if kind == "dataflash" else ulog_bytes
    name = "flight.bin" if kind == "dataflash" else "flight.ulg"
    return collect(memoryview(write(flown)), name, find_format(kind), Limits())


def spoil(flight: Flight, rng: random.Random) -> Flight:
    """The same flight with less in it, and wrong values."""
    share = rng.choice([0.0, 0.2, 0.5, 0.9])
    first, last = sorted(rng.uniform(-0.3, 1.3) for _ in range(2))
    clock = flight.clocks[0]
    window = [clock.first_ns + edge * (clock.last_ns - clock.first_ns) for edge in (first, last)]
    tables = {}
    for key, table in flight.tables.items():
        if key in KEPT:
            tables[key] = table
            continue
        if rng.random() < share:
            continue
        times = table[TIME].to_numpy()
        every = rng.choice([1, 1, 1, 3, 20, 500])
        kept = np.flatnonzero((times >= window[0]) & (times <= window[1]))[::every]
        tables[key] = _with_sentinels(table.take(pa.array(kept)), rng)
    return replace(flight, tables=tables)


def _with_sentinels(table: pa.Table, rng: random.Random) -> pa.Table:
    """Some rows of some columns of floats, or a whole column, replaced."""
    for i, field in enumerate(table.schema):
        if field.name in (BOOT, TIME) or not pa.types.is_floating(field.type) or rng.random() > 0.1:
            continue
        values = np.array(table[field.name].to_numpy(), dtype=float)
        wrong = np.array([rng.random() < 0.05 for _ in values], dtype=bool) | (rng.random() < 0.3)
        values[wrong] = rng.choice(SENTINELS)
        with np.errstate(over="ignore"):
            table = table.set_column(i, field, pa.array(values.astype(field.type.to_pandas_dtype())))
    return table


def compare(flight: Flight, rng: random.Random) -> str:
    """What is wrong with the review of a flight that was spoilt; "" where nothing is."""
    spoilt = spoil(flight, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = review_flight(LoggedFlight(FlightLog(spoilt)))
    return "; ".join(nonsense(found))


def nonsense(found: Review) -> Iterator[str]:
    """What a review must not state."""
    yield from found.broken
    document = found.to_dict()
    try:
        json.dumps(document, allow_nan=False)
    except ValueError:
        yield from (f"{key} is no number" for key in _not_finite(document))
    for fact in found.facts:
        if fact.value is None and not fact.missing:
            yield f"{fact.key} has neither a value nor a reason"
        if fact.interval is not None and not fact.interval[0] <= fact.interval[1]:
            yield f"{fact.key} has the interval {fact.interval}"
    for section in found.sections:
        for action in section.actions:
            for change in action.changes:
                if change.old and not 0.5 <= change.new / change.old <= 2.0:
                    yield f"{change.words} is more than a factor of two"
        for finding in section.findings:
            if "nan" in finding.text.split() or "inf" in finding.text.split():
                yield finding.text


def _not_finite(document: Mapping[str, object], at: str = "") -> Iterator[str]:
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _not_finite(value, f"{at}{key}.")
        elif isinstance(value, float) and not np.isfinite(value):
            yield f"{at}{key}"
