"""One topic: its decoder, its clock, its stream keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, KEY_IF_SEVERAL, RECEIVED, TIME, ClockMap, field_metadata
from flysid.ingest.formats.base import StreamPart
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.clock import UNIX_NS
from flysid.ingest.formats.common.gather import Bytes, Index
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.px4_keys import px4_key
from flysid.ingest.formats.common.px4_units import px4_topic, px4_unit
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.messages.cbor import cbor_as_json
from flysid.ingest.formats.messages.cdr import Columns, UnevenError, decode
from flysid.ingest.formats.messages.channel import Channel
from flysid.ingest.formats.messages.definitions import (
    DefinitionError,
    MessageType,
    parse_definition,
    units_of,
)
from flysid.ingest.formats.messages.idl import parse_idl
from flysid.ingest.formats.messages.json_schema import decode_json, parse_json_schema
from flysid.ingest.formats.messages.protobuf import decode_protobuf, parse_descriptors
from flysid.ingest.formats.messages.steps import ROS1_WIRE, WIDES, Wire, has_wide, largest_run, plan

MAX_LAGS = 4096
MAX_COLUMNS = 20_000
ZERO_PAGE = 1 << 14
PX4 = "px4_msgs/"
FRAMES = ("header.frame_id", "frame_id", "child_frame_id")
"""Fields with the frame that values are in: of several sensors on one topic each has its own."""
KEYS: Mapping[str, str] = {
    "diagnostic_msgs/KeyValue": "key",
    "mavros_msgs/DebugValue": "name",
    "sensor_msgs/BatteryState": "location",
}
"""Type of message -> a text that tells its things apart."""
NAMES = ("name", "names", "joint_names")
"""Lists that name the elements of the lists beside them, as sensor_msgs/JointState has."""


@dataclass(frozen=True)
class Messages:
    """Payloads data[at : at + size] of one channel, with their log times; all (n,).

    `data` ends with ZERO_PAGE zeros.
    """

    data: Bytes
    at: Index
    size: Index
    log_ns: Index

    def pick(self, which: Index) -> Messages:
        return Messages(self.data, self.at[which], self.size[which], self.log_ns[which])


@dataclass(frozen=True)
class Decoded:
    """Columns of the messages numbered `kept`, in that order, and metadata by column.

    `longer` of the others go on behind what their definition says. `odd` are values that could not be kept.
    """

    columns: Columns
    kept: Index
    notes: Mapping[str, dict[bytes, bytes] | None]
    longer: int = 0
    odd: OddCells | None = None


Decoder = Callable[[Messages], Decoded]


def decoder_for(channel: Channel) -> Decoder:
    """The decoder of a channel's messages. Raises DefinitionError where there is none."""
    if channel.fault:
        raise DefinitionError(channel.fault)
    schema = channel.schema
    kind = schema.encoding if schema is not None else ""
    name, raw = (schema.name, schema.data) if schema is not None else ("", b"")
    if channel.encoding == "json" and kind in ("jsonschema", ""):
        return _json_decoder(raw)
    if channel.encoding == "ros1" and kind == "ros1msg":
        return _ros1_decoder(name, raw.decode("utf-8", "replace"))
    if channel.encoding == "cdr" and kind == "ros2msg":
        return _cdr_decoder(name, parse_definition(name, raw.decode("utf-8", "replace"), 2))
    if channel.encoding == "cdr" and kind in ("ros2idl", "omgidl"):
        return _cdr_decoder(name, parse_idl(name, raw.decode("utf-8", "replace")))
    if channel.encoding == "cbor" and kind in ("jsonschema", ""):
        return _cbor_decoder(raw)
    if channel.encoding == "protobuf" and kind == "protobuf":
        return _protobuf_decoder(name, raw)
    raise DefinitionError(f"encoding {channel.encoding!r} with schema {kind!r} is not known")


