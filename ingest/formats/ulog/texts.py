"""What a ULog says in words: information, parameters, logged messages, dropouts."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, TIME, field_metadata
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.gather import Values
from flysid.ingest.formats.ulog.layouts import NUMBERS
from flysid.ingest.formats.ulog.records import MAX_KEYS

MAX_INFO = 500
MAX_INFO_CHARS = 4096
LEVELS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_VALUES = {
    kind: struct.Struct("<" + {"i8": "q", "u8": "Q"}.get(code.lstrip("<"), np.dtype(code).char))
    for kind, code in NUMBERS.items()
    if kind != "char"
}
ORIGINS = {0: "initial", 1: "changed", 2: "system default", 3: "setup default"}


class Named(NamedTuple):
    """A "type name" key and its value: a number, text, or bytes."""

    kind: str
    name: str
    value: float | int | str | bytes


def parse_named(body: memoryview) -> Named | None:
    """u8 key length, key, value; None where the value does not fit its type."""
    width = body[0] if len(body) else 0
    kind, name, layout = _parse_key(bytes(body[1 : 1 + width]))
    raw = body[1 + width :]
    if not name:
        return None
    if layout is not None:
        return Named(kind, name, layout.unpack_from(raw)[0]) if len(raw) >= layout.size else None
    value = bytes(raw)
    return Named(kind, name, value.decode("utf-8", "replace") if kind.startswith("char[") else value)


@lru_cache(maxsize=MAX_KEYS)
def _parse_key(key: bytes) -> tuple[str, str, struct.Struct | None]:
    """Type, name, and how a number of that type lies."""
    kind, _, name = key.decode("utf-8", "replace").partition(" ")
    return kind, name, _VALUES.get(kind)


@dataclass
class Words:
    """Collects records in words; each method takes a payload and the vehicle time in ns where it has none."""

    info: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    _messages: list[tuple[int, int, int | None, str]] = field(default_factory=list)
    _parameters: list[tuple[int, str, float, str, int]] = field(default_factory=list)
    _dropouts: list[tuple[int, int]] = field(default_factory=list)
    _texts: list[tuple[int, str, str, bool]] = field(default_factory=list)

    def add_info(self, body: memoryview) -> bool:
        """An information record; False where it cannot be read."""
        named = parse_named(body)
        if named is None:
            return False
        if isinstance(named.value, int):
            self.numbers[named.name] = named.value
        if not isinstance(named.value, bytes) and len(self.info) < MAX_INFO:
            self.info[named.name] = str(named.value)[:MAX_INFO_CHARS]
        return True

    def add_multiple(self, body: memoryview, time_ns: int) -> bool:
        """One piece of a multi-part information; binary ones are left out, unknown types are False."""
        named = parse_named(body[1:]) if len(body) else None
        if named is None or named.kind.partition("[")[0] not in NUMBERS:
            return False
        if isinstance(named.value, str):
            self._texts.append((time_ns, named.name, named.value, bool(body[0])))
        return True

    def add_parameter(self, body: memoryview, time_ns: int, origin: int) -> bool:
        """A parameter's value; `origin` as in ORIGINS."""
        named = parse_named(body)
        if named is None or isinstance(named.value, str | bytes):
            return False
        self._parameters.append((time_ns, named.name, float(named.value), named.kind, origin))
        return True

    def add_keyed(self, key: bytes, body: memoryview, time_ns: int, origin: int) -> bool:
        """A parameter whose key and length are known to be sound; False where its value is no number."""
        kind, name, layout = _parse_key(key)
        if layout is None:
            return False
        value = float(layout.unpack_from(body, 1 + len(key))[0])
        self._parameters.append((time_ns, name, value, kind, origin))
        return True

    def add_default(self, body: memoryview, time_ns: int) -> bool:
        """A parameter's default: bit 0 the system's, bit 1 the current setup's."""
        if not len(body):
            return False
        which = [origin for bit, origin in ((1, 2), (2, 3)) if body[0] & bit]
        return bool(which) and all(self.add_parameter(body[1:], time_ns, origin) for origin in which)

    def add_message(self, body: memoryview, tagged: bool) -> None:
        """A logged message: level, maybe tag, time in us, text."""
        head = struct.Struct("<BHQ" if tagged else "<BQ")
        level, *tag, time_us = head.unpack_from(body, 0)
        text = bytes(body[head.size :]).decode("utf-8", "replace")
        self._messages.append((min(time_us, 1 << 53) * 1000, level - 48, tag[0] if tag else None, text))

    def add_dropout(self, body: memoryview, time_ns: int) -> int:
        """A dropout; returns its length in ms."""
        duration = body[0] | body[1] << 8
        self._dropouts.append((time_ns, duration))
        return duration

    def tables(self) -> dict[str, pa.Table]:
        """Streams "messages", "parameters", "dropouts", "info_multiple", as far as there is anything."""
        found: dict[str, pa.Table] = {}
        if self._messages:
            times, levels, tags, texts = zip(*self._messages, strict=True)
            found["messages"] = _table(times, level=_levels(levels), tag=_tags(tags), text=_words(texts))
        if self._parameters:
            times, names, values, types, origins = zip(*self._parameters, strict=True)
            found["parameters"] = _table(
                times,
                name=_words(names),
                value=_column(np.array(values, dtype=np.float64)),
                type=_words(types),
                origin=_words([ORIGINS[o] for o in origins]),
            )
        if self._dropouts:
            times, durations = zip(*self._dropouts, strict=True)
            found["dropouts"] = _table(
                times, duration=_column(np.array(durations, dtype=np.uint16), unit="ms")
            )
        if self._texts:
            times, keys, texts, continued = zip(*self._texts, strict=True)
            flags = _column(np.array(continued, dtype=np.bool_))
            found["info_multiple"] = _table(times, key=_words(keys), text=_words(texts), continued=flags)
        return found


_Column = tuple[pa.Array, dict[bytes, bytes] | None]


def _column(values: Values, unit: str = "") -> _Column:
    return arrow_arrays.numeric(values), field_metadata(unit=unit)


def _words(values: Sequence[str]) -> _Column:
    return arrow_arrays.strings(values), None


def _levels(values: Sequence[int]) -> _Column:
    levels = np.array(values, dtype=np.uint8)
    return arrow_arrays.numeric(levels), field_metadata(enum=dict(enumerate(LEVELS)))


def _tags(values: Sequence[int | None]) -> _Column:
    """Tags; null where a message has none."""
    known = np.array([v is not None for v in values], dtype=np.bool_)
    numbers = np.array([v or 0 for v in values], dtype=np.uint16)
    buffers = [pa.py_buffer(np.packbits(known, bitorder="little")), pa.py_buffer(numbers)]
    return pa.Array.from_buffers(pa.uint16(), len(numbers), buffers), None


def _table(times: Sequence[int], **columns: _Column) -> pa.Table:
    """time_ns, boot, then the columns."""
    time_ns = np.array(times, dtype=np.int64)
    heads = [
        arrow_arrays.numeric(time_ns),
        arrow_arrays.numeric(np.zeros(len(time_ns), dtype=np.int32)),
    ]
    fields = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
    fields += [pa.field(name, array.type, metadata=note) for name, (array, note) in columns.items()]
    schema = pa.schema(fields, metadata={"time_source": "timestamp"})
    return pa.Table.from_arrays([*heads, *(array for array, _ in columns.values())], schema=schema)
