"""The real AR.Drone flight with motion capture, as a ROS 2 bag would have recorded it."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tests.samplelogs.mcap import Topic, mcap_file
from tests.samplelogs.ros import HEADER_2, POSE_STAMPED_2, definition

Columns = Mapping[str, npt.NDArray[np.float64]]

NAVDATA = definition(
    "std_msgs/Header header\nfloat32 rotX\nfloat32 rotY\nfloat32 rotZ\nint32 altd\n"
    "float32 vx\nfloat32 vy\nfloat32 vz\nuint8 motor1\nuint8 motor2\nuint8 motor3\nuint8 motor4\n",
    std_msgs__Header=HEADER_2,
    builtin_interfaces__Time="int32 sec\nuint32 nanosec\n",
)
_ANGLES_AND_SPEEDS = ("rotX_deg", "rotY_deg", "rotZ_deg", "altd_mm", "vx_mm_s", "vy_mm_s", "vz_mm_s")


def bag(nav: Columns, pose: Columns, pose_clock_late_s: float = 0.0, pose_drift_ppm: float = 0.0) -> bytes:
    """An MCAP file with /ardrone/navdata and /optitrack/pose, header stamps as recorded.

    Motion capture's clock may be set late and made to drift against its first stamp.
    """
    first = pose["stamp"][0]
    stamps = first + (pose["stamp"] - first) / (1 + 1e-6 * pose_drift_ppm) - pose_clock_late_s
    return mcap_file(
        [
            Topic(
                "/ardrone/navdata", "cdr", "ardrone/msg/Navdata", "ros2msg", NAVDATA.encode(), _navdata(nav)
            ),
            Topic(
                "/optitrack/pose",
                "cdr",
                "geometry_msgs/msg/PoseStamped",
                "ros2msg",
                POSE_STAMPED_2.encode(),
                _poses(pose, stamps),
            ),
        ],
        chunk_size=1 << 20,
    )


def _navdata(nav: Columns) -> list[tuple[int, bytes]]:
    rows = zip(*(nav[name].tolist() for name in _ANGLES_AND_SPEEDS), strict=True)
    motors = zip(*(nav[f"motor{i}"].astype(int).tolist() for i in range(1, 5)), strict=True)
    return [
        (
            round(stamp * 1e9),
            _header(stamp) + struct.pack("<fffifff4B", *row[:3], int(row[3]), *row[4:], *speeds),
        )
        for stamp, row, speeds in zip(nav["stamp"].tolist(), rows, motors, strict=True)
    ]


def _poses(pose: Columns, stamps: npt.NDArray[np.float64]) -> list[tuple[int, bytes]]:
    rows = zip(*(pose[name].tolist() for name in ("x", "y", "z", "qx", "qy", "qz", "qw")), strict=True)
    return [
        (round(stamp * 1e9), _header(stamp) + struct.pack("<7d", *row))
        for stamp, row in zip(stamps.tolist(), rows, strict=True)
    ]


def _header(stamp: float) -> bytes:
    """CDR encapsulation, stamp, an empty frame_id; padded to 16 bytes so that doubles follow aligned."""
    nanoseconds = round(stamp * 1e9)
    head = struct.pack("<iI", nanoseconds // 10**9, nanoseconds % 10**9) + struct.pack("<I", 4) + b"abc\0"
    return b"\x00\x01\x00\x00" + head


def read_flight(folder: Path) -> tuple[Columns, Columns]:
    """The two recordings of the real flight, from ../shared/logs."""
    import pyarrow.parquet as pq

    names = ("ardrone2_flight_nav_198hz", "ardrone2_flight_optitrack_120hz")
    tables = [pq.read_table(folder / "ardrone" / f"{name}.parquet") for name in names]
    nav, pose = ({c: t[c].to_numpy().astype(np.float64) for c in t.column_names} for t in tables)
    return nav, pose
