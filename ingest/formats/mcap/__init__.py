"""MCAP containers."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "mcap",
        "MCAP (ROS 1, ROS 2, protobuf, JSON)",
        (".mcap",),
        "flysid.ingest.formats.mcap.reader",
        "flysid.ingest.formats.mcap.scrub",
        joins=True,
    ),
)
