"""Logs reviewed: every section computed, each guarded so that none takes the others down."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from flysid.errors import FormatError, UsageError
from flysid.extras import Extra, Missing, extra
from flysid.ingest.lake.crash import end_at_crash
from flysid.progress import tell
from flysid.reviews.evidence import evidence
from flysid.reviews.fact import Section
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.reviewed import NO_TIMELINE, Review
from flysid.reviews.sections import SECTIONS, section_of


def review(path: str | Path, page: str | Path | None = None) -> Review:
    """Review one log: does the vehicle fly well, and what should be changed?

    Parameters
    ----------
    path : a log of any format that flysid reads.
    page : write the page to this file, too.

    Raises
    ------
    UsageError : there is no such file, or it is a folder or archive of several flights.
    FormatError : nothing of it can be read.
    StoreError : the page cannot be written.

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
        logs = open_lake(place).logs
        if len(logs) != 1:
            raise UsageError(f"it holds {len(logs)} flights", path=path, hint=f"flysid review {path}")
        (stored,) = logs
        flight = LoggedFlight(stored, stored.manifest.damage, stored.manifest.source.name)
        found = review_flight(flight, with_evidence=page is not None)
    if page is not None:
        from flysid.reviews.page import write_review

        write_review(page, [found])
    return found


def review_flight(flight: LoggedFlight, *, with_evidence: bool = False) -> Review:
    """All sections of one flight; what breaks in one of them leaves the others as they are.

    Parameters
    ----------
    with_evidence : read the fields behind the figures over time, too: a page shows them.
    """
    sections = []
    broken = Missing()
    timeline = NO_TIMELINE
    with broken.gathering():
        flight = extra(Extra.REVIEWED, partial(end_at_crash, flight), None, of="crash") or flight
        for i, key in enumerate(SECTIONS):
            tell(f"reviewing: {key}", log=flight.name, share=i / len(SECTIONS))
            made = extra(Extra.REVIEWED, partial(_review, key, flight), None, of=key)
            if made is not None:
                sections.append(made)
        facts = [fact for section in sections for fact in section.facts]
        if with_evidence:
            timeline = extra(Extra.REVIEW_PICTURE, partial(evidence, flight, facts), timeline, of="evidence")
        flight.forget()
    return Review(
        flight.name,
        flight.info,
        flight.clock,
        tuple(sections),
        tuple(broken.sentences),
        flight.whole_parameters,
        timeline,
    )


def _review(key: str, flight: LoggedFlight) -> Section:
    return section_of(key)(flight)