def _json_decoder(raw: bytes) -> Decoder:
    layout = parse_json_schema(raw)

    def decode_batch(messages: Messages) -> Decoded:
        odd = OddCells()
        table, kept = decode_json(messages.data, messages.at, messages.size, layout, odd)
        columns = [(n, _whole(c)) for n, c in zip(table.column_names, table.columns, strict=True)]
        return Decoded(columns, kept, layout.notes, odd=odd)

    return decode_batch


def _whole(column: pa.ChunkedArray) -> pa.Array:
    return column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks or [pa.nulls(0)])


def _protobuf_decoder(name: str, raw: bytes) -> Decoder:
    layout = parse_descriptors(name, raw)
    notes = dict(layout.columns())

    def decode_batch(messages: Messages) -> Decoded:
        arrays, kept = decode_protobuf(messages.data, messages.at, messages.size, layout)
        return Decoded(list(zip(notes, arrays, strict=True)), kept, notes)

    return decode_batch


def _ros1_decoder(name: str, text: str) -> Decoder:
    kind = parse_definition(name, text, 1)
    steps = plan(kind)
    notes = _unit_notes(name, kind)
    zeros = largest_run(steps)

    def decode_batch(messages: Messages) -> Decoded:
        data = _pad(messages.data, zeros)
        columns, kept, longer = decode(data, messages.at, messages.size, steps, ROS1_WIRE)
        return Decoded(_taken(columns, kept), kept, notes, longer)

    return decode_batch


def _cbor_decoder(raw: bytes) -> Decoder:
    decode_json_batch = _json_decoder(raw)

    def decode_batch(messages: Messages) -> Decoded:
        texts = cbor_as_json(messages.data, messages.at, messages.size)
        which = np.flatnonzero([text is not None for text in texts])
        size = np.array([len(text) for text in texts if text is not None], dtype=np.int64)
        data = np.frombuffer(b"".join([*filter(None, texts), bytes(ZERO_PAGE)]), dtype=np.uint8)
        found = decode_json_batch(Messages(data, np.cumsum(size) - size, size, messages.log_ns[which]))
        return replace(found, kept=which[found.kept])

    return decode_batch


def _cdr_decoder(name: str, kind: MessageType) -> Decoder:
    steps = plan(kind)
    notes = _unit_notes(name, kind)
    zeros = largest_run(steps)
    wides = WIDES if has_wide(steps) else WIDES[:1]

    def decode_batch(messages: Messages) -> Decoded:
        data = _pad(messages.data, zeros)
        groups = []
        longer = 0
        kinds = np.where(messages.size >= 4, data[messages.at + 1], 255)
        for kind in np.unique(kinds).tolist():
            wire = CDR_WIRES.get(kind)
            which = np.flatnonzero(kinds == kind)
            if wire is not None:
                at = messages.at[which] + 4
                size = messages.size[which] - 4
                tries = (decode(data, at, size, steps, replace(wire, wide=wide)) for wide in wides)
                columns, kept, surplus = max(tries, key=lambda found: len(found[1]))
                groups.append((_taken(columns, kept), which[kept]))
                longer += surplus
        return replace(_merge(groups), notes=notes, longer=longer)

    return decode_batch


def _unit_notes(name: str, kind: MessageType) -> dict[str, dict[bytes, bytes] | None]:
    """Units as the definition's comments state them; for PX4's messages, else as PX4 does."""
    topic = px4_topic(name) if name.startswith(PX4) else ""
    return {
        path: field_metadata(unit or (px4_unit(topic, path) if topic else ""))
        for path, unit in units_of(kind)
    }


# second byte of the encapsulation header; parameter lists (2, 3, 10, 11) have no fixed order
CDR_WIRES: Mapping[int, Wire] = {
    0: Wire(">", 8),
    1: Wire("<", 8),
    6: Wire(">", 4),
    7: Wire("<", 4),
}


def _pad(data: Bytes, zeros: int) -> Bytes:
    """`data`, which ends with ZERO_PAGE zeros, with at least `zeros` of them."""
    return data if zeros <= ZERO_PAGE else np.concatenate([data, np.zeros(zeros, dtype=np.uint8)])


