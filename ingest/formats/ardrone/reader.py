"""AR.Drone navdata: UDP packets one after the other, or a pcap capture with the AT commands.

Streams: `navdata/header` (sequence, state) and one per option that carries flight data (`navdata/demo`,
`navdata/references`, ... see `navdata_options`); from captures also `at/PCMD` and `at/CONFIG`
(`commands`). `time_ns` is the vehicle's clock, option `time`: 11 bits of seconds and 21 of microseconds,
which wrap at 2,048 s and are unwrapped here; a step back is a reboot. Captures give arrival times
(`recv_ns`, UTC) too, and put the commands on the vehicle's clock. With navdata_demo=1 the vehicle sends no
time: then arrival counts, or the sequence at 15 Hz.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from flysid.errors import FormatError
from flysid.flight import BOOT, RECEIVED, TIME, ClockMap, field_metadata
from flysid.ingest.formats.ardrone.commands import Commands
from flysid.ingest.formats.ardrone.frames import (
    HEADERS,
    MAX_PACKET_BYTES,
    Fate,
    Packets,
    Sorted,
    find_headers,
    parse_makeup,
    sort_packets,
)
from flysid.ingest.formats.ardrone.layouts import (
    AT_PORT,
    CHECKSUM_TAG,
    NAVDATA_PORT,
    NOT_FLIGHT_DATA,
    Option,
    option_of,
)
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.capture import Payload, datagrams, is_capture
from flysid.ingest.formats.common.clock import UtcFit, interpolate
from flysid.ingest.formats.common.gather import Bytes, Index, Values, as_bytes, numbers, rows
from flysid.ingest.formats.common.tally import Tally

WRAP_NS = 2048 * 10**9
DEMO_PERIOD_NS = 10**9 // 15
MAX_SEQUENCE_GAP = 100_000
TIME_TAG = 1
Boots = NDArray[np.int32]
_Clock = tuple[Index, Index, Boots, Index | None]
SOURCES = {"clock": "navdata time", "arrival": "arrival", "sequence": "sequence at 15 Hz"}


@dataclass
class Batch:
    """Candidates in one buffer: places, ends that they must not pass, arrival times (or None), (n,) each."""

    data: Bytes
    at: Index
    stop: Index
    received_ns: Index | None = None


@dataclass
class Decoder:
    """Turns good packets into parts; keeps the clock, the sequence and the first arrival between batches."""

    tally: Tally
    utc: UtcFit = field(default_factory=UtcFit)
    knots: list[tuple[Index, Index, Boots]] = field(default_factory=list)  # arrival, vehicle time, boot
    _source: str = ""
    _boot: int = 0
    _base_ns: int = 0
    _last_ns: int = -1
    _last_sequence: int = -1
    _first_sequence: int = 0

    def parts(self, batch: Batch, found: Sorted) -> Iterator[StreamPart]:
        """The header stream and one part per option of the good packets, in file order."""
        good = np.flatnonzero(found.fate == Fate.GOOD)
        if not len(good):
            return
        at = batch.at[good]
        received = batch.received_ns[good] if batch.received_ns is not None else None
        head = rows(batch.data, at, 16).view(HEAD)
        self._count_gaps(head["sequence"].astype(np.int64))
        time_ns, boot = self._times(batch, at, (found.groups, head, received))
        for b in np.unique(boot).tolist():
            own = boot == b
            self.utc.add(int(b), time_ns[own], received[own] if received is not None else None)
        if received is not None:
            self.knots.append((received, time_ns, boot))
        clock = (at, time_ns, boot, received)
        columns = [("state", head["state"]), ("sequence", head["sequence"]), ("vision", head["vision"])]
        arrays = [(pa.field(n, arrow_arrays.numeric(v).type), arrow_arrays.numeric(v)) for n, v in columns]
        yield StreamPart("navdata/header", self._table(np.arange(len(at)), clock, arrays))
        yield from self._options(batch.data, found.groups, clock)

    def _options(self, data: Bytes, groups: tuple[Packets, ...], clock: _Clock) -> Iterator[StreamPart]:
        tags = sorted({tag for g in groups for tag in g.makeup.options} - NOT_FLIGHT_DATA - {CHECKSUM_TAG})
        for tag in tags:
            places: dict[Option, list[tuple[Index, Index]]] = {}
            for group in groups:
                if tag not in group.makeup.options:
                    continue
                offset, size = group.makeup.options[tag]
                option = option_of(tag, size)
                if option is None:
                    self.tally.undecode(f"navdata/option {tag}", len(group.at))
                else:
                    places.setdefault(option, []).append((group.at, group.at + offset))
            for option, pieces in places.items():
                packet = np.concatenate([p for p, _ in pieces])
                order = np.argsort(packet, kind="stable")
                body = np.concatenate([b for _, b in pieces])[order]
                index = np.searchsorted(clock[0], packet[order])
                table = rows(data, body, option.dtype().itemsize).view(option.dtype())
                yield StreamPart(f"navdata/{option.name}", self._table(index, clock, _columns(option, table)))

    def _table(self, index: Index, clock: _Clock, columns: list[tuple[pa.Field, pa.Array]]) -> pa.Table:
        _, time_ns, boot, received = clock
        arrays = [arrow_arrays.numeric(time_ns[index]), arrow_arrays.numeric(boot[index])]
        fields = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
        if received is not None:
            arrays.append(arrow_arrays.numeric(received[index]))
            fields.append(pa.field(RECEIVED, pa.int64()))
        schema = pa.schema(fields + [f for f, _ in columns], metadata={"time_source": SOURCES[self._source]})
        return pa.Table.from_arrays(arrays + [a for _, a in columns], schema=schema)

    def _count_gaps(self, sequence: Index) -> None:
        steps = np.diff(
            sequence, prepend=self._last_sequence if self._last_sequence >= 0 else sequence[0] - 1
        )
        lost = steps[(steps > 1) & (steps < MAX_SEQUENCE_GAP)] - 1
        if len(lost):
            self.tally.sequence_gaps["navdata"] += int(lost.sum())
        if self._last_sequence < 0:
            self._first_sequence = int(sequence[0])
        self._last_sequence = int(sequence[-1])

    def _times(
        self, batch: Batch, at: Index, known: tuple[tuple[Packets, ...], Values, Index | None]
    ) -> tuple[Index, Boots]:
        """Vehicle time and boot of every packet."""
        groups, head, received = known
        raw = np.full(len(at), -1, dtype=np.int64)
        for group in groups:
            offset, size = group.makeup.options.get(TIME_TAG, (0, 0))
            if size >= 4:
                raw[np.searchsorted(at, group.at)] = numbers(batch.data, group.at + offset, "<u4")
        if not self._source:
            self._source = "clock" if (raw >= 0).any() else "sequence" if received is None else "arrival"
        if self._source == "clock":
            return self._unwrap(raw)
        boot = np.zeros(len(at), dtype=np.int32)
        if received is not None:
            return received, boot
        return (head["sequence"].astype(np.int64) - self._first_sequence) * DEMO_PERIOD_NS, boot

    def _unwrap(self, raw: Index) -> tuple[Index, Boots]:
        """Seconds and microseconds as ns since the first wrap; packets without a time take the last one's."""
        clock = (raw >> 21) * 10**9 + (raw & 0x1FFFFF) * 1000
        time_ns = np.empty(len(raw), dtype=np.int64)
        boot = np.empty(len(raw), dtype=np.int32)
        known = np.maximum.accumulate(np.where(raw >= 0, np.arange(len(raw)), -1))
        start = self._last_ns if self._last_ns >= 0 else int(clock[raw >= 0][0]) if (raw >= 0).any() else 0
        clock = np.where(known >= 0, clock[known], start)
        steps = np.diff(clock, prepend=start)
        wraps = steps < -WRAP_NS // 2
        reboots = (steps < -(10**9)) & ~wraps
        base = self._base_ns + np.cumsum(wraps) * WRAP_NS
        boot[:] = self._boot + np.cumsum(reboots)
        time_ns[:] = clock + base
        for place in np.flatnonzero(reboots).tolist():  # a new boot counts its own wraps
            time_ns[place:] -= base[place]
            base = base - base[place]
        self._base_ns, self._boot, self._last_ns = int(base[-1]), int(boot[-1]), int(clock[-1])
        back = int(((steps < 0) & ~wraps & ~reboots).sum())
        if back:
            self.tally.out_of_order["navdata"] += back
        return time_ns, boot


