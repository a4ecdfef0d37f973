"""MAVLink telemetry logs (.tlog), raw MAVLink and captures -> one table per (system, component, message).

Layout and framing: see `frames`. The file is read in batches: frames are found, sorted by stream, gathered
into byte matrices and viewed as the message's packed dtype (`columns`); vehicle time comes from
`vehicle_time`. Whether timestamps precede the frames is decided by which reading chains more valid frames at
the start.

Left out: signatures are not verified (a log has no key), and message ids that no dialect of pymavlink
knows are counted as undecoded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import FormatError
from flysid.flight import KEY, ClockMap, Damage
from flysid.ingest.formats.base import HEAD_BYTES, Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.common.capture import is_capture
from flysid.ingest.formats.common.clock import SECOND_NS, SIDE, UNIX_NS, IntArray, is_outlier, last_good
from flysid.ingest.formats.common.columns import (
    ByteMatrix,
    RecordLayout,
    as_array,
    gather,
    message_schema,
)
from flysid.ingest.formats.common.gps_weeks import weeks_lost
from flysid.ingest.formats.common.vehicle_time import Clocked, Source, VehicleTime
from flysid.ingest.formats.mavlink.capture import Capture, holds_mavlink, scan_batch
from flysid.ingest.formats.mavlink.dialect import DEFAULT, Dialect, load_dialect
from flysid.ingest.formats.mavlink.frames import LOOK_AHEAD, STAMP_BYTES, Frames, MessageId, Scanner
from flysid.ingest.formats.mavlink.links import Links
from flysid.ingest.formats.mavlink.parameters import EXTENDED, NUMBERS, Encodings, with_values
from flysid.ingest.formats.mavlink.probing import (
    count_frames,
    first_stamp_bytes,
    knowing_scanner,
    make_scanner,
    may_chain,
    stamp_bytes,
)

PROBE_BYTES = 1 << 20
MAX_STREAMS = 2000
AUTOPILOT_INVALID = 8
TIME_FIELDS = {"time_boot_ms": 1_000_000, "time_boot_us": 1000, "time_usec": 1000, "time_us": 1000}
BOOT_FIELDS = ("time_boot_ms", "time_boot_us")
MAX_NS = (1 << 63) - 1


# ------------------------------------------------------------------------------------------ detection


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Confidence that these bytes begin a tlog or raw MAVLink: do checked frames chain?"""
    behind_zeros = head.lstrip(b"\0")
    if is_capture(behind_zeros):
        return 0.95 if holds_mavlink(behind_zeros, load_dialect().crc_extra) else 0.0
    if not any(may_chain(head, stamp) for stamp in (STAMP_BYTES, 0)):
        return 0.0
    frames, _ = count_frames(head, stamp_bytes(head))
    return 0.95 if frames >= 3 else 0.6 if frames else 0.0


# -------------------------------------------------------------------------------------------- reading


