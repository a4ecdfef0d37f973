"""Blackbox logs: against another decoder, against a writer of our own, and where they are damaged."""

from __future__ import annotations

import dataclasses
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import FormatError
from flysid.flight import Flight, field_scale, field_unit
from flysid.ingest.align.align import dataset
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.blackbox.header import START, numbers_of
from flysid.ingest.formats.blackbox.writing import (
    Fields,
    Writer,
    groups,
    signed_vb,
    unsigned_vb,
    wrap,
)
from flysid.ingest.formats.common.units import factor
from flysid.ingest.formats.registry import FORMATS
from tests.samplelogs import blackbox as sample
from tests.samplelogs.blackbox import END, KINDS, SETTINGS

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "blackbox"
REAL = sorted(LOGS.glob("*")) if LOGS.is_dir() else []
QUICK_BYTES = 60_000


def read(blob: bytes, limits: Limits | None = None) -> Flight:
    return collect(memoryview(blob), "log.bbl", FORMATS["blackbox"], limits or Limits())


def matrix(flight: Flight, stream: str, boot: int = 0) -> np.ndarray:
    """(n, fields) of one log, with the log's own numbers."""
    table = flight[stream]
    rows = table["boot"].to_numpy() == boot
    return np.column_stack([c.to_numpy().astype(np.int64)[rows] for c in table.columns[2:]])


# ----------------------------------------------------------------------------- another decoder's reading


def compare_with_chirp_core(path: Path, size: int | None = None) -> None:
    """Every field of every main, slow and GPS frame of every log in a file."""
    decoder = pytest.importorskip("betaflight_chirp_core.decoder", reason="betaflight-chirp-core is missing")
    blob = path.read_bytes()[:size]
    flight = read(blob)
    starts = [match.start() for match in re.finditer(re.escape(START), blob)]
    bounds = zip(starts, [*starts[1:], len(blob)], strict=True)
    total = 0
    for boot, (start, stop) in enumerate(bounds):
        other = decoder.FlightLogParser(blob, start, stop)
        other.parse_header()
        other.parse_data(raw=False)
        total += len(other.main_frames)
        for stream, kind, frames in (
            ("main", "I", other.main_frames),
            ("slow", "S", other.slow_frames),
            ("gps", "G", other.gps_frames),
        ):
            if not frames:
                assert stream not in flight or not len(matrix(flight, stream, boot))
                continue
            if stream not in flight and flight.damage.lossy:
                continue  # the other takes slow frames inside a wound, too
            ours = matrix(flight, stream, boot)
            theirs = np.array(frames, dtype=np.int64)
            assert other.frame_defs[kind]["name"] == flight[stream].column_names[2:]
            np.testing.assert_array_equal(ours, theirs, err_msg=f"{path.name}, log {boot}, {stream}")
    assert flight["main"].num_rows == total > 0


@pytest.mark.parametrize("path", REAL, ids=lambda p: p.name)
def test_real_logs_are_what_chirp_core_reads(path: Path) -> None:
    compare_with_chirp_core(path, QUICK_BYTES)


@pytest.mark.skipif(not REAL, reason="no ../shared/logs/blackbox")
def test_three_logs_in_a_file_are_three_boots() -> None:
    flight = flysid.read(LOGS / "btfl_002.bbl")
    boots, counts = np.unique(flight["main"]["boot"].to_numpy(), return_counts=True)
    assert dict(zip(boots.tolist(), counts.tolist(), strict=True)) == {0: 1136, 1: 38, 2: 11615}
    assert (flight["gps"].num_rows, flight["home"].num_rows) == (260, 3)
    assert not flight.damage.lossy
    assert flight.info["padding_bytes"] == "1273"
    assert (flight.info["autopilot"], flight.info["firmware"]) == ("betaflight", "4.2.9")
    assert [clock.boot for clock in flight.clocks] == [0, 1, 2]
    began = flight.clocks[2].first_ns + (flight.clocks[2].utc_offset_ns or 0)
    first, second = (np.datetime64(int(t), "ns") for t in (began, flight.clocks[0].utc_offset_ns or 0))
    assert str(first)[:10] == str(second)[:10] == "2022-02-05"


