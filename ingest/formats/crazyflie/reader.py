"""Logs of the Crazyflie's uSD-card deck, versions 1 and 2: one stream per kind of event.

See `layouts` for the bytes, `walk` for the way through them.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from flysid.errors import FormatError
from flysid.ingest.formats.base import HEAD_BYTES, Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.common.clock import IntArray, UtcFit
from flysid.ingest.formats.common.columns import (
    ByteMatrix,
    as_array,
    gather,
    message_schema,
)
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.crazyflie.layouts import Header, header_of
from flysid.ingest.formats.crazyflie.walk import Events, walk

CRC_BYTES = 4
_CRC_PIECE = 16 << 20


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """Certain where a sound header stands at the beginning."""
    return 0.99 if header_of(head) is not None else 0.0


@dataclass
class _Reader:
    """What is remembered between batches."""

    header: Header
    schemas: dict[int, pa.Schema] = field(default_factory=dict)
    fit: UtcFit = field(default_factory=UtcFit)


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a log; see `Format.read`."""
    header = header_of(bytes(view[:HEAD_BYTES]))
    if header is None:
        raise FormatError(
            "the header of this Crazyflie log is damaged: only it states what the events hold",
            path=name,
            byte=0,
            hint="copy the file from the card again",
        )
    tally = Tally()
    has_crc = _crc_is_right(view)
    stop = len(view) - CRC_BYTES if has_crc else len(view)
    reader = _Reader(header)
    for found in walk(view, header, stop, limits.batch_bytes, 0 if has_crc else CRC_BYTES):
        if isinstance(found, Events):
            yield from _parts(reader, view, found)
            release(view, int(found.at[0]), int(found.at[-1]))
        elif found.end == stop and stop - found.start == CRC_BYTES and tally.freeze().region_count:
            pass  # the checksum, which is wrong because of the damage before
        else:
            tally.truncated |= not has_crc and found.end == stop
            tally.skip(found.start, found.end, found.reason)
    if not has_crc:
        tally.bad_checksums = 1
        tally.truncated |= not tally.freeze().region_count
    return Summary(
        tally.freeze(), reader.fit.clocks(), {"vehicle": "Crazyflie", "log_version": str(header.version)}
    )


def _crc_is_right(view: memoryview) -> bool:
    """Whether the last four bytes are the CRC-32 of all before them."""
    stop = len(view) - CRC_BYTES
    crc = 0
    for start in range(0, stop, _CRC_PIECE):
        crc = zlib.crc32(view[start : min(start + _CRC_PIECE, stop)], crc)
        release(view, start, min(start + _CRC_PIECE, stop))
    return stop > 0 and struct.unpack("<I", view[stop:])[0] == crc


def _parts(reader: _Reader, view: memoryview, events: Events) -> list[StreamPart]:
    """The events of a batch, kind by kind."""
    first = int(events.at[0])
    buffer = as_array(view[first : int(events.at[-1]) + reader.header.size_of(int(events.kind[-1]))])
    parts = []
    for kind in np.unique(events.kind).tolist():
        mine = np.flatnonzero(events.kind == kind)
        size = reader.header.kinds[kind].size
        at = events.at[mine] - first + reader.header.head_bytes
        matrix = gather(buffer, at, np.full(len(at), size, dtype=np.int64), size)
        parts.append(_part(reader, kind, matrix, events.time_ns[mine]))
    reader.fit.add(0, events.time_ns)
    return parts


def _part(reader: _Reader, kind: int, matrix: ByteMatrix, time_ns: IntArray) -> StreamPart:
    layout = reader.header.kinds[kind]
    if kind not in reader.schemas:
        source = "the deck's clock, since boot"
        metadata = {"time_source": source, "message": layout.name}
        reader.schemas[kind] = message_schema(layout.columns, metadata, received=False)
    return StreamPart(layout.name, layout.table(reader.schemas[kind], (time_ns, 0), matrix))
