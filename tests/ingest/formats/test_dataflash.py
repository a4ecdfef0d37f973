"""DataFlash: equal to pymavlink's DFReader, with the units that the log itself states, on one clock."""

from __future__ import annotations

import random
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.flight import Flight, field_scale, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.formats.dataflash import frames, rules
from flysid.ingest.formats.dataflash.layouts import CHARACTERS, make_layout
from flysid.ingest.formats.registry import FORMATS
from tests.format_trials import sample
from tests.ingest.formats.things import apart
from tests.inner_headers import plant_headers
from tests.marked_garbage import marked
from tests.samplelogs import dataflash_text as text_sample
from tests.samplelogs.dataflash import CODES, TYPES, build, fmt, pack

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "dataflash"
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/logs is not there")
SCALED = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}


TEXT = FORMATS["dataflash_text"]


def read(blob: bytes, **limits: Any) -> Flight:
    return collect(memoryview(blob), "x.bin", FORMATS["dataflash"], Limits(**limits))


def define(number: int, name: str, form: str, labels: str, length: int | None = None) -> bytes:
    size = 3 + sum(
        np.dtype((CHARACTERS[c][0], CHARACTERS[c][1] or 1)).itemsize for c in form if c in CHARACTERS
    )
    return pack(128, number, size if length is None else length, name, form, labels)


def message(number: int, form: str, *values: object) -> bytes:
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES[c] for c in form), *values)


def dfreader_rows(path: Path) -> dict[str, list[Any]]:
    from pymavlink import DFReader

    log = DFReader.DFReader_binary(str(path))
    rows: dict[str, list[Any]] = defaultdict(list)
    while (found := log.recv_msg()) is not None:
        rows[found.get_type()].append(found)
    log.filehandle.close()
    return rows


@needs_logs
@pytest.mark.parametrize("name", ["copter_437s.bin", "pymavlink_test.BIN"])
def test_every_field_is_what_dfreader_reads(name: str) -> None:
    flight = flysid.read(LOGS / name)
    expected = apart(flight, dfreader_rows(LOGS / name))
    assert set(flight.streams) == set(expected)
    for stream, table in flight.tables.items():
        assert table.num_rows == len(expected[stream]), stream
        columns = table.to_pydict()
        for i, theirs in enumerate(expected[stream]):
            for label, character in zip(theirs.fmt.columns, theirs.fmt.format, strict=False):
                ours = columns[label][i]
                value = getattr(theirs, label)
                if character in SCALED:
                    value = round(value / SCALED[character])
                value = list(value) if isinstance(value, bytes) else value
                assert ours == value or (ours != ours and value != value), f"{stream}.{label} row {i}"


@needs_logs
def test_units_come_from_the_log() -> None:
    flight = flysid.read(LOGS / "sitl_copter_49s.BIN")
    gps = flight["GPS"].schema
    att = flight["ATT"].schema
    assert (field_unit(gps.field("Lat")), field_scale(gps.field("Lat"))) == ("deg", 1e-7)
    assert (field_unit(att.field("DesRoll")), field_scale(att.field("DesRoll"))) == ("deg", 0.01)
    assert (field_unit(att.field("TimeUS")), field_scale(att.field("TimeUS"))) == ("s", 1e-6)
    assert flight["IMU[0]"].schema.metadata[b"key"] == b"I"
    assert flight.info["firmware"] == "4.4.4"
    assert flight.damage.dropouts == {"messages": 8}
    (clock,) = flight.clocks
    assert clock.slope == pytest.approx(1.0, abs=1e-3)
    assert clock.utc_offset_ns is not None
    assert 1.6e18 < clock.utc_offset_ns < 2e18


def test_a_definition_that_changes_begins_a_new_stream() -> None:
    form = "QB"
    later = "QBf"
    blob = define(128, *TYPES[128]) + define(20, "ABC", form, "TimeUS,A")
    blob += b"".join(message(20, form, 1000 * i, i) for i in range(5))
    blob += define(20, "ABC", later, "TimeUS,A,B") + b"".join(
        message(20, later, 1000 * i, i, 0.5) for i in range(7)
    )
    blob += define(21, "ABC", form, "TimeUS,A") + b"".join(message(21, form, 9000 + i, i) for i in range(3))
    flight = read(blob)
    assert {s: t.num_rows for s, t in flight.tables.items()} == {"ABC": 8, "ABC~2": 7, "FMT": 4}
    assert flight.tables["ABC~2"].column_names[2:] == ["TimeUS", "A", "B"]


