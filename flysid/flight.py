"""Flight: one typed table per message stream, as recorded, with what was lost.

A stream key names a message and its sender: `1.1/ATTITUDE` (MAVLink system 1,
component 1), `/ardrone/navdata` (MCAP topic), `vehicle_attitude#1` (ULog instance 1), `ATT` (DataFlash).
Where rows of one message belong to several things, each has a stream of its own: `IMU[0]`,
`1.1/NAMED_VALUE_FLOAT[alt_err]`.

Every table begins with `time_ns` (int64, vehicle clock, nanoseconds) and `boot` (int32, 0 for the first
boot in the file). Where arrival at the ground was recorded too, `recv_ns` (int64, UTC) follows. The
remaining columns are the message's fields with their raw values. Field metadata (`field_metadata`)
carries unit, scale and enumeration; schema metadata carries `time_source`, system and component, and `key`:
the field that names the thing to which a row belongs (several fields: joined by commas). Where no
definition declares such a field and its name suggests one, as `header.frame_id` does, it is `key_if_several`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from flysid.errors import UsageError
from flysid.showing import Shown, Table, counted, first_of

if TYPE_CHECKING:
    import pyarrow as pa

TIME = "time_ns"
BOOT = "boot"
RECEIVED = "recv_ns"
KEY = "key"
KEY_IF_SEVERAL = "key_if_several"
OTHERS = " (others)"
"""Stands behind a message for rows that stay together, as a log has more things than are kept apart. Not in
brackets, where any text may stand."""
ROW_NUMBER = "row number"
"""The `time_source` of a table without a time: rows stand a second apart until a recipe sets the step."""


@dataclass(frozen=True)
class Region:
    """A half-open byte range [start, end) of a log that could not be read, and why."""

    start: int
    end: int
    reason: str

    @property
    def size(self) -> int:
        return self.end - self.start


@dataclass(frozen=True)
class Damage:
    """What a reader could not keep. All counts are exact; `regions` may be cut at `MAX_REGIONS`.

    Attributes
    ----------
    bytes_skipped : bytes that belong to no valid record.
    regions : where those bytes are, at most `MAX_REGIONS` of them.
    region_count : how many regions there are in all.
    bad_checksums : frames, packets or chunks whose checksum failed.
    truncated : the file ends inside a record.
    undecoded : records per stream that are framed well but have no known layout.
    time_outliers : records per stream whose time was rejected.
    sequence_gaps : messages lost before the log was written, per source, by sequence number.
    silence_gaps : the same in multiples of 256, likely lost in silences: the number has eight bits.
    repeats : messages that came again byte for byte, per source, as a router's loop sends them; one of each
        is kept.
    dropouts : what the recorder itself counted as lost, e.g. {"records": 12, "ms": 140}.
    out_of_order : records per stream whose time runs backwards; kept.
    reasons : why records of a stream in `undecoded` could not be decoded, where the reader knows.

    Examples
    --------
    >>> damage = flysid.read("sample_logs/01-multisine-seed1.tlog").damage
    >>> damage.bytes_skipped, damage.lossy
    (0, False)
    """

    MAX_REGIONS = 1000

    bytes_skipped: int = 0
    regions: tuple[Region, ...] = ()
    region_count: int = 0
    bad_checksums: int = 0
    truncated: bool = False
    undecoded: Mapping[str, int] = field(default_factory=dict)
    time_outliers: Mapping[str, int] = field(default_factory=dict)
    sequence_gaps: Mapping[str, int] = field(default_factory=dict)
    silence_gaps: Mapping[str, int] = field(default_factory=dict)
    repeats: Mapping[str, int] = field(default_factory=dict)
    dropouts: Mapping[str, int] = field(default_factory=dict)
    out_of_order: Mapping[str, int] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)

    def behind_zeros(self, count: int) -> Damage:
        """This damage in a log that `count` zero bytes stand ahead of."""
        moved = (replace(r, start=r.start + count, end=r.end + count) for r in self.regions)
        regions = (Region(0, count, "zeros"), *moved)[: self.MAX_REGIONS]
        return replace(
            self,
            bytes_skipped=self.bytes_skipped + count,
            regions=regions,
            region_count=self.region_count + 1,
        )

    @property
    def lossy(self) -> bool:
        """True when the file held something that could not be kept (exit code 3).

        Sequence gaps and dropouts happened before the file was written; they are shown, and do not count.
        """
        return bool(
            self.bytes_skipped
            or self.bad_checksums
            or self.truncated
            or sum(self.undecoded.values())
            or sum(self.time_outliers.values())
        )


@dataclass(frozen=True)
class ClockMap:
    """utc_ns = utc_offset_ns + slope * vehicle_ns, fitted robustly over one boot.

    `residual_ns` is the median absolute residual; None where nothing anchors the boot to UTC.
    """

    boot: int
    first_ns: int
    last_ns: int
    utc_offset_ns: int | None = None
    slope: float = 1.0
    residual_ns: int | None = None

    @property
    def began_utc_ns(self) -> float | None:
        """When the boot began, nanoseconds of UTC; None where nothing anchors it."""
        return None if self.utc_offset_ns is None else self.utc_offset_ns + self.slope * self.first_ns


@dataclass(frozen=True)
class Source:
    """The file a flight came from. `name` is the base name: paths do not travel."""

    name: str
    format: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True, repr=False)
class Flight(Shown):
    """A log as recorded: nothing resampled, nothing dropped unseen.

    Attributes
    ----------
    source : the file.
    tables : stream key -> table; see the module's docstring for the columns.
    damage : what could not be kept.
    clocks : one per boot, in order.
    info : facts about the vehicle, e.g. {"autopilot": "ardupilot", "firmware": "4.3.1"}.

    Examples
    --------
    >>> flight = flysid.read("sample_logs/01-multisine-seed1.tlog")
    >>> flight["ATTITUDE"].column_names[:2]
    ['time_ns', 'boot']
    """

    source: Source
    tables: Mapping[str, pa.Table]
    damage: Damage = field(default_factory=Damage)
    clocks: tuple[ClockMap, ...] = ()
    info: Mapping[str, str] = field(default_factory=dict)

    @property
    def streams(self) -> tuple[str, ...]:
        return tuple(self.tables)

    def _table(self) -> Table:
        whose = ", ".join(self.info[key] for key in ("vehicle", "autopilot", "firmware") if key in self.info)
        title = (
            f"{self.source.name}: {self.source.format}, {counted(self.rows, 'record')} in "
            f"{counted(len(self.tables), 'stream')}"
        )
        title += f"; {whose}" if whose else ""
        title += "; with losses" if self.damage.lossy else ""
        most = sorted(self.tables.items(), key=lambda item: -item[1].num_rows)
        rows = [(key, f"{t.num_rows:,}", ", ".join(t.column_names[2:])) for key, t in most]
        return Table(title, ("stream", "records", "columns"), rows)

    @property
    def rows(self) -> int:
        return sum(t.num_rows for t in self.tables.values())

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __contains__(self, stream: object) -> bool:
        return isinstance(stream, str) and bool(matching_streams(stream, self.tables))

    def __getitem__(self, stream: str) -> pa.Table:
        """The table of a stream, by its key or by its message name where that is unambiguous.

        Raises
        ------
        UsageError : no stream of that name, or several.
        """
        return self.tables[resolve_stream(stream, self.tables, self.source.name)]


@lru_cache(maxsize=4096)
def stem_of(stream: str) -> str:
    """A stream's key without the thing that its rows belong to: `1.1/ESC_INFO` of `1.1/ESC_INFO[0]`."""
    if not stream.endswith("]"):
        return stream
    opened: list[int] = []
    begin = 0
    for at, character in enumerate(stream):
        if character == "[":
            opened.append(at)
        elif character == "]" and opened:
            begin = opened.pop()  # at last, of the bracket that ends the key
    return stream[: opened[0] if opened else begin] or stream


