"""One ROS message (ROS 1 or CDR) scrubbed: its fields found by its type, and overwritten where they stand."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber, ScrubColumn
from flysid.ingest.formats.messages.channel import Channel
from flysid.ingest.formats.messages.definitions import (
    Array,
    DefinitionError,
    MessageType,
    Number,
    Text,
    Type,
    parse_definition,
)
from flysid.ingest.formats.messages.idl import parse_idl
from flysid.ingest.formats.messages.steps import ROS1_WIRE, Wire, has_wide, plan
from flysid.ingest.formats.messages.topic import CDR_WIRES

Clean = Callable[[bytes], bytes]
CORRECTIONS = "rtcm"
FRAME_NAMES = frozenset({"frame_id", "child_frame_id"})
MAX_STEPS = 1_000_000


@dataclass(frozen=True)
class Spot:
    """A number (`dtype`) or a text ("") at data[at : at + size]."""

    path: str
    dtype: str
    at: int
    size: int


class MessageError(ValueError):
    """A message that does not fit its type."""


def may_hold(kind: Type, path: str = "") -> bool:
    """Whether a type has texts other than frame names, identifiers or positions."""
    return any(
        (dtype == "" and name.rpartition(".")[2] not in FRAME_NAMES)
        or rules.is_identity(name)
        or "lat" in name.lower().rpartition(".")[2]
        for name, dtype in _names(kind, path)
    )


def _names(kind: Type, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(kind, MessageType):
        for name, inner in kind.fields:
            yield from _names(inner, f"{path}.{name}" if path else name)
    elif isinstance(kind, Array):
        yield from _names(kind.element, path)
    else:
        yield path, kind.dtype if isinstance(kind, Number) else ""


def scrub_message(kind: MessageType, data: bytes, wire: Wire, where: str, scrubber: Scrubber) -> bytes:
    """The message with the same length. Raises MessageError where it does not fit its type."""
    out = bytearray(data)
    numbers: dict[str, Spot] = {}
    walk = _Walk(data, wire)
    for spot in walk.spots(kind, ""):
        name = spot.path.rpartition(".")[2].partition("[")[0]
        if spot.dtype:
            numbers[spot.path] = spot
            if rules.is_identity(name) and any(out[spot.at : spot.at + spot.size]):
                out[spot.at : spot.at + spot.size] = bytes(spot.size)
                scrubber.note(rules.IDENTITY, f"{where}.{spot.path}", 1)
        elif name not in FRAME_NAMES:
            text = data[spot.at : spot.at + spot.size]
            clean = b"x" * len(text) if rules.is_identity(name) else rules.redact(text)
            out[spot.at : spot.at + spot.size] = clean
            scrubber.note(rules.TEXT, f"{where}.{name}", clean != text)
    out[walk.end() :] = bytes(len(out) - walk.end())
    _move(out, numbers, wire, where, scrubber)
    return bytes(out)


def _move(out: bytearray, numbers: dict[str, Spot], wire: Wire, where: str, scrubber: Scrubber) -> None:
    for place in rules.places([ScrubColumn(path, path) for path in numbers]):
        spots = [numbers[c.key] for c in (place.lat, place.lon, *place.altitudes)]
        kinds = [np.dtype(wire.order + spot.dtype) for spot in spots]
        values = tuple(
            np.frombuffer(out, kind, 1, spot.at)[0] for kind, spot in zip(kinds, spots, strict=True)
        )
        rows = np.array([values], dtype=[(spot.path, kind) for spot, kind in zip(spots, kinds, strict=True)])
        rules.scrub_place(rows, place, where, scrubber)
        for spot in spots:
            out[spot.at : spot.at + spot.size] = rows[spot.path].tobytes()


_PARSERS: Mapping[tuple[str, str], Callable[[str, str], MessageType]] = {
    ("ros1", "ros1msg"): partial(parse_definition, ros=1),
    ("cdr", "ros2msg"): partial(parse_definition, ros=2),
    ("cdr", "ros2idl"): parse_idl,
    ("cdr", "omgidl"): parse_idl,
}


def cleaner_for(channel: Channel, scrubber: Scrubber) -> Clean | None:
    """What cleans one message of a ROS topic; None where its definition gives no layout.

    Corrections for receivers are None too: they tell where the base is.
    """
    schema = channel.schema
    where = channel.topic
    if schema is None or channel.fault or CORRECTIONS in f"{where} {schema.name}".lower():
        return None
    parse = _PARSERS.get((channel.encoding, schema.encoding))
    if parse is None:
        return None
    try:
        kind = parse(schema.name, schema.data.decode("utf-8", "replace"))
        is_plain = not has_wide(plan(kind))  # how wide strings lie, only all messages together tell
    except DefinitionError:
        return None
    if not is_plain:
        return None
    if not may_hold(kind):
        return bytes
    if channel.encoding == "ros1":
        return lambda raw: scrub_message(kind, raw, ROS1_WIRE, where, scrubber)
    return lambda raw: _scrub_cdr(kind, raw, where, scrubber)


def _scrub_cdr(kind: MessageType, raw: bytes, where: str, scrubber: Scrubber) -> bytes:
    """A message behind its 4 bytes of encapsulation. Raises MessageError where these are not known."""
    wire = CDR_WIRES.get(raw[1]) if len(raw) >= 4 else None
    if wire is None:
        raise MessageError("an encapsulation that is not known")
    return raw[:4] + scrub_message(kind, raw[4:], wire, where, scrubber)


class _Walk:
    """A cursor over one message."""

    def __init__(self, data: bytes, wire: Wire) -> None:
        self._data = data
        self._wire = wire
        self._at = 0
        self._drift = 0  # see cdr
        self._steps = 0

    def end(self) -> int:
        """Where the message ends. Raises MessageError where more follows than padding."""
        surplus = len(self._data) - self._at
        if surplus > self._drift + 3 or (surplus and self._wire.align == 1):
            raise MessageError("bytes remain after the end of its definition")
        return self._at

    def spots(self, kind: Type, path: str) -> Iterator[Spot]:
        self._steps += 1
        if self._steps > MAX_STEPS:
            raise MessageError("too many elements")
        if isinstance(kind, MessageType):
            for name, inner in kind.fields:
                yield from self.spots(inner, f"{path}.{name}" if path else name)
        elif isinstance(kind, Array):
            yield from self._array(kind, path)
        elif isinstance(kind, Text):
            size = self._count()
            yield Spot(path, "", self._take(size), max(size - self._wire.nul, 0))
        else:
            size = np.dtype(kind.dtype).itemsize
            self._align(size)
            yield Spot(path, "u1" if kind.dtype == "b1" else kind.dtype, self._take(size), size)

    def _array(self, kind: Array, path: str) -> Iterator[Spot]:
        count = self._count() if kind.size is None else kind.size
        if isinstance(kind.element, Number):
            size = np.dtype(kind.element.dtype).itemsize
            before = self._at
            self._align(size)
            if not count:
                self._drift += self._at - before
                self._at = before
            at = self._take(size * count)
            if rules.is_identity(path):
                yield Spot(path, "u1", at, size * count)
            return
        for k in range(count):
            yield from self.spots(kind.element, f"{path}[{k}]")

    def _align(self, size: int) -> None:
        unit = min(size, self._wire.align)
        drifted = -(self._at + self._drift) % unit
        gap = -self._at % unit
        self._at += gap
        self._drift += drifted - gap

    def _count(self) -> int:
        self._align(4)
        return int(struct.unpack_from(self._wire.order + "I", self._data, self._take(4))[0])

    def _take(self, size: int) -> int:
        at = self._at
        self._at = self._at + size
        if self._at > len(self._data):
            raise MessageError("the message ends early")
        return at
