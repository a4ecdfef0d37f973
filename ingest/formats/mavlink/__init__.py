"""MAVLink telemetry: `.tlog` and raw streams."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "tlog",
        "MAVLink telemetry (.tlog, raw, pcap)",
        (".tlog", ".rlog", ".mavlink", ".raw", ".pcap", ".pcapng", ".cap"),
        "flysid.ingest.formats.mavlink.reader",
        "flysid.ingest.formats.mavlink.scrub",
        zeros=8,
    ),
)
