"""ROS 1 bags."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "rosbag",
        "ROS 1 bag",
        (".bag",),
        "flysid.ingest.formats.rosbag1.reader",
        "flysid.ingest.formats.rosbag1.scrub",
        joins=True,
    ),
)