def _taken(columns: Columns, kept: Index) -> Columns:
    """The rows `kept` of every column."""
    if not columns or len(kept) == len(columns[0][1]):
        return columns
    which = arrow_arrays.numeric(kept)
    return [(name, array.take(which)) for name, array in columns]


def _merge(groups: list[tuple[Columns, Index]]) -> Decoded:
    """Groups of rows as one, in the order of the messages."""
    if len(groups) <= 1:
        columns, kept = groups[0] if groups else ([], np.empty(0, dtype=np.int64))
        return Decoded(columns, kept, {})
    kept = np.concatenate([g[1] for g in groups])
    order = np.argsort(kept, kind="stable")
    joined = [
        (name, pa.concat_arrays([g[0][c][1] for g in groups])) for c, (name, _) in enumerate(groups[0][0])
    ]
    which = arrow_arrays.numeric(order)
    return Decoded([(name, array.take(which)) for name, array in joined], kept[order], {})


class Topic:
    """What is known of one channel while its batches pass."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.rows = 0
        self.first_ns = np.iinfo(np.int64).max
        self.last_ns = np.iinfo(np.int64).min
        self.lags: list[int] = []
        self._clock: str | None = None
        self._previous_ns = 0
        self._reason = ""
        try:
            self._decoder: Decoder | None = decoder_for(channel)
        except DefinitionError as error:
            self._decoder = None
            self._reason = str(error)

    @property
    def is_unstamped(self) -> bool:
        """Whether its messages carry no time of their own."""
        return self._clock == "log_time"

    def decode(self, messages: Messages, tally: Tally, taken: dict[str, pa.Schema]) -> Iterator[StreamPart]:
        """The part that a batch gives, if any; `taken` holds the stream keys of all topics."""
        if self._decoder is None:
            tally.undecode(self.channel.topic, len(messages.at), self._reason)
            return
        try:
            decoded = self._decoder(messages)
        except (UnevenError, OverflowError, DefinitionError) as error:
            tally.undecode(self.channel.topic, len(messages.at), str(error))
            return
        if decoded.odd is not None:
            decoded.odd.tell(tally, prefix=f"{self.channel.topic}.", before=self.rows, place="message")
        lost = len(messages.at) - len(decoded.kept)
        tally.undecode(self.channel.topic, decoded.longer, "bytes remain after the end of its definition")
        tally.undecode(self.channel.topic, lost - decoded.longer, "the message does not fit its definition")
        if len(decoded.columns) > MAX_COLUMNS:
            why = f"its definition gives {len(decoded.columns)} columns; at most {MAX_COLUMNS} are read"
            tally.undecode(self.channel.topic, len(decoded.kept), why)
        elif len(decoded.kept):
            table = self._table(messages.log_ns[decoded.kept], decoded, tally)
            yield StreamPart(self._key(table.schema, taken), table)

    def _key(self, schema: pa.Schema, taken: dict[str, pa.Schema]) -> str:
        """The stream of this topic that has this schema; a new one, `~2` on, where none has."""
        number = 1
        key = self.channel.topic
        while key in taken and not taken[key].equals(schema, check_metadata=True):
            number += 1
            key = f"{self.channel.topic}~{number}"
        taken[key] = schema
        return key

    def _table(self, log_ns: Index, decoded: Decoded, tally: Tally) -> pa.Table:
        stamps = own_times(dict(decoded.columns), decoded.notes)
        if self._clock is None:
            self._clock = next((n for n, t in stamps.items() if t.any()), "log_time")
        time_ns = stamps.get(self._clock, log_ns)
        self._observe(time_ns, log_ns, tally)
        names = [TIME, BOOT, RECEIVED]
        arrays = [
            arrow_arrays.numeric(time_ns),
            arrow_arrays.numeric(np.zeros(len(time_ns), dtype=np.int32)),
            arrow_arrays.numeric(log_ns),
        ]
        fields = [pa.field(n, a.type) for n, a in zip(names, arrays, strict=True)]
        used = set(names)
        for name, array in decoded.columns:
            free = arrow_arrays.free_name(name, used)
            used.add(free)
            fields.append(pa.field(free, array.type, metadata=decoded.notes.get(name)))
            arrays.append(array)
        about = self._about() | self._key_of(fields)
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=about))

    def _key_of(self, fields: Sequence[pa.Field]) -> dict[str, str]:
        """The fields that tell several things apart: PX4's, else frames of reference and lists of names."""
        schema = self.channel.schema
        if schema is not None and schema.name.startswith(PX4):
            return px4_key(px4_topic(schema.name), [f.name for f in fields])
        kind = schema.name.replace("/msg/", "/") if schema is not None else ""
        texts = [f.name for f in fields if f.name in (*FRAMES, KEYS.get(kind)) and pa.types.is_string(f.type)]
        names = [f.name for f in fields if f.name in NAMES and f.type == pa.list_(pa.string())]
        found = ",".join([*texts, *names])
        return {KEY_IF_SEVERAL: found} if found else {}

    def _about(self) -> dict[str, str]:
        schema = self.channel.schema
        return {
            "time_source": self._clock or "log_time",
            "message_type": schema.name if schema is not None else "",
            "encoding": self.channel.encoding,
        }

    def _observe(self, time_ns: Index, log_ns: Index, tally: Tally) -> None:
        """Note the span, the distance of log time from stamps, and steps back."""
        back = int((np.diff(time_ns) < 0).sum()) + int(self.rows > 0 and time_ns[0] < self._previous_ns)
        self._previous_ns = int(time_ns[-1])
        if back:
            tally.out_of_order[self.channel.topic] += back
        self.rows += len(time_ns)
        self.first_ns = min(self.first_ns, int(time_ns.min()))
        self.last_ns = max(self.last_ns, int(time_ns.max()))
        if self._clock != "log_time" and len(self.lags) < MAX_LAGS:
            self.lags += (log_ns - time_ns)[:: max(1, len(time_ns) // 64)].tolist()


def log_clock(topics: Sequence[Topic]) -> ClockMap:
    """Log time (UTC) against the messages' own stamps: their median distance, at slope 1."""
    first = min((t.first_ns for t in topics if t.rows), default=0)
    last = max((t.last_ns for t in topics if t.rows), default=0)
    lags = np.array([lag for t in topics for lag in t.lags], dtype=np.int64)
    if len(lags) == 0:
        return ClockMap(0, first, last)
    offset = int(np.median(lags))
    log_is_utc = last + offset > UNIX_NS
    return ClockMap(
        0, first, last, offset if log_is_utc else None, 1.0, int(np.median(np.abs(lags - offset)))
    )


_PARTS = (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos"))
_STAMPS = ("header.stamp", "stamp", "header.timestamp", "timestamp")
_UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def own_times(
    columns: Mapping[str, pa.Array], notes: Mapping[str, dict[bytes, bytes] | None]
) -> dict[str, Index]:
    """Times that the messages state themselves, in ns, the preferred one first."""
    found: dict[str, Index] = {}
    for stamp in _STAMPS:
        for seconds, fraction in _PARTS:
            s = columns.get(f"{stamp}.{seconds}")
            f = columns.get(f"{stamp}.{fraction}")
            if _is_whole(s) and _is_whole(f):
                found[stamp] = _integers(s) * 10**9 + _integers(f)
        unit = ((notes.get(stamp) or {}).get(b"unit", b"")).decode()
        if unit in _UNITS_NS and _is_whole(columns.get(stamp)):
            found[stamp] = _integers(columns[stamp]) * _UNITS_NS[unit]
    return found


def _is_whole(array: pa.Array | None) -> bool:
    return array is not None and pa.types.is_integer(array.type) and array.null_count == 0


def _integers(array: pa.Array) -> Index:
    return arrow_arrays.whole_numbers(array)
