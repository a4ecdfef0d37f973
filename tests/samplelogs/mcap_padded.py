"""MCAP files record by record, with the mcap library's records: any features, any record longer than today's.

The idea is that of the format's own conformance files: one content, every combination of optional parts.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field

import zstandard
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

FEATURES = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "zstd", "crc")
EXTENSIBLE: tuple[int, ...] = tuple(
    int(op) for op in Opcode if op not in (Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER)
)
ROWS = 6
_MAGIC = b"\x89MCAP0\r\n"

Pad = Callable[[int], bytes]


@dataclass
class Builder:
    """Records one after the other; `pad` gives what stands behind the fields of a record of some opcode."""

    pad: Pad
    out: bytearray = field(default_factory=bytearray)

    def add(self, one: mcap.McapRecord) -> tuple[int, int]:
        """Write a record; returns its place and its length."""
        stream = RecordBuilder()
        one.write(stream)
        raw = bytes(stream.end())  # type: ignore[no-untyped-call]
        more = self.pad(raw[0]) if raw[0] in EXTENSIBLE else b""
        place = len(self.out)
        self.out += raw[:1] + struct.pack("<Q", len(raw) - 9 + len(more)) + raw[9:] + more
        return place, len(raw) + len(more)


def schemas() -> list[mcap.Schema]:
    """JSON and ROS 1."""
    layout = json.dumps({"type": "object", "properties": {"k": {"type": "integer"}}}).encode()
    return [
        mcap.Schema(id=1, name="a", encoding="jsonschema", data=layout),
        mcap.Schema(id=2, name="p/Pair", encoding="ros1msg", data=b"uint32 k\nfloat64 x\n"),
    ]


def channels() -> list[mcap.Channel]:
    """One topic of each schema."""
    names = (("/a", "json"), ("/b", "ros1"))
    return [
        mcap.Channel(id=k, topic=topic, message_encoding=encoding, metadata={"foo": "bar"}, schema_id=k)
        for k, (topic, encoding) in enumerate(names, start=1)
    ]


def messages() -> list[mcap.Message]:
    """`ROWS` messages of each topic, in turn."""
    found = []
    for k in range(ROWS):
        for channel, payload in ((1, json.dumps({"k": k}).encode()), (2, struct.pack("<Id", k, k / 3))):
            time = 10**9 + k
            found.append(
                mcap.Message(channel_id=channel, data=payload, log_time=time, publish_time=time, sequence=k)
            )
    return found


def padded_mcap(features: Set[str], pads: Mapping[int, bytes] | Pad) -> bytes:
    """A finished file of two topics with `ROWS` messages each, an attachment and metadata.

    Parameters
    ----------
    features : of FEATURES: chunks, message indexes, statistics, repeated schemas and channels, indexes of
        attachments, metadata and chunks, summary offsets, zstd in chunks, checksums.
    pads : bytes behind the fields, by opcode.
    """
    pad: Pad = pads if callable(pads) else lambda op: pads.get(op, b"")
    file = Builder(pad, bytearray(_MAGIC))
    file.add(mcap.Header(library="flysid tests", profile="test"))
    chunk = _write_data(file, features, pad)
    attachment = mcap.Attachment(
        create_time=1, log_time=2, name="file", media_type="text/plain", data=b"\x05\x06\x07"
    )
    metadata = mcap.Metadata(name="craft", metadata={"mass": "2 kg"})
    attached = file.add(attachment)
    described = file.add(metadata)
    data_crc = zlib.crc32(file.out) if "crc" in features else 0
    file.add(mcap.DataEnd(data_section_crc=data_crc))
    start = len(file.out)
    groups = _write_summary(file, features, chunk, (attachment, attached), (metadata, described))
    offsets = len(file.out) if "sum" in features and groups else 0
    for op, place, length in groups if "sum" in features else ():
        file.add(mcap.SummaryOffset(group_opcode=op, group_start=place, group_length=length))
    start = start if groups else 0
    footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets)
    crc = zlib.crc32(bytes(file.out[start:]) + footer) if "crc" in features and groups else 0
    return bytes(file.out) + footer + struct.pack("<I", crc) + _MAGIC


def _write_data(file: Builder, features: Set[str], pad: Pad) -> mcap.ChunkIndex | None:
    """Definitions and messages, in a chunk or not."""
    inner = Builder(pad) if "ch" in features else file
    for definition in (*schemas(), *channels()):
        inner.add(definition)
    index: dict[int, list[tuple[int, int]]] = {1: [], 2: []}
    for message in messages():
        index[message.channel_id].append((message.log_time, inner.add(message)[0]))
    if inner is file:
        return None
    raw = bytes(inner.out)
    packed = zstandard.compress(raw) if "zstd" in features else raw
    name = "zstd" if "zstd" in features else ""
    first = 10**9
    last = 10**9 + ROWS - 1
    chunk = mcap.Chunk(
        compression=name,
        data=packed,
        message_end_time=last,
        message_start_time=first,
        uncompressed_crc=zlib.crc32(raw) if "crc" in features else 0,
        uncompressed_size=len(raw),
    )
    place, length = file.add(chunk)
    behind = len(file.out)
    places = {}
    if "mx" in features:
        places = {
            number: file.add(mcap.MessageIndex(channel_id=number, records=rows))[0]
            for number, rows in index.items()
        }
    return mcap.ChunkIndex(
        chunk_length=length,
        chunk_start_offset=place,
        compression=name,
        compressed_size=len(packed),
        message_end_time=last,
        message_index_length=len(file.out) - behind,
        message_index_offsets=places,
        message_start_time=first,
        uncompressed_size=len(raw),
    )


def _write_summary(
    file: Builder,
    features: Set[str],
    chunk: mcap.ChunkIndex | None,
    attached: tuple[mcap.Attachment, tuple[int, int]],
    described: tuple[mcap.Metadata, tuple[int, int]],
) -> list[tuple[int, int, int]]:
    """The summary section; returns its groups as (opcode, place, length)."""
    attachment, (at, size) = attached
    metadata, (metadata_at, metadata_size) = described
    statistics = mcap.Statistics(
        attachment_count=1,
        channel_count=2,
        channel_message_counts={1: ROWS, 2: ROWS},
        chunk_count=int(chunk is not None),
        message_count=2 * ROWS,
        message_end_time=10**9 + ROWS - 1,
        message_start_time=10**9,
        metadata_count=1,
        schema_count=2,
    )
    attachment_index = mcap.AttachmentIndex(
        offset=at,
        length=size,
        log_time=attachment.log_time,
        create_time=attachment.create_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
    metadata_index = mcap.MetadataIndex(offset=metadata_at, length=metadata_size, name=metadata.name)
    parts: dict[str, tuple[int, list[mcap.McapRecord]]] = {
        "rsh": (Opcode.SCHEMA, list(schemas())),
        "rch": (Opcode.CHANNEL, list(channels())),
        "st": (Opcode.STATISTICS, [statistics]),
        "mdx": (Opcode.METADATA_INDEX, [metadata_index]),
        "ax": (Opcode.ATTACHMENT_INDEX, [attachment_index]),
        "chx": (Opcode.CHUNK_INDEX, [chunk] if chunk is not None else []),
    }
    groups = []
    for feature, (op, found) in parts.items():
        place = len(file.out)
        if feature in features and found:
            for one in found:
                file.add(one)
            groups.append((int(op), place, len(file.out) - place))
    return groups
