"""Which stretches of the flights are meant: between two times, in some flight modes, without mishaps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.errors import UsageError
from flysid.flight import BOOT, TIME
from flysid.flightwriter import int_values
from flysid.ingest.align.allowed import Allowed
from flysid.ingest.align.conditions import ALWAYS
from flysid.ingest.align.resample import FOREVER, Span
from flysid.ingest.align.signals import Log
from flysid.ingest.lake.events import mode_changes
from flysid.ingest.lake.mishaps import mishaps
from flysid.showing import clock

_CLOCK = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d*)?)")


@dataclass(frozen=True)
class Stretches:
    """What a user says of the time within flights.

    `between`: "12:30..14:00": minutes and seconds (or h:m:s, or seconds) since the beginning of a boot;
        either end may be missing; "": all of it.
    `modes`: names of flight modes, e.g. ("LOITER",); empty: all.
    `mishaps`: keep what is a crash, a failsafe or a loss of control, and what follows it.
    `without`: parts of single flights that are left out, as `parse_part` reads them, by whole ids.
    """

    between: str = ""
    modes: tuple[str, ...] = ()
    mishaps: bool = False
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        parse_between(self.between)
        for text in self.without:
            parse_part(text)

    def allowed(self, log: Log) -> Allowed:
        """Where a log may be used."""
        found = Allowed()
        if self.between:
            found = found.within(_between(log, *parse_between(self.between), self.between))
        if self.modes:
            found = found.within(_in_modes(log, self.modes))
        for part in map(parse_part, self.without):
            if part.flight == log.name:
                found = found.within(_without(log, part))
        return found if self.mishaps else found.within(_without_mishaps(log))

    @property
    def words(self) -> str:
        """For people; "" where all of every flight is meant."""
        said = [f"{self.between} of the flight"] if self.between else []
        said += [f"in {' or '.join(self.modes)}"] if self.modes else []
        said += ["crashes and failsafes kept"] if self.mishaps else []
        said += [f"without {text}" for text in self.without]
        return ", ".join(said)


@dataclass(frozen=True)
class Part:
    """A flight, one boot of it, or a part of its time.

    `flight`: its id, or the unambiguous beginning of it.
    `boot`: None: every one of the flight's.
    `between`: as `Stretches.between`.
    """

    flight: str
    boot: int | None = None
    between: str = ""

    def __str__(self) -> str:
        boot = "" if self.boot is None else f"#{self.boot}"
        return f"{self.flight}{boot}{'@' if self.between else ''}{self.between}"

    def spans(self, begin_ns: Mapping[int, int]) -> dict[int, Span]:
        """Boot -> the span of vehicle time that is meant, ns, from the boots' beginnings."""
        low_s, high_s = parse_between(self.between)
        return {
            boot: (
                start + round(low_s * 1e9) if low_s else ALWAYS,
                FOREVER if high_s == float("inf") else start + round(high_s * 1e9),
            )
            for boot, start in begin_ns.items()
            if self.boot in (None, boot)
        }


def parse_part(text: str) -> Part:
    """ "0042", "0042#1" (its second boot), "0042@12:30..14:00". Raises UsageError: none of these."""
    named, at, between = text.partition("@")
    flight, mark, boot = named.partition("#")
    if not flight or (at and not between) or (mark and not boot.isdecimal()):
        raise UsageError(
            f"{text!r} names no flight and no part of one", hint="FLIGHT, or FLIGHT@12:30..14:00"
        )
    parse_between(between)
    return Part(flight, int(boot) if mark else None, between)


def held_spans(logs: Iterable[Log], parts: Sequence[str]) -> dict[str, list[Span]]:
    """What is held out, by the name that alignment gives a flight: spans of vehicle time, ns.

    `parts`: of flights, as `parse_part` reads them, by whole ids.
    Raises UsageError: a flight is not among the logs, or has no such boot.
    """
    by_name = {log.name: log for log in logs}
    found: dict[str, list[Span]] = {}
    for part in map(parse_part, parts):
        begin_ns = beginnings(by_name[part.flight]) if part.flight in by_name else {}
        spans = part.spans(begin_ns)
        if not spans:
            raise UsageError(
                f"{str(part)!r} cannot be held out: it is not among the chosen flights",
                hint="flysid ls DATA",
            )
        for boot, span in spans.items():
            for name in (part.flight, f"{part.flight}#{boot}"):
                found.setdefault(name, []).append(span)
    return found


