"""JSON lines as pymavlink's `mavlogdump --format json` prints them, of telemetry and of DataFlash logs.

    {"meta": {"type": "ATTITUDE", "timestamp": 1.5, "srcSystem": 1, "srcComponent": 1}, "data": {"roll": 0.1}}

Messages that the MAVLink dialect knows get its types, units and enumerations; those of DataFlash get the
types that its FMT lines state. The sender stands in a line only where `--show-source` was asked for. Vehicle
time is made as for a .tlog. A line that is no such object, or that does not fit its message, is counted. A
last line needs no end: its brackets show that it is whole.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.errors import FormatError
from flysid.flight import BOOT, KEY, RECEIVED, TIME
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary
from flysid.ingest.formats.common.columns import Field, IntArray, numbers, schema_field
from flysid.ingest.formats.common.line_batches import whole_lines
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.common.vehicle_time import Clocked, Source, VehicleTime
from flysid.ingest.formats.dataflash.layouts import Definitions, Units
from flysid.ingest.formats.dataflash.reader import firmware_in
from flysid.ingest.formats.dataflash.reader import vehicle_facts as on_board
from flysid.ingest.formats.mavlink.dialect import KEYS, load_dialect
from flysid.ingest.formats.mavlink.parameters import NUMBERS, REAL32, SENT, VALUE, Encodings
from flysid.ingest.formats.mavlink.reader import AUTOPILOT_INVALID, vehicle_facts
from flysid.ingest.formats.messages.json_schema import as_numbers

MAX_LINE_BYTES = 1 << 20
MOST_FIELDS = 255  # of a message: the bytes that it may have
MOST_ROWS = 1 << 16  # of a part: a line without most of its fields is short, a row of its table is not
MAX_NS = 1 << 62
HEADS = (TIME, BOOT, RECEIVED)
BAD_DATA = "BAD_DATA"  # what mavlogdump prints for bytes that it could not read
UNKNOWN_SYSTEM = 0  # no line says who sent it
FIRST_OTHER = 1 << 24  # beyond the ids of MAVLink
TIME_FIELDS: Mapping[str, int] = {
    "TimeUS": 1000,
    "time_boot_ms": 1_000_000,
    "time_boot_us": 1000,
    "time_usec": 1000,
    "time_us": 1000,
}
BOOT_FIELDS = ("TimeUS", "time_boot_ms", "time_boot_us")
# letters of FMT: text, and whole numbers; all others are printed as fractions
TEXT_LETTERS = frozenset("nNZ")
WHOLE_LETTERS = frozenset("bBhHiIMqQ")
LIST_LETTER = "a"


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Certain where the first whole line is such an object."""
    line, end, _ = head.partition(b"\n")
    return 0.99 if end and line.startswith(b'{"meta"') and _message_of(line) is not None else 0.0


@dataclass(frozen=True)
class _Message:
    """One line: its type, who sent it, when it arrived, and its fields."""

    kind: str
    sender: tuple[int, int]
    stamp_ns: int
    data: Mapping[str, Any]