HEAD = np.dtype([("magic", "<u4"), ("state", "<u4"), ("sequence", "<u4"), ("vision", "<u4")])


def _columns(option: Option, table: Values) -> list[tuple[pa.Field, pa.Array]]:
    columns = []
    for spec in option.fields:
        values = table[spec.name]
        array = arrow_arrays.matrix(values) if spec.count else arrow_arrays.numeric(values)
        note = field_metadata(spec.unit, spec.scale, spec.enum)
        columns.append((pa.field(arrow_arrays.free_name(spec.name, {}), array.type, metadata=note), array))
    return columns


# ------------------------------------------------------------------------------------ raw concatenation


def _read_raw(view: memoryview, limits: Limits, decoder: Decoder) -> Iterator[StreamPart]:
    data = as_bytes(view)
    at = 0
    while at < len(data):
        stop = min(len(data), at + limits.batch_bytes + MAX_PACKET_BYTES)
        final = stop == len(data)
        candidates = find_headers(data, at, stop)
        batch = Batch(data, candidates, np.full(len(candidates), stop, dtype=np.int64))
        found = sort_packets(data, candidates, batch.stop)
        batch, found = _disjoint(batch, found)
        last = _last_start(batch, found, stop, final)
        batch, found = _before(batch, found, last)
        _count_damage(batch, found, (at, last), decoder.tally)
        if final:
            _note_cut(data, batch, found, decoder.tally)
        yield from decoder.parts(batch, found)
        release(view, at, last)
        at = last


