"""MAVLink logs: equal to pymavlink on intact logs, better where it loses frames, on the vehicle's clock."""

from __future__ import annotations

import math
import random
import struct
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.facts.vehicle import vehicle_of
from flysid.flight import Flight, field_scale, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common.columns import as_array
from flysid.ingest.formats.mavlink import reader as tlog
from flysid.ingest.formats.mavlink.dialect import load_dialect
from flysid.ingest.formats.mavlink.frames import Scanner, plain_chain
from flysid.ingest.formats.registry import FORMATS
from tests.command import call
from tests.ingest.formats.things import apart
from tests.samplelogs.tlog import EPOCH_US, build, frame, sender, stamped

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "tlog"
MS = 1_000_000
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/logs is not there")


def read(blob: bytes, **limits: Any) -> Flight:
    return collect(memoryview(blob), "x.tlog", FORMATS["tlog"], Limits(**limits))


def log_of(frames: list[bytes], step_us: int = 1000) -> bytes:
    return b"".join(stamped(EPOCH_US + step_us * i, f) for i, f in enumerate(frames))


def pymavlink_rows(path: Path) -> dict[str, list[tuple[float, Any]]]:
    """What pymavlink reads, by stream key."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    rows: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    while (message := log.recv_match()) is not None:
        if message.get_type() != "BAD_DATA":
            key = f"{message.get_srcSystem()}.{message.get_srcComponent()}/{message.get_type()}"
            rows[key].append((message._timestamp, message))
    log.close()
    return rows


def same(ours: object, theirs: object) -> bool:
    if isinstance(ours, float) and isinstance(theirs, float) and math.isnan(theirs):
        return math.isnan(ours)
    return ours == theirs


@needs_logs
@pytest.mark.parametrize("name", ["sitl_copter_98s", "sitl_vtol_v1"])
def test_every_field_is_what_pymavlink_reads(name: str) -> None:
    flight = flysid.read(LOGS / f"{name}.tlog")
    expected = apart(flight, pymavlink_rows(LOGS / f"{name}.tlog"), lambda row, field: getattr(row[1], field))
    assert set(flight.streams) == set(expected)
    for stream, table in flight.tables.items():
        columns = table.to_pydict()
        assert table.num_rows == len(expected[stream]), stream
        for i, (stamp, message) in enumerate(expected[stream]):
            assert columns["recv_ns"][i] == pytest.approx(stamp * 1e9, abs=1000)
            for field in message._fieldnames:
                assert same(columns[field][i], getattr(message, field)), f"{stream}.{field} row {i}"


@needs_logs
@pytest.mark.parametrize(
    ("name", "rows", "skipped", "boots"),
    [
        ("sitl_copter_500s", 53_295, 0, 1),
        ("sitl_param_flood_v1_v2", 138, 0, 1),
        ("sitl_x27_two_boots_stray_bytes", 96_646, 2565, 2),
    ],
)
def test_known_logs_are_read_whole(name: str, rows: int, skipped: int, boots: int) -> None:
    flight = flysid.read(LOGS / f"{name}.tlog")
    assert (flight.rows, flight.damage.bytes_skipped, len(flight.clocks)) == (rows, skipped, boots)
    assert flight.damage.region_count == len(flight.damage.regions)
    assert sum(r.size for r in flight.damage.regions) == skipped


@needs_logs
def test_a_clock_that_runs_27_times_too_fast_is_followed() -> None:
    flight = flysid.read(LOGS / "sitl_x27_two_boots_stray_bytes.tlog")
    assert 1 / flight.clocks[1].slope == pytest.approx(27.1, abs=0.5)
    heartbeats = flight["1.1/HEARTBEAT"]
    times = heartbeats["time_ns"].to_numpy()
    boots = heartbeats["boot"].to_numpy()
    gaps = np.diff(times[boots == 1]) * 1e-9
    assert np.median(gaps) == pytest.approx(1.0, abs=0.05)


def test_short_v1_frames_after_v2_frames_are_kept() -> None:
    mav = sender()
    frames = []
    for _ in range(20):
        frames.append(frame(mav, mav.heartbeat_encode(2, 3, 81, 0, 4)))
        frames.append(frame(mav, mav.param_request_list_encode(1, 1), v1=True))
        frames.append(frame(mav, mav.heartbeat_encode(2, 3, 81, 0, 4), v1=True))
    for blob in (b"".join(frames), log_of(frames)):
        flight = read(blob)
        assert {s: t.num_rows for s, t in flight.tables.items()} == {
            "1.1/HEARTBEAT": 40,
            "1.1/PARAM_REQUEST_LIST": 20,
        }
        assert not flight.damage.lossy


def random_values(message: Any, rng: random.Random) -> list[Any]:
    """A value for every field, in the order of the constructor; NaN and infinities among the floats."""
    values: list[Any] = []
    for name, kind in zip(message.fieldnames, message.fieldtypes, strict=True):
        count = message.array_lengths[message.ordered_fieldnames.index(name)]
        values.append(random_value(kind, count, rng))
    return values


def random_value(kind: str, count: int, rng: random.Random) -> Any:
    if kind == "char":
        size = rng.randrange(count + 1) if count else 1
        return bytes(rng.choice(b"abcXYZ 09_") for _ in range(size))
    return [random_number(kind, rng) for _ in range(count)] if count else random_number(kind, rng)


def random_number(kind: str, rng: random.Random) -> float | int:
    if kind in ("float", "double"):
        value = rng.choice([math.nan, math.inf, -math.inf, -0.0, rng.uniform(-1e6, 1e6)])
        return float(struct.unpack("<f", struct.pack("<f", value))[0]) if kind == "float" else value
    bits = int("".join(c for c in kind.split("_mav")[0] if c.isdigit()))
    return (
        rng.randrange(1 << bits)
        if kind.startswith("u")
        else rng.randrange(-(1 << (bits - 1)), 1 << (bits - 1))
    )


@pytest.mark.parametrize("dialect", ["common", "ardupilotmega", "all"])
@pytest.mark.parametrize("form", ["v1", "v2", "signed"])
def test_every_message_comes_back(dialect: str, form: str) -> None:
    import importlib

    module = importlib.import_module(f"pymavlink.dialects.v20.{dialect}")
    mav = module.MAVLink(None, srcSystem=3, srcComponent=4)
    rng = random.Random(form)
    if form == "signed":
        mav.signing.secret_key = bytes(32)
        mav.signing.sign_outgoing = True
        mav.signing.timestamp = 1
    sent = []
    frames = []
    for number, kind in sorted(module.mavlink_map.items()):
        if form == "v1" and (number > 255 or kind.unpacker.size > 255):
            continue
        message = kind(*random_values(kind, rng))
        frames.append(frame(mav, message, v1=form == "v1"))
        sent.append(message)
    flight = read(log_of(frames))
    assert not flight.damage.lossy, flight.damage
    assert flight.rows == len(sent)
    for message in sent:
        row = flight[f"3.4/{message.msgname}"].to_pylist()[0]
        for name in message.fieldnames:
            if name == "param_value":  # read as what it means; test_parameters.py
                continue
            ours = row[name]
            theirs = getattr(message, name)
            theirs = theirs.decode() if isinstance(theirs, bytes) else theirs
            pairs = zip(ours, theirs, strict=True) if isinstance(ours, list) else [(ours, theirs)]
            assert all(same(a, b) for a, b in pairs), f"{message.msgname}.{name}"


def test_units_scales_and_enums_are_stated() -> None:
    mav = sender()
    flight = read(log_of([frame(mav, mav.global_position_int_encode(1, 2, 3, 4, 5, 6, 7, 8, 9))] * 3))
    schema = flight["GLOBAL_POSITION_INT"].schema
    assert (field_unit(schema.field("lat")), field_scale(schema.field("lat"))) == ("deg", 1e-7)
    assert (field_unit(schema.field("vx")), field_scale(schema.field("vx"))) == ("m/s", 0.01)
    heartbeat = read(log_of([frame(mav, mav.heartbeat_encode(2, 3, 81, 0, 4))] * 3))["HEARTBEAT"].schema
    assert b"MAV_TYPE_QUADROTOR" in heartbeat.field("type").metadata[b"enum"]


def flying(mav: Any, count: int, first_ms: int = 1000, step_ms: int = 20) -> list[bytes]:
    return [frame(mav, mav.attitude_encode(first_ms + step_ms * i, 0, 0, 0, 0, 0, 0)) for i in range(count)]


def test_messages_without_a_clock_lie_between_their_neighbours() -> None:
    vehicle = sender()
    station = sender(255, 190)
    frames: list[bytes] = []
    for i, attitude in enumerate(flying(vehicle, 100)):
        frames.append(attitude)
        if i % 10 == 3:
            frames.append(frame(vehicle, vehicle.heartbeat_encode(2, 3, 0, i, 4)))
        if i % 10 == 7:
            frames.append(frame(station, station.heartbeat_encode(6, 8, 0, i, 4)))
    for blob in (log_of(frames, 7000), b"".join(frames)):
        flight = read(blob)
        assert flight["1.1/ATTITUDE"]["time_ns"].to_pylist() == [(1000 + 20 * i) * MS for i in range(100)]
        for stream in ("1.1/HEARTBEAT", "255.190/HEARTBEAT"):
            table = flight[stream]
            assert table.schema.metadata[b"time_source"] == b"arrival-mapped"
            for time_ns, i in zip(
                table["time_ns"].to_pylist(), table["custom_mode"].to_pylist(), strict=True
            ):
                assert (1000 + 20 * i) * MS < time_ns < (1020 + 20 * i) * MS


def test_unix_time_in_time_usec_is_not_taken_for_time_since_boot() -> None:
    vehicle = sender()
    frames = []
    for i, attitude in enumerate(flying(vehicle, 50)):
        unix = EPOCH_US + 20_000 * i
        frames += [attitude, frame(vehicle, vehicle.gps_raw_int_encode(unix, 3, 0, 0, 0, 0, 0, 0, 0, 9))]
        frames.append(
            frame(vehicle, vehicle.raw_imu_encode(1_000_000 + 20_000 * i, 0, 0, 0, 0, 0, 0, 0, 0, 0))
        )
    flight = read(log_of(frames))
    assert flight["GPS_RAW_INT"].schema.metadata[b"time_source"] == b"arrival-mapped"
    assert flight["RAW_IMU"].schema.metadata[b"time_source"] == b"time_usec"
    assert flight["GPS_RAW_INT"]["time_ns"].to_pylist()[25] == pytest.approx(1500 * MS, abs=20 * MS)
    assert not flight.damage.lossy


def test_a_reboot_begins_a_boot_and_an_absurd_time_does_not() -> None:
    vehicle = sender()
    frames = flying(vehicle, 60, 50_000) + flying(vehicle, 60, 300)
    frames[20] = frame(vehicle, vehicle.attitude_encode(4_000_000_000, 0, 0, 0, 0, 0, 0))
    flight = read(log_of(frames, 20_000))
    assert flight["ATTITUDE"]["boot"].to_pylist() == [0] * 60 + [1] * 60
    assert flight.damage.time_outliers == {"1.1/ATTITUDE": 1}
    assert flight["ATTITUDE"]["time_ns"].to_pylist()[20] == pytest.approx(50_400 * MS, abs=21 * MS)
    assert [(c.boot, c.first_ns, c.last_ns) for c in flight.clocks] == [
        (0, 50_000 * MS, 51_180 * MS),
        (1, 300 * MS, 1480 * MS),
    ]


@pytest.mark.parametrize("stamp", [0, EPOCH_US - 50 * 31_557_600 * 10**6, 2**63 - 1])
def test_a_damaged_arrival_ahead_of_the_first_clock_moves_no_row(stamp: int) -> None:
    vehicle = sender()
    frames = [frame(vehicle, vehicle.heartbeat_encode(2, 3, 0, i, 4)) for i in range(3)]
    blob = bytearray(log_of(frames + flying(vehicle, 60), 20_000))
    blob[:8] = stamp.to_bytes(8, "big")
    flight = read(bytes(blob))
    assert flight["HEARTBEAT"]["time_ns"].to_pylist()[0] == pytest.approx(960 * MS, abs=41 * MS)
    assert flight.damage.time_outliers == {"recv_ns": 1}
    assert flight.clocks[0].slope == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("batch_bytes", [1 << 20, 2000])
def test_a_clock_that_leaps_is_cut_there_and_said(batch_bytes: int) -> None:
    vehicle = sender()
    frames = flying(vehicle, 100) + flying(vehicle, 200, 7_203_000)
    flight = read(log_of(frames, 20_000), batch_bytes=batch_bytes)
    assert flight["ATTITUDE"]["boot"].to_pylist() == [0] * 100 + [1] * 200
    assert "leapt ahead of the arrivals by 7,200.0 s before boot 1" in flight.info["clock_note"]
    first, second = (c.utc_offset_ns or 0 for c in flight.clocks)
    assert first - second == pytest.approx(7200 * 10**9, abs=10**9)
    assert not flight.damage.lossy


@pytest.mark.parametrize("batch_bytes", [1 << 20, 2000])
@pytest.mark.parametrize("leap_ms", [1500, 4000, 9000])
def test_a_clock_that_leaps_by_a_few_seconds_is_cut_there(leap_ms: int, batch_bytes: int) -> None:
    vehicle = sender()
    frames = flying(vehicle, 100) + flying(vehicle, 200, 3000 + leap_ms)
    flight = read(log_of(frames, 20_000), batch_bytes=batch_bytes)
    assert flight["ATTITUDE"]["boot"].to_pylist() == [0] * 100 + [1] * 200
    first, second = (c.utc_offset_ns or 0 for c in flight.clocks)
    assert first - second == pytest.approx(leap_ms * MS, abs=MS)
    assert all(c.slope == pytest.approx(1.0, abs=1e-6) for c in flight.clocks)


@pytest.mark.parametrize("late_s", [2, 9])
def test_messages_that_come_late_are_no_leap(late_s: int) -> None:
    """The link holds them up and some are lost; then it catches up, and the clock goes on as it did."""
    frames = flying(sender(), 400)
    stamps = [EPOCH_US + 20_000 * i for i in range(400)]
    held = range(200, 200 + 50 * late_s)[: 400 - 250]
    stamps = [max(us, stamps[held[-1]]) if i in held else us for i, us in enumerate(stamps)]
    kept = [i for i in range(400) if i not in held[1:-2]]
    flight = read(b"".join(stamped(stamps[i], frames[i]) for i in kept))
    assert len(flight.clocks) == 1
    assert "clock_note" not in flight.info


@pytest.mark.parametrize(
    ("set_s", "count"), [(3600, 200), (-3600, 200), (30, 200), (2, 1000), (-2, 1000), (-7, 2000), (7, 2000)]
)
@pytest.mark.parametrize("share", [0.4, 0.75])
def test_a_station_clock_that_is_set_bends_no_map(set_s: int, count: int, share: float) -> None:
    frames = flying(sender(), count)
    at = int(share * count)
    stamps = [EPOCH_US + 20_000 * i + (set_s * 10**6 if i >= at else 0) for i in range(count)]
    flight = read(b"".join(stamped(us, f) for us, f in zip(stamps, frames, strict=True)))
    assert flight["ATTITUDE"]["time_ns"].to_pylist() == [(1000 + 20 * i) * MS for i in range(count)]
    (clock,) = flight.clocks
    assert clock.slope == pytest.approx(1.0, abs=1e-6)
    longer_us = EPOCH_US - 1_000_000 + (set_s * 10**6 if share < 0.5 else 0)
    assert clock.utc_offset_ns == pytest.approx(longer_us * 1000, abs=MS)
    assert f"the station's clock was set by {set_s:+,}.0 s in boot 0" in flight.info["clock_note"]


def test_a_gap_in_the_record_is_no_leap() -> None:
    vehicle = sender()
    early = log_of(flying(vehicle, 100), 20_000)
    late = log_of(flying(vehicle, 100, 603_000), 20_000)
    size = len(late) // 100
    moved = bytearray(late)
    for at in range(0, len(late), size):
        moved[at : at + 8] = (int.from_bytes(late[at : at + 8], "big") + 602 * 10**6).to_bytes(8, "big")
    flight = read(early + bytes(moved))
    assert len(flight.clocks) == 1
    assert "clock_note" not in flight.info


def test_late_messages_are_counted_and_a_reboot_within_a_second_is_one() -> None:
    vehicle = sender()
    late = flying(vehicle, 60)
    late[20], late[21] = late[21], late[20]
    flight = read(log_of(late, 20_000))
    assert flight.damage.out_of_order == {"1.1/ATTITUDE": 1}
    assert set(flight["ATTITUDE"]["boot"].to_pylist()) == {0}
    rebooted = flying(vehicle, 40, 100) + flying(vehicle, 60, 100)
    flight = read(log_of(rebooted, 20_000))
    assert flight["ATTITUDE"]["boot"].to_pylist() == [0] * 40 + [1] * 60
    assert flight.damage.out_of_order == {}


def test_milliseconds_that_wrap_after_49_days_go_on() -> None:
    vehicle = sender()
    wrap = 1 << 32
    frames = [
        frame(vehicle, vehicle.attitude_encode((wrap - 100 + 20 * i) % wrap, 0, 0, 0, 0, 0, 0))
        for i in range(30)
    ]
    times = read(log_of(frames))["ATTITUDE"]["time_ns"].to_pylist()
    assert [b - a for a, b in pairwise(times)] == [20 * MS] * 29


def test_32_bits_of_microseconds_are_unwrapped_by_the_clock() -> None:
    vehicle = sender()
    frames = []
    for i in range(40):
        ms = 4_294_000 + 100 * i
        frames.append(frame(vehicle, vehicle.attitude_encode(ms, 0, 0, 0, 0, 0, 0)))
        frames.append(
            frame(vehicle, vehicle.servo_output_raw_encode(ms * 1000 % (1 << 32), 0, 1, 2, 3, 4, 5, 6, 7, 8))
        )
    table = read(log_of(frames))["SERVO_OUTPUT_RAW"]
    assert table["time_ns"].to_pylist() == [(4_294_000 + 100 * i) * MS for i in range(40)]


def test_lost_messages_are_counted_per_sender() -> None:
    vehicle = sender()
    frames = flying(vehicle, 300)
    flight = read(log_of(frames[:100] + frames[110:200] + frames[201:]))
    assert flight.damage.sequence_gaps == {"1.1": 11}
    assert not flight.damage.lossy


def test_an_unknown_message_counts_only_where_a_known_one_follows() -> None:
    vehicle = sender()
    frames = flying(vehicle, 10)
    alien = b"\xfd\x04\x00\x00\x07\x01\x01" + (0xABCDE).to_bytes(3, "little") + b"\1\2\3\4\0\0"
    inside = read(log_of([*frames[:5], alien, *frames[5:]]))
    assert inside.damage.undecoded == {"1.1/#703710": 1}
    assert (inside.rows, inside.damage.bytes_skipped) == (10, 0)
    last = read(log_of([*frames, alien]))
    assert last.damage.undecoded == {}
    assert last.damage.bytes_skipped == len(alien) + 8


def test_a_bad_checksum_is_counted_and_located() -> None:
    vehicle = sender()
    frames = flying(vehicle, 10)
    blob = bytearray(log_of(frames))
    size = len(frames[0]) + 8
    blob[3 * size + 20] ^= 1
    blob[4 * size + 20] ^= 1
    flight = read(bytes(blob))
    assert (flight.rows, flight.damage.bad_checksums) == (8, 2)
    assert [(r.start, r.end, r.reason) for r in flight.damage.regions] == [
        (3 * size, 5 * size, "bad checksum")
    ]


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_the_compiled_walk_stops_where_the_plain_one_does(data: st.DataObject) -> None:
    from flysid.ingest.formats.mavlink.kernel import compiled_chain

    vehicle = sender()
    blob = bytearray(log_of(flying(vehicle, 20)))
    for _ in range(data.draw(st.integers(0, 2))):
        blob[data.draw(st.integers(0, len(blob) - 1))] = data.draw(st.integers(0, 255))
    cut = as_array(bytes(blob[: data.draw(st.integers(0, len(blob)))]))
    limit = data.draw(st.integers(0, len(cut)))
    seeds = load_dialect().crc_extra
    plain = plain_chain(seeds)(cut, 0, limit, 8)
    compiled = compiled_chain(seeds)(cut, 0, limit, 8)
    assert plain[0].tolist() == compiled[0].tolist()
    assert plain[1] == compiled[1]


@given(st.binary(max_size=600), st.sampled_from([0, 8]))
@settings(max_examples=100, deadline=None)
def test_every_byte_is_in_a_frame_or_in_a_region(garbage: bytes, stamp: int) -> None:
    vehicle = sender()
    frames = flying(vehicle, 4)
    good = log_of(frames) if stamp else b"".join(frames)
    blob = good + garbage + good
    seeds = load_dialect().crc_extra
    scanner = Scanner(seeds, stamp, plain_chain(seeds))
    found, end = scanner.scan(as_array(blob), 0, len(blob))
    framed = int((found.payload + found.length + 2 - found.start).sum()) + stamp * len(found)
    assert end == len(blob)
    assert scanner.bytes_skipped + framed - stamp * scanner.unstamped == len(blob)
    assert len(found) >= 7


def test_a_log_that_names_every_sender_there_can_be_is_bounded() -> None:
    import fastcrc

    frames = []
    for sender_id in range(1 << 14):
        body = bytes([9, 0, sender_id >> 8, sender_id & 255, 0]) + bytes(9)
        crc = fastcrc.crc16.mcrf4xx(body + bytes([50]))
        frames.append(b"\xfe" + body + struct.pack("<H", crc))
    flight = read(b"".join(frames))
    assert len(flight.streams) == tlog.MAX_STREAMS
    assert flight.damage.undecoded == {"streams beyond 2,000": (1 << 14) - tlog.MAX_STREAMS}


def test_zeros_behind_a_log_are_skipped_however_many() -> None:
    zeros = bytes(20 << 20)  # more than two batches
    flight = read(build() + zeros)
    assert flight.rows == read(build()).rows
    assert flight.damage.bytes_skipped == len(zeros)


@pytest.mark.parametrize("ahead", [bytes(2_900_000), bytes(100_001), random.Random(4).randbytes(200_000)])
def test_whether_frames_carry_stamps_is_decided_where_frames_begin(ahead: bytes) -> None:
    log = log_of(flying(sender(), 1000))
    flight = read(ahead + log)
    assert (flight.rows, flight.info["timestamps"]) == (1000, "arrival")
    assert flight.damage.bytes_skipped == len(ahead)
    raw = read(ahead + b"".join(flying(sender(), 1000)))
    assert (raw.rows, raw.info["timestamps"]) == (1000, "none")


def test_damage_to_one_frame_does_not_change_the_dialect() -> None:
    vehicle = sender()
    frames = [*flying(vehicle, 5), frame(vehicle, vehicle.ahrs_encode(0, 0, 0, 0, 0, 0, 0))]
    frames[-1] = frames[-1][:-1] + bytes([frames[-1][-1] ^ 1])
    flight = read(log_of(frames))
    assert flight.info["dialect"] == "ardupilotmega"
    assert flight.damage.bad_checksums == 1


def test_telemetry_of_px4_knows_the_vehicle_by_the_number_that_its_ulog_has() -> None:
    number = bytes.fromhex("0006000000003736323032335111002f0022")
    vehicle = sender()
    about = vehicle.autopilot_version_encode(
        0, 0x010D0300, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0, number
    )
    beat = vehicle.heartbeat_encode(2, 12, 81, 0, 4)
    flight = read(log_of([frame(vehicle, message) for message in (beat, about)] + flying(vehicle, 5)))
    assert flight.info["firmware"] == "1.13.3"
    assert vehicle_of(flight.info) == f"px4 {number.hex()}"


# --------------------------------------------------------------------------------- private dialects


def reseeded(packed: bytes, seed: int) -> bytes:
    """A v2 frame of a dialect whose layout of this message has another seed."""
    import fastcrc

    crc = fastcrc.crc16.mcrf4xx(packed[1:-2] + bytes([seed]))
    return packed[:-2] + struct.pack("<H", crc)


def with_private(share: float, seed: int, rng: random.Random) -> tuple[bytes, int]:
    """Attitudes, and among them messages under a shipped number in a layout of one's own; how many."""
    mav = sender()
    out = []
    private = 0
    for k in range(400):
        micros = EPOCH_US + 20_000 * k
        attitude = mav.attitude_encode(5000 + 20 * k, 0.1, 0.5, -1, 0, 0, 0)
        out.append(stamped(micros, frame(mav, attitude)))
        if rng.random() < share:
            own = mav.wind_encode(rng.random(), rng.random(), rng.random())
            out.append(stamped(micros + 9, reseeded(frame(mav, own), seed)))
            private += 1
    return b"".join(out), private


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_a_private_message_under_a_shipped_number_is_no_damage(
    share: float, tmp_path: Path, fresh_seed: int
) -> None:
    rng = random.Random(fresh_seed)
    seed = rng.choice([k for k in range(256) if k != 1])  # 1 is WIND's own
    blob, private = with_private(share, seed, rng)
    flight = read(blob)
    assert flight.tables["1.1/ATTITUDE"].num_rows == 400
    assert (flight.damage.bytes_skipped, flight.damage.bad_checksums) == (0, 0)
    assert flight.damage.undecoded == {"1.1/#168": private}
    assert f"168 is not WIND: its checksums hold with the seed {seed}" in flight.damage.reasons["1.1/#168"]
    (tmp_path / "a.tlog").write_bytes(blob)
    done = call("doctor", "a.tlog", cwd=tmp_path)
    assert "bytes lost" not in done.stdout + done.stderr
    assert "of a private dialect" in " ".join(done.stderr.split())


def test_damage_is_not_taken_for_a_private_message() -> None:
    rng = random.Random(3)
    blob = bytearray(build())
    for _ in range(30):
        blob[rng.randrange(len(blob))] ^= 1 << rng.randrange(8)
    damage = read(bytes(blob)).damage
    assert damage.bytes_skipped > 0
    assert not damage.reasons
