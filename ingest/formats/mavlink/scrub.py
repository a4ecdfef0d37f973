"""MAVLink telemetry without positions and identifiers: fields rewritten, frames sealed again.

Arrival times and sequence numbers stay. A changed frame gets its CRC anew, and loses its signature, which
nobody else can make. Bytes that are no checked frame, and frames of unknown messages, are left out: what
cannot be read cannot be cleaned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.errors import UsageError
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.capture import is_capture
from flysid.ingest.formats.common.columns import RecordLayout, gather
from flysid.ingest.formats.common.pcap import FILE_HEAD_BYTES
from flysid.ingest.formats.common.scrub_rules import Position, Scrubber, ScrubColumn
from flysid.ingest.formats.mavlink.dialect import Dialect
from flysid.ingest.formats.mavlink.frames import SIGNATURE_BYTES, V1, V2, Frames
from flysid.ingest.formats.mavlink.reader import frame_batches

# What a message carries for others: pieces of files, of logs, of radio corrections (a base station's place).
CONTENT: Mapping[str, str] = {
    "GPS_INJECT_DATA": "data",
    "GPS_RTCM_DATA": "data",
    "FILE_TRANSFER_PROTOCOL": "payload",
    "LOGGING_DATA": "data",
    "LOGGING_DATA_ACKED": "data",
    "LOG_DATA": "data",
    "REMOTE_LOG_DATA_BLOCK": "data",
    "ENCAPSULATED_DATA": "data",
    "SERIAL_CONTROL": "data",
    "TUNNEL": "payload",
    "V2_EXTENSION": "payload",
    "DATA16": "data",
    "DATA32": "data",
    "DATA64": "data",
    "DATA96": "data",
    "AUTH_KEY": "key",
    "OPEN_DRONE_ID_SELF_ID": "description",
    "OPEN_DRONE_ID_AUTHENTICATION": "authentication_data",
    "OPEN_DRONE_ID_MESSAGE_PACK": "messages",
    "VIDEO_STREAM_INFORMATION": "name",
}
TEXTS: Mapping[str, str] = {"STATUSTEXT": "text"}
PARAMETERS = ("PARAM_VALUE", "PARAM_SET", "PARAM_EXT_VALUE", "PARAM_EXT_SET", "PARAM_EXT_ACK")
PLACED = ("MISSION_ITEM", "MISSION_ITEM_INT", "COMMAND_INT")
OPERATOR = ("operator_latitude", "operator_longitude", "operator_altitude_geo")


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The log's records, scrubbed. Raises UsageError for a capture."""
    if is_capture(bytes(view[:FILE_HEAD_BYTES])):
        raise UsageError(
            "captures cannot be scrubbed", hint="they hold more than MAVLink; share the ingested flight"
        )
    read = signed = 0
    for frames, dialect, _ in frame_batches(view, limits):
        payloads = _payloads(frames, dialect, scrubber)
        for i in range(len(frames)):
            record, size, was_signed = _record(frames, i, payloads.get(i), dialect)
            read = read + size
            signed = signed + was_signed
            yield record
    scrubber.note(rules.UNREADABLE, "between frames", len(view) - read)
    scrubber.note(rules.SIGNATURE, "frames", signed)


def _payloads(frames: Frames, dialect: Dialect, scrubber: Scrubber) -> dict[int, bytes]:
    """Frame number -> its whole payload (not cut at trailing zeros), for messages that may hold something."""
    out: dict[int, bytes] = {}
    for message in np.unique(frames.message).tolist():
        layout = dialect.layout(message)
        rows = np.flatnonzero(frames.message == message)
        matrix = gather(frames.buffer, frames.payload[rows], frames.length[rows], layout.size)
        records = matrix.copy().view(layout.dtype).reshape(len(rows))
        before = records.tobytes()
        scrub_message(records, layout, scrubber)
        after = records.tobytes()
        if before != after:
            size = layout.size
            new = {int(i): after[k * size : (k + 1) * size] for k, i in enumerate(rows)}
            old = {int(i): before[k * size : (k + 1) * size] for k, i in enumerate(rows)}
            out |= {i: payload for i, payload in new.items() if payload != old[i]}
    return out