@pytest.mark.skipif(not REAL, reason="no ../shared/logs/blackbox")
def test_the_rate_is_that_of_the_stamps_and_units_are_those_of_the_firmware() -> None:
    flight = flysid.read(LOGS / "greenreaper_flight24.bfl")
    main = flight["main"]
    seconds = np.diff(main["time_ns"].to_numpy()[[0, -1]])[0] * 1e-9
    assert (main.num_rows, round((main.num_rows - 1) / seconds)) == (103_744, 967)  # the header says 1,000
    assert set(np.diff(main["loopIteration"].to_numpy().astype(int)).tolist()) == {2}
    units = {f.name: (field_unit(f), field_scale(f)) for f in main.schema}
    assert units["gyroADC[0]"] == ("deg/s", 1.0)
    assert units["accSmooth[2]"] == ("G", 1 / 2048)
    assert units["vbatLatest"] == ("V", 0.1)
    assert units["axisP[0]"] == ("%", 0.1)
    still = np.median(main["accSmooth[2]"].to_numpy()[:500]) / 2048
    assert 0.8 < still < 1.2
    assert 14.0 < np.median(main["vbatLatest"].to_numpy()) * 0.1 < 17.0


# --------------------------------------------------------------------------------- a writer of our own

ENCODINGS = (0, 1, 3, 6, 7, 8, 9, 10)


@st.composite
def layouts(draw: st.DrawFn) -> tuple[dict[str, Fields], list[list[int]], int, str]:
    """Fields with random encodings and predictors, and random differences for a number of frames."""
    count = draw(st.integers(1, 24))
    signed = [0, 0, *draw(st.lists(st.integers(0, 1), min_size=count, max_size=count))]
    codes = st.lists(st.sampled_from(ENCODINGS), min_size=count, max_size=count)
    first = draw(codes)
    later = draw(codes)
    absolute = st.lists(st.sampled_from([0, 4, 5, 8, 9, 11]), min_size=count, max_size=count)
    relative = st.lists(st.sampled_from([0, 1, 2, 3, 4, 5, 8, 9, 11]), min_size=count, max_size=count)
    names = ["loopIteration", "time", "motor[0]", *(f"f[{k}]" for k in range(count - 1))]
    kinds = {
        "I": Fields(names, signed, [0, 0, 0, *draw(absolute)[1:]], [1, 1, *first]),
        "P": Fields(names, signed, [6, 2, 1, *draw(relative)[1:]], [9, 0, *later]),
    }
    frames = []
    for _ in range(draw(st.integers(1, 40))):
        bits = draw(st.lists(st.integers(0, 31), min_size=count, max_size=count))
        frames.append([draw(st.integers(-(1 << b), (1 << b) - 1)) for b in bits])
    return kinds, frames, draw(st.sampled_from([1, 2])), draw(st.sampled_from(["1/1", "1/2", "2/3", "1/8"]))


def in_range(raw: int, encoding: int) -> int:
    """A difference that the encoding can hold."""
    if encoding == 3:
        return -(raw % (1 << 13))
    if encoding == 8:
        return (raw + (1 << 15)) % (1 << 16) - (1 << 15)
    return 0 if encoding == 9 else raw


@settings(deadline=None, max_examples=100, suppress_health_check=[HealthCheck.too_slow])
@given(layouts())
def test_what_was_written_is_read(case: tuple[dict[str, Fields], list[list[int]], int, str]) -> None:
    kinds, frames, version, share = case
    writer = Writer(kinds, {**SETTINGS, "P interval": share}, version)
    out = [*writer.header()]
    rows = []
    iteration = 0
    for k, differences in enumerate(frames):
        kind = "I" if iteration % 16 == 0 else "P"
        fields = kinds[kind]
        values = [iteration, 1000 + 700 * k]
        codes = [code for _, span, code in groups(fields.encoding) for _ in range(span)]
        for n, raw in enumerate(differences, start=2):
            value = writer.prediction(kind, n, values) + in_range(raw, codes[n])
            values.append(wrap(value) if fields.signed[n] else value % (1 << 32))
        out.append(writer.frame(kind, values))
        rows.append(values)
        iteration = writer.due(iteration)
    flight = read(b"".join([*out, END]))
    assert not flight.damage.lossy, flight.damage
    np.testing.assert_array_equal(matrix(flight, "main"), np.array(rows, dtype=np.int64))