@pytest.mark.parametrize("time_us", [0, 1 << 63, (1 << 64) - 1, 3 * 31_557_600 * 10**6])
@pytest.mark.parametrize("at", [0, 1, 17, 39])
@pytest.mark.parametrize("is_alone", [True, False])
def test_an_absurd_time_moves_nothing(time_us: int, at: int, is_alone: bool) -> None:
    blob = (
        define(128, *TYPES[128])
        + define(20, "ATT", "Qc", "TimeUS,Roll")
        + define(21, "ONE", "Qc", "TimeUS,A")
    )
    for i in range(40):
        wrong = message(21 if is_alone else 20, "Qc", time_us, i) if i == at else b""
        blob += wrong or message(20, "Qc", 500_000_000 + 100_000 * i, i)
    flight = read(blob)
    assert flight.damage.time_outliers == {"ONE" if is_alone else "ATT": 1}
    times = np.concatenate([t["time_ns"].to_numpy() for s, t in flight.tables.items() if s != "FMT"])
    assert times.min() >= 499 * SECOND_NS
    assert times.max() <= 505 * SECOND_NS
    (clock,) = flight.clocks
    assert (clock.first_ns, clock.last_ns) == (
        (500_000 + 100 * (at == 0)) * 10**6,
        (503_900 - 100 * (at == 39)) * 10**6,
    )


def test_times_that_run_backwards_are_counted() -> None:
    blob = define(128, *TYPES[128]) + define(20, "ATT", "Qc", "TimeUS,Roll")
    order = [*range(10), 11, 10, *range(12, 40)]
    blob += b"".join(message(20, "Qc", 5_000_000 + 100_000 * i, i) for i in order)
    flight = read(blob)
    assert flight.damage.out_of_order == {"ATT": 1}
    assert [c.boot for c in flight.clocks] == [0]
    assert not flight.damage.lossy


def test_milliseconds_serve_where_there_are_no_microseconds() -> None:
    blob = define(128, *TYPES[128]) + define(20, "ATT", "Ic", "TimeMS,Roll") + define(21, "CMD", "B", "Num")
    for i in range(20):
        blob += message(20, "Ic", 500 + 100 * i, i) + (message(21, "B", i) if i % 5 == 2 else b"")
    flight = read(blob)
    assert flight["ATT"]["time_ns"].to_pylist() == [(500 + 100 * i) * 10**6 for i in range(20)]
    assert field_scale(flight["ATT"].schema.field("Roll")) == 0.01
    assert flight["CMD"].schema.metadata[b"time_source"] == b"order-mapped"
    for time_ns, i in zip(flight["CMD"]["time_ns"].to_pylist(), [2, 7, 12, 17], strict=True):
        assert (500 + 100 * i) * 10**6 < time_ns < (600 + 100 * i) * 10**6


def test_gps_weeks_serve_where_nothing_counts_from_boot() -> None:
    blob = (
        define(128, *TYPES[128])
        + define(20, "GPS", "BIH", "Status,TimeMS,Week")
        + define(21, "ATT", "c", "Roll")
    )
    for i in range(20):
        blob += message(20, "BIH", 3, 200_000_000 + 200 * i, 1800) + message(21, "c", i)
    flight = read(blob)
    gps = np.diff(flight["GPS"]["time_ns"].to_numpy())
    assert (gps == 200_000_000).all()
    assert (np.diff(flight["ATT"]["time_ns"].to_numpy()) >= 0).all()
    utc = flight.clocks[0].utc_offset_ns
    assert utc is not None
    first = utc + flight["GPS"]["time_ns"].to_pylist()[0]
    gps_seconds = 315_964_800 + 1800 * 604_800 + 200_000 - 16  # 16 leap seconds in July 2014
    assert first == pytest.approx(gps_seconds * SECOND_NS, abs=10**6)


def test_two_logs_in_one_file_are_two_boots() -> None:
    one = define(128, *TYPES[128]) + define(20, "ATT", "Qc", "TimeUS,Roll")
    one += b"".join(message(20, "Qc", 5_000_000 + 100_000 * i, i) for i in range(50))
    flight = read(one + one)
    assert flight["ATT"]["boot"].to_pylist() == [0] * 50 + [1] * 50
    assert [(c.boot, c.first_ns) for c in flight.clocks] == [(0, 5 * SECOND_NS), (1, 5 * SECOND_NS)]


def test_a_format_that_contradicts_itself_costs_only_its_own_messages() -> None:
    blob = (
        define(128, *TYPES[128])
        + define(20, "GOOD", "QB", "TimeUS,A")
        + define(21, "BAD", "Q!", "TimeUS,A", 12)
    )
    for i in range(10):
        blob += message(20, "QB", 1000 * i, i) + message(21, "QB", 1000 * i, i)
    flight = read(blob)
    assert flight["GOOD"].num_rows == 10
    assert flight.damage.undecoded == {"BAD": 10}
    assert flight.damage.bytes_skipped == 0