def scrub_message(records: npt.NDArray[Any], layout: RecordLayout, scrubber: Scrubber) -> None:
    """Scrub the records of one message in place."""
    names = records.dtype.names or ()
    scales = {f.name: f.scale for f in layout.fields}
    columns = [ScrubColumn(name, name, scales.get(name)) for name in names]
    rules.scrub_rows(records, columns, layout.name, scrubber)
    by_name = {c.name: c for c in columns}
    if all(name in names for name in OPERATOR):
        lat, lon, alt = (by_name[name] for name in OPERATOR)
        rules.scrub_place(records, Position(lat, lon, (alt,)), f"{layout.name}.operator", scrubber)
    if layout.name == "VFR_HUD":
        _raise(records, scrubber)
    if layout.name in CONTENT:
        where = f"{layout.name}.{CONTENT[layout.name]}"
        rules.clear(records, CONTENT[layout.name], (rules.CONTENT, where), scrubber)
    if layout.name in TEXTS:
        key = TEXTS[layout.name]
        rules.scrub_texts(records, key, (rules.TEXT, f"{layout.name}.{key}"), scrubber)
    if layout.name in PARAMETERS:
        _parameters(records, layout.name, scrubber)
    if layout.name in PLACED:
        place = Position(by_name["x"], by_name["y"], (by_name["z"],))
        used = np.isin(records["frame"], rules.GLOBAL_FRAMES) & np.isin(
            records["command"], rules.LOCATED_COMMANDS
        )
        above_sea = np.isin(records["frame"], (0, 5))
        rules.scrub_place(records, place, layout.name, scrubber, used & above_sea)
        rules.scrub_place(
            records, Position(place.lat, place.lon, ()), layout.name, scrubber, used & ~above_sea
        )
    if layout.name == "COMMAND_LONG":
        place = Position(by_name["param5"], by_name["param6"], ())
        used = np.isin(records["command"], rules.LOCATED_COMMANDS)
        rules.scrub_place(records, place, layout.name, scrubber, used)


def _raise(records: npt.NDArray[Any], scrubber: Scrubber) -> None:
    """VFR_HUD gives the altitude above sea level without a position."""
    if scrubber.middle is not None:
        records["alt"] = scrubber.raised(records["alt"].astype(np.float64))
        scrubber.note(rules.ALTITUDE, "VFR_HUD.alt", len(records))


def _parameters(records: npt.NDArray[Any], where: str, scrubber: Scrubber) -> None:
    for i, name in enumerate(records["param_id"]):
        text = bytes(name).split(b"\0", 1)[0].decode("ascii", "replace")
        if rules.is_private_parameter(text):
            nothing = np.zeros((), dtype=records.dtype["param_value"])
            scrubber.note(rules.PARAMETER, f"{where} {text}", records["param_value"][i] != nothing)
            records["param_value"][i] = nothing


def _record(frames: Frames, i: int, payload: bytes | None, dialect: Dialect) -> tuple[bytes, int, bool]:
    """One record as it shall be written, the bytes that it had, and whether it was signed."""
    import fastcrc

    buffer = frames.buffer
    q = int(frames.start[i])
    at = int(frames.payload[i])
    length = int(frames.length[i])
    has_stamp = frames.stamp_us is not None and int(frames.stamp_us[i]) >= 0
    first = q - 8 if has_stamp else q
    is_signed = buffer[q] == V2 and bool(buffer[q + 2] & 1)
    end = at + length + 2 + SIGNATURE_BYTES * is_signed
    stamp = buffer[first:q].tobytes() if has_stamp else _stamp_like(frames, i)
    if payload is None and not is_signed:
        return stamp + buffer[q:end].tobytes(), end - first, False
    content = buffer[at : at + length].tobytes() if payload is None else payload
    content = content[:length] if buffer[q] == V1 else content.rstrip(b"\0") or b"\0"
    head = bytearray(buffer[q:at].tobytes())
    head[1] = len(content)
    if buffer[q] == V2:
        head[2] = 0
    seed = bytes([dialect.crc_extra[int(frames.message[i])]])
    crc = fastcrc.crc16.mcrf4xx(bytes(head[1:]) + content + seed)
    return stamp + bytes(head) + content + crc.to_bytes(2, "little"), end - first, is_signed


def _stamp_like(frames: Frames, i: int) -> bytes:
    """The time for a frame whose own was damaged: that of the frame before; none in logs without times."""
    if frames.stamp_us is None:
        return b""
    known = np.flatnonzero(frames.stamp_us[: i + 1] >= 0)
    return int(frames.stamp_us[known[-1]] if len(known) else 0).to_bytes(8, "big")


__all__ = ["scrub", "scrub_message"]
