"""A log reviewed: its sections, and what of them stands on the first screen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flysid.errors import FormatError
from flysid.extras import Extra, Missing, extra
from flysid.facts.clock import LogClock
from flysid.progress import tell
from flysid.reviews.fact import Action, Fact, Finding, Grade, Section, order
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.sections import SECTIONS, section_of
from flysid.showing import Shown, Table

FIRST_SCREEN = 3
"""Sentences, and next actions: what a person reads before looking away."""
NOTHING_FOUND = Finding("Nothing in this log can be judged", Grade.WATCH, 0.0, "trust.duration")


@dataclass(frozen=True, eq=False, repr=False)
class Review(Shown):
    """What a log tells about its vehicle.

    Attributes
    ----------
    name, info : of the log, and facts about its vehicle.
    clock : the axis of all times.
    air_s : spans in the air on that clock.
    sections : in the order of the page.
    broken : a sentence for every section that could not be given.

    Examples
    --------
    >>> found = flysid.review("sample_logs/01-multisine-seed1.tlog")
    >>> found.fact("trust.lost").words
    'nothing'
    """

    name: str
    info: Mapping[str, str]
    clock: LogClock
    air_s: tuple[tuple[float, float], ...]
    sections: tuple[Section, ...]
    broken: tuple[str, ...] = field(default=())

    @property
    def facts(self) -> Iterator[Fact]:
        """All facts, section by section."""
        return (fact for section in self.sections for fact in section.facts)

    @property
    def findings(self) -> list[Finding]:
        """The sentences of the first screen, the gravest first; the first one is the headline."""
        found = order([finding for section in self.sections for finding in section.findings])
        return found[:FIRST_SCREEN] or [NOTHING_FOUND]

    @property
    def actions(self) -> list[Action]:
        """What to do next, what gains most first."""
        found = [action for section in self.sections for action in section.actions]
        return sorted(found, key=lambda action: -action.weight)[:FIRST_SCREEN]

    def fact(self, key: str) -> Fact | None:
        """The fact of a key; None where this log's review has none of that name."""
        return next((fact for fact in self.facts if fact.key == key), None)

    def to_dict(self) -> dict[str, Any]:
        """The document, as `flysid review --json` prints it."""
        from flysid.reviews.document import to_dict

        return to_dict(self)

    def write(self, path: str | Path) -> Path:
        """Write the page; returns its path."""
        from flysid.reviews.page import write

        return write(path, [self])

    def _table(self) -> Table:
        rows = [(fact.key, fact.label, fact.words) for fact in self.facts]
        return Table(f"{self.name}: {self.findings[0].text}", ("fact", "what", "value"), rows)


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
