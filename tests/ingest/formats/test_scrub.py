"""A scrubbed log tells nothing that it should not, and flies as the log did."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sqlite3
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import zstandard

import flysid
from flysid.cli.scrub import apart
from flysid.errors import FormatError, UsageError
from flysid.flight import Flight, field_scale
from flysid.ingest.formats.base import map_file
from flysid.ingest.formats.common.scrub_rules import (
    Fix,
    Gps,
    Scrubber,
    ScrubColumn,
    is_private_parameter,
    places,
    redact,
)
from flysid.ingest.formats.rosbag1.writer import BagWriter
from flysid.ingest.formats.scrubbing import Scrubbed, scrub_log, scrubbers
from tests.private_logs import ALT, PRIVATE, SERIAL, STEPS, Private
from tests.samplelogs import tlog

ROOT = Path(__file__).resolve().parents[3]
METRES = 111_319.49


@pytest.fixture(params=PRIVATE)
def private(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Private, Path]:
    log = PRIVATE[request.param]()
    (tmp_path / f"log{log.suffix}").write_bytes(log.blob)
    return log, tmp_path / f"log{log.suffix}"


def scrubbed(path: Path, **options: Any) -> tuple[Scrubbed, Path]:
    out = path.with_name(f"out{path.suffix}")
    return scrub_log(path, out, **options), out


def degrees(flight: Flight, log: Private) -> np.ndarray:
    """(n, 2) of the main position, without rows that have no fix."""
    table = flight[log.stream]
    columns = [table[c].to_numpy().astype(float) * field_scale(table.schema.field(c)) for c in log.columns]
    found = np.column_stack(columns)
    found = found * (1e-7 if np.abs(found).max() > 360 else 1.0)
    return found[np.any(found != 0, axis=1)]


def test_every_format_has_a_private_log() -> None:
    assert set(PRIVATE) == set(scrubbers())


@pytest.mark.parametrize("gps", ["shift", "remove"])
def test_no_secret_bytes_remain(private: tuple[Private, Path], gps: str) -> None:
    log, path = private
    present = [s for s in log.secrets if s in log.blob]
    assert len(present) > 100, "the log does hold what is looked for"
    done, out = scrubbed(path, gps=gps)
    content = out.read_bytes()
    assert [s for s in present if s in content] == []
    assert sum(n for (what, _), n in done.removed.items() if what == "positions") >= STEPS


def test_the_copy_reads_without_loss_and_nothing_else_has_changed(private: tuple[Private, Path]) -> None:
    _, path = private
    done, out = scrubbed(path)
    before = flysid.read(path)
    after = flysid.read(out)
    assert not after.damage.lossy
    gone = set(before.tables) - set(after.tables)
    assert all(any(key in where for what, where in done.removed if what == "embedded data") for key in gone)
    for key in after.tables:
        assert after.tables[key].num_rows == before.tables[key].num_rows
        changed = {
            c
            for c in before.tables[key].column_names
            if not same(before.tables[key][c], after.tables[key][c])
        }
        known = " ".join(where for _, where in done.removed)
        assert not changed & {"time_ns", "boot"}
        assert not changed or key.rpartition("/")[2] in known or key in known, (key, changed)


def same(a: pa.ChunkedArray, b: pa.ChunkedArray) -> bool:
    if a.equals(b):
        return True
    return pa.types.is_floating(a.type) and np.array_equal(a.to_numpy(), b.to_numpy(), equal_nan=True)


def test_a_shifted_position_keeps_its_metres(private: tuple[Private, Path]) -> None:
    log, path = private
    _, out = scrubbed(path)
    before = degrees(flysid.read(path), log)
    after = degrees(flysid.read(out), log)
    assert len(before) == len(after)
    assert np.abs(after).max() < 0.02
    metres = [METRES * (d - d.mean(0)) * [1.0, np.cos(np.radians(d[:, 0].mean()))] for d in (before, after)]
    assert np.abs(metres[0] - metres[1]).max() < 0.05
    assert np.abs(metres[0]).max() > 25


def test_a_removed_position_is_no_fix(private: tuple[Private, Path]) -> None:
    log, path = private
    _, out = scrubbed(path, gps="remove")
    assert len(degrees(flysid.read(out), log)) == 0


def test_scrubbing_twice_finds_nothing_new(private: tuple[Private, Path]) -> None:
    _, path = private
    _, out = scrubbed(path, gps="remove")
    again = scrub_log(out, out.with_name(f"again{out.suffix}"), gps="remove")
    assert {what for (what, _), n in again.removed.items() if n} <= {"altitudes above sea level"}


def test_wounds_of_a_blackbox_log_are_not_in_the_copy(tmp_path: Path) -> None:
    blob = PRIVATE["blackbox"]().blob
    frames = [m.start() for m in re.finditer(rb"I[^H]", blob[6000:])]
    at = 6000 + frames[len(frames) // 2]
    path = tmp_path / "log.bbl"
    path.write_bytes(blob[:at] + b"\x00\xfe lat 48.1234567" + blob[at:])
    before = flysid.read(path)
    assert before.damage.bytes_skipped > 0
    done, out = scrubbed(path)
    after = flysid.read(out)
    assert (after.damage.bytes_skipped, after.damage.undecoded) == (0, {})
    assert after["main"].equals(before["main"])
    assert after["gps"].num_rows == before["gps"].num_rows
    assert after["events"].num_rows == before["events"].num_rows + 1
    assert 14 in after["events"]["event"].to_pylist()
    assert done.removed["bytes that could not be read", "between frames"] == before.damage.bytes_skipped
    assert b"48.12" not in out.read_bytes()


def test_a_real_blackbox_log_flies_as_before_elsewhere(tmp_path: Path) -> None:
    log = ROOT.parent / "shared" / "logs" / "blackbox" / "btfl_002.bbl"
    if not log.is_file():
        pytest.skip("no ../shared/logs")
    out = tmp_path / "out.bbl"
    done = scrub_log(log, out)
    before = flysid.read(log)
    after = flysid.read(out)
    assert not after.damage.lossy
    for stream in ("main", "slow", "events"):
        assert after[stream].equals(before[stream])
    lat, lon = (after["gps"][f"GPS_coord[{k}]"].to_numpy() * 1e-7 for k in (0, 1))
    assert max(np.abs(lat).max(), np.abs(lon).max()) < 0.05
    assert done.removed["positions", "gps"] == before["gps"].num_rows
    moved = [c for c in before["gps"].column_names if not before["gps"][c].equals(after["gps"][c])]
    assert moved == ["GPS_coord[0]", "GPS_coord[1]", "GPS_altitude"]


# -------------------------------------------------------------------------------- other people's readers


def test_pymavlink_reads_the_copy(tmp_path: Path) -> None:
    log = PRIVATE["tlog"]()
    (tmp_path / "log.tlog").write_bytes(log.blob)
    done, out = scrubbed(tmp_path / "log.tlog")
    parser = tlog.sender()
    found = [m for m in parser.parse_buffer(_frames(out.read_bytes())) or [] if m.get_type() != "BAD_DATA"]
    assert len(found) == flysid.read(tmp_path / "log.tlog").rows
    assert not any(m.get_signed() for m in found)
    assert done.removed["signatures", "frames"] > 0
    version = next(m for m in found if m.get_type() == "AUTOPILOT_VERSION")
    assert (version.uid, set(version.uid2)) == (0, {0})
    items = [m for m in found if m.get_type() == "MISSION_ITEM_INT"]
    assert (items[1].x, items[1].y) == (12345, 678), "local coordinates stay"
    values = {m.param_id: m.param_value for m in found if m.get_type() == "PARAM_VALUE"}
    assert values == {"BRD_SERIAL_NUM": 0.0, "ATC_RAT_RLL_P": pytest.approx(0.135)}
    assert (
        next(m.text for m in found if m.get_type() == "STATUSTEXT") == "board xxxxxxxxxxxxxxxx at xxxxxxxxxx"
    )


def _frames(blob: bytes) -> bytes:
    """A tlog without its times."""
    return b"".join(blob[r.start + 8 : r.end] for r in tlog.records(blob))


def test_pymavlink_reads_the_dataflash_copy(tmp_path: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    (tmp_path / "log.bin").write_bytes(PRIVATE["dataflash"]().blob)
    _, out = scrubbed(tmp_path / "log.bin")
    counts: dict[str, int] = {}
    reader = DFReader_binary(str(out))
    while (message := reader.recv_msg()) is not None:
        counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
        if message.get_type() == "GPS":
            assert abs(message.Lat) < 0.02
            assert abs(message.Alt) < 10
    reader.close() if hasattr(reader, "close") else None
    assert (counts["GPS"], counts["ATT"], counts["FILE"]) == (STEPS, STEPS, 1)


def test_pyulog_reads_the_copy(tmp_path: Path) -> None:
    from pyulog import ULog

    (tmp_path / "log.ulg").write_bytes(PRIVATE["ulog"]().blob)
    _, out = scrubbed(tmp_path / "log.ulg")
    read = ULog(str(out))
    assert not read.file_corruption
    assert np.abs(read.get_dataset("vehicle_global_position").data["lat"]).max() < 0.02
    assert read.msg_info_dict["sys_uuid"] == "0" * 16
    assert read.initial_parameters == {"CAL_ACC0_ID": 0, "MPC_XY_P": pytest.approx(0.95)}
    assert read.logged_messages[0].message == "board " + "x" * 16


def test_mcap_reads_the_copy(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    (tmp_path / "log.mcap").write_bytes(PRIVATE["mcap"]().blob)
    _, out = scrubbed(tmp_path / "log.mcap")
    both = []
    for path in (tmp_path / "log.mcap", out):
        reader = make_reader(io.BytesIO(path.read_bytes()), validate_crcs=True)
        both.append(
            [
                (s and s.name, c.topic, m.log_time, m.publish_time, m.sequence)
                for s, c, m in reader.iter_messages()
            ]
        )
    assert both[0] == both[1]


def by_rosbags(path: Path) -> list[Any]:
    reader = pytest.importorskip("rosbags.rosbag1", reason="the rosbags library is not installed").Reader
    with reader(path) as bag:
        return [(c.topic, c.msgtype, c.digest, time, len(raw)) for c, time, raw in bag.messages()]


def by_sqlite(path: Path) -> list[Any]:
    query = "SELECT t.name, t.type, d.encoded_message_definition, m.timestamp, length(m.data) FROM messages m"
    query += " JOIN topics t ON t.id = m.topic_id JOIN message_definitions d ON d.topic_type = t.type"
    with contextlib.closing(sqlite3.connect(path)) as link:
        assert link.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return link.execute(f"{query} ORDER BY m.id").fetchall()


@pytest.mark.parametrize(("form", "messages"), [("rosbag", by_rosbags), ("rosbag2", by_sqlite)])
def test_others_read_the_copy_of_a_bag(
    tmp_path: Path, form: str, messages: Callable[[Path], list[Any]]
) -> None:
    log = PRIVATE[form]()
    (tmp_path / f"log{log.suffix}").write_bytes(log.blob)
    _, out = scrubbed(tmp_path / f"log{log.suffix}")
    found = messages(out)
    assert found == messages(tmp_path / f"log{log.suffix}")
    assert len(found) == 2 * STEPS


@pytest.mark.parametrize("kind", [b"bz2", b"lz4"])
def test_a_compressed_bag_stays_compressed_and_a_topic_of_no_known_type_is_left_out(
    tmp_path: Path, kind: bytes
) -> None:
    log = tmp_path / "a.bag"
    with log.open("w+b") as file, tempfile.TemporaryFile() as body:
        writer = BagWriter(body, kind)
        about = {b"type": b"p/Pair", b"md5sum": b"0" * 32, b"message_definition": b"float64 x\nfloat64 y\n"}
        writer.connect(b"/motion", about)
        writer.connect(b"/strange", {**about, b"message_definition": b"nonsense[ x\n"})
        for k in range(40_000):  # several chunks
            writer.add(k % 2, struct.pack("<II", 1000 + k, 0), struct.pack("<dd", k, -k))
        writer.finish()
        body.seek(0)
        file.write(writer.head() + body.read())
    done = scrub_log(log, tmp_path / "b.bag")
    assert done.removed == {("bytes that could not be read", "messages of /strange"): 20_000}
    before = flysid.read(log)
    after = flysid.read(tmp_path / "b.bag")
    assert b"compression=" + kind in (tmp_path / "b.bag").read_bytes()
    assert not after.damage.lossy
    assert list(after.tables) == ["/motion"]
    assert after["/motion"].equals(before["/motion"])


def test_a_bag_compressed_as_a_whole_stays_so(tmp_path: Path) -> None:
    log = PRIVATE["rosbag2"]()
    (tmp_path / "a.db3.zstd").write_bytes(zstandard.compress(log.blob))
    done = scrub_log(tmp_path / "a.db3.zstd", tmp_path / "b.db3.zstd")
    copy = zstandard.ZstdDecompressor().decompressobj().decompress((tmp_path / "b.db3.zstd").read_bytes())
    assert not [s for s in log.secrets if s in copy]
    assert flysid.read(tmp_path / "b.db3.zstd").rows == 2 * STEPS
    assert sum(n for (what, _), n in done.removed.items() if what == "positions") >= STEPS


def test_protobuf_fields_are_found_by_their_names(tmp_path: Path) -> None:
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from mcap.writer import CompressionType

    from tests.samplelogs.mcap import Topic, mcap_file

    file = FileDescriptorProto(name="fix.proto", package="t", syntax="proto3")
    message = file.message_type.add(name="Fix")
    for number, name in enumerate(("latitude", "longitude", "altitude", "speed"), start=1):
        message.field.add(name=name, number=number, type=FieldDescriptorProto.TYPE_DOUBLE, label=1)
    message.field.add(name="device_name", number=5, type=FieldDescriptorProto.TYPE_STRING, label=1)
    pool = DescriptorPool()
    pool.Add(file)
    kind = GetMessageClass(pool.FindMessageTypeByName("t.Fix"))
    rows = [
        kind(latitude=48 + 1e-5 * k, longitude=11.25, altitude=ALT, speed=k, device_name="mine")
        for k in range(20)
    ]
    schema = FileDescriptorSet(file=[file]).SerializeToString()
    messages = [(k + 1, row.SerializeToString()) for k, row in enumerate(rows)]
    (tmp_path / "p.mcap").write_bytes(
        mcap_file(
            [Topic("/fix", "protobuf", "t.Fix", "protobuf", schema, messages)],
            compression=CompressionType.NONE,
        )
    )
    _, out = scrubbed(tmp_path / "p.mcap")
    table = flysid.read(out)["/fix"]
    assert np.abs(table["latitude"].to_numpy()).max() < 0.02
    assert table["speed"].to_pylist() == list(range(20))
    assert set(table["device_name"].to_pylist()) == {""}
    assert struct.pack("<d", 11.25) not in out.read_bytes()


# ------------------------------------------------------------------------------------------- the command


def flysid_scrub(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "flysid", "scrub", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=environment)


def test_the_command_says_what_it_removed(tmp_path: Path) -> None:
    (tmp_path / "a.tlog").write_bytes(PRIVATE["tlog"]().blob)
    done = flysid_scrub("a.tlog", "-o", "b.tlog", "--json", cwd=tmp_path)
    assert done.returncode == 3, "the log holds bytes that are no frame"
    removed = {(r["what"], r["where"]) for r in json.loads(done.stdout)["removed"]}
    assert {("identifiers", "WIFI_CONFIG_AP.password"), ("embedded data", "GPS_RTCM_DATA.data")} <= removed
    again = flysid_scrub("a.tlog", "-o", "b.tlog", cwd=tmp_path)
    assert (again.returncode, "the target exists" in again.stderr) == (2, True)
    itself = flysid_scrub("a.tlog", "-o", "./a.tlog", "--force", cwd=tmp_path)
    assert (itself.returncode, "would replace the log" in itself.stderr) == (2, True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.tlog", "b.tlog"]


def test_what_cannot_be_scrubbed_is_refused(tmp_path: Path) -> None:
    from tests.samplelogs import navdata

    capture = navdata.pcap([(5, navdata.udp(navdata.build()[:500], 5554, 5554))])
    (tmp_path / "a.pcap").write_bytes(capture)
    with pytest.raises(UsageError, match="cannot be scrubbed"):
        scrub_log(tmp_path / "a.pcap", tmp_path / "b.pcap")
    assert not (tmp_path / "b.pcap").exists()


@pytest.mark.parametrize(
    ("text", "clean"),
    [
        ("ArduCopter V4.5.7 (2a3dc4b7)", "ArduCopter V4.5.7 (2a3dc4b7)"),
        (f"PX4v2 {SERIAL.decode()}", "PX4v2 " + "x" * 16),
        ("Origin at 48.12345 -1.23456", "Origin at xxxxxxxx xxxxxxxx"),
        ("log /home/me/flights/1.bin open", "log xxxxxxxxxxxxxxxxxxxxxx open"),
        ("mail pilot@example.org now", "mail xxxxxxxxxxxxxxxxx now"),
        ("EKF3 IMU0 is using GPS, 12.5 V, 400 Hz", "EKF3 IMU0 is using GPS, 12.5 V, 400 Hz"),
    ],
)
def test_texts_lose_identifiers_only(text: str, clean: str) -> None:
    assert redact(text.encode()).decode() == clean


@pytest.mark.parametrize("gps", ["shift", "remove"])
def test_pairs_that_are_no_fix_lose_what_is_no_mark(gps: Gps) -> None:
    unset = 214.7483647
    lat = np.array([48.0, np.nan, unset, 0.0, 34.09, 95.0])
    lon = np.array([11.0, np.nan, unset, 0.0, 8e168, 11.0])
    new_lat, new_lon, is_fix = Scrubber(gps, Fix(48.0, 11.0, 0.0)).moved(lat, lon)
    assert is_fix.tolist() == [True] + [False] * 5
    assert np.allclose([new_lat[1:], new_lon[1:]], [np.nan, unset, 0, 0, 0], equal_nan=True)
    assert np.allclose([new_lat[0], new_lon[0]], 0.01 if gps == "shift" else 0.0)


def test_names_of_positions_and_parameters() -> None:
    names = [
        "timestamp",
        "lat",
        "lon",
        "alt",
        "alt_ellipsoid",
        "previous.lat",
        "previous.lon",
        "flat",
        "ref_lat",
        "ref_lon",
    ]
    found = [
        (p.lat.name, p.lon.name, [a.name for a in p.altitudes])
        for p in places([ScrubColumn(n, n) for n in names])
    ]
    assert found == [
        ("lat", "lon", ["alt", "alt_ellipsoid"]),
        ("previous.lat", "previous.lon", []),
        ("ref_lat", "ref_lon", []),
    ]
    private = [
        "BRD_SERIAL_NUM",
        "COMPASS_DEV_ID",
        "CAL_GYRO0_ID",
        "SIM_OPOS_LAT",
        "INS_ACC2_ID",
        "COMPASS_DEC",
    ]
    assert all(map(is_private_parameter, private))
    public = ["SERIAL1_BAUD", "ATC_RAT_RLL_P", "MAV_SYS_ID", "SERIAL_PASS1", "MPC_XY_P", "WPNAV_SPEED"]
    assert not any(map(is_private_parameter, public))


def cut_while_it_is_read(path: Path) -> Scrubbed:
    """What a recorder or a copy does that begins anew: the log's end is gone, and then looked at."""
    with map_file(path) as view:
        os.truncate(path, 0)
        return Scrubbed(str(view[-1]), {}, ())


@pytest.mark.skipif(sys.platform == "win32", reason="a mapped file cannot be cut there")
def test_a_log_that_is_cut_while_it_is_scrubbed_is_named(tmp_path: Path) -> None:
    (tmp_path / "log.tlog").write_bytes(tlog.build())
    with pytest.raises(FormatError, match="cut short meanwhile"):
        apart(cut_while_it_is_read, tmp_path / "log.tlog")