def test_the_sample_is_read_as_it_was_written() -> None:
    flight = read(sample.build())
    for log, start_us in enumerate((150_000_000, (1 << 32) - 90_000)):
        rows = matrix(flight, "main", log)
        expected = [sample.main_values(k, int(i), start_us) for k, i in enumerate(rows[:, 0])]
        np.testing.assert_array_equal(rows, expected)
        table = flight["main"].filter(flight["main"]["boot"].to_numpy() == log)
        steps = np.diff(table["time_ns"].to_numpy())
        assert steps.min() > 0  # also where 32 bits of microseconds wrap
    events = flight["events"].to_pylist()
    assert [e["value"] for e in events if e["event"] == 13] == [-7.0, 1.5] * 2
    assert [e["other"] for e in events if e["event"] == 13] == [5.0, 5.0] * 2
    assert events[-1]["text"] == "End of log"
    gps = flight["gps"]
    assert field_unit(gps.schema.field("GPS_coord[0]")) == "degE7"
    assert gps["GPS_coord[0]"][0].as_py() == sample.HOME_DEGREES[0] + 15
    parameters = {row["name"]: row for row in flight["parameters"].to_pylist()}
    assert parameters["rollPID"]["values"] == [47.0, 85.0, 38.0]
    assert parameters["looptime"]["value"] == 125.0
    assert parameters["Craft name"]["value"] is None


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("46,45,25", (46.0, 45.0, 25.0)),
        ("0, 0", (0.0, 0.0)),
        ("1/8", (1.0, 8.0)),
        ("0x3f800000", (1.0,)),
        ("0x7f800000", ()),
        ("-5", (-5.0,)),
        ("OMNIBUSF4SD", ()),
        ("", ()),
    ],
)
def test_numbers_of_header_lines(text: str, numbers: tuple[float, ...]) -> None:
    assert numbers_of(text) == numbers


# ------------------------------------------------------------------------------------------------ damage


def pieces_of(log: int = 0) -> list[sample.Piece]:
    return [piece for piece in sample.pieces() if piece.log == log]


def test_an_i_frame_whose_number_is_wrong_costs_its_group_only() -> None:
    """Its own group does not go on into the next one; the frames behind tell which of both is wrong."""
    pieces = pieces_of()
    whole = read(b"".join(p.raw for p in pieces_of()))
    heads = [k for k, p in enumerate(pieces) if p.group > 0 and p.raw[:1] == b"I"]
    for head in heads[2:10]:
        for shift in (3, 12):
            raw = bytearray(pieces[head].raw)
            raw[1] ^= 1 << shift % 7
            damaged = [*pieces[:head], dataclasses.replace(pieces[head], raw=bytes(raw)), *pieces[head + 1 :]]
            flight = read(b"".join(p.raw for p in damaged))
            assert flight.damage.lossy
            gone = whole["main"].num_rows - flight["main"].num_rows
            assert 0 < gone <= 16
            kept = {tuple(row) for row in matrix(whole, "main").tolist()}
            assert all(tuple(row) in kept for row in matrix(flight, "main").tolist())


def test_a_frame_that_is_missing_without_a_trace_costs_its_group() -> None:
    """P frames count on from their predecessors: after one that is gone, all would be wrong."""
    pieces = pieces_of()
    at = next(k for k, p in enumerate(pieces) if p.group == 4 and p.raw[:1] == b"P")
    flight = read(b"".join(p.raw for p in [*pieces[:at], *pieces[at + 1 :]]))
    whole = matrix(read(b"".join(p.raw for p in pieces)), "main")
    kept = {tuple(row) for row in whole.tolist()}
    assert all(tuple(row) in kept for row in matrix(flight, "main").tolist())
    assert flight.damage.time_outliers["main"] > 0
    assert flight["main"].num_rows == len(whole) - 8


def test_a_pause_announced_by_the_log_is_no_damage() -> None:
    flight = read(sample.build())
    steps = np.diff(matrix(flight, "main")[:, 0])
    assert steps.max() > 100
    assert not flight.damage.lossy
    assert not flight.damage.sequence_gaps


def test_a_wound_longer_than_any_pause_does_not_end_the_log() -> None:
    """An I frame far ahead counts where its group leads to another one."""
    writer = Writer(KINDS, {**SETTINGS, "P interval": "1/1"})
    out = [*writer.header()]
    iteration = 0
    for k in range(200):
        if k == 80:
            out.append(b"\x9c" * 300)
            iteration += 160_000
        out.append(writer.frame("I" if iteration % 16 == 0 else "P", sample.main_values(k, iteration, 5)))
        iteration = writer.due(iteration)
    flight = read(b"".join([*out, END]))
    assert flight["main"].num_rows == 199  # nothing tells that the frame before the wound is whole
    assert 300 < flight.damage.bytes_skipped < 350