@dataclass
class _Reader:
    """What is remembered between batches."""

    dialect: Dialect
    scanner: Scanner
    time: VehicleTime = field(default_factory=VehicleTime)
    encodings: Encodings = field(default_factory=Encodings)
    weeks_lost: int = 0
    schemas: dict[Source, pa.Schema] = field(default_factory=dict)
    admitted: set[Source] = field(default_factory=set)
    surplus: int = 0
    links: Links = field(default_factory=Links)
    last_stamps: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    bad_stamps: int = 0
    row: int = 0
    vehicles: dict[tuple[int, int], dict[str, str]] = field(default_factory=dict)
    boards: dict[tuple[int, int], dict[str, str]] = field(default_factory=dict)
    arrival_span: tuple[int, int] | None = None
    stamps: str = ""  # where arrivals come from, if not from the frames' stamps


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a tlog, a raw MAVLink file or a capture; see `Format.read`."""
    head = bytes(view[:HEAD_BYTES])
    skipped = len(head) - len(head.lstrip(b"\0"))  # a stamp may begin with zeros, a capture does not
    if is_capture(head[skipped:]):
        summary = yield from _read_capture(view[skipped:], name, limits)
        return replace(summary, damage=summary.damage.behind_zeros(skipped)) if skipped else summary
    stamp = first_stamp_bytes(view)
    reader = _Reader(load_dialect(), make_scanner(DEFAULT, stamp, len(view)))
    position = 0
    while position < len(view):
        start = position
        frames, position = _next_frames(reader.scanner, view, start, limits)
        if start == 0 and reader.scanner.foreign:
            dialect, scanner = knowing_scanner(bytes(view[:PROBE_BYTES]), stamp, len(view))
            if dialect != DEFAULT or scanner.private:
                reader = _Reader(load_dialect(dialect), scanner)
                frames, position = _next_frames(reader.scanner, view, start, limits)
        yield from _parts(reader, frames)
        release(view, start, position)
    if reader.row == 0 and not reader.scanner.unknown:
        raise FormatError("no valid MAVLink frame", path=name, hint="check that this is a telemetry log")
    return _summary(reader)


def _read_capture(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of the MAVLink that a capture holds."""
    capture = Capture(load_dialect().crc_extra)
    reader = None
    for batch, base in capture.batches(view, limits.batch_bytes):
        if reader is None:
            dialect, scanner = knowing_scanner(bytes(batch.data[:PROBE_BYTES]), 0, len(view))
            reader = _Reader(load_dialect(dialect), scanner, stamps="capture")
        yield from _parts(reader, scan_batch(reader.scanner, batch, base))
    if reader is None:
        raise FormatError(
            "no MAVLink in the capture",
            path=name,
            hint="unencrypted UDP and TCP are read, over Ethernet, raw IP, loopback or Linux cooked capture",
        )
    summary = _summary(reader)
    seen = {"captured_twice": str(capture.tally.repeats)} if capture.tally.repeats else {}
    return replace(summary, damage=capture.located(summary.damage), info={**summary.info, **seen})


def frame_batches(view: memoryview, limits: Limits) -> Iterator[tuple[Frames, Dialect, int]]:
    """Valid frames batch by batch, the dialect that knows them, and where in the file the batch ends."""
    stamp = first_stamp_bytes(view)
    name = DEFAULT
    scanner = make_scanner(name, stamp, len(view))
    frames, position = _next_frames(scanner, view, 0, limits)
    if scanner.foreign:
        name, scanner = knowing_scanner(bytes(view[:PROBE_BYTES]), stamp, len(view))
        frames, position = _next_frames(scanner, view, 0, limits)
    yield frames, load_dialect(name), position
    while position < len(view):
        frames, position = _next_frames(scanner, view, position, limits)
        yield frames, load_dialect(name), position


def _next_frames(scanner: Scanner, view: memoryview, start: int, limits: Limits) -> tuple[Frames, int]:
    """Frames of the batch that begins at `start`, and where the next one begins."""
    stop = start + limits.batch_bytes
    if stop + LOOK_AHEAD >= len(view):
        return scanner.scan(as_array(view[start:]), start, len(view) - start)
    return scanner.scan(as_array(view[start : stop + LOOK_AHEAD]), start, limits.batch_bytes)


def _parts(reader: _Reader, frames: Frames) -> Iterator[StreamPart]:
    """The tables of one batch."""
    frames = reader.links.counted(frames)
    if not len(frames):
        return
    arrival, placing, has_utc = _arrival(reader, frames)
    groups = _admit(reader, dict(_streams(frames)))
    clocked: dict[Source, Clocked] = {}
    for source, rows in groups.items():
        layout = reader.dialect.layout(source[2])
        if source[2] == MessageId.HEARTBEAT:
            _note_vehicle(reader, source, _matrix(frames, rows, layout), layout)
        elif source[2] == MessageId.AUTOPILOT_VERSION:
            _note_board(reader, source, _matrix(frames, rows, layout), layout)
        elif source[2] == MessageId.SYSTEM_TIME:
            _note_date(reader, _matrix(frames, rows, layout), layout)
        if (name := _time_field(layout)) is not None:
            clocked[source] = reader.time.unwrapped(_read_clock(source, name, rows, frames, layout))
    reader.time.begin(list(clocked.values()), placing, utc=has_utc)
    for source, rows in groups.items():
        time_ns, boots = reader.time.times(source, rows, clocked.get(source))
        matrix = _matrix(frames, rows, reader.dialect.layout(source[2]))
        yield _table(reader, source, matrix, (time_ns, boots), arrival[rows] if has_utc else None)
    reader.row += len(frames)


