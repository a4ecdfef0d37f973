"""A recording -> MCAP whose JSON messages describe themselves: each schema names the unit of every field.

Topics: /ardrone/command (theta_in, phi_in in deg, vz_in in m/s) and /ardrone/state (measured velocities,
tilt, altitude), in the paper's own signs. `stamp` is the vehicle's time of the sample as UTC nanoseconds and
is also the publish time; the log time is the arrival at the recorder.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from flysid.ingest.synth.telemetry import Recording, Telemetry, arrival_utc_ns, heard, in_sending_order

# Goes into the file's header; the library's own name carries a version, which would change the bytes.
LIBRARY = "flysid"

COMMAND = {"theta_in": "deg", "phi_in": "deg", "vz_in": "m/s"}
STATE = {"vx": "m/s", "vy": "m/s", "vz": "m/s", "theta": "deg", "phi": "deg", "z": "m"}
MEANING = {
    "theta_in": "commanded tilt, forward positive",
    "phi_in": "commanded tilt, right positive",
    "vz_in": "commanded climb, up positive",
    "vx": "velocity forward",
    "vy": "velocity to the right",
    "vz": "velocity up",
    "theta": "tilt, forward positive",
    "phi": "tilt, right positive",
    "z": "altitude above the start",
}


def mcap_bytes(recording: Recording, compression: str = "none", *, chunk_bytes: int = 256 * 1024) -> bytes:
    """The whole log, with chunks compressed by "none", "lz4" or "zstd".

    Uncompressed bytes depend on nothing but the recording; compressed ones also on the library's version.
    """
    from mcap.writer import CompressionType, Writer

    file = io.BytesIO()
    writer = Writer(file, chunk_size=chunk_bytes, compression=CompressionType[compression.upper()])
    writer.start(profile="", library=LIBRARY)
    topics = [
        _channel(writer, "/ardrone/command", "ardrone/Command", COMMAND),
        _channel(writer, "/ardrone/state", "ardrone/State", STATE),
    ]
    _messages(writer, recording, topics)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def _channel(writer: Any, topic: str, title: str, units: dict[str, str]) -> int:
    """Register a topic; returns its channel id."""
    stamp = {"type": "integer", "unit": "ns", "description": "UTC of the sample by the vehicle's clock"}
    numbers = {
        name: {"type": "number", "unit": unit, "description": MEANING[name]} for name, unit in units.items()
    }
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "type": "object",
        "properties": {"stamp": stamp, **numbers},
        "required": ["stamp", *units],
    }
    text = json.dumps(schema, separators=(",", ":")).encode()
    schema_id = writer.register_schema(name=title, encoding="jsonschema", data=text)
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id))


def _messages(writer: Any, recording: Recording, topics: list[int]) -> None:
    rows = [_rows(recording, recording.command, COMMAND), _rows(recording, recording.state, STATE)]
    due, kind, row = in_sending_order(recording.command.time_ns, recording.state.time_ns)
    arrival = arrival_utc_ns(recording, due)
    for i in np.flatnonzero(heard(recording, due)).tolist():
        writer.add_message(
            channel_id=topics[kind[i]],
            log_time=int(arrival[i]),
            data=rows[kind[i]][row[i]],
            publish_time=int(due[i]) + recording.boot_utc_ns,
            sequence=int(row[i]),
        )


def _rows(
    recording: Recording, series: Telemetry, units: dict[str, str], *, decimals: int = 6
) -> list[bytes]:
    """One JSON document per sample, at a micro-unit's resolution."""
    columns = [np.round(series[name], decimals).tolist() for name in units]
    stamps = (series.time_ns + recording.boot_utc_ns).tolist()
    names = ("stamp", *units)
    return [
        json.dumps(dict(zip(names, values, strict=True)), separators=(",", ":")).encode()
        for values in zip(stamps, *columns, strict=True)
    ]