def test_positions_without_a_home_are_counted_not_invented() -> None:
    pieces = [p for p in pieces_of() if not (p.group >= 0 and p.raw[:1] == b"H")]
    flight = read(b"".join(p.raw for p in pieces))
    assert "gps" not in flight
    assert flight.damage.undecoded == {"gps": 16}


def test_a_log_without_an_end_and_flash_behind_it_is_whole() -> None:
    body = b"".join(p.raw for p in pieces_of() if p.raw != END)
    flight = read(body + b"\xff" * 500)
    assert not flight.damage.lossy
    assert flight.info["padding_bytes"] == "500"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"H Field I encoding:1,2,0\n", "unknown encoding"),
        (b"H Field I name:loopIteration,tide,x\n", "no field 'time'"),
        (b"H Field P predictor:6,2\n", "not defined"),
        (b"H Field I predictor:0,0,44\n", "unknown predictor"),
    ],
)
def test_a_header_that_cannot_be_read_by_says_why(line: bytes, why: str) -> None:
    names = ["loopIteration", "time", "x"]
    kinds = {"I": Fields(names, [0, 0, 1], [0] * 3, [1, 1, 0]), "P": Fields(names, [], [6, 2, 1], [9, 0, 0])}
    lines = Writer(kinds, SETTINGS).header()
    key = line.partition(b":")[0]
    lines = [line if one.startswith(key) else one for one in lines]
    flight = read(b"".join([*lines, b"I\x00\x05\x02P\x03\x02", END]))
    assert why in flight.damage.reasons["main"]
    assert flight.damage.lossy
    assert flight.streams == ("parameters",)


def test_inav_ends_with_a_reason_and_logs_at_a_share_of_its_loops() -> None:
    changed = {"Firmware revision": "INAV 6.1.0 (1234abcd) MATEKF722", "P interval": "2/4"}
    writer = Writer(KINDS, {**SETTINGS, **changed})
    out = [*writer.header()]
    iteration = 0
    iterations = []
    for k in range(100):
        out.append(writer.frame("I" if iteration % 16 == 0 else "P", sample.main_values(k, iteration, 5)))
        iterations.append(iteration)
        iteration = writer.due(iteration)
    out.append(b"E\xffEnd of log (disarm reason:4)\x00")
    flight = read(b"".join(out))
    assert not flight.damage.lossy
    assert flight.info["autopilot"] == "inav"
    assert matrix(flight, "main")[:, 0].tolist() == iterations
    assert flight["events"]["text"].to_pylist() == ["End of log (disarm reason:4)"]


# as the firmwares' field tables have them: INAV 8, Rotorflight 2; in groups where their encodings have groups
CRAFT = {
    "INAV 8.0.0 (1234abcd) F722": (
        "1/2",
        ["attitude[0]", "navVel[2]", "mcVelAxisOut[1]", "vbat", "servo[0]"],
    ),
    "Rotorflight 4.5.0 (1234abcd) NEXUS": ("2", ["headspeed", "mixer[0]", "axisO[1]", "Vbat", "servo[0]"]),
}
UNITS = {
    "attitude[0]": ("deg", 0.1),
    "navVel[2]": ("m/s", 0.01),
    "mcVelAxisOut[1]": ("m/s^2", 0.01),
    "vbat": ("V", 0.01),
    "servo[0]": ("s", 1e-6),
    "headspeed": ("rpm", 1.0),
    "mixer[0]": ("", 1e-3),
    "axisO[1]": ("", 1e-3),
    "Vbat": ("V", 0.01),
}