def thing_of(stream: str) -> str:
    """To which of several things a stream's rows belong: `0` of `IMU[0]`; "" where its message has no key."""
    return stream[len(stem_of(stream)) + 1 : -1]


def message_of(stream: str) -> str:
    """A stream's key without its sender: `BATTERY_STATUS[0]` of `1.1/BATTERY_STATUS[0]`."""
    stem = stem_of(stream)
    return stem.rpartition("/")[2] + stream[len(stem) :]


def split_address(address: str) -> tuple[str, str]:
    """Stream and field of `STREAM.FIELD`, whose thing may have dots; the stream is "" where there is none."""
    depth = 0
    for at, character in enumerate(address):
        depth += (character == "[") - (character == "]")
        if character == "." and depth <= 0:
            return address[:at], address[at + 1 :]
    return "", address


def matching_streams(name: str, streams: Mapping[str, Any]) -> list[str]:
    """Keys that `name` may mean: the key itself, else all whose message is `name`, else all things of it.

    `topic[1]` also means the ULog instance `topic#1`, and `topic[0]` the `topic` that stands beside it.
    """
    if name in streams:
        return [name]
    found = [key for key in streams if message_of(key) == name]
    found = found or [key for key in streams if name in _stems(key)]
    if found or not thing_of(name):
        return found
    return [key for key in streams if as_instance(key, streams) == name]