def _admit(reader: _Reader, groups: dict[Source, IntArray]) -> dict[Source, IntArray]:
    """Streams within the bound on their number; messages of others are counted, not decoded.

    Real traffic has some hundred streams. A forged log can name 65,536 senders, each with its own tables.
    """
    kept = {}
    for source, rows in groups.items():
        if source in reader.admitted or len(reader.admitted) < MAX_STREAMS:
            reader.admitted.add(source)
            kept[source] = rows
        else:
            reader.surplus += len(rows)
    return kept


def _matrix(frames: Frames, rows: IntArray, layout: RecordLayout) -> ByteMatrix:
    return gather(frames.buffer, frames.payload[rows], frames.length[rows], layout.size)


def _arrival(reader: _Reader, frames: Frames) -> tuple[IntArray, IntArray, bool]:
    """Arrival in ns UTC as stated, the arrival to place frames by, and whether there is any.

    Frames whose timestamp damage took get their predecessor's. Stamps that stand apart from their
    neighbours are kept as they are and counted; their frames are placed by the stamp before. Frames of a
    log without timestamps are placed by their position.
    """
    if frames.stamp_us is None:
        order = np.arange(reader.row, reader.row + len(frames), dtype=np.int64)
        return order, order, False
    stated = np.concatenate([reader.last_stamps, frames.stamp_us * 1000])
    missing = stated < 0
    stated = last_good(stated, missing)
    wrong = is_outlier(stated)
    placing = last_good(stated, wrong)[len(reader.last_stamps) :]
    reader.bad_stamps += int((missing | wrong)[len(reader.last_stamps) :].sum())
    stated = stated[len(reader.last_stamps) :]
    reader.last_stamps = placing[-SIDE:].copy()
    low, high = reader.arrival_span or (int(placing[0]), int(placing[0]))
    reader.arrival_span = (min(low, int(placing.min())), max(high, int(placing.max())))
    return stated, placing, True


def _streams(frames: Frames) -> Iterator[tuple[Source, IntArray]]:
    """(system, component, message id) and the rising row numbers of its frames."""
    senders, who = _dense(frames.senders())
    messages, what = _dense(frames.message)
    codes = who * len(messages) + what
    order = np.argsort(codes.astype(np.uint16) if codes.max() < 1 << 16 else codes, kind="stable")
    counts = np.bincount(codes)
    present = np.flatnonzero(counts)
    edges = np.concatenate([[0], np.cumsum(counts[present])])
    for i, code in enumerate(present.tolist()):
        sender, message = divmod(code, len(messages))
        key = (*divmod(int(senders[sender]), 256), int(messages[message]))
        yield key, order[edges[i] : edges[i + 1]]


def _dense(values: IntArray) -> tuple[IntArray, IntArray]:
    """(distinct values rising, index of each value among them), for small non-negative integers."""
    present = np.flatnonzero(np.bincount(values))
    place = np.zeros(int(present[-1]) + 1, dtype=np.int64)
    place[present] = np.arange(len(present))
    return present, place[values]


def _time_field(layout: RecordLayout) -> str | None:
    """The field that carries the vehicle's clock, if the message has one."""
    names = layout.dtype.names or ()
    return next((f for f in TIME_FIELDS if f in names), None)


