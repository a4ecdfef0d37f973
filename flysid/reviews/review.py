"""Logs reviewed: every section computed, each guarded so that none takes the others down."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from flysid.errors import FormatError
from flysid.extras import Extra, Missing, extra
from flysid.progress import tell
from flysid.reviews.crash import end_at_crash
from flysid.reviews.fact import Section
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.reviewed import Review
from flysid.reviews.sections import SECTIONS, section_of


def review(path: str | Path) -> Review:
    """Review one log: does the vehicle fly well, and what should be changed?

    Parameters
    ----------
    path : a log of any format that flysid reads.

    Raises
    ------
    UsageError, FormatError : there is no such file, or nothing of it can be read.

    Examples
    --------
    >>> found = flysid.review("sample_logs/01-multisine-seed1.tlog")
    >>> found.to_dict()["log"]
    '01-multisine-seed1.tlog'
    """
    from flysid.ingest.lake.batch import ingest_logs
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.ingest.lake.workers import Bounds

    with TemporaryDirectory() as folder:
        place = Path(folder) / "data"
        results = list(ingest_logs(find_logs([Path(path)], Bounds()), place, bounds=Bounds()))
        if results[0].skipped:
            raise FormatError(results[0].reason, path=results[0].path)
        (stored,) = open_lake(place).logs
        return review_flight(LoggedFlight(stored, stored.manifest.damage, stored.manifest.source.name))


def review_flight(flight: LoggedFlight) -> Review:
    """All sections of one flight; what breaks in one of them leaves the others as they are."""
    sections = []
    broken = Missing()
    with broken.gathering():
        flight = extra(Extra.REVIEWED, partial(end_at_crash, flight), None, of="crash") or flight
        for i, key in enumerate(SECTIONS):
            tell(f"reviewing: {key}", log=flight.name, share=i / len(SECTIONS))
            made = extra(Extra.REVIEWED, partial(_review, key, flight), None, of=key)
            if made is not None:
                sections.append(made)
    return Review(
        flight.name, flight.info, flight.clock, flight.air_s, tuple(sections), tuple(broken.sentences)
    )


def _review(key: str, flight: LoggedFlight) -> Section:
    return section_of(key)(flight)