@pytest.mark.parametrize("revision", CRAFT)
def test_fields_of_other_firmwares_have_their_units(revision: str) -> None:
    interval, own = CRAFT[revision]
    names = ["loopIteration", "time", *own]
    fields = {
        "I": Fields(names, [0, 0, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0, 9, 8], [1, 1, 0, 0, 0, 3, 0]),
        "P": Fields(names, [0, 0, 1, 1, 1, 0, 0], [6, 2, 1, 1, 1, 1, 3], [9, 0, 7, 7, 7, 6, 0]),
    }
    writer = Writer(fields, {**SETTINGS, "Firmware revision": revision, "P interval": "1/2"})
    rows = [[2 * k, 1000 * k, k % 50 - 25, 3 * k % 700, -k, 2480 - k // 9, 1500 + k % 7] for k in range(60)]
    frames = [writer.frame("I" if row[0] % 16 == 0 else "P", row) for row in rows]
    header = [line.replace(b"P interval:1/2", f"P interval:{interval}".encode()) for line in writer.header()]
    flight = read(b"".join([*header, *frames, END]))
    assert not flight.damage.lossy
    assert matrix(flight, "main").tolist() == rows
    found = {f.name: (field_unit(f), field_scale(f)) for f in flight["main"].schema}
    for name in own:
        unit, scale = UNITS[name]
        assert factor(found[name][0], unit) * found[name][1] == pytest.approx(scale), name


def test_other_layouts_later_in_the_file_get_a_stream_of_their_own() -> None:
    names = ["loopIteration", "time", "gyroADC[0]"]
    fields = {
        "I": Fields(names, [0, 0, 1], [0, 0, 0], [1, 1, 0]),
        "P": Fields(names, [0, 0, 1], [6, 2, 3], [9, 0, 0]),
    }
    writer = Writer(fields, SETTINGS)
    other = [*writer.header(), *(writer.frame("I", [16 * k, 5 + 8000 * k, k]) for k in range(20)), END]
    flight = read(b"".join([*(p.raw for p in pieces_of()), *other]))
    assert {"main", "main~2"} <= set(flight.streams)
    assert set(flight["main~2"]["boot"].to_pylist()) == {1}


def test_high_resolution_and_old_scales() -> None:
    def unit(name: str, **changed: str) -> tuple[str, float]:
        writer = Writer(KINDS, {**SETTINGS, **changed})
        blob = b"".join([*writer.header(), writer.frame("I", sample.main_values(0, 0, 5)), END])
        column = read(blob)["main"].schema.field(name)
        return field_unit(column), field_scale(column)

    fine = {"blackbox_high_resolution": "1", "Firmware revision": "Betaflight 4.5.0 (x) Y"}
    assert unit("gyroADC[1]", **fine) == ("deg/s", 0.1)
    assert unit("vbatLatest", **fine) == ("V", 0.01)
    old = {"Firmware revision": "Betaflight 3.0.1 (x) Y", "vbatscale": "110"}
    assert unit("vbatLatest", **old) == ("V", 0.33 * 110 / 4095)
    assert unit("amperageLatest", **old) == ("", 1.0)
    micro = {"gyro_scale": "0x" + struct.pack(">f", 1e-9).hex(), "Firmware revision": "Baseflight 1.0"}
    assert unit("gyroADC[1]", **micro)[1] == pytest.approx(1e-3 * 180 / np.pi, rel=1e-6)


def test_what_is_no_blackbox_is_refused_with_what_to_try() -> None:
    with pytest.raises(FormatError, match="download the log"):
        read(b"H Product: something else\n" + bytes(1000))


def test_erased_flash_before_the_first_log_is_harmless_and_other_bytes_count() -> None:
    assert not read(b"\xff" * 4096 + sample.build()).damage.lossy
    assert read(b"garbage" * 10 + sample.build()).damage.bytes_skipped == 70


def test_a_table_with_hostile_settings_takes_no_time_and_no_memory() -> None:
    names = ["loopIteration", "time", *(f"f{k}" for k in range(240))]
    nothing = [9] * 240
    kinds = {
        "I": Fields(names, [0] * 242, [0] * 242, [1, 1, *nothing]),
        "P": Fields(names, [0] * 242, [6, 2, *([1] * 240)], [9, 9, *nothing]),
    }
    changed = {"I interval": "2147483647", "P interval": "1/2147483647"}
    writer = Writer(kinds, {**SETTINGS, **changed})
    blob = b"".join([*writer.header(), b"I\x00\x05", b"P" * 50_000, END])
    flight = read(blob, Limits(batch_bytes=1 << 16))
    assert flight["main"].num_rows == 50_001


def by_hand() -> list[Any]:
    """Bytes of each encoding, worked out from the format's description by hand, and their values."""
    return [
        (1, b"\xac\x02", [300]),
        (0, b"\x03", [-2]),
        (3, b"\x05", [-5]),
        (7, b"\x1e", [1, -1, -2]),
        (7, b"\x47\x8e", [7, -8, -2]),
        (7, b"\x9f\x20\x01", [31, -32, 1]),
        (7, b"\xc4\x05\x00\x01\xff", [5, 256, -1]),
        (8, b"\xe4\x7f\xf0\x01\x00", [0, 7, -1, 16]),
        (10, b"\x5e\x1f", [15, 1, -1]),
    ]


def test_encodings_by_hand() -> None:
    assert unsigned_vb(300) == b"\xac\x02"
    assert signed_vb(-2) == b"\x03"
    for code, raw, values in by_hand():
        names = ["time", *(f"f{k}" for k in range(len(values)))]
        n = len(names)
        kinds = {"I": Fields(names, [0] + [1] * (n - 1), [0] * n, [1] + [code] * (n - 1))}
        blob = b"".join([*Writer(kinds, SETTINGS).header(), b"I\x05" + raw, END])
        flight = read(blob)
        assert not flight.damage.lossy, (code, flight.damage)
        assert matrix(flight, "main").tolist() == [[5, *values]], code


# ------------------------------------------------------------------------------------------ the recipe


@pytest.mark.skipif(not REAL, reason="no ../shared/logs/blackbox")
@pytest.mark.parametrize("name", ["greenreaper_flight15.bfl", "hiro_lowP_lowD.bfl"])
def test_the_computed_setpoint_is_the_one_that_the_controller_followed(name: str) -> None:
    """P = 0.032029 Kp (setpoint - gyro): the log's own P term tells what the setpoint was."""
    flight = flysid.read(LOGS / name)
    gains = {row["name"]: row["values"] for row in flight["parameters"].to_pylist()}
    for axis, key in enumerate(("rollPID", "pitchPID")):
        asked = flight["setpoint"][f"setpoint[{axis}]"].to_numpy()
        error = asked - flight["main"][f"gyroADC[{axis}]"].to_numpy()
        term = flight["main"][f"axisP[{axis}]"].to_numpy()
        slope, _ = np.polyfit(0.032029 * gains[key][0] * error, term, 1)
        assert np.corrcoef(error, term)[0, 1] > 0.998
        assert 0.97 < slope < 1.0  # below 1 where throttle takes gain away (TPA)


@pytest.mark.skipif(not REAL, reason="no ../shared/logs/blackbox")
@pytest.mark.parametrize("name", ["btfl_002.bbl", "hiro_lowP_lowD.bfl"])
def test_the_recipe_takes_old_and_newer_logs(name: str) -> None:
    flight = flysid.read(LOGS / name)
    recipe = load_recipe("betaflight-rate")
    for channel in ("pitch_pid", "yaw_motors"):  # btfl_002 has no axisD[2]
        data = dataset([flight], recipe, channel)
        assert 1 / data.dt_s == pytest.approx(250.0)
        assert len(data) * data.dt_s > 40.0
    roll = dataset([flight], recipe, "roll_rate")
    asked = np.concatenate([s.u for s in roll.segments])
    turned = np.concatenate([s.y for s in roll.segments])
    assert np.corrcoef(asked[:, 0], turned[:, 0])[0, 1] > 0.95


def test_the_sum_of_a_controllers_terms_and_the_difference_of_motors() -> None:
    names = ["time", "axisP[0]", "axisI[0]", *(f"motor[{k}]" for k in range(4)), "gyroADC[0]"]
    kinds = {"I": Fields(names, [0] * 8, [0] * 8, [1] * 8)}
    writer = Writer(kinds, {**SETTINGS, "P interval": "1/16"})
    rows = [[1000 * k, 100 + k % 7, 50, 10, 20, 130 + k % 5, 140, k % 11] for k in range(400)]
    flight = read(b"".join([*writer.header(), *(writer.frame("I", row) for row in rows), END]))
    recipe = dataclasses.replace(load_recipe("betaflight-rate"), max_rate_hz=1000.0, antialias=False)
    (pid,) = dataset([flight], recipe, "roll_pid").segments
    (motors,) = dataset([flight], recipe, "roll_motors").segments
    values = np.array(rows)
    np.testing.assert_allclose(pid.u[:, 0], 0.1 * (values[:, 1] + values[:, 2]))
    np.testing.assert_allclose(
        motors.u[:, 0], (values[:, 5] + values[:, 6] - values[:, 3] - values[:, 4]) / 4
    )


def test_a_slow_frame_that_takes_in_events_is_counted() -> None:
    """A damaged width byte made a state read the two events behind it, up to a third: lost in silence."""
    blob = bytearray(sample.build())
    at = blob.index(bytes([3, 5]) + b"E\x1e\x05\x01E\r\x05\rE") + 1
    blob[at] = 0xEC
    flight = read(bytes(blob))
    assert len(flight["events"]) == 12
    assert flight.damage.undecoded == {"slow": 1}
