"""Decode a tlog's records, as they come, into rows of the wanted streams; each row has its vehicle time.

What a log's reader knows only at the end is not waited for: a message that states no time of its own is
placed by its arrival behind the vehicle's latest time, where the reader of a log puts it between its
neighbours. A few messages come at a time, so that plain Python is quicker than arrays up to the rows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.flight import KEY, OTHERS, ClockMap, matching_streams
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common.arrow_arrays import fixed_text
from flysid.ingest.formats.common.columns import RecordLayout, message_schema
from flysid.ingest.formats.common.vehicle_time import AGREES_NS, AUTOPILOT_COMPONENT
from flysid.ingest.formats.keyed import keys_in, thing_text
from flysid.ingest.formats.mavlink.dialect import Dialect, load_dialect
from flysid.ingest.formats.mavlink.frames import SIGNED, STAMP_BYTES, V2, MessageId
from flysid.ingest.formats.mavlink.reader import BOOT_FIELDS, TIME_FIELDS, vehicle_facts
from flysid.live.framing import LIVE_DIALECT

IntArray = npt.NDArray[np.int64]
NEW_CLOCK = 3  # so many stated times in a row that disagree with the clock: it began anew


@dataclass(frozen=True, eq=False)
class Rows:
    """New rows of a stream: (n,) vehicle times in ns, boot, and (n,) records of the message's fields."""

    t_ns: IntArray
    boot: int
    records: npt.NDArray[Any]


@dataclass
class _Clock:
    """The time of a system: when it was last stated, and when that arrived."""

    time_ns: int
    arrival_ns: int
    boot: int = 0
    odd: int = 0

    def expected(self, arrival_ns: int) -> int:
        """The vehicle time of what arrives now."""
        return self.time_ns + arrival_ns - self.arrival_ns

    def takes(self, time_ns: int, arrival_ns: int) -> bool:
        """Whether a stated time is the clock's, or the clock's new beginning."""
        if abs(time_ns - self.expected(arrival_ns)) < AGREES_NS:
            self.odd = 0
            if time_ns >= self.time_ns:
                self.time_ns = time_ns
                self.arrival_ns = arrival_ns
            return True
        self.odd += 1
        if self.odd < NEW_CLOCK:
            return False
        self.time_ns = time_ns
        self.arrival_ns = arrival_ns
        self.boot += 1
        self.odd = 0
        return True


class _MessageStream:
    """One message of one sender; of one `thing`, e.g. `[0]`, where its rows belong to several."""

    def __init__(self, key: tuple[int, int, int], dialect: Dialect, thing: str = "") -> None:
        self.system, component, message = self.source = key
        self.name = f"{self.system}.{component}/{dialect.message_name(message)}{thing}"
        self.layout: RecordLayout = dialect.layout(message)
        self.key_field = dialect.key(message)
        self.things: dict[bytes, _MessageStream] = {}
        self.rows = 0
        self.is_asked = False
        self.is_heartbeat = message == MessageId.HEARTBEAT
        names = self.layout.dtype.names or ()
        self.time_field = next((f for f in TIME_FIELDS if f in names), "")
        self.is_clock = self.time_field in BOOT_FIELDS and component == AUTOPILOT_COMPONENT
        self.payloads: list[bytes] = []
        self.stamps_ns: list[int] = []

    def schema(self) -> pa.Schema:
        """The columns that a log's table has."""
        key = {KEY: self.key_field} if self.key_field else {}
        return message_schema(self.layout.columns, key, received=True)


