"""Blackbox logs of Betaflight, INAV, Cleanflight and Rotorflight -> tables, on the flight controller's clock.

Streams: `main` (I and P frames: what the control loop saw and did), `slow` (S: modes and states), `gps` (G),
`home` (H), `events` (E) and `parameters` (the header). One file often holds several logs, one per arming.
They are its boots, in order, as each has a header and maybe a clock of its own; headers without frames
count too, so that the numbers are those of other readers. Frames of a later log with other fields begin a
stream with "~2".

Logs of Betaflight before 4.0 hold sticks, not setpoints: the stream `setpoint` has what the header's rates
make of them.

`time_ns` is the field `time` where frames have one. Slow frames, events and header lines are written between
main frames, and have the time of the main frame before them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import FormatError
from flysid.flight import BOOT, TIME, ClockMap, field_metadata
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.blackbox.codes import EventKind
from flysid.ingest.formats.blackbox.encodings import ByteArray, IntArray
from flysid.ingest.formats.blackbox.frames import Block, Rows, Walker, content_end
from flysid.ingest.formats.blackbox.header import (
    START,
    Header,
    find_logs,
    is_sound,
    numbers_of,
    read_header,
)
from flysid.ingest.formats.blackbox.layouts import (
    EVENTS,
    STREAMS,
    YES_OR_NO,
    Layout,
    LayoutError,
    layout_of,
    meanings,
)
from flysid.ingest.formats.blackbox.setpoint import Rates, rates_of
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.tally import Tally

AT_THE_START = 1.0
FURTHER_ON = 0.96
US_NS = 1000
_START_TIME = re.compile(r"[1-9]\d{3}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?([+-]\d\d:\d\d|Z)")


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """1 where the first line is a blackbox log's; 0.96 where a later one is."""
    if head.startswith(START):
        return AT_THE_START
    return FURTHER_ON if START in head else 0.0


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a blackbox file.

    Raises
    ------
    FormatError : it holds no blackbox log.
    """
    starts = find_logs(view)
    if not starts:
        raise FormatError(
            "no blackbox log: the line 'H Product:Blackbox flight data recorder ...' is missing",
            path=name,
            byte=0,
            hint="download the log from the flight controller again",
        )
    reader = _Reader(view, limits)
    reader.skip_front(starts[0])
    for boot, (start, stop) in enumerate(zip(starts, [*starts[1:], len(view)], strict=True)):
        yield from reader.log(boot, start, stop)
        release(view, start, stop)
    return Summary(reader.tally.freeze(), tuple(reader.clocks), reader.info)


@dataclass
class _Log:
    """One log while it is read: rows without a time wait for the first main frame."""

    boot: int
    header: Header
    layout: Layout | None = None
    first_us: int = -1
    last_us: int = -1
    waiting: list[tuple[str, Rows]] = field(default_factory=list)


class _Reader:
    """What is remembered between the logs of a file."""

    def __init__(self, view: memoryview, limits: Limits) -> None:
        self.tally = Tally()
        self.clocks: list[ClockMap] = []
        self.info: dict[str, str] = {}
        self._view = view
        self._limits = limits
        self._raw: ByteArray = np.frombuffer(view, dtype=np.uint8)
        self._schemas: dict[str, list[pa.Schema]] = {}

    def skip_front(self, start: int) -> None:
        """Bytes before the first log."""
        end = content_end(self._raw, 0, start)
        self.tally.skip(0, end, "before the first log")

    def log(self, boot: int, start: int, stop: int) -> Iterator[StreamPart]:
        """The parts of one log."""
        header = read_header(self._view, start, stop)
        for region in header.damaged:
            self.tally.skip(region.start, region.end, region.reason)
        log = _Log(boot, header)
        self._learn(header)
        if header.cut:
            self.tally.skip(header.end, stop, "cut off inside the header")
            self.tally.truncated |= stop == len(self._raw)
        else:
            yield from self._frames(log, stop)
        yield from self._outstanding(log)
        yield self._parameters(log)
        first_us = max(log.first_us, 0)
        last_us = max(log.last_us, 0)
        self.clocks.append(ClockMap(boot, first_us * US_NS, last_us * US_NS, *_utc(header, first_us)))

    def _learn(self, header: Header) -> None:
        """Facts about the vehicle, of the first log; what later logs say stands in their parameters."""
        for line in header.lines:
            if not is_sound(line):
                self.tally.undecode("parameters", why=f"the header line at byte {line.start} is damaged")
        if self.info:
            return
        name, version = header.firmware
        known = {
            "autopilot": name,
            "firmware": ".".join(map(str, version)),
            "vehicle": header.text("Craft name").strip(),
            "firmware_revision": header.text("Firmware revision"),
            "board": header.text("Board information").strip(),
        }
        self.info = {key: text for key, text in known.items() if text}

    # ------------------------------------------------------------------------------------------- frames

    def _frames(self, log: _Log, stop: int) -> Iterator[StreamPart]:
        start = log.header.end
        try:
            log.layout = layout_of(log.header)
        except LayoutError as error:
            self._give_up(start, stop, str(error))
            return
        walker = Walker(self._raw, start, stop, log.layout, self.tally, self._limits.batch_bytes)
        done = start
        for block in walker.blocks():
            yield from self._block(log, block)
            release(self._view, done, block.end)
            done = block.end
        if walker.rejected:
            self.tally.time_outliers["main"] += walker.rejected
        self.tally.undecode("gps", walker.homeless, "no home position before it")
        if walker.padding:
            padding = int(self.info.get("padding_bytes", "0")) + walker.padding
            self.info["padding_bytes"] = str(padding)

    def _give_up(self, start: int, stop: int, why: str) -> None:
        """A log whose header does not say how to read its frames."""
        end = content_end(self._raw, start, stop)
        if end > start:
            self.tally.undecode("main", why=why)
            self.tally.skip(start, end, "frames that the header does not define")

    def _block(self, log: _Log, block: Block) -> Iterator[StreamPart]:
        main = block.rows.get("main")
        if main is not None:
            if log.first_us < 0:
                log.first_us = int(main.us[0])
            log.last_us = int(main.us[-1])
        for stream, rows in block.rows.items():
            log.waiting.append((stream, rows))
        if log.first_us >= 0:
            yield from self._outstanding(log)

    def _outstanding(self, log: _Log) -> Iterator[StreamPart]:
        """Rows that have been waiting for a time."""
        for stream, rows in log.waiting:
            time_us = np.where(rows.us < 0, max(log.first_us, 0), rows.us)
            if stream == "event":
                yield self._events(log, rows, time_us)
                continue
            yield self._fields(log, stream, rows, time_us)
            if stream == "main":
                yield from self._setpoint(log, rows, time_us)
        log.waiting.clear()

    def _fields(self, log: _Log, stream: str, rows: Rows, time_us: IntArray) -> StreamPart:
        kind = next(letter for letter, name in STREAMS.items() if name == stream)
        assert log.layout is not None, "rows come from frames that are defined"
        definition = log.layout.definitions[kind]
        sound = _are_states(definition.names, rows.values)
        if not sound.all():
            self.tally.undecode(stream, int((~sound).sum()), "a yes or no that is neither")
            time_us = time_us[sound]
            rows = replace(rows, values=rows.values[:, sound])
        columns = [
            arrow_arrays.numeric(values.view(np.uint32) if unsigned else values)
            for values, unsigned in zip(rows.values, definition.unsigned, strict=True)
        ]
        notes = [m.metadata() for m in meanings(log.header, kind, definition.names)]
        return self._part(log, stream, time_us, definition.names, columns, notes)

    def _setpoint(self, log: _Log, rows: Rows, time_us: IntArray) -> Iterator[StreamPart]:
        """What the sticks asked for, where the log does not say so itself."""
        assert log.layout is not None, "rows come from frames that are defined"
        places = {name: k for k, name in enumerate(log.layout.definitions["I"].names)}
        rates = rates_of(log.header)
        sticks = [f"rcCommand[{axis}]" for axis in range(len(rates))]
        if not rates or any(name not in places for name in sticks):
            return
        names = tuple(f"setpoint[{axis}]" for axis in range(len(rates)))
        columns = [
            arrow_arrays.numeric(_looked_up(axis, rows.values[places[name]]))
            for axis, name in zip(rates, sticks, strict=True)
        ]
        note = field_metadata("deg/s", description="computed from the sticks and the header's rates")
        yield self._part(log, "setpoint", time_us, names, columns, [note] * len(names))

    def _events(self, log: _Log, rows: Rows, time_us: IntArray) -> StreamPart:
        number, value, other, at, size = rows.values
        texts = [bytes(self._view[a : a + n]) for a, n in zip(at.tolist(), size.tolist(), strict=True)]
        columns = [
            arrow_arrays.numeric(number.astype(np.uint8)),
            arrow_arrays.numeric(_event_values(number, value, other)),
            arrow_arrays.numeric(
                np.where(number == EventKind.ADJUSTMENT, other & 0x7F, other).astype(np.float64)
            ),
            arrow_arrays.strings(text.decode("utf-8", "replace") for text in texts),
        ]
        notes = [
            field_metadata(enum=EVENTS),
            field_metadata(
                description="time in us, new value, iteration, reason or flags, as the event has it"
            ),
            field_metadata(description="function that was adjusted, time in us, or flags before"),
            None,
        ]
        return self._part(log, "events", time_us, ("event", "value", "other", "text"), columns, notes)

    def _parameters(self, log: _Log) -> StreamPart:
        """The header, line by line."""
        lines = log.header.lines
        numbers = [numbers_of(line.text) for line in lines]
        joined = np.array([x for n in numbers for x in n], dtype=np.float64)
        counts = np.array([len(n) for n in numbers], dtype=np.int64)
        columns = [
            arrow_arrays.strings(line.name for line in lines),
            arrow_arrays.numeric_or_null(n[0] if len(n) == 1 else None for n in numbers),
            arrow_arrays.lists(arrow_arrays.numeric(joined), counts),
            arrow_arrays.strings(line.text for line in lines),
        ]
        time_us = np.full(len(lines), max(log.first_us, 0), dtype=np.int64)
        return self._part(
            log, "parameters", time_us, ("name", "value", "values", "text"), columns, [None] * len(columns)
        )

    def _part(
        self,
        log: _Log,
        stream: str,
        time_us: IntArray,
        names: tuple[str, ...],
        columns: list[pa.Array],
        notes: list[dict[bytes, bytes] | None],
    ) -> StreamPart:
        """A table of a stream, or of "~2" where the stream began with other columns."""
        heads = [
            arrow_arrays.numeric(time_us * US_NS),
            arrow_arrays.numeric(np.full(len(time_us), log.boot, dtype=np.int32)),
        ]
        fields = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
        taken = {TIME, BOOT}
        for name, column, note in zip(names, columns, notes, strict=True):
            free = arrow_arrays.free_name(name, taken)
            taken.add(free)
            fields.append(pa.field(free, column.type, metadata=note))
        own = stream == "setpoint" or (stream in ("main", "gps") and "time" in names)
        schema = pa.schema(fields, metadata={"time_source": "time" if own else "main frame before"})
        known = self._schemas.setdefault(stream, [])
        version = next((k for k, s in enumerate(known) if s.equals(schema, check_metadata=True)), len(known))
        if version == len(known):
            known.append(schema)
        key = stream if version == 0 else f"{stream}~{version + 1}"
        return StreamPart(key, pa.Table.from_arrays([*heads, *columns], schema=known[version]))


def _are_states(names: tuple[str, ...], values: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
    """(n,) rows whose yes-or-no fields hold one of the two: a damaged width takes in the frames behind it."""
    sound = np.ones(values.shape[1], dtype=np.bool_)
    for name, row in zip(names, values, strict=True):
        if name in YES_OR_NO:
            sound &= (row == 0) | (row == 1)
    return sound


def _looked_up(rates: Rates, stick: npt.NDArray[np.int32]) -> npt.NDArray[np.float32]:
    """(n,) setpoints of (n,) sticks: whole numbers of a small range, so each is computed once."""
    low = int(stick.min())
    high = int(stick.max())
    if high - low > len(stick):
        return rates.setpoint(stick).astype(np.float32)
    table = rates.setpoint(np.arange(low, high + 1)).astype(np.float32)
    return table[stick - low]


def _event_values(number: IntArray, value: IntArray, other: IntArray) -> np.ndarray:
    """The events' first numbers; an adjustment of function 128 or more has the bits of a float32."""
    found = value.astype(np.float64)
    is_float = (number == EventKind.ADJUSTMENT) & (other >= 0x80)
    found[is_float] = value[is_float].astype(np.uint32).view(np.float32)
    return found


def _utc(header: Header, first_us: int) -> tuple[int | None, float]:
    """(UTC of vehicle time zero in ns, 1), from the time of day at which the log says it began."""
    text = header.text("Log start datetime")
    if not _START_TIME.fullmatch(text):
        return None, 1.0
    try:
        began = datetime.fromisoformat(text)
    except ValueError:
        return None, 1.0
    since = began - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000 - first_us * US_NS, 1.0
