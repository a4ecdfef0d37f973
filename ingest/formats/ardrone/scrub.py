"""AR.Drone navdata packets without positions: the GPS option's coordinates rewritten, checksums made anew.

Captures (pcap) are refused: besides navdata they hold addresses of network cards, session names and whatever
else went over the air. Bytes that are no sound packet are left out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from flysid.errors import UsageError
from flysid.ingest.formats.ardrone.frames import MAX_PACKET_BYTES, Fate, MakeUp, find_headers, sort_packets
from flysid.ingest.formats.ardrone.layouts import NOT_FLIGHT_DATA, option_of
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.capture import is_capture
from flysid.ingest.formats.common.gather import as_bytes
from flysid.ingest.formats.common.scrub_rules import Scrubber, ScrubColumn

CHECKSUM_BYTES = 8


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:  # noqa: ARG001
    """The packets, scrubbed. Raises UsageError for a capture."""
    if is_capture(bytes(view[:24])):
        raise UsageError(
            "captures cannot be scrubbed", hint="they hold more than navdata; share the ingested flight"
        )
    data = as_bytes(view)
    at = find_headers(data, 0, len(data))
    found = sort_packets(data, at, np.minimum(at + MAX_PACKET_BYTES, len(data)))
    makeups = {int(a): group.makeup for group in found.groups for a in group.at.tolist()}
    kept = free = 0
    for start in at[found.fate == Fate.GOOD].tolist():
        if start < free:
            continue  # a chance header inside a packet
        makeup = makeups[start]
        packet = bytearray(view[start : start + makeup.size])
        _scrub_packet(packet, makeup, scrubber)
        kept = kept + len(packet)
        free = start + makeup.size
        yield bytes(packet)
    scrubber.note(rules.UNREADABLE, "between packets", len(data) - kept)


def _scrub_packet(packet: bytearray, makeup: MakeUp, scrubber: Scrubber) -> None:
    before = bytes(packet)
    for tag, (at, size) in makeup.options.items():
        if tag in NOT_FLIGHT_DATA:
            continue
        option = option_of(tag, size)
        if option is None:
            continue
        kind = option.dtype()
        rows = np.frombuffer(bytes(packet[at : at + kind.itemsize]), dtype=kind).copy()
        plain = [ScrubColumn(f.name, f.name, 1.0) for f in option.fields if not f.count]
        rules.scrub_rows(rows, plain, f"navdata/{option.name}", scrubber)
        packet[at : at + kind.itemsize] = rows.tobytes()
    if packet != before:
        body = len(packet) - CHECKSUM_BYTES
        struct.pack_into("<I", packet, body + 4, sum(packet[:body]) & 0xFFFFFFFF)