@dataclass
class Decoder:
    """Decodes the records of one sender; what it has seen is a log's (`flysid.ingest.align.signals.Log`).

    `wanted`: messages, by name or by key of a stream.
    """

    wanted: Collection[str]
    info: dict[str, str] = field(default_factory=dict)
    name: str = "live"

    def __post_init__(self) -> None:
        self._dialect = load_dialect(LIVE_DIALECT)
        self._streams: dict[tuple[int, int, int], _MessageStream | None] = {}
        self._by_name: dict[str, _MessageStream] = {}
        self._clocks: dict[int, _Clock] = {}

    @property
    def rows(self) -> Mapping[str, int]:
        """Rows of every stream so far."""
        return {name: stream.rows for name, stream in self._by_name.items()}

    @property
    def clocks(self) -> Sequence[ClockMap]:
        """Not known before the end."""
        return ()

    @property
    def allowed(self) -> None:
        """Nothing is cut out."""
        return None

    def columns(self, stream: str) -> Sequence[str]:
        """Names of a stream's columns."""
        names: Sequence[str] = self._by_name[stream].schema().names
        return names

    def keys(self, stream: str) -> Sequence[str]:
        """The field that names the thing to which each of a stream's rows belongs."""
        return keys_in({KEY: self._by_name[stream].key_field})

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        """A table without rows: what came is not kept."""
        return pa.Table.from_batches([], self._by_name[stream].schema()).select(list(columns))

    def newest_ns(self, stream: str) -> int:
        """The latest time that the stream's vehicle has stated."""
        clock = self._clock_of(self._by_name[stream])
        return 0 if clock is None else clock.time_ns

    def _clock_of(self, stream: _MessageStream) -> _Clock | None:
        """The clock of the stream's system; a ground station is on the vehicle's, if there is one."""
        return self._clocks.get(stream.system) or next(iter(self._clocks.values()), None)

    def read(self, content: bytes) -> dict[str, list[Rows]]:
        """The rows of whole records, by the key of their stream."""
        touched: dict[str, _MessageStream] = {}
        at = 0
        while at < len(content):
            head = at + STAMP_BYTES
            size = content[head + 1]
            if content[head] == V2:
                key = (
                    content[head + 5],
                    content[head + 6],
                    int.from_bytes(content[head + 7 : head + 10], "little"),
                )
                start = head + 10
                end = start + size + 2 + (13 if content[head + 2] & SIGNED else 0)
            else:
                key = content[head + 3], content[head + 4], content[head + 5]
                start = head + 6
                end = start + size + 2
            stream = self._streams[key] if key in self._streams else self._met(key)
            if stream is not None and (stream.key_field or stream.is_asked):
                width = stream.layout.size
                payload = content[start : start + min(size, width)].ljust(width, b"\0")
                stream = self._thing(stream, payload) if stream.key_field else stream
            if stream is not None:
                stream.rows += 1
                if stream.is_asked:
                    stream.payloads.append(payload)
                    stream.stamps_ns.append(int.from_bytes(content[at:head], "big") * 1000)
                    touched[stream.name] = stream
            at = end
        # clocks first: the others are placed by them
        ordered = sorted(touched.values(), key=lambda s: not s.is_clock)
        return {stream.name: found for stream in ordered if (found := self._rows_of(stream))}

    def _met(self, key: tuple[int, int, int]) -> _MessageStream | None:
        """A stream's first message; None where the message is not known."""
        message = key[2]
        extra = self._dialect.crc_extra
        stream = None
        if message < len(extra) and extra[message] >= 0:
            stream = _MessageStream(key, self._dialect)
            if not stream.key_field:
                self._note(stream)
        self._streams[key] = stream
        return stream

    def _thing(self, whole: _MessageStream, payload: bytes) -> _MessageStream:
        """The stream of the thing that a message belongs to."""
        kind, at = whole.layout.dtype.fields[whole.key_field][:2]  # type: ignore[index]
        raw = payload[at : at + kind.itemsize]
        known = whole.things.get(raw)
        if known is not None:
            return known
        text = _text_of(raw, kind)
        is_room = len(self._by_name) < Limits().max_things
        stream = _MessageStream(whole.source, self._dialect, f"[{text}]" if is_room else OTHERS)
        stream = self._by_name.get(stream.name) or self._note(stream)
        if is_room:
            whole.things[raw] = stream
        return stream

    def _note(self, stream: _MessageStream) -> _MessageStream:
        """A stream that rows have come of."""
        stream.is_asked = stream.is_heartbeat or any(
            matching_streams(word, {stream.name: 0}) for word in self.wanted
        )
        self._by_name[stream.name] = stream
        return stream

    def _rows_of(self, stream: _MessageStream) -> list[Rows]:
        """The rows that have come of a stream, boot by boot; without those that have no time."""
        records = np.frombuffer(b"".join(stream.payloads), stream.layout.dtype)
        stamps = stream.stamps_ns
        stream.payloads = []
        stream.stamps_ns = []
        if stream.is_heartbeat:
            self.info = {**vehicle_facts(self._dialect, records["autopilot"], records["type"]), **self.info}
        if stream.is_clock and stream.system not in self._clocks:
            first = int(records[stream.time_field][0]) * TIME_FIELDS[stream.time_field]
            self._clocks[stream.system] = _Clock(first, stamps[0])
        clock = self._clock_of(stream)
        if clock is None:
            return []
        boots: dict[int, tuple[list[int], list[int]]] = {}
        stated = records[stream.time_field].tolist() if stream.time_field else [0] * len(records)
        unit = TIME_FIELDS.get(stream.time_field, 0)
        for row, (number, stamp) in enumerate(zip(stated, stamps, strict=True)):
            time_ns = number * unit
            if stream.is_clock:
                if not clock.takes(time_ns, stamp):
                    continue
            elif not unit or abs(time_ns - clock.expected(stamp)) > AGREES_NS:
                time_ns = clock.expected(stamp)
            times, rows = boots.setdefault(clock.boot, ([], []))
            times.append(time_ns)
            rows.append(row)
        return [
            Rows(np.array(times, np.int64), boot, records if len(rows) == len(records) else records[rows])
            for boot, (times, rows) in boots.items()
        ]


def _text_of(raw: bytes, kind: np.dtype[Any]) -> str:
    """The value of a key in a stream's name."""
    if kind.kind == "S":
        return str(fixed_text(np.frombuffer(raw, np.uint8)[None])[0].as_py())
    return thing_text(np.frombuffer(raw, kind)[0].item())
