"""The result of a review, as the page, JSON and terminal show it. Nothing here computes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from flysid.facts.clock import LogClock
from flysid.facts.vehicle import firmware_of
from flysid.ingest.lake.timeline import Timeline
from flysid.reviews.fact import Action, Fact, Finding, Grade, Section, order
from flysid.showing import Shown, Table
from flysid.version import __version__

FORMAT = "flysid-review"
VERSION = 1
FIRST_SCREEN = 3
"""Sentences, and next actions: what a person reads before looking away."""
NOTHING_FOUND = Finding("Nothing in this log can be judged", Grade.WATCH, 0.0, "trust.duration")
NOTHING_STRIKES = Finding("Nothing in this log stands out, good or bad", Grade.PLAIN, 0.0, "trust.duration")

NO_TIMELINE = Timeline("", (), (), ())


@dataclass(frozen=True, eq=False, repr=False)
class Review(Shown):
    """The review of one log.

    `name`, `info`: of the log, and facts about its vehicle.
    `clock`: the axis of all times.
    `sections`: in the order of the page.
    `broken`: a sentence for every section that could not be given.
    `whole`: names of the parameters that are whole numbers.
    `timeline`: the evidence over time, for a page; empty unless a page was requested.

    >>> found = flysid.review("sample_logs/01-multisine-seed1.tlog")
    >>> found.fact("trust.lost").words
    'nothing'
    """

    name: str
    info: Mapping[str, str]
    clock: LogClock
    sections: tuple[Section, ...]
    broken: tuple[str, ...] = ()
    whole: frozenset[str] = frozenset()
    timeline: Timeline = NO_TIMELINE

    @property
    def facts(self) -> Iterator[Fact]:
        """All facts, section by section."""
        return (fact for section in self.sections for fact in section.facts)

    @property
    def family(self) -> str:
        """Firmware, as `LoggedFlight.family`."""
        return firmware_of(self.info)

    @property
    def is_judged(self) -> bool:
        """Whether any section has something to say of the flight, beside how much of it the log holds."""
        found = any(section.findings for section in self.sections if section.key != "trust")
        return found or self.shows_tracking

    @property
    def shows_tracking(self) -> bool:
        """Whether the log holds a setpoint and what came of it: good or bad, that much is known."""
        return any(fact.value is not None for fact in self.facts if fact.key.startswith("tracking."))

    @property
    def values(self) -> dict[str, dict[str, float | str | None]]:
        """Section -> figure -> value, None where it is not determined: what `--fail-if` compares."""
        return {
            section.key: {fact.key.partition(".")[2]: fact.value for fact in section.facts}
            for section in self.sections
        }

    @property
    def findings(self) -> list[Finding]:
        """The sentences of the first screen, the gravest first; the first one is the headline."""
        found = order([finding for section in self.sections for finding in section.findings])
        return found[:FIRST_SCREEN] or [NOTHING_STRIKES if self.shows_tracking else NOTHING_FOUND]

    @property
    def actions(self) -> list[Action]:
        """What to do next, what gains most first."""
        found = [action for section in self.sections for action in section.actions]
        return sorted(found, key=lambda action: -action.weight)[:FIRST_SCREEN]

    def fact(self, key: str) -> Fact | None:
        """The fact of a key; None where this log's review has none of that name."""
        return next((fact for fact in self.facts if fact.key == key), None)

    def to_dict(self) -> dict[str, Any]:
        """The document, as `flysid review --json` prints it: every fact by its section and key."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "flysid": __version__,
            "log": self.name,
            "vehicle": dict(self.info),
            "clock": self.clock.words,
            "findings": [finding.to_dict() for finding in self.findings],
            "actions": [action.to_dict() for action in self.actions],
            "sections": {section.key: section.to_dict() for section in self.sections},
            "broken": list(self.broken),
        }

    def _table(self) -> Table:
        rows = [(fact.key, fact.label, fact.words) for fact in self.facts]
        return Table(f"{self.name}: {self.findings[0].text}", ("fact", "what", "value"), rows)