def _disjoint(batch: Batch, found: Sorted) -> tuple[Batch, Sorted]:
    """Without the candidates that lie inside good packets."""
    good = np.flatnonzero(found.fate == Fate.GOOD)
    before = np.searchsorted(batch.at[good], batch.at, side="right") - 1
    inside = (
        (before >= 0) & (batch.at < found.end[good][before]) if len(good) else np.zeros(len(batch.at), bool)
    )
    inside[good] = False
    overlapping = good[1:][batch.at[good][1:] < np.maximum.accumulate(found.end[good])[:-1]]
    inside[overlapping] = True
    return _pick(batch, found, ~inside)


def _before(batch: Batch, found: Sorted, stop: int) -> tuple[Batch, Sorted]:
    return _pick(batch, found, batch.at < stop)


def _pick(batch: Batch, found: Sorted, keep: Values) -> tuple[Batch, Sorted]:
    at = batch.at[keep]
    kept = np.zeros(len(batch.data), dtype=np.bool_)  # by place: garbage may hold very many headers
    kept[at] = True
    groups = tuple(Packets(g.makeup, g.at[kept[g.at]]) for g in found.groups)
    received = batch.received_ns[keep] if batch.received_ns is not None else None
    return (
        Batch(batch.data, at, batch.stop[keep], received),
        Sorted(tuple(g for g in groups if len(g.at)), found.fate[keep], found.end[keep]),
    )


def _last_start(batch: Batch, found: Sorted, stop: int, final: bool) -> int:
    """Where the next batch begins: behind the last good packet that surely was seen whole."""
    if final:
        return stop
    good = np.flatnonzero(found.fate == Fate.GOOD)
    surely = stop - MAX_PACKET_BYTES
    early = good[batch.at[good] <= surely]
    return max(int(found.end[early[-1]]), surely) if len(early) else surely


def _count_damage(batch: Batch, found: Sorted, span: tuple[int, int], tally: Tally) -> None:
    """Skipped bytes are those between good packets."""
    good = found.fate == Fate.GOOD
    tally.bad_checksums += int((found.fate == Fate.BAD_SUM).sum())
    starts = np.append(batch.at[good], span[1])
    ends = np.append(span[0], found.end[good])
    for k in np.flatnonzero(starts > ends).tolist():
        inside = found.fate[(batch.at >= ends[k]) & (batch.at < starts[k])]
        reason = "packet checksum failed" if (inside == Fate.BAD_SUM).any() else "no packet here"
        tally.skip(int(ends[k]), int(starts[k]), reason)


def _note_cut(data: Bytes, batch: Batch, found: Sorted, tally: Tally) -> None:
    """The file is cut where its last bytes begin a packet."""
    good = found.fate == Fate.GOOD
    end = int(found.end[good].max()) if good.any() else 0
    tail = data[end : end + 4].tobytes()
    if 0 < len(data) - end < 4:
        tally.truncated = any(h.startswith(tail) for h in HEADERS)
    elif tail in HEADERS:
        tally.truncated = bool((found.fate[batch.at == end] == Fate.CUT).any())


# ------------------------------------------------------------------------------------ captures


def _read_capture(view: memoryview, limits: Limits, decoder: Decoder) -> Iterator[StreamPart]:
    commands = Commands()
    held: list[Payload] = []
    size = 0
    for datagram in datagrams(view, decoder.tally):
        if datagram.target_port == AT_PORT:
            commands.add(datagram.content, datagram.time_ns)
        elif NAVDATA_PORT in (datagram.source_port, datagram.target_port) and len(datagram.content) > 16:
            held.append(datagram)
            size += len(datagram.content)
            if size >= limits.batch_bytes:
                yield from _decode_datagrams(held, decoder)
                held = []
                size = 0
    yield from _decode_datagrams(held, decoder)
    decoder.tally.undecode("at", commands.unread)
    yield from _command_parts(commands, decoder)


