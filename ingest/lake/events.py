"""What a log says beside its numbers: flight modes, text messages, parameters and their changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.facts.modes import COLUMNS, mode_texts
from flysid.flight import BOOT, TIME, matching_streams
from flysid.flightwriter import float_values, int_values
from flysid.ingest.align.signals import Log
from flysid.ingest.align.things import find_stream

ORIGIN = "origin"
IN_FORCE = ("", "initial", "changed")
"""Origins of values that were in force; a ULog also states defaults."""
MESSAGES = (("MSG", "Message"), ("STATUSTEXT", "text"), ("messages", "text"))
PARAMETERS = (
    ("PARM", "Name", "Value"),
    ("PARAM_VALUE", "param_id", "param_value"),
    ("parameters", "name", "value"),
)


@dataclass(frozen=True)
class Event:
    """Something that the log states at one moment.

    `boot`, `time_ns`: when, on the vehicle's clock.
    `kind`: "mode", "message" or "parameter".
    `text`: a mode's name, a message, or "NAME = value (was value)".
    """

    boot: int
    time_ns: int
    kind: str
    text: str


@dataclass(frozen=True)
class Setting:
    """A parameter as the log stated it at one moment."""

    boot: int
    time_ns: int
    name: str
    value: float | str


def events(log: Log) -> list[Event]:
    """Mode changes, messages and parameter changes of a log, in order of boot and time."""
    found = [*mode_changes(log), *messages(log), *parameter_changes(settings(log))]
    return sorted(found, key=lambda e: (e.boot, e.time_ns))


def mode_changes(log: Log) -> list[Event]:
    """The first mode of every boot, and each change after it."""
    for message, column in COLUMNS:
        stream = find_stream(message, log.rows)
        if stream is None or column not in log.columns(stream):
            continue
        table = log.table(stream, [BOOT, TIME, column])
        boots = int_values(table[BOOT])
        values = float_values(table[column])
        _, first, of = np.unique(values, return_index=True, return_inverse=True)
        words = np.array(mode_texts(values[first], stream, column, log.info), dtype=object)[of]
        starts = np.flatnonzero((words != np.roll(words, 1)) | (np.diff(boots, prepend=-1) != 0))
        times = int_values(table[TIME])
        return [Event(int(boots[i]), int(times[i]), "mode", str(words[i])) for i in starts if words[i]]
    return []


def messages(log: Log) -> list[Event]:
    """Text messages, of every system that the log holds."""
    return [
        Event(boot, time_ns, "message", str(text).strip())
        for message, column in MESSAGES
        for boot, time_ns, text in _rows(log, message, [column])
        if str(text).strip()
    ]


def settings(log: Log) -> list[Setting]:
    """Every statement of a parameter that was in force, in the order of the log's streams.

    Defaults that a ULog lists beside them were not.
    """
    return [
        Setting(boot, time_ns, str(name), value)
        for message, column, content in PARAMETERS
        for boot, time_ns, name, value in _rows(log, message, [column, content])
    ]


def parameter_changes(stated: Sequence[Setting]) -> list[Event]:
    """The statements that differ from the one before it of the same name and boot."""
    latest: dict[tuple[int, str], float | str] = {}
    changes = []
    for setting in sorted(stated, key=lambda s: (s.boot, s.time_ns)):
        key = (setting.boot, setting.name)
        before = latest.get(key, setting.value)
        if before != setting.value:
            text = f"{setting.name} = {written(setting.value)} (was {written(before)})"
            changes.append(Event(setting.boot, setting.time_ns, "parameter", text))
        latest[key] = setting.value
    return changes


def _rows(log: Log, message: str, columns: Sequence[str]) -> Iterator[tuple[Any, ...]]:
    for stream in matching_streams(message, log.rows):
        held = log.columns(stream)
        if not log.rows[stream] or not set(columns) <= set(held):
            continue
        table = log.table(stream, [BOOT, TIME, *columns, *({ORIGIN} & set(held))])
        if ORIGIN in table.column_names:
            table = table.filter(pc.is_in(table[ORIGIN], pa.array(IN_FORCE)))
        yield from zip(*(table[c].to_pylist() for c in (BOOT, TIME, *columns)), strict=True)


def written(value: float | str) -> str:
    """A parameter's value in the fewest digits that give it back: 0.46 is often kept in single precision."""
    if not isinstance(value, float):
        return str(value)
    with np.errstate(over="ignore"):
        single = np.float32(value)
    return f"{float(str(single)) if float(single) == value else value:.15g}"
