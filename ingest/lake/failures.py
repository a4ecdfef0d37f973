"""What a log states of failures: ArduPilot's errors, states of PX4, MAVLink and blackboxes, and messages.

The words and their meaning stand in `flysid/facts/failures.toml`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from flysid.facts.vehicle import firmware_of
from flysid.flight import BOOT, TIME, split_address
from flysid.ingest.align.resample import FOREVER, Span
from flysid.ingest.align.signals import Log
from flysid.ingest.align.things import things_of
from flysid.ingest.lake.events import Event, messages

DISARMED = 15
"""The blackbox's event (FLIGHT_LOG_EVENT_DISARM)."""


@dataclass(frozen=True)
class Mishap:
    """Something that went wrong.

    `boot`, `span`: from when to when, on the vehicle's clock of one boot.
    `what`: it was.
    `spoils`: while it lasts, no model is fitted: another controller is at work, or a part is broken.
    `ends`: the flight is over: it crashed, or a part is broken for good.
    """

    boot: int
    span: Span
    what: str
    spoils: bool = True
    ends: bool = False


def stated_failures(log: Log) -> list[Mishap]:
    """All that a log's states and errors tell of, in order of boot and time."""
    found = [*_errors(log), *_states(log), *_disarmed(log)]
    return sorted(found, key=lambda m: (m.boot, m.span))


def failure_messages(log: Log) -> list[Event]:
    """The messages that tell the pilot of a failure, in the log's order."""
    known = _known()["messages"]
    stated = re.compile("|".join(f"(?:{words})" for words in known["of"]), re.IGNORECASE)
    harmless = re.compile(known["not"], re.IGNORECASE)
    found = [(event, plain_words(event.text)) for event in messages(log)]
    return [event for event, text in found if stated.search(text) and not harmless.search(text)]


def plain_words(message: str) -> str:
    """A message without its sender, and without PX4's word for a check that also runs in the air.

    >>> plain_words("[health_and_arming_checks] Preflight Fail: Attitude failure (roll)")
    'Attitude failure (roll)'
    """
    text = message.strip()
    while text.startswith("[") and "]" in text:
        text = text.partition("]")[2].strip()
    return text.removeprefix("Preflight Fail:").strip()


def _errors(log: Log) -> Iterator[Mishap]:
    """ERR messages of DataFlash logs."""
    begun: dict[tuple[int, int], tuple[int, Mapping[str, Any]]] = {}
    for boot, time_ns, subsystem, code in _rows(log, "ERR", ("Subsys", "ECode")):
        error = _error(subsystem, code)
        if error is not None:
            begun.setdefault((boot, subsystem), (time_ns, error))
        elif code == 0 and (boot, subsystem) in begun and not begun[boot, subsystem][1].get("ends"):
            start, ended = begun.pop((boot, subsystem))
            yield Mishap(boot, (start, time_ns), ended["words"], ended.get("spoils", False))
    for (boot, _), (start, error) in begun.items():
        yield Mishap(
            boot, (start, FOREVER), *(error.get(name, False) for name in ("words", "spoils", "ends"))
        )


def _error(subsystem: int, code: int) -> Mapping[str, Any] | None:
    for error in _known()["ardupilot"]:
        if error["subsystem"] == subsystem and (code in error["codes"] if "codes" in error else code):
            return dict(error)
    return None


def _states(log: Log) -> Iterator[Mishap]:
    for state in _known()["state"]:
        message, field = split_address(state["field"])
        spoils = state.get("spoils", False)
        for boot, span, words, from_start in _while(log, message, field, state):
            if spoils or not from_start:
                yield Mishap(boot, span, words, spoils, span[1] == FOREVER and state.get("ends", False))


def _words(state: Mapping[str, Any], value: float) -> str:
    """What a value means; "" for nothing."""
    if "bits" in state:
        return ", ".join(words for bit, words in state["bits"].items() if int(value) & int(bit))
    words: str = state["values"].get(str(int(value)), "")
    return words


def _while(
    log: Log, message: str, column: str, state: Mapping[str, Any]
) -> Iterator[tuple[int, Span, str, bool]]:
    """Boot, span and words of every time in which a state means something, and whether it began with it."""
    began: tuple[int, int, str, bool] | None = None
    last_boot = -1
    for boot, time_ns, value in _rows(log, message, (column,)):
        words = "" if value is None or value != value else _words(state, value)
        if began is not None and (boot, words) != (began[0], began[2]):
            yield began[0], (began[1], time_ns if boot == began[0] else FOREVER), began[2], began[3]
            began = None
        if words and began is None:
            began = (boot, time_ns, words, boot != last_boot)
        last_boot = boot
    if began is not None:
        yield began[0], (began[1], FOREVER), began[2], began[3]


def _disarmed(log: Log) -> Iterator[Mishap]:
    """Why a blackbox says that its vehicle was disarmed."""
    reasons = _known()["disarm"].get(firmware_of(log.info), {})
    for boot, time_ns, event, value in _rows(log, "events", ("event", "value")) if reasons else ():
        words = reasons.get(str(int(value))) if event == DISARMED else None
        if words:
            yield Mishap(boot, (time_ns, FOREVER), words, spoils=False)


def _rows(log: Log, message: str, columns: Sequence[str]) -> Iterator[tuple[Any, ...]]:
    """(boot, time, values) of the autopilot's stream of that message, of the first of several things."""
    stream = next(iter(things_of(message, log.rows)), None)
    if stream is None or not set(columns) <= set(log.columns(stream)):
        return
    table = log.table(stream, [BOOT, TIME, *columns])
    yield from zip(*(table[c].to_pylist() for c in (BOOT, TIME, *columns)), strict=True)


@cache
def _known() -> dict[str, Any]:
    return tomllib.loads(files("flysid.facts").joinpath("failures.toml").read_text("utf-8"))
