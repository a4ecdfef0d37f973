"""PX4 ULog."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "ulog",
        "PX4 ULog",
        (".ulg",),
        "flysid.ingest.formats.ulog.reader",
        "flysid.ingest.formats.ulog.scrub",
    ),
)
