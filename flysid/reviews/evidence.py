"""What facts were computed from, over time: the curves of a page."""

from __future__ import annotations

from collections.abc import Iterable

from flysid.facts.clock import LogClock
from flysid.flight import split_address
from flysid.ingest.lake.timeline import Timeline, Trace, happenings, with_gaps
from flysid.reviews.fact import Fact
from flysid.reviews.logged import Column, LoggedFlight


def evidence(flight: LoggedFlight, facts: Iterable[Fact]) -> Timeline:
    """The fields of facts in their order; those of one stream and unit share a panel."""
    panels: dict[tuple[str, str], list[Trace]] = {}
    for address in dict.fromkeys(address for fact in facts for address in fact.fields):
        column = flight.read.get(address)
        if column is not None:
            panels.setdefault((split_address(address)[0], column.unit), []).append(_trace(column))
    clock: LogClock = flight.clock
    seen = happenings(flight.log, clock.offsets_s, flight.duration_s)
    return Timeline(flight.name, tuple(map(tuple, panels.values())), *seen, clock.words)


def _trace(column: Column) -> Trace:
    time_s, values = with_gaps(column.time_s, column.values)
    return Trace(column.address, column.unit, time_s, values)