def parse_between(text: str) -> tuple[float, float]:
    """ "12:30..14:00" in seconds: (750.0, 840.0).

    Raises UsageError: not two times with .. between them, or in the wrong order.
    """
    first, dots, last = text.partition("..")
    try:
        low = _seconds(first) if first else 0.0
        high = _seconds(last) if last else float("inf")
    except ValueError:
        low = 0.0
        high = 0.0
        dots = ""
    if text and (not dots or low >= high):
        raise UsageError(
            f"{text!r} are not two times since the beginning of the flight",
            hint="minutes and seconds: 12:30..14:00, or 12:30.. to the end",
        )
    return low, high


def _seconds(text: str) -> float:
    match = _CLOCK.fullmatch(text.strip())
    if match is None:
        raise ValueError(text)
    hours, minutes, seconds = (float(part or 0.0) for part in match.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def beginnings(log: Log) -> dict[int, int]:
    """Boot -> vehicle time at which it began, ns: the zero of times that people say."""
    return {boot: first for boot, (first, _) in _lasting(log).items()}


def _lasting(log: Log) -> dict[int, Span]:
    """Boot -> when it began and ended, ns; by its longest stream where the log has no clocks."""
    if log.clocks:
        return {clock.boot: (clock.first_ns, clock.last_ns) for clock in log.clocks}
    longest = max(log.rows, key=lambda stream: log.rows[stream], default=None)
    if longest is None:
        return {}
    table = log.table(longest, [BOOT, TIME])
    boots = int_values(table[BOOT])
    times = int_values(table[TIME])
    of = {int(boot): times[boots == boot] for boot in np.unique(boots)}
    return {boot: (int(own.min()), int(own.max())) for boot, own in of.items()}


def _between(log: Log, low_s: float, high_s: float, said: str) -> Allowed:
    spans: dict[int, Sequence[Span]] = {}
    lasting = _lasting(log)
    for boot, (start, _) in lasting.items():
        end = FOREVER if high_s == float("inf") else start + round(high_s * 1e9)
        spans[boot] = [(start + round(low_s * 1e9), end)]
    longest_s = max((last - first for first, last in lasting.values()), default=0) * 1e-9
    if longest_s < low_s:
        return Allowed(spans, never=(f"{said} never holds: the log ends after {longest_s:.0f} s",))
    return Allowed(spans, (f"only {said} of the flight, as asked",))


def _without(log: Log, part: Part) -> Allowed:
    spans = {boot: _cut([(ALWAYS, FOREVER)], span) for boot, span in part.spans(beginnings(log)).items()}
    if not spans:
        raise UsageError(
            f"{str(part)!r} cannot be left out: the flight has no such boot", hint="flysid ls DATA"
        )
    return Allowed(spans, (f"left out, as asked: {part}",))


def _in_modes(log: Log, modes: Sequence[str]) -> Allowed:
    wanted = {mode.upper() for mode in modes}
    changes = mode_changes(log)
    spans: dict[int, list[Span]] = {boot: [] for boot in beginnings(log)}
    for i, change in enumerate(changes):
        if change.text.upper() in wanted:
            after = changes[i + 1] if i + 1 < len(changes) else None
            end = after.time_ns if after is not None and after.boot == change.boot else FOREVER
            spans.setdefault(change.boot, []).append((change.time_ns, end))
    said = " or ".join(modes)
    if any(spans.values()):
        return Allowed(spans, (f"only in {said}, as asked",))
    flown = ", ".join(dict.fromkeys(change.text for change in changes))
    told = f"the modes of the log are {flown}" if flown else "the log states no modes"
    return Allowed(spans, never=(f"mode {said} never holds: {told}",))


def _without_mishaps(log: Log) -> Allowed:
    spans: dict[int, Sequence[Span]] = {}
    notes = []
    starts = beginnings(log)
    for mishap in mishaps(log):
        first, last = mishap.span
        spans[mishap.boot] = _cut(spans.get(mishap.boot, [(ALWAYS, FOREVER)]), mishap.span)
        since = clock((first - starts.get(mishap.boot, first)) * 1e-9)
        until = "to the end" if last == FOREVER else f"for {(last - first) * 1e-9:.0f} s"
        notes.append(f"left out from {since} {until}: {mishap.what} (--keep-mishaps keeps it)")
    return Allowed(spans, tuple(dict.fromkeys(notes)))


def _cut(spans: Sequence[Span], hole: Span) -> list[Span]:
    """The spans without the hole."""
    parts = [part for a, b in spans for part in ((a, min(b, hole[0])), (max(a, hole[1]), b))]
    return [(a, b) for a, b in parts if a < b]