@dataclass
class _Reader:
    """What is remembered between batches."""

    tally: Tally = field(default_factory=Tally)
    time: VehicleTime = field(default_factory=VehicleTime)
    schemas: dict[Source, pa.Schema] = field(default_factory=dict)
    ids: dict[str, int] = field(default_factory=dict)
    formats: dict[str, dict[str, pa.DataType]] = field(default_factory=dict)
    definitions: Definitions = field(default_factory=Definitions)
    units: Units = field(default_factory=Units)
    encodings: Encodings = field(default_factory=Encodings)
    rows: dict[Source, int] = field(default_factory=dict)
    odd: OddCells = field(default_factory=OddCells)
    lost_to: int = -1
    info: dict[str, str] = field(default_factory=dict)
    parameters: set[str] = field(default_factory=set)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a log; see `Format.read`."""
    reader = _Reader()
    count = 0
    for lines in whole_lines(view, 0, limits.batch_bytes, MAX_LINE_BYTES, _ending):
        messages = list(_messages(reader, lines.data, lines.start))
        count += len(messages)
        yield from _parts(reader, messages)
        reader.tally.truncated |= lines.is_cut
        reader.tally.skip(lines.end, lines.stop, lines.fault)
    if not count:
        raise FormatError(
            "no line is a message of mavlogdump",
            path=name,
            byte=0,
            hint="write it with: mavlogdump.py --format json",
        )
    reader.odd.tell(reader.tally, place="message")
    for source, rejected in reader.time.outliers.items():
        reader.tally.time_outliers[_stream(reader, source)] += rejected
    for source, late in reader.time.out_of_order.items():
        reader.tally.out_of_order[_stream(reader, source)] += late
    return Summary(reader.tally.freeze(), reader.time.fit().clocks(), _about(reader))


def _about(reader: _Reader) -> dict[str, str]:
    """Whose log it is: by the heartbeats of telemetry, by the banner or the parameters of a log on board."""
    known = reader.info if "autopilot" in reader.info else {}
    if not known and (reader.formats or reader.parameters or reader.info):
        known = on_board(reader.info, reader.parameters)
    return {"printed_by": "mavlogdump", **known}


# ----------------------------------------------------------------------------------------------- lines


def _messages(reader: _Reader, data: bytes, base: int) -> Iterator[_Message]:
    """The messages of some lines; blank lines count as lost only beside lines that are."""
    at = base
    sound_to = base
    for line in data.splitlines(keepends=True):
        at += len(line)
        message = _message_of(line)
        if message is not None:
            sound_to = at
        if message is not None and message.kind == BAD_DATA:
            reader.tally.undecode(BAD_DATA, 1, "bytes that mavlogdump could not read")
        elif message is not None:
            yield message
        elif line.strip() or reader.lost_to == at - len(line):
            reader.tally.skip(sound_to, at, "no message")
            sound_to = at
            reader.lost_to = at


def _ending(line: bytes, before: bytes) -> bytes:  # noqa: ARG001
    """A last line without its end, where it is whole: an object ends with a bracket of its own."""
    return line if _message_of(line) is not None else b""


def _message_of(line: bytes) -> _Message | None:
    """The message in a line; None where there is none."""
    try:
        found = json.loads(line)
        meta = found["meta"]
        data = found["data"]
        stamp_ns = round(meta["timestamp"] * 1e9)
        sender = (int(meta.get("srcSystem", UNKNOWN_SYSTEM)), int(meta.get("srcComponent", UNKNOWN_SYSTEM)))
        kind = meta["type"]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None
    sound = isinstance(kind, str) and kind.isprintable() and kind and isinstance(data, dict)
    within = abs(stamp_ns) < MAX_NS and all(0 <= part < 256 for part in sender)
    return _Message(kind, sender, stamp_ns, data) if sound and within else None


# --------------------------------------------------------------------------------------------- streams


def _parts(reader: _Reader, messages: list[_Message]) -> Iterator[StreamPart]:
    """The messages of a batch, stream by stream."""
    groups: dict[Source, list[int]] = {}
    for row, message in enumerate(messages):
        if message.kind == "FMT":
            _note_format(reader, message.data)
        elif message.kind == "FMTU":
            _note_units(reader, message.data)
        groups.setdefault(_source(reader, message), []).append(row)
        _note_encoding(reader.encodings, message)
        _note_vehicle(reader, message)
    arrival = np.array([message.stamp_ns for message in messages], dtype=np.int64)
    clocked = {}
    for source, rows in groups.items():
        found = _read_clock(source, rows, messages)
        if found is not None:
            clocked[source] = reader.time.unwrapped(found)
    if len(messages):
        reader.time.begin(list(clocked.values()), arrival, utc=True)
    for source, rows in groups.items():
        picked = np.array(rows, dtype=np.int64)
        times = reader.time.times(source, picked, clocked.get(source))
        for at in range(0, len(rows), MOST_ROWS):
            some = slice(at, at + MOST_ROWS)
            chosen = [messages[row] for row in rows[some]]
            yield _part(reader, source, chosen, (times[0][some], times[1][some]), arrival[picked[some]])


def _note_vehicle(reader: _Reader, message: _Message) -> None:
    """What a message tells of the vehicle: the first that does counts."""
    data = message.data
    if message.kind == "HEARTBEAT" and data.get("autopilot") != AUTOPILOT_INVALID:
        reader.time.vehicles.add(message.sender[0])
        kinds = [data.get("autopilot"), data.get("type")]
        if "autopilot" not in reader.info and all(isinstance(kind, int) for kind in kinds):
            autopilot, kind = (np.array([value]) for value in kinds)
            reader.info |= vehicle_facts(load_dialect(), autopilot, kind)
    elif message.kind == "MSG" and "firmware" not in reader.info:
        reader.info |= firmware_in([str(data.get("Message", ""))])
    elif message.kind == "PARM":
        reader.parameters.add(str(data.get("Name", "")))


def _note_encoding(encodings: Encodings, message: _Message) -> None:
    """What a message tells of how its sender packs parameters."""
    told = message.data.get(
        {"HEARTBEAT": "autopilot", "AUTOPILOT_VERSION": "capabilities"}.get(message.kind, "")
    )
    if isinstance(told, int) and message.kind == "HEARTBEAT":
        encodings.note_autopilot(message.sender, told)
    elif isinstance(told, int):
        encodings.note_capabilities(message.sender, told)


def _source(reader: _Reader, message: _Message) -> Source:
    known = _mavlink_ids().get(message.kind)
    number = reader.ids.setdefault(message.kind, FIRST_OTHER + len(reader.ids) if known is None else known)
    return (*message.sender, number)


def _stream(reader: _Reader, source: Source) -> str:
    kind = next(name for name, number in reader.ids.items() if number == source[2])
    return f"{source[0]}.{source[1]}/{kind}" if source[0] or source[1] else kind


def _read_clock(source: Source, rows: list[int], messages: list[_Message]) -> Clocked | None:
    """The times that a stream states, where all its rows do."""
    name = next((name for name in TIME_FIELDS if name in messages[rows[0]].data), None)
    if name is None:
        return None
    unit = TIME_FIELDS[name]
    stated = [messages[row].data.get(name) for row in rows]
    fits = [isinstance(value, int) and 0 <= value < MAX_NS // unit for value in stated]
    if not any(fits):
        return None
    chosen = [row for row, fit in zip(rows, fits, strict=True) if fit]
    if len(chosen) < len(rows):
        return None
    time_ns = np.array(stated, dtype=np.int64) * unit
    period = (1 << 32) * unit if name in ("time_boot_ms", "time_boot_us") else 0
    return Clocked(source, name, np.array(rows, dtype=np.int64), time_ns, name in BOOT_FIELDS, period)


def _note_format(reader: _Reader, data: Mapping[str, Any]) -> None:
    """The types of a DataFlash message, as its FMT line states them."""
    name, letters, columns = (data.get(key) for key in ("Name", "Format", "Columns"))
    if isinstance(name, str) and isinstance(letters, str) and isinstance(columns, str):
        kinds = {
            column: _kind_of(letter)
            for column, letter in zip(columns.split(","), letters[:MOST_FIELDS], strict=False)
        }
        reader.formats.setdefault(name, kinds)
        number, length = (data.get(key) for key in ("Type", "Length"))
        if isinstance(number, int) and isinstance(length, int):
            reader.definitions.add(number, length, name, letters, columns)


def _note_units(reader: _Reader, data: Mapping[str, Any]) -> None:
    """The units of a DataFlash message, as its FMTU line states them."""
    number, units = (data.get(key) for key in ("FmtType", "UnitIds"))
    if isinstance(number, int) and isinstance(units, str):
        reader.units.of_message[number] = (units, "")


def _key(reader: _Reader, source: Source, message: _Message) -> str:
    """The fields that tell to which of several things a message belongs; "" where there are none."""
    if source[2] < FIRST_OTHER:
        return load_dialect().key(source[2])
    named = (d for d in reader.definitions.items if d.name == message.kind and d.layout is not None)
    definition = next(named, None)
    if definition is not None:
        return reader.units.apply(definition)[1]
    field = KEYS.get(message.kind, "")  # of a dialect that has more messages
    return field if field in message.data else ""


def _kind_of(letter: str) -> pa.DataType:
    if letter in TEXT_LETTERS:
        return pa.string()
    if letter == LIST_LETTER:
        return pa.list_(pa.int64())
    return pa.int64() if letter in WHOLE_LETTERS else pa.float64()


@cache
def _mavlink_ids() -> Mapping[str, int]:
    module = load_dialect()._module
    return {str(kind.msgname): int(number) for number, kind in module.mavlink_map.items()}


# --------------------------------------------------------------------------------------------- columns


def _part(
    reader: _Reader,
    source: Source,
    messages: list[_Message],
    times: tuple[IntArray, IntArray],
    arrival: IntArray,
) -> StreamPart:
    stream = _stream(reader, source)
    if source not in reader.schemas:
        reader.schemas[source] = _schema(reader, source, messages)
    schema = reader.schemas[source]
    own = [(item, item.name.removesuffix("_") if item.name[:-1] in HEADS else item.name) for item in schema]
    own = own[len(HEADS) :]
    before = reader.rows.get(source, 0)
    reader.rows[source] = before + len(messages)
    columns = [
        _column(reader, f"{stream}.{item.name}", item.type, [m.data.get(key) for m in messages], before)
        for item, key in own
    ]
    _count_strangers(reader, stream, {key for _, key in own}, messages)
    if messages[0].kind in NUMBERS:
        at = next(k for k, (item, _) in enumerate(own) if item.name == VALUE)
        columns[at] = _parameters(reader, f"{stream}.{VALUE}", messages, before)
    heads = [numbers(times[0]), numbers(times[1].astype(np.int32)), numbers(arrival)]
    return StreamPart(stream, pa.Table.from_arrays([*heads, *columns], schema=schema))


def _schema(reader: _Reader, source: Source, messages: list[_Message]) -> pa.Schema:
    """time_ns, boot, recv_ns, then the message's fields."""
    own = list(load_dialect().layout(source[2]).columns) if source[2] < FIRST_OTHER else []
    first = messages[0]
    if not own:
        kinds = reader.formats.get(first.kind) or _guesses(messages)
        own = [schema_field(Field(name), kind) for name, kind in kinds.items()]
    heads = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32()), pa.field(RECEIVED, pa.int64())]
    if first.kind in NUMBERS:
        own = [item.with_type(pa.float64()) if item.name == VALUE else item for item in own]
    fields = [item.with_name(item.name + "_") if item.name in HEADS else item for item in own]
    metadata = {"time_source": reader.time.source_of(source), "message": first.kind}
    if key := _key(reader, source, first):
        metadata[KEY] = key
    if any(first.sender):
        metadata |= {"system": str(source[0]), "component": str(source[1])}
    return pa.schema(heads + fields, metadata=metadata)