def _read_clock(source: Source, name: str, rows: IntArray, frames: Frames, layout: RecordLayout) -> Clocked:
    """The times that a stream states; only the bytes of that field are gathered."""
    kind, at = layout.dtype.fields[name][:2]  # type: ignore[index]
    width = kind.itemsize
    left = np.clip(frames.length[rows] - at, 0, width)
    bare = RecordLayout(name, np.dtype([(name, kind)]), ())
    matrix = gather(frames.buffer, frames.payload[rows] + at, left, width)
    unit = TIME_FIELDS[name]
    time_ns = np.minimum(_field_values(matrix, bare, name), MAX_NS // unit) * unit
    return Clocked(source, name, rows, time_ns, name in BOOT_FIELDS, (1 << 32) * unit if width == 4 else 0)


def _field_values(matrix: ByteMatrix, layout: RecordLayout, name: str) -> IntArray:
    values: npt.NDArray[np.uint64] = matrix.view(layout.dtype).reshape(len(matrix))[name]
    return np.minimum(values, np.uint64((1 << 63) - 1)).astype(np.int64)


def _note_vehicle(reader: _Reader, source: Source, matrix: ByteMatrix, layout: RecordLayout) -> None:
    autopilots, kinds = (_field_values(matrix, layout, name) for name in ("autopilot", "type"))
    for autopilot in np.unique(autopilots).tolist():
        reader.encodings.note_autopilot(source[:2], autopilot)
    facts = vehicle_facts(reader.dialect, autopilots, kinds)
    if facts:
        reader.time.vehicles.add(source[0])
        reader.vehicles.setdefault(source[:2], facts)


def vehicle_facts(
    dialect: Dialect, autopilots: npt.NDArray[np.integer], kinds: npt.NDArray[np.integer]
) -> dict[str, str]:
    """What heartbeats tell of a vehicle; nothing where none of them (n,) is an autopilot's."""
    real = autopilots != AUTOPILOT_INVALID
    if not real.any():
        return {}
    first = int(np.argmax(real))
    return {
        "autopilot": _short(dialect.enum_name("MAV_AUTOPILOT", int(autopilots[first]))),
        "vehicle": _short(dialect.enum_name("MAV_TYPE", int(kinds[first]))),
    }


def _note_board(reader: _Reader, source: Source, matrix: ByteMatrix, layout: RecordLayout) -> None:
    """The board's own number, 18 bytes; major, minor and patch of flight_sw_version, highest byte first."""
    board = reader.boards.setdefault(source[:2], {})
    number = matrix.view(layout.dtype).reshape(len(matrix))["uid2"][-1]
    if number.any():
        board["uid2"] = number.tobytes().hex()
    reader.encodings.note_capabilities(source[:2], int(_field_values(matrix, layout, "capabilities")[-1]))
    version = int(_field_values(matrix, layout, "flight_sw_version")[-1])
    if version:
        board["firmware"] = ".".join(str(version >> shift & 255) for shift in (24, 16, 8))


def _identity(reader: _Reader) -> dict[str, str]:
    """Whose log it is: the autopilot of the system whose clock counts, and no other's board.

    Cameras, gimbals and a second vehicle state their versions, too, and at any time.
    """
    senders = sorted(reader.vehicles, key=lambda sender: (sender[0] != reader.time.main, sender[1] != 1))
    if senders:
        return {**reader.vehicles[senders[0]], **reader.boards.get(senders[0], {})}
    return next(iter(reader.boards.values())) if len(reader.boards) == 1 else {}


def _note_date(reader: _Reader, matrix: ByteMatrix, layout: RecordLayout) -> None:
    """Whether the vehicle's own dates lack weeks; UTC comes from the arrivals."""
    stated_us = _field_values(matrix, layout, "time_unix_usec")
    dates_us = stated_us[(stated_us > UNIX_NS // 1000) & (stated_us < MAX_NS // 1000)]
    reader.weeks_lost = max(reader.weeks_lost, weeks_lost(dates_us * 1000))


def _short(enum_name: str) -> str:
    """MAV_AUTOPILOT_ARDUPILOTMEGA -> ardupilotmega."""
    return enum_name.removeprefix("MAV_AUTOPILOT_").removeprefix("MAV_TYPE_").lower()


def _table(
    reader: _Reader,
    source: Source,
    matrix: ByteMatrix,
    times: tuple[IntArray, IntArray],
    received: IntArray | None,
) -> StreamPart:
    layout = reader.dialect.layout(source[2])
    if source not in reader.schemas:
        metadata = {
            "time_source": reader.time.source_of(source),
            "system": str(source[0]),
            "component": str(source[1]),
            "message": layout.name,
        }
        if key := reader.dialect.key(source[2]):
            metadata[KEY] = key
        reader.schemas[source] = message_schema(layout.columns, metadata, received=received is not None)
    heads = times if received is None else (*times, received)
    table = layout.table(reader.schemas[source], heads, matrix)
    if layout.name in NUMBERS | EXTENDED:
        records = matrix.view(layout.dtype).reshape(len(matrix))
        table = with_values(table, reader.encodings, layout.name, source[:2], records)
    return StreamPart(f"{source[0]}.{source[1]}/{layout.name}", table)


# -------------------------------------------------------------------------------------------- summary


def _summary(reader: _Reader) -> Summary:
    scanner = reader.scanner
    outliers = {_key(reader, source): n for source, n in sorted(reader.time.outliers.items())}
    late = {_key(reader, source): n for source, n in sorted(reader.time.out_of_order.items())}
    if reader.bad_stamps:
        outliers["recv_ns"] = reader.bad_stamps
    undecoded = {_key(reader, source): n for source, n in sorted(scanner.unknown.items())}
    if reader.surplus:
        undecoded[f"streams beyond {MAX_STREAMS:,}"] = reader.surplus
    damage = Damage(
        bytes_skipped=scanner.bytes_skipped,
        regions=tuple(scanner.regions),
        region_count=scanner.region_count,
        bad_checksums=scanner.bad_checksums,
        truncated=scanner.truncated,
        undecoded=undecoded,
        time_outliers=outliers,
        out_of_order=late,
        reasons=_private(reader),
        sequence_gaps=reader.links.by_sender("lost"),
        silence_gaps=reader.links.by_sender("hidden"),
        repeats=reader.links.by_sender("repeated"),
    )
    return Summary(damage, _clocks(reader), _info(reader))


def _private(reader: _Reader) -> dict[str, str]:
    """Why messages were not decoded whose number the dialect gives to another message."""
    private = reader.scanner.private
    return {
        _key(reader, source): f"of a private dialect, in which {source[2]} is not "
        f"{reader.dialect.message_name(source[2])}: its checksums hold with the seed {private[source[2]]}"
        for source in sorted(reader.scanner.unknown)
        if source[2] in private
    }


def _key(reader: _Reader, source: Source) -> str:
    is_private = source[2] in reader.scanner.private
    name = f"#{source[2]}" if is_private else reader.dialect.message_name(source[2])
    return f"{source[0]}.{source[1]}/{name}"


def _clocks(reader: _Reader) -> tuple[ClockMap, ...]:
    clocks = reader.time.fit().clocks()
    if clocks or reader.arrival_span is None:
        return clocks
    return (ClockMap(0, *reader.arrival_span, utc_offset_ns=0),)


def _info(reader: _Reader) -> Mapping[str, str]:
    stamps = reader.stamps or ("arrival" if reader.scanner.stamp else "none")
    main = "" if reader.time.main is None else str(reader.time.main)
    notes = []
    if found := reader.time.leapt.get(reader.time.main or 0):
        sizes = ", ".join(f"{ns / SECOND_NS:,.1f} s before boot {boot}" for boot, ns in sorted(found.items()))
        notes.append(f"the vehicle's clock leapt ahead of the arrivals by {sizes}; cut there")
    fit = reader.time.fit()
    for boot in sorted(fit.first_ns):
        if times := fit.set_by(boot):
            count = len(times) - 1
            more = f", and {'once' if count == 1 else f'{count} times'} more" if count else ""
            notes.append(
                f"the station's clock was set by {times[0] / SECOND_NS:+,.1f} s in boot {boot}{more}, or the "
                "link was later by as much from then on; the UTC is that of the longest part"
            )
    if reader.weeks_lost:
        notes.append(
            f"the vehicle's own dates (SYSTEM_TIME) lie {reader.weeks_lost:,} weeks low, as its GPS receiver "
            "counts weeks in ten bits; they are kept as recorded"
        )
    note = {"clock_note": "; ".join(notes)} if notes else {}
    about = {"dialect": reader.dialect.name, "timestamps": stamps, "clock_system": main}
    return {**about, **note, **_identity(reader)}
