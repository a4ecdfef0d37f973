"""Flight: one typed table per message stream, as recorded, with what was lost.

A stream key says where a message came from and what it is: `1.1/ATTITUDE` (MAVLink system 1,
component 1), `/ardrone/navdata` (MCAP topic), `vehicle_attitude#1` (ULog instance 1), `ATT` (DataFlash).

Every table begins with `time_ns` (int64, vehicle clock, nanoseconds) and `boot` (int32, 0 for the first
boot in the file). Where arrival at the ground was recorded too, `recv_ns` (int64, UTC) follows. The
remaining columns are the message's fields with their raw values. Field metadata (`field_metadata`)
carries unit, scale and enumeration; schema metadata carries `time_source`, system and component.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from flysid.errors import UsageError
from flysid.showing import Shown, Table, counted

if TYPE_CHECKING:
    import pyarrow as pa

TIME = "time_ns"
BOOT = "boot"
RECEIVED = "recv_ns"
ROW_NUMBER = "row number"
"""The `time_source` of a table without a time: rows stand a second apart until a recipe says how far."""


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
    dropouts : what the recorder itself says it lost, e.g. {"records": 12, "ms": 140}.
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


def matching_streams(name: str, streams: Mapping[str, Any]) -> list[str]:
    """Keys that `name` may mean: the key itself, else all keys whose part after the last '/' is `name`."""
    if name in streams:
        return [name]
    return [key for key in streams if key.rpartition("/")[2] == name]


def resolve_stream(name: str, streams: Mapping[str, Any], where: str) -> str:
    """The one key that `name` means in `streams`; raises UsageError with the nearest names otherwise."""
    found = matching_streams(name, streams)
    if len(found) == 1:
        return found[0]
    if found:
        raise UsageError(
            f"{name!r} names {len(found)} streams", path=where, hint=f"one of {', '.join(sorted(found))}"
        )
    import difflib

    near = difflib.get_close_matches(name, {*streams, *(k.rpartition("/")[2] for k in streams)}, n=3)
    hint = f"{', '.join(near)}" if near else f"one of {', '.join(sorted(streams)[:8])}"
    raise UsageError(f"no stream {name!r} in the log", path=where, hint=hint)


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
