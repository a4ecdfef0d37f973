"""ROS 2 bags: SQLite, read page by page."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "rosbag2",
        "ROS 2 bag (SQLite)",
        (".db3", ".db3.zstd"),
        "flysid.ingest.formats.rosbag2.reader",
        "flysid.ingest.formats.rosbag2.scrub",
        joins=True,
    ),
)
