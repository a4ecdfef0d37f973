"""What a log under review keeps in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flysid
from flysid.flight import split_address
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.timeline import Trace
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.review import review_flight

SAMPLE = Path(__file__).parents[3] / "sample_logs" / "01-multisine-seed1.tlog"


def test_columns_of_a_stream_share_their_times() -> None:
    flight = LoggedFlight(FlightLog(flysid.read(SAMPLE)))
    roll, pitch = (flight.column(f"ATTITUDE.{name}", unit="deg") for name in ("roll", "pitch"))
    assert roll is not None
    assert pitch is not None
    assert np.shares_memory(roll.time_s, pitch.time_s)


def test_a_review_keeps_no_column() -> None:
    """A series holds its flights until all are compared: ten of them held 974 MB."""
    flight = LoggedFlight(FlightLog(flysid.read(SAMPLE)))
    found = review_flight(flight, with_evidence=True)
    assert found.timeline.panels
    assert not flight.read


def test_traces_of_a_stream_share_their_times() -> None:
    """Of a blackbox log of 10 MB the times of sixteen fields of one stream took 57 MB."""
    flight = LoggedFlight(FlightLog(flysid.read(SAMPLE)))
    found = review_flight(flight, with_evidence=True)
    streams: dict[str, list[Trace]] = {}
    for trace in (trace for panel in found.timeline.panels for trace in panel):
        streams.setdefault(split_address(trace.name)[0], []).append(trace)
    assert max(map(len, streams.values())) > 1
    assert all(trace.time_s is of_one[0].time_s for of_one in streams.values() for trace in of_one)
