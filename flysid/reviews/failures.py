"""Failures that a log reports, counted as a pilot would: two reports of one moment are one failure."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from flysid.ingest.lake.events import Event
from flysid.ingest.lake.failures import failure_messages, plain_words
from flysid.reviews.logged import LoggedFlight

MOMENT_S = 2.0
"""ArduPilot and PX4 state an error, its message and the change of mode within a second or two."""
GENERAL = ("failsafe", "emergency", "attitude beyond its limit")
"""Words that do not say what failed: a more exact one of the same moment stands for them."""


@dataclass(frozen=True)
class Failure:
    """Something that failed in a log.

    `at_s`: when, on the log's clock.
    `words`: what.
    `stated`: by a state or an error of the firmware, not by a message alone.
    `failsafe`: the firmware calls it one.
    `mode`: to which the vehicle changed in that moment; "" for none.
    """

    at_s: float
    words: str
    stated: bool
    failsafe: bool
    mode: str

    @property
    def sentence(self) -> str:
        """ "Failsafe at 77 s: Low battery, then RTL"."""
        kind = "Failsafe at" if self.mode or self.failsafe else "At"
        then = f", then {self.mode}" if self.mode else ""
        return f"{kind} {self.at_s:.0f} s: {self.words}{then}"


def stated_failures(flight: LoggedFlight, stated_events: Sequence[Event]) -> list[Failure]:
    """In the order of their beginnings. `stated_events`: of the log."""
    stated = [(flight.clock.seconds(m.boot, m.span[0]), m.what, True) for m in flight.failures]
    stated += [
        (flight.clock.seconds(e.boot, e.time_ns), plain_words(e.text), False)
        for e in failure_messages(flight.log)
    ]
    modes = [(flight.clock.seconds(e.boot, e.time_ns), e.text) for e in stated_events if e.kind == "mode"]
    return [_joined(group, modes) for group in _moments(sorted(stated))]


def _moments(stated: Sequence[tuple[float, str, bool]]) -> Iterator[list[tuple[float, str, bool]]]:
    """What was stated within a moment of the first of them."""
    group: list[tuple[float, str, bool]] = []
    for found in stated:
        if group and found[0] - group[0][0] > MOMENT_S:
            yield group
            group = []
        group.append(found)
    if group:
        yield group


def _joined(group: Sequence[tuple[float, str, bool]], modes: Sequence[tuple[float, str]]) -> Failure:
    """One failure of all that was stated in a moment: an error's words before a message's."""
    exact = [found for found in group if not _is_general(found[1])] or list(group)
    words = min(exact, key=lambda found: not found[2])[1]
    at_s = group[0][0]
    changed = [
        mode
        for (_, before), (time_s, mode) in itertools.pairwise(modes)
        if mode != before and -0.5 * MOMENT_S <= time_s - at_s <= MOMENT_S
    ]
    stated = any(found[2] for found in group)
    failsafe = any("failsafe" in found[1].lower() for found in group)
    return Failure(at_s, words, stated, failsafe, changed[-1] if changed else "")


def _is_general(words: str) -> bool:
    low = words.lower()
    return low in GENERAL or low.startswith(("failsafe activated", "failsafe (", "failsafe mode"))
