"""Logs that say where, with what and by whom they were flown, one per format; and the bytes that tell it."""

from __future__ import annotations

import json
import math
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from mcap.writer import CompressionType

from flysid.ingest.formats.blackbox.writing import Writer, signed_vb
from flysid.ingest.formats.rosbag1.writer import BagWriter
from tests.samplelogs import blackbox, dataflash, dataflash_text, mcap, navdata, rosbag2, tlog, ulog

STEPS = 60
LAT = 48.1234567
LON = -122.7654321
ALT = 523.45
SERIAL = b"0039002F31385114"
PASSWORD = b"tell no one"
UID = bytes(range(101, 119))


@dataclass(frozen=True)
class Private:
    """A log, what must not be in its scrubbed copy, and the stream and columns of its main position."""

    suffix: str
    blob: bytes
    secrets: tuple[bytes, ...]
    stream: str
    columns: tuple[str, str]


def track(k: int) -> tuple[float, float, float]:
    """Degrees, degrees, metres: a circle of about 30 m, climbing."""
    return LAT + 3e-4 * math.sin(0.1 * k), LON + 4e-4 * math.cos(0.1 * k), ALT + 0.1 * k


def scaled(k: int) -> tuple[int, int, int]:
    """1e-7 degrees, 1e-7 degrees, millimetres."""
    lat, lon, alt = track(k)
    return round(lat * 1e7), round(lon * 1e7), round(alt * 1e3)


def integers() -> tuple[bytes, ...]:
    """The coordinates as int32, in both byte orders."""
    values = [v for k in range(STEPS) for v in scaled(k)[:2]]
    return tuple(struct.pack(order + "i", v) for v in values for order in "<>")


def doubles() -> tuple[bytes, ...]:
    return tuple(struct.pack(order + "d", v) for k in range(STEPS) for v in track(k)[:2] for order in "<>")


def telemetry() -> Private:
    link = tlog.sender()
    signed = tlog.sender()
    signed.signing.secret_key = bytes(32)
    signed.signing.sign_outgoing = True
    signed.signing.timestamp = 1
    out = []
    for k in range(STEPS):
        lat, lon, alt = scaled(k)
        ms = 5000 + 20 * k
        us = tlog.EPOCH_US + 20_000 * k
        messages = [
            link.attitude_encode(ms, math.sin(0.1 * k), 0.5, -1, 0, 0, 0),
            link.global_position_int_encode(ms, lat, lon, alt, 100 * k, 10, -20, 3, 9000),
            link.gps_raw_int_encode(
                us, 3 if k > 5 else 0, *((lat, lon, alt) if k > 5 else (0, 0, 0)), 90, 80, 10, 20, 9
            ),
        ]
        if k % 10 == 0:
            messages += [
                link.home_position_encode(*scaled(0), 0, 0, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0),
                link.statustext_encode(6, b"board " + SERIAL + b" at 48.1234567"),
                link.autopilot_version_encode(
                    1, 1, 1, 1, 1, b"12345678", b"12345678", b"12345678", 7, 8, 0, UID
                ),
                link.param_value_encode(b"BRD_SERIAL_NUM", 4711.0, 9, 2, 0),
                link.param_value_encode(b"ATC_RAT_RLL_P", 0.135, 9, 2, 1),
                link.wifi_config_ap_encode(b"home", PASSWORD),
                link.mission_item_int_encode(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, lat, lon, 20.0),
                link.mission_item_int_encode(1, 1, 0, 1, 16, 0, 1, 0, 0, 0, 0, 12345, 678, 20.0),
                link.command_long_encode(1, 1, 179, 0, 0, 0, 0, 0, LAT, LON, 5.0),
                link.gps_rtcm_data_encode(0, 4, (SERIAL + bytes(164))),
            ]
        for message in messages:
            sender = signed if k % 7 == 3 else link
            sender.seq = link.seq
            out.append(tlog.stamped(us, tlog.frame(sender, message)))
            link.seq = sender.seq
        if k == 30:
            out.append(b"\x00" * 9 + struct.pack("<ii", *scaled(30)[:2]))
    floats = tuple(struct.pack("<f", v) for v in (LAT, LON))
    secrets = (*integers(), *floats, SERIAL, PASSWORD, UID, b"48.1234567", struct.pack("<f", 4711.0))
    return Private(".tlog", b"".join(out), secrets, "1.1/GLOBAL_POSITION_INT", ("lat", "lon"))