def _guesses(messages: list[_Message]) -> dict[str, pa.DataType]:
    """The types of fields that no definition states: what most of the first values are."""
    values: dict[str, list[object]] = {}
    for message in messages:
        for name, value in message.data.items():
            if name in values or len(values) < MOST_FIELDS:
                values.setdefault(name, []).append(value)
    return {name: _guess([v for v in told if v is not None]) for name, told in values.items()}


def _guess(values: list[object]) -> pa.DataType:
    lists, texts = (sum(isinstance(value, kind) for value in values) for kind in (list, str))
    if 2 * lists > len(values):
        return pa.list_(pa.float64())
    return pa.string() if 2 * texts > len(values) else pa.float64()


def _column(reader: _Reader, name: str, kind: pa.DataType, values: list[Any], before: int) -> pa.Array:
    """A column; null where a value does not fit its type, and counted, behind as many rows before."""
    try:
        return pa.array(values, kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        pass
    if pa.types.is_floating(kind):
        array, wrong = as_numbers(values)
        if wrong:
            reader.odd.note(name, [before + 1 + place for place in wrong], str(values[wrong[0]]))
        return array.cast(kind)
    fits = [_fits(value, kind) for value in values]
    reader.tally.undecode(name, fits.count(False), f"not {kind}")
    return pa.array([v if fit else None for v, fit in zip(values, fits, strict=True)], kind)


def _parameters(reader: _Reader, name: str, messages: list[_Message], before: int) -> pa.Array:
    """The values of parameters; null, and noted, where bytes of an integer were printed as no number."""
    with np.errstate(over="ignore"):
        printed = np.array([_number(m.data.get(VALUE)) for m in messages], dtype=np.float64).astype(
            np.float32
        )
    kinds = np.array([_number(m.data.get("param_type"), 0) for m in messages]).astype(np.int64)
    owners = []
    for message in messages:
        target = [_number(message.data.get(f"target_{part}"), 0) for part in ("system", "component")]
        system, component = message.sender if message.kind == SENT else (int(part) for part in target)
        owners.append(system * 256 + component)
    found = reader.encodings.decode(np.array(owners), printed, kinds)
    lost = np.isnan(printed) & (kinds != REAL32)
    if lost.any():
        reader.odd.note(name, (before + 1 + np.flatnonzero(lost)).tolist(), "NaN")
    kept = zip(found.tolist(), lost.tolist(), strict=True)
    return pa.array([None if is_lost else value for value, is_lost in kept], pa.float64())


def _number(value: object, instead: float = float("nan")) -> float:
    """A printed number; `instead` where it is none."""
    return float(value) if isinstance(value, int | float) else instead


def _fits(value: object, kind: pa.DataType) -> bool:
    try:
        pa.array([value], kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        return False
    return True


def _count_strangers(reader: _Reader, stream: str, names: set[str], messages: list[_Message]) -> None:
    """Fields that the message does not have: names that damage made, or those of another dialect."""
    for message in messages:
        for name in message.data.keys() - names:
            reader.tally.undecode(
                f"{stream}.{printable(name)[:40]}", 1, "a field that the message does not have"
            )


def printable(name: str) -> str:
    """A name without control characters."""
    return "".join(c if c.isprintable() else "?" for c in name)
