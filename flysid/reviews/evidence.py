"""What facts were computed from, over time: the curves of a page."""

from __future__ import annotations

from collections.abc import Iterable

from flysid.ingest.lake.timeline import Timeline, Trace, happenings, with_gaps
from flysid.reviews.fact import Fact
from flysid.reviews.logged import Column, LoggedFlight


def evidence(flight: LoggedFlight, facts: Iterable[Fact]) -> Timeline:
    """The fields of facts, in their order: those of one fact and unit share a panel."""
    panels: list[tuple[Trace, ...]] = []
    drawn: set[str] = set()
    for fact in facts:
        new = [flight.read[a] for a in fact.fields if a in flight.read and a not in drawn]
        units = dict.fromkeys(column.unit for column in new)
        panels += [tuple(_trace(column) for column in new if column.unit == unit) for unit in units]
        drawn |= set(fact.fields)
    seen = happenings(flight.log, flight.clock.offsets_s, flight.duration_s)
    return Timeline(flight.name, tuple(panels), *seen, flight.clock.words)


def _trace(column: Column) -> Trace:
    time_s, values = with_gaps(column.time_s, column.values)
    return Trace(column.address, column.unit, time_s, values)