DF_TYPES = dataflash.TYPES | {
    20: ("PARM", "QNff", "TimeUS,Name,Value,Default"),
    21: ("FILE", "NIBZ", "FileName,Offset,Length,Data"),
    22: ("CAND", "QBQQ", "TimeUS,NodeId,UID1,UID2"),
}


def binary() -> Private:
    kept = dict(dataflash.TYPES)
    dataflash.TYPES.update(DF_TYPES)
    try:
        out = [dataflash.fmt(n) for n in DF_TYPES]
        out += [
            dataflash.pack(12, 1, f"PX4v2 {SERIAL.decode()} x"),
            dataflash.pack(20, 2, "BRD_SERIAL_NUM", 4711.0, 0.0),
        ]
        out += [
            dataflash.pack(20, 3, "ATC_RAT_RLL_P", 0.135, 0.1),
            dataflash.pack(21, "scripts", 0, 9, PASSWORD.decode()),
        ]
        out += [dataflash.pack(22, 4, 3, int.from_bytes(UID[:8], "little"), 7)]
        for k in range(STEPS):
            lat, lon, alt = scaled(k)
            us = 10_000_000 + 20_000 * k
            out += [dataflash.pack(10, us, 10 * k, -k, 100 * k, 0.25 * k)]
            out += [dataflash.pack(11, us + 500, 3, 200_000_000 + 20 * k, 2300, lat, lon, alt // 10)]
    finally:
        dataflash.TYPES.clear()
        dataflash.TYPES.update(kept)
    secrets = (*integers(), SERIAL, PASSWORD, UID[:8], struct.pack("<f", 4711.0))
    return Private(".bin", b"".join(out), secrets, "GPS", ("Lat", "Lng"))


def text() -> Private:
    lines = [
        f"FMT, {n}, 20, {name}, {form}, {labels}" for n, (name, form, labels) in DF_TYPES.items() if n != 21
    ]
    lines += [
        f"MSG, 1, PX4v2 {SERIAL.decode()} x",
        "PARM, 2, BRD_SERIAL_NUM, 4711, 0",
        "PARM, 3, ATC_RAT_RLL_P, 0.135, 0.1",
    ]
    secrets: list[bytes] = [SERIAL, b"4711"]
    for k in range(STEPS):
        lat, lon, alt = track(k)
        us = 10_000_000 + 20_000 * k
        lines.append(f"ATT, {us}, {0.1 * k:.2f}, {-k / 100:.2f}, {k}, {0.25 * k}")
        lines.append(f"GPS, {us + 500}, 3, {200_000_000 + 20 * k}, 2300, {lat:.7f}, {lon:.7f}, {alt:.2f}")
        secrets += [f"{lat:.7f}".encode(), f"{lon:.7f}".encode()]
    return Private(
        dataflash_text.SUFFIX, "\n".join(lines).encode() + b"\n", tuple(secrets), "GPS", ("Lat", "Lng")
    )


def px4() -> Private:
    old = (
        "vehicle_gps_position:uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt;"
        "float vel_m_s;uint8_t fix_type;"
    )
    new = "vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;float terrain;"
    motion = "vehicle_attitude:uint64_t timestamp;float[4] q;"
    parts = [ulog.HEAD, ulog.record("B", bytes(40))]
    parts += [ulog.record("F", f.encode()) for f in (old, new, motion)]
    parts += [
        ulog.record("I", ulog.named("char[16] sys_uuid", SERIAL)),
        ulog.record("I", ulog.named("char[3] sys_name", b"PX4")),
    ]
    parts += [ulog.record("P", ulog.named("int32_t CAL_ACC0_ID", struct.pack("<i", 1310988)))]
    parts += [ulog.record("P", ulog.named("float MPC_XY_P", struct.pack("<f", 0.95)))]
    parts += [ulog.subscribe(i, 0, f.partition(":")[0]) for i, f in enumerate((old, new, motion))]
    for k in range(STEPS):
        us = 2_000_000 + 20_000 * k
        parts.append(ulog.data(0, struct.pack("<QiiifB", us, *scaled(k), 2.5, 3)))
        parts.append(ulog.data(1, struct.pack("<Qddff", us + 1, *track(k), 500.0)))
        parts.append(ulog.data(2, struct.pack("<Q4f", us + 2, 1.0, 0.1 * k, 0.0, 0.0)))
        if k == 20:
            parts.append(ulog.record("L", b"6" + struct.pack("<Q", us) + b"board " + SERIAL))
    secrets = (*integers(), *doubles(), SERIAL, struct.pack("<i", 1310988))
    return Private(".ulg", b"".join(parts), secrets, "vehicle_gps_position", ("lat", "lon"))


NAVSATFIX = (
    "std_msgs/Header header\nint8 status\nfloat64 latitude\nfloat64 longitude\n"
    "float64 altitude\nstring name\n"
)


def _fix_message(k: int, ros: int) -> bytes:
    """NAVSATFIX without its own library: packed in ROS 1, aligned in CDR."""
    out = bytearray()

    def put(form: str, *values: object) -> None:
        size = struct.calcsize("<" + form[-1])
        if ros == 2:
            out.extend(bytes(-len(out) % size))
        out.extend(struct.pack("<" + form, *values))

    def string(value: bytes) -> None:
        raw = value + b"\0" * (ros == 2)
        put("I", len(raw))
        out.extend(raw)

    for number in (1, 2, k) if ros == 1 else (k, 5):
        put("I", number)
    string(b"gps")
    put("b", 0)
    for value in track(k):
        put("d", value)
    string(b"unit " + SERIAL)
    return (b"\x00\x01\x00\x00" if ros == 2 else b"") + bytes(out)


def ros_bag() -> Private:
    """ROS 1: a receiver and a plain topic, whose publishers are named after a machine and a user."""
    text = f"{NAVSATFIX}{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    topics = {"/gps": ("p/Fix", text), "/motion": ("p/Pair", "float64 x\nfloat64 y\n")}
    with tempfile.TemporaryFile() as body:
        writer = BagWriter(body)
        for topic, (kind, definition) in topics.items():
            about = {
                "type": kind,
                "md5sum": "0" * 32,
                "message_definition": definition,
                "callerid": f"/{SERIAL.decode()}",
            }
            writer.connect(topic.encode(), {k.encode(): v.encode() for k, v in about.items()})
        for k in range(STEPS):
            time = struct.pack("<II", 1_600_000_000 + k, 5)
            writer.add(0, time, _fix_message(k, 1))
            writer.add(1, time, struct.pack("<dd", k / 3, -k))
        writer.finish()
        body.seek(0)
        blob = writer.head() + body.read()
    return Private(".bag", blob, (*doubles(), SERIAL), "/gps", ("latitude", "longitude"))


def ros2_bag() -> Private:
    text = f"{NAVSATFIX}{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    topics = [
        ("/gps", "p/msg/Fix", "ros2msg", text),
        ("/motion", "p/msg/Pair", "ros2msg", "float64 x\nfloat64 y\n"),
    ]
    rows = []
    for k in range(STEPS):
        pair = b"\x00\x01\x00\x00" + struct.pack("<dd", k / 3, -k)
        rows += [(1, 1_600_000_000 * 10**9 + k, _fix_message(k, 2)), (2, 1_600_000_000 * 10**9 + k, pair)]
    secrets = (*doubles(), SERIAL)
    return Private(".db3", rosbag2.database(topics, rows), secrets, "/gps", ("latitude", "longitude"))


def robot() -> Private:
    rows = [
        {
            "k": k,
            "fix": dict(zip(("latitude", "longitude", "altitude"), track(k), strict=True)),
            "vx": k / 7,
            "serial": SERIAL.decode(),
        }
        for k in range(STEPS)
    ]
    separator = "=" * 80
    ros1 = f"{NAVSATFIX}{separator}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    ros2 = f"{NAVSATFIX}{separator}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    pairs = [struct.pack("<dd", k / 3, -k) for k in range(STEPS)]
    topics = [
        mcap.json_topic("/json", {"properties": {"k": {"type": "integer"}}}, rows),
        mcap.ros1_topic("/ros1/gps", "p/Fix", ros1, [_fix_message(k, 1) for k in range(STEPS)]),
        mcap.ros2_topic("/ros2/gps", "p/msg/Fix", ros2, [_fix_message(k, 2) for k in range(STEPS)]),
        mcap.ros1_topic("/motion", "p/Pair", "float64 x\nfloat64 y\n", pairs),
    ]
    blob = mcap.mcap_file(topics, compression=CompressionType.NONE, chunk_size=2000)
    texts = tuple(json.dumps(v).encode() for k in range(STEPS) for v in track(k)[:2])
    return Private(".mcap", blob, (*doubles(), *texts, SERIAL), "/ros2/gps", ("latitude", "longitude"))


def ardrone() -> Private:
    from flysid.ingest.formats.ardrone.layouts import OPTIONS

    kind = OPTIONS[27].dtype()
    out = []
    for k in range(STEPS):
        row = np.zeros(1, dtype=kind)
        lat, lon, alt = track(k)
        row["latitude"] = lat
        row["longitude"] = lon
        row["elevation"] = alt
        row["lat0"], row["long0"], row["lat_fused"], row["long_fused"] = *track(0)[:2], lat, lon
        options = {
            navdata.DEMO: navdata.demo(k),
            navdata.TIME: navdata.clock(5_000_000 + 5000 * k),
            27: row.tobytes(),
        }
        out.append(navdata.packet(k + 1, options))
    return Private(navdata.SUFFIX, b"".join(out), doubles(), "navdata/gps", ("latitude", "longitude"))


def betaflight() -> Private:
    """Two logs in a file: positions that count from home, and positions as they are."""
    plain = replace(blackbox.GPS, predictor=[10, 0, 0, 0, 0, 0])
    home = scaled(0)[:2]
    names = {"Craft name": SERIAL.decode(), "Pilot name": PASSWORD.decode(), "features": "541196296"}
    out = []
    for gps in (blackbox.GPS, plain):
        writer = Writer(blackbox.KINDS | {"G": gps}, blackbox.SETTINGS | names)
        out += writer.header()
        iteration = 0
        for k in range(2 * STEPS):
            values = blackbox.main_values(k, iteration, 1_000_000)
            out.append(writer.frame("P" if iteration % 16 else "I", values))
            iteration = writer.due(iteration)
            if k == 0:
                out.append(writer.frame("H", home))
            if k % 2:
                lat, lon, alt = scaled(k // 2)
                out.append(writer.frame("G", [values[1] + 90, 9, lat, lon, alt // 100, 300]))
        out += [b"E\x65" + bytes([len(SERIAL)]) + SERIAL, blackbox.END]
    secrets = tuple(signed_vb(v) for k in range(STEPS) for v in scaled(k)[:2])
    return Private(
        ".bbl", b"".join(out), (*secrets, SERIAL, PASSWORD), "gps", ("GPS_coord[0]", "GPS_coord[1]")
    )


PRIVATE: dict[str, Callable[[], Private]] = {
    "blackbox": betaflight,
    "tlog": telemetry,
    "dataflash": binary,
    "dataflash_text": text,
    "ulog": px4,
    "mcap": robot,
    "navdata": ardrone,
    "rosbag": ros_bag,
    "rosbag2": ros2_bag,
}