def _decode_datagrams(held: list[Payload], decoder: Decoder) -> Iterator[StreamPart]:
    if not held:
        return
    data = as_bytes(b"".join(d.content for d in held))
    stop = np.cumsum([len(d.content) for d in held])
    at = np.append(0, stop[:-1])
    received = np.array([d.time_ns for d in held], dtype=np.int64)
    marked = np.isin(numbers(data, at, "<u4"), (0x55667788, 0x55667789))
    found = sort_packets(data, at[marked], stop[marked])
    decoder.tally.bad_checksums += int((found.fate == Fate.BAD_SUM).sum())
    broken = int((found.fate != Fate.GOOD).sum() - (found.fate == Fate.BAD_SUM).sum() + (~marked).sum())
    decoder.tally.undecode("navdata", broken)
    yield from decoder.parts(Batch(data, at[marked], stop[marked], received[marked]), found)


def _command_parts(commands: Commands, decoder: Decoder) -> Iterator[StreamPart]:
    """Commands on the vehicle's clock, by the arrivals of the navdata around them."""
    arrivals = commands.received_ns()
    if not arrivals:
        return
    if decoder.knots:
        received, vehicle, boots = (np.concatenate(k) for k in zip(*decoder.knots, strict=True))
        rising = np.append(True, np.diff(np.maximum.accumulate(received)) > 0)
        received = received[rising]
        vehicle = vehicle[rising]
        boots = boots[rising]
        times = {s: interpolate(a, received, vehicle, 1.0) for s, a in arrivals.items()}
        boot = {
            s: boots[np.clip(np.searchsorted(received, a, side="right") - 1, 0, None)]
            for s, a in arrivals.items()
        }
    else:
        times = arrivals
        boot = {s: np.zeros(len(a), dtype=np.int32) for s, a in arrivals.items()}
    for stream, table in commands.tables(times, boot).items():
        yield StreamPart(stream, table)


# ------------------------------------------------------------------------------------ the format


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a navdata recording.

    Raises
    ------
    FormatError : there is not one valid packet.
    """
    decoder = Decoder(Tally())
    capture = is_capture(bytes(view[:24]))
    rows_seen = 0
    for part in (_read_capture if capture else _read_raw)(view, limits, decoder):
        rows_seen += part.table.num_rows
        yield part
    if not rows_seen:
        raise FormatError(
            "no navdata packet with a valid checksum",
            path=name,
            byte=0,
            hint="check that this is a log of an AR.Drone's navdata",
        )
    return Summary(decoder.tally.freeze(), _clocks(decoder), _about(capture, decoder.tally))


def _clocks(decoder: Decoder) -> tuple[ClockMap, ...]:
    return decoder.utc.clocks()


def _about(capture: bool, tally: Tally) -> Mapping[str, str]:
    seen = {"captured_twice": str(tally.repeats)} if tally.repeats else {}
    return {"autopilot": "ardrone", "source": "pcap" if capture else "navdata", **seen}


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """1 for a first packet that adds up, 0.8 for one further in; less for captures (see the ports)."""
    if is_capture(head):
        return 0.95 if _holds_navdata(head) else 0.2
    data = as_bytes(head)
    candidates = find_headers(data, 0, len(data))[:64]
    if not len(candidates):
        return 0.0
    if candidates[0] == 0 and _is_good_or_long(data):
        return 1.0
    fate = sort_packets(data, candidates, np.full(len(candidates), len(data), dtype=np.int64)).fate
    return 0.8 if (fate == Fate.GOOD).any() else 0.0


def _is_good_or_long(data: Bytes) -> bool:
    """Whether the packet at 0 adds up."""
    try:
        makeup = parse_makeup(data, 0, len(data))
    except EOFError:
        return False
    zero = np.zeros(1, dtype=np.int64)
    stop = np.array([len(data)], dtype=np.int64)
    return makeup is not None and bool((sort_packets(data, zero, stop).fate == Fate.GOOD).all())


def _holds_navdata(head: bytes) -> bool:
    """Whether the first datagrams of a capture are navdata or AT commands."""
    found = (datagram.content for datagram in datagrams(memoryview(head), Tally()))
    return any(content.startswith((*HEADERS, b"AT*")) for content in found)