def _stems(key: str) -> tuple[str, str]:
    """What a stream is called without its thing, with its sender and without."""
    stem = stem_of(key)
    return stem, message_of(stem)


def as_instance(stream: str, streams: Collection[str]) -> str:
    """The address of a ULog instance: `topic[1]` of `topic#1`, `topic[0]` of the `topic` beside it."""
    topic, mark, number = stream.partition("#")
    if mark:
        return f"{topic}[{number}]"
    return f"{stream}[0]" if any(other.startswith(f"{stream}#") for other in streams) else stream


def resolve_stream(name: str, streams: Mapping[str, Any], where: str) -> str:
    """The one key that `name` means in `streams`; raises UsageError with the nearest names otherwise."""
    found = matching_streams(name, streams)
    if len(found) == 1:
        return found[0]
    if found:
        words, hint = why_several(name, found)
        raise UsageError(words, path=where, hint=hint)
    import difflib

    near = difflib.get_close_matches(name, {*streams, *map(message_of, streams)}, n=3)
    hint = f"{', '.join(near)}" if near else f"one of {', '.join(sorted(streams)[:8])}"
    raise UsageError(f"no stream {name!r} in the log", path=where, hint=hint)


def why_several(name: str, found: Sequence[str], *, most: int = 12) -> tuple[str, str]:
    """That a name means several streams, and what to name instead, `most` of them."""
    is_keyed = len({name.partition("[")[0] for name in found}) == 1
    words = "several things, each a stream of its own" if is_keyed else f"{len(found)} streams"
    return f"{name!r} names {words}", f"one of {first_of(sorted(found), most)}"


def field_metadata(
    unit: str = "", scale: float = 1.0, enum: Mapping[int, str] | None = None, description: str = ""
) -> dict[bytes, bytes] | None:
    """Metadata of a column: physical value = raw value * scale, in `unit`; `enum` names the raw values.

    Returns None when there is nothing to say, as pyarrow expects.
    """
    items: dict[bytes, bytes] = {}
    if unit:
        items[b"unit"] = unit.encode()
    if scale != 1.0:
        items[b"scale"] = repr(float(scale)).encode()
    if enum:
        items[b"enum"] = json.dumps({str(k): v for k, v in enum.items()}).encode()
    if description:
        items[b"description"] = description.encode()
    return items or None


def field_scale(column: pa.Field) -> float:
    """The factor from raw to physical values of a column; 1.0 where none is stated."""
    return float((column.metadata or {}).get(b"scale", b"1"))


def field_unit(column: pa.Field) -> str:
    """The unit of a column after scaling; '' where none is stated."""
    return str((column.metadata or {}).get(b"unit", b"").decode(errors="replace"))
