"""A recording -> MCAP as a ROS 1 or ROS 2 ground station would have recorded an AR.Drone.

Topics: /cmd_vel (geometry_msgs/Twist: tilts and climb as fractions of the firmware's limits, forward, left
and up positive), /ardrone/navdata (ardrone_autonomy/Navdata: rotX right, rotY forward, rotZ left positive
in degrees; vx forward, vy left in mm/s; altd in mm; vz stays zero, as on the vehicle) and /pose
(geometry_msgs/ PoseStamped, motion capture in a frame x forward, y left, z up). Messages carry a stamp
where their type has one.

ROS 1 serialises fields one after the other; ROS 2 (CDR) puts 4 bytes in front and aligns every number to
its size.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import (
    IntArray,
    Recording,
    arrival_utc_ns,
    as_bytes,
    heard,
    in_sending_order,
)

Field = tuple[str, str]
Definition = tuple[str, dict[str, str]]  # the message, and the messages it needs
LIMITS = {"theta_in": np.degrees(0.209), "phi_in": np.degrees(0.209), "vz_in": 0.7}
FLYING = 3

HEADER = "std_msgs/Header header"
VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
TWIST = ("geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n", {"geometry_msgs/Vector3": VECTOR})
POSE = (
    f"{HEADER}\ngeometry_msgs/Pose pose\n",
    {
        "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        "geometry_msgs/Point": VECTOR,
        "geometry_msgs/Quaternion": VECTOR + "float64 w\n",
    },
)
NAVDATA_FIELDS = (
    "float32 batteryPercent", "uint32 state", "int32 magX", "int32 magY", "int32 magZ", "int32 pressure",
    "int32 temp", "float32 wind_speed", "float32 wind_angle", "float32 wind_comp_angle", "float32 rotX",
    "float32 rotY", "float32 rotZ", "int32 altd", "float32 vx", "float32 vy", "float32 vz", "float32 ax",
    "float32 ay", "float32 az", "uint8 motor1", "uint8 motor2", "uint8 motor3", "uint8 motor4",
    "uint32 tags_count", "uint32[] tags_type", "uint32[] tags_xc", "uint32[] tags_yc", "uint32[] tags_width",
    "uint32[] tags_height", "float32[] tags_orientation", "uint32[] tags_distance", "float32 tm",
)  # fmt: skip
NAVDATA: Definition = ("\n".join((HEADER, *NAVDATA_FIELDS, "")), {})
NUMPY = {"float64": "<f8", "float32": "<f4", "uint32": "<u4", "int32": "<i4", "uint8": "u1"}


@dataclass(frozen=True)
class Dialect:
    """How one ROS writes messages down."""

    name: str
    schema_encoding: str
    message_encoding: str
    type_infix: str
    header: str
    aligned: bool


ROS1 = Dialect("ros1", "ros1msg", "ros1", "/", "uint32 seq\ntime stamp\nstring frame_id\n", False)
ROS2 = Dialect("ros2", "ros2msg", "cdr", "/msg/", "builtin_interfaces/Time stamp\nstring frame_id\n", True)
STAMP2 = "int32 sec\nuint32 nanosec\n"


def ros1_bytes(recording: Recording) -> bytes:
    """The whole log as ROS 1 records it."""
    return _ros_bytes(recording, ROS1)


def ros2_bytes(recording: Recording) -> bytes:
    """The whole log as ROS 2 records it."""
    return _ros_bytes(recording, ROS2)


def _ros_bytes(recording: Recording, ros: Dialect) -> bytes:
    from mcap.writer import CompressionType, Writer

    file = io.BytesIO()
    writer = Writer(file, chunk_size=256 * 1024, compression=CompressionType.NONE)
    writer.start(profile=ros.name, library="flysid")
    sent = recording.command.time_ns
    seen = recording.state.time_ns
    topics = (
        ("/cmd_vel", "geometry_msgs/Twist", TWIST, sent, _twist(recording, ros)),
        ("/ardrone/navdata", "ardrone_autonomy/Navdata", NAVDATA, seen, _navdata(recording, ros)),
        ("/pose", "geometry_msgs/PoseStamped", POSE, seen, _pose(recording, ros)),
    )
    channels = [_channel(writer, ros, topic, kind, text) for topic, kind, text, _, _ in topics]
    rows = [as_bytes(table) for *_, table in topics]
    due, topic, row = in_sending_order(*(times for *_, times, _ in topics))
    arrival = arrival_utc_ns(recording, due)
    for i in np.flatnonzero(heard(recording, due)).tolist():
        now = int(arrival[i])
        writer.add_message(channels[topic[i]], now, rows[topic[i]][row[i]], now, int(row[i]))
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def _channel(writer: Any, ros: Dialect, topic: str, kind: str, text: Definition) -> int:
    """Register a topic with its definition and those it needs. ROS 2 forbids capitals in field names."""
    body, needs = text
    if ros.aligned:
        body = re.sub(r"(?<= )\w+$", lambda m: snake(m[0]), body, flags=re.MULTILINE)
    if HEADER in body:
        needs = {**needs, "std_msgs/Header": ros.header}
        if ros.aligned:
            needs["builtin_interfaces/Time"] = STAMP2
    joined = body + "".join(f"{'=' * 80}\nMSG: {name}\n{part}" for name, part in needs.items())
    schema = writer.register_schema(kind.replace("/", ros.type_infix), ros.schema_encoding, joined.encode())
    return int(writer.register_channel(topic, ros.message_encoding, schema))


def snake(name: str) -> str:
    """rotX to rot_x, batteryPercent to battery_percent."""
    return re.sub(r"(?<=[a-z0-9])([A-Z])", r"_\1", name).lower()


def layout(fields: Sequence[Field], aligned: bool) -> np.dtype[Any]:
    """The bytes of a message of fixed size: packed, or CDR with its 4 bytes in front."""
    offsets = []
    at = 4 if aligned else 0
    for _, code in fields:
        size = np.dtype(code).itemsize
        unit = 1 if code.startswith("S") else size
        if aligned:
            at += -(at - 4) % unit
        offsets.append(at)
        at += size
    names, formats = zip(*fields, strict=True)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})


def _rows(n: int, fields: Sequence[Field], ros: Dialect) -> npt.NDArray[np.void]:
    rows: npt.NDArray[np.void] = np.zeros(n, dtype=layout(fields, ros.aligned))
    if ros.aligned:
        rows.view(np.uint8).reshape(n, -1)[:, 1] = 1  # CDR, little-endian
    return rows


def _stamp(recording: Recording, frame: str, fields: Sequence[Field], ros: Dialect) -> npt.NDArray[np.void]:
    """Rows of the state's messages with their header filled in."""
    text = frame.encode() + (b"\0" if ros.aligned else b"")
    head: list[Field] = [] if ros.aligned else [("seq", "<u4")]
    head += [("sec", "<u4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame_id", f"S{len(text)}")]
    utc_ns: IntArray = recording.boot_utc_ns + recording.state.time_ns
    rows = _rows(len(utc_ns), [*head, *fields], ros)
    rows["sec"] = utc_ns // SECOND_NS
    rows["nanosec"] = utc_ns % SECOND_NS
    rows["length"] = len(text)
    rows["frame_id"] = text
    if not ros.aligned:
        rows["seq"] = np.arange(len(rows))
    return rows


