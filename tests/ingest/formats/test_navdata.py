"""AR.Drone navdata: options, checksums, the wrapping clock, captures and commands."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import FormatError
from flysid.flight import Flight, field_scale, field_unit
from flysid.ingest.formats.ardrone.layouts import OPTIONS
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import FORMATS, detect
from tests.samplelogs import navdata as sample

PACKETS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "navdata"
needs_packets = pytest.mark.skipif(not PACKETS.exists(), reason="no ../shared/logs/navdata here")
SECOND = 10**9


def read(raw: bytes, limits: Limits | None = None) -> Flight:
    return collect(memoryview(raw), "x.navdata", FORMATS["navdata"], limits or Limits())


@needs_packets
@pytest.mark.parametrize("name", ["packet_a", "packet_b", "packet_c"])
def test_real_packets(name: str) -> None:
    flight = flysid.read(PACKETS / f"{name}.bin")
    assert flight.source.format == "navdata"
    assert not flight.damage.lossy, flight.damage
    raw = (PACKETS / f"{name}.bin").read_bytes()
    theta, phi, psi, altitude, vx, vy, vz = struct.unpack_from("<3fi3f", raw, 16 + 4 + 8)
    demo = flight["navdata/demo"].to_pylist()[0]
    assert (demo["theta"], demo["phi"], demo["psi"]) == (theta, phi, psi)
    assert (demo["altitude"], demo["vx"], demo["vy"], demo["vz"]) == (altitude, vx, vy, vz)
    assert demo["vbat_flying_percentage"] == 50
    assert flight["navdata/header"]["sequence"].to_pylist() == [300711]
    assert len(flight.streams) >= 21
    assert flight["navdata/kalman_pressure"].num_rows == 1


def test_option_sizes_are_those_of_the_sdk() -> None:
    known = {0: 148, 1: 8, 2: 52, 3: 46, 4: 16, 5: 12, 6: 88, 7: 16, 8: 24, 9: 76, 10: 56, 11: 16, 12: 44}
    known |= {13: 92, 17: 8, 21: 18, 22: 75, 23: 56, 24: 72, 26: 8, 27: 216}
    assert {tag: option.dtype().itemsize + 4 for tag, option in OPTIONS.items()} == known


def test_units_and_times() -> None:
    flight = read(sample.build())
    demo = flight["navdata/demo"]
    assert demo["theta"].to_pylist()[:3] == [0.0, 100.0, 200.0]
    assert (field_unit(demo.schema.field("theta")), field_scale(demo.schema.field("theta"))) == ("deg", 1e-3)
    assert (field_unit(demo.schema.field("vx")), field_scale(demo.schema.field("vx"))) == ("m/s", 1e-3)
    assert demo["time_ns"].to_pylist() == [5 * SECOND + 5_000_000 * k for k in range(40)]
    assert flight["navdata/references"].num_rows == 32
    assert demo.schema.metadata[b"time_source"] == b"navdata time"
    assert b'"FLYING"' in demo.schema.field("ctrl_state").metadata[b"enum"]


def test_the_clock_wraps_after_2048_seconds() -> None:
    packets = sample.flight(40, start_us=2_047_900_000)
    for batch in (1 << 25, 2048):
        flight = read(b"".join(packets), Limits(batch_bytes=batch))
        times = flight["navdata/demo"]["time_ns"].to_pylist()
        assert times == [2_047_900_000_000 + 5_000_000 * k for k in range(40)]
        assert set(flight["navdata/demo"]["boot"].to_pylist()) == {0}


def test_a_clock_that_starts_again_is_a_new_boot() -> None:
    packets = sample.flight(20, start_us=500_000_000) + sample.flight(20, start_us=3_000_000)
    flight = read(b"".join(packets))
    assert flight["navdata/demo"]["boot"].to_pylist() == [0] * 20 + [1] * 20
    assert flight["navdata/demo"]["time_ns"].to_pylist()[20] == 3 * SECOND
    assert [c.boot for c in flight.clocks] == [0, 1]


def test_gaps_in_the_sequence_are_counted() -> None:
    packets = sample.flight(40)
    flight = read(b"".join(packets[:10] + packets[13:20] + packets[21:]))
    assert flight.damage.sequence_gaps == {"navdata": 4}
    assert not flight.damage.lossy


def test_a_packet_that_does_not_add_up_is_skipped_and_located() -> None:
    packets = sample.flight(10)
    hit = bytearray(packets[4])
    hit[40] ^= 4
    flight = read(b"".join([*packets[:4], bytes(hit), *packets[5:]]))
    assert flight["navdata/demo"].num_rows == 9
    assert flight.damage.bad_checksums == 1
    start = sum(map(len, packets[:4]))
    assert [(r.start, r.end, r.reason) for r in flight.damage.regions] == [
        (start, start + len(hit), "packet checksum failed")
    ]


def test_demo_mode_has_no_time_and_counts_on_the_sequence() -> None:
    raw = b"".join(sample.packet(100 + k, {sample.DEMO: sample.demo(k)}) for k in range(30))
    table = read(raw)["navdata/demo"]
    assert table["time_ns"].to_pylist()[15] == 15 * (SECOND // 15)
    assert table.schema.metadata[b"time_source"] == b"sequence at 15 Hz"


START = 1_600_000_000 * SECOND


def capture(order: str = "<", nano: bool = False, link: int = 1) -> bytes:
    """40 packets at 200 Hz, 20 ms late, and a command every 30 ms, the configuration in the middle."""
    items = []
    for k, raw in enumerate(sample.flight(40)):
        items.append((START + 5_000_000 * k + 20_000_000, sample.udp(raw + bytes(0), 5554, 5554, k)))
    for k in range(6):
        text = sample.pcmd(k, (0.5, -0.25, 0.1 * k, 1.0))
        if k == 3:
            text = sample.config(90, "control:euler_angle_max", "0.3") + text
        items.append((START + 30_000_000 * k, sample.udp(text, 5556, 5556, 1000 + k)))
    items.append((START, sample.udp(b"video", 5555, 9999, 7)))
    return sample.pcap(sorted(items, key=lambda i: i[0]), order=order, nano=nano, link=link)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nano", [False, True])
@pytest.mark.parametrize("link", [1, 113, 276, 101])
def test_captures(order: str, nano: bool, link: int) -> None:
    flight = read(capture(order, nano, link))
    demo = flight["navdata/demo"]
    assert demo.num_rows == 40
    assert demo["time_ns"].to_pylist()[1] - demo["time_ns"].to_pylist()[0] == 5_000_000
    assert demo["recv_ns"].to_pylist()[3] == START + 35_000_000
    assert not flight.damage.lossy, flight.damage
    offset = flight.clocks[0].utc_offset_ns
    assert offset is not None
    assert abs(offset + 5 * SECOND - START - 20_000_000) < 1_000_000


def test_commands_are_scaled_by_the_configuration_in_force() -> None:
    moves = read(capture())["at/PCMD"].to_pylist()
    assert [m["roll"] for m in moves] == [0.5] * 6
    np.testing.assert_allclose([m["roll_ref"] for m in moves], [0.1045] * 3 + [0.15] * 3)
    np.testing.assert_allclose([m["pitch_ref"] for m in moves], [-0.05225] * 3 + [-0.075] * 3)
    np.testing.assert_allclose([m["vz_ref"] for m in moves], [70 * k for k in range(6)], rtol=1e-6)
    assert {m["yaw_rate_ref"] for m in moves} == {1.745}
    assert [m["sequence"] for m in moves] == list(range(6))
    settings_seen = read(capture())["at/CONFIG"].to_pylist()
    assert [(s["key"], s["value"]) for s in settings_seen] == [("control:euler_angle_max", "0.3")]


def test_commands_are_on_the_vehicles_clock() -> None:
    moves = read(capture())["at/PCMD"].to_pylist()
    # a packet of vehicle time 5 s arrives at START + 20 ms, so that START + 60 ms is 5.04 s
    assert abs(moves[2]["time_ns"] - 5_040_000_000) < 1000


def test_fragments_are_put_together_in_any_order() -> None:
    raw = sample.packet(1, {sample.DEMO: sample.demo(3), 15: bytes(360), 16: bytes(3000)})
    pieces = sample.udp(raw, 5554, 5554, 9)
    assert len(pieces) > 2
    assert read(sample.pcap([(START, pieces[::-1])]))["navdata/demo"].num_rows == 1


def test_a_cut_and_a_damaged_capture() -> None:
    raw = capture()
    cut = read(raw[: len(raw) - 100])
    assert cut.damage.truncated
    assert cut["navdata/demo"].num_rows == 39
    middle = len(raw) // 2
    flight = read(raw[:middle] + b"\xee" * 700 + raw[middle:])
    assert flight["navdata/demo"].num_rows >= 38
    assert flight.damage.lossy


def test_commands_that_cannot_be_read_are_counted() -> None:
    text = b"AT*PCMD=1,2,3\rAT*PCMD=2,1,0,0,0,99999999999\rAT*CONFIG=3,oops\rAT*COMWDG=4\r" + sample.pcmd(
        5, (math.inf, 0, 0, 0)
    )
    raw = sample.pcap(
        [(START, sample.udp(text, 5556, 5556)), (START, sample.udp(sample.build()[:200], 1, 2))]
    )
    flight = read(raw)
    assert flight.damage.undecoded == {"at": 3}
    assert flight["at/PCMD"]["sequence"].to_pylist() == [5]


def test_detection() -> None:
    assert detect(sample.build(), "x").name == "navdata"
    assert detect(capture(), "x").name == "navdata"
    with pytest.raises(FormatError):
        read(b"\x88\x77\x66\x55" * 100)


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes(tail: bytes) -> None:
    for start in (b"", sample.packet(1, {0: sample.demo(1)}), capture()[:200]):
        try:
            read(start + tail)
        except FormatError:
            continue


@pytest.mark.parametrize("size", [0, 3, 4, 8, 65535])
def test_hostile_option_sizes(size: int) -> None:
    good = sample.build()
    bad = struct.pack("<4IHH", 0x55667788, 0, 1, 1, 0, size) + bytes(40)
    assert read(bad + good)["navdata/demo"].num_rows == 40