@pytest.mark.parametrize("byte", [0x00, 0xFF])
def test_padding_at_the_end_is_no_loss(byte: int) -> None:
    flight = read(build() + bytes([byte]) * 3000)
    assert flight.rows == read(build()).rows
    assert not flight.damage.lossy
    assert flight.info["padding_bytes"] == "3000"


def test_headers_inside_sound_messages_neither_cost_nor_invent_a_row() -> None:
    outcome = plant_headers(40, lambda: True)
    assert (outcome.trials, outcome.failures) == (40, [])


@pytest.mark.parametrize("at", [0, 1])
def test_a_first_and_a_last_message_far_from_the_others_hide_nothing(at: int) -> None:
    blob = define(128, *TYPES[128]) + define(20, "ATT", "QB", "TimeUS,Roll")
    blob += define(21, "TWO", "QIQB", "TimeUS,A,B,C")  # ends as an ATT would
    far_us = (2_000_000, 9_000_000)[at]
    inner = struct.pack("<QB", 5_000_000, 7)
    outer = b"\xa3\x95" + bytes([21]) + struct.pack("<Q", far_us) + b"\0" + b"\xa3\x95" + bytes([20]) + inner
    messages = [message(20, "QB", 5_000_000 + 100_000 * i, i) for i in range(20)]
    messages.insert((0, 20)[at], outer)
    flight = read(blob + b"".join(messages))
    assert {s: t.num_rows for s, t in flight.tables.items()} == {"ATT": 20, "TWO": 1, "FMT": 3}
    assert not flight.damage.lossy


@pytest.mark.parametrize(("time_us", "is_believed"), [(10**15, False), (5_400_000, True)])
def test_messages_inside_another_count_where_its_time_is_impossible(time_us: int, is_believed: bool) -> None:
    blob = define(128, *TYPES[128]) + define(20, "ATT", "QB", "TimeUS,Roll")
    blob += define(21, "TWO", "QBIQ", "TimeUS,A,B,C")  # as long as two of the others
    messages = [message(20, "QB", 5_000_000 + 100_000 * i, i) for i in range(20)]
    messages[4] = b"\xa3\x95" + bytes([21]) + struct.pack("<Q", time_us) + messages[4][11:]
    flight = read(blob + b"".join(messages))
    assert flight["ATT"].num_rows == (18 if is_believed else 19)
    assert ("TWO" in flight.tables) == is_believed


def test_labels_are_made_unique_and_complete() -> None:
    twice = make_layout("X", "BBB", ("A_3", "A", "A"), 6)
    assert twice is not None
    assert twice.dtype.names == ("A_3", "A", "A_3_3")
    layout = make_layout("X", "BBB", ("A", "A"), 6)
    assert layout is not None
    assert [f.name for f in layout.fields] == ["A", "A_2", "field3"]
    assert make_layout("X", "BB", ("A", "B"), 6) is None


def test_pieces_of_files_stay_bytes() -> None:
    data = bytes(range(64))
    blob = define(128, *TYPES[128]) + define(20, "FILE", "NBZ", "FileName,Length,Data")
    blob += message(20, "NBZ", b"a.txt", 64, data) * 3
    assert bytes(read(blob)["FILE"]["Data"].to_pylist()[0]) == data


@given(st.lists(st.tuples(st.integers(0, 400), st.binary(min_size=1, max_size=60)), max_size=3))
@settings(max_examples=40, deadline=None)
def test_damage_anywhere_never_raises_and_small_batches_agree(edits: list[tuple[int, bytes]]) -> None:
    blob = bytearray(b"".join(fmt(n) for n in TYPES) + build()[-1500:])
    for at, garbage in edits:
        blob[800 + at : 800 + at] = garbage
    whole = read(bytes(blob))
    pieces = read(bytes(blob), batch_bytes=512)
    assert pieces.rows == whole.rows
    assert pieces.damage.bytes_skipped == whole.damage.bytes_skipped


def test_the_text_of_a_log_gives_the_same_physical_values() -> None:
    from tests.samplelogs.dataflash_text import build as build_text

    text = collect(memoryview(build_text()), "x.log", TEXT, Limits())
    binary = read(build())
    for stream in ("ATT", "IMU[0]", "IMU[1]", "GPS"):
        for name in binary[stream].column_names[2:]:
            ours, theirs = (
                f[stream][name].to_numpy() * field_scale(f[stream].schema.field(name)) for f in (text, binary)
            )
            assert ours == pytest.approx(theirs, rel=1e-6, abs=0.0051), f"{stream}.{name}"
        assert text[stream]["time_ns"].equals(binary[stream]["time_ns"])
    assert text["MSG"]["Message"].to_pylist() == ["ArduCopter V4.3.1, (0123abcd)"]
    assert text.info["firmware"] == "4.3.1"