def fraction(recording: Recording, name: str) -> FloatArray:
    """A command as a share of the firmware's limit, clipped as the firmware does."""
    return np.asarray(np.clip(recording.command[name] / LIMITS[name], -1.0, 1.0), dtype=np.float64)


def _twist(recording: Recording, ros: Dialect) -> npt.NDArray[np.void]:
    rows = _rows(len(recording.command), [(n, "<f8") for n in ("x", "y", "z", "rx", "ry", "rz")], ros)
    rows["x"], rows["y"] = fraction(recording, "theta_in"), -fraction(recording, "phi_in")
    rows["z"] = fraction(recording, "vz_in")
    return rows


def _navdata(recording: Recording, ros: Dialect) -> npt.NDArray[np.void]:
    pairs = [line.split() for line in NAVDATA_FIELDS]
    fields = [
        (name, "<u4" if kind.endswith("[]") else NUMPY[kind]) for kind, name in pairs
    ]  # empty: length 0
    rows = _stamp(recording, "ardrone_base_link", fields, ros)
    state = recording.state
    rows["batteryPercent"] = 90.0
    rows["state"] = FLYING
    rows["rotX"], rows["rotY"], rows["rotZ"] = state["phi"], state["theta"], -state["psi"]
    rows["vx"], rows["vy"] = 1000.0 * state["vx"], -1000.0 * state["vy"]
    rows["altd"] = np.round(1000.0 * (state["z"] + recording.start_height_m))
    rows["az"] = 1.0
    rows["tm"] = state.time_ns * 1e-3
    return rows


def _pose(recording: Recording, ros: Dialect) -> npt.NDArray[np.void]:
    names = ("px", "py", "pz", "qx", "qy", "qz", "qw")
    rows = _stamp(recording, "world", [(n, "<f8") for n in names], ros)
    state = recording.state
    rows["px"], rows["py"], rows["pz"] = state["x"], -state["y"], state["z"] + recording.start_height_m
    for name, value in zip(names[3:], _orientation(state["phi"], state["theta"], -state["psi"]), strict=True):
        rows[name] = value
    return rows


def _orientation(phi_deg: FloatArray, theta_deg: FloatArray, psi_deg: FloatArray) -> list[FloatArray]:
    """x, y, z, w of the turns Z (psi), X (phi), Y (theta), the paper's order."""
    half = [np.radians(a) / 2.0 for a in (phi_deg, theta_deg, psi_deg)]
    (sp, st, ss), (cp, ct, cs) = (np.sin(a) for a in half), (np.cos(a) for a in half)
    return [
        cs * sp * ct - ss * cp * st,
        cs * cp * st + ss * sp * ct,
        cs * sp * st + ss * cp * ct,
        cs * cp * ct - ss * sp * st,
    ]
