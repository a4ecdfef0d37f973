"""What a log under review keeps in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flysid
from flysid.ingest.align.signals import FlightLog
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