def test_windows_line_ends_are_line_ends() -> None:
    from tests.samplelogs.dataflash_text import build as build_text

    flight = collect(memoryview(build_text().replace(b"\n", b"\r\n")), "x.log", TEXT, Limits())
    assert flight.rows == collect(memoryview(build_text()), "x.log", TEXT, Limits()).rows
    assert not flight.damage.lossy


@pytest.mark.parametrize(
    "garbage", [b"abc\n\n", b"\n\nabc\n", b"\r\n\xff\xfe\n\r\n", b"abc\n\r", b"\nabc\n\nabc\n\n"]
)
def test_line_ends_beside_damage_are_part_of_it(garbage: bytes) -> None:
    blob = text_sample.build()
    at = blob.index(b"ATT, 10")
    flight = collect(memoryview(blob[:at] + garbage + blob[at:]), "a.log", TEXT, Limits())
    assert flight.rows == collect(memoryview(blob), "a.log", TEXT, Limits()).rows
    assert [(r.start, r.end) for r in flight.damage.regions] == [(at, at + len(garbage))]
    assert flight.damage.bytes_skipped == len(garbage)


@pytest.mark.parametrize("seed", range(12))
def test_compiled_rules_find_what_the_plain_ones_find(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """They take over where a log is dense with headers: what is found must not depend on who looked."""
    sound = sample("dataflash")
    middle = len(sound) // 2
    blob = sound[:middle] + marked("dataflash", 3000, random.Random(seed)) + sound[middle:]
    found = []
    for is_costly in (True, False):
        monkeypatch.setattr(frames, "_is_costly", lambda _, decided=is_costly: decided)
        flight = read(blob, batch_bytes=1000 if seed % 2 else 1 << 20)
        found.append((flight.damage, {name: table.to_pydict() for name, table in flight.tables.items()}))
    assert repr(found[0]) == repr(found[1])


def test_random_times_are_in_no_order() -> None:
    """Two headers by chance stated times of centuries, one behind the other, and became messages."""
    assert not rules.is_in_order(rules.LAST_NS, rules.NO_TIME, rules.LAST_NS)


def test_a_fmt_whose_length_and_name_are_damaged_costs_its_own_messages_only() -> None:
    raw = bytearray(build())
    at = next(k for k in range(0, 800, 89) if raw[k + 3] == 13)
    raw[at + 4 : at + 12] = b"\xff" * 8  # ten of its messages would fit into one
    flight = read(bytes(raw))
    kept = {
        stream: table.num_rows for stream, table in flight.tables.items() if stream in ("ATT", "GPS", "NOTE")
    }
    assert kept == {"ATT": 45, "GPS": 5, "NOTE": 5}
    assert flight.damage.bytes_skipped == 90 * 24


def test_empty_lines_between_whole_ones_mean_nothing() -> None:
    blob = text_sample.build()
    flight = collect(memoryview(blob.replace(b"\n", b"\r\n\r\n\n") + b"\n\n"), "a.log", TEXT, Limits())
    assert not flight.damage.lossy


@pytest.mark.parametrize("garbage", [b"x", b"\xff" * 300, b"FMT, 1, 2", b"MSG, 1, a text"])
def test_a_fmt_behind_what_lost_its_end_still_defines(garbage: bytes) -> None:
    blob = text_sample.build()
    at = blob.index(b"FMT, 13")
    flight = collect(memoryview(blob[:at] + garbage + blob[at:]), "a.log", TEXT, Limits())
    assert flight.rows == collect(memoryview(blob), "a.log", TEXT, Limits()).rows
    assert [(r.start, r.end) for r in flight.damage.regions] == [(at, at + len(garbage))]


@pytest.mark.parametrize("letter", [b"\xf7", b"J", b"*", b" ", b"\0\0\0\0", b"\xff\xffTT"])
def test_a_text_that_holds_the_next_line_is_damage_and_another_is_not(letter: bytes) -> None:
    blob = text_sample.build()
    head = b"" if len(letter) > 1 else b"ATT"
    joined = blob.replace(b"(0123abcd)\nATT", b"(0123abcd)" + letter + head)
    whole, flight = (collect(memoryview(b), "a.log", TEXT, Limits()) for b in (blob, joined))
    assert flight.rows == whole.rows - 2
    assert [r.reason for r in flight.damage.regions] == ["two lines run into one"]
    talk = blob + b"MSG, 9, EKF3 IMU0, ATT bad, 3, 4\nMSG, 10, XATT, 5, 6\nMSG, 11, 5\xb0, 6, 7\n"
    assert not collect(memoryview(talk), "a.log", TEXT, Limits()).damage.lossy
