"""Rows of one message that belong to several things: streams of their own in every verb."""

from __future__ import annotations

import csv
import json
import math
import struct
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow.csv import write_csv
from pyarrow.parquet import write_table

import flysid
from flysid.errors import RecipeError, UsageError
from flysid.flight import Flight, matching_streams, message_of, split_address, stem_of, thing_of
from flysid.ingest.align.recipe import SignalSpec, Source
from flysid.ingest.align.signals import FlightLog, find_source, load_signal
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import find_format
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.survey import survey
from flysid.ingest.lake.timeline import find_fields
from flysid.live.decoding import Decoder
from flysid.store import read_flight
from tests.command import Done, call
from tests.keyed_trials import KINDS, draw, trials
from tests.parameter_trials import written
from tests.samplelogs import dataflash

TYPES = {
    **{number: dataflash.TYPES[number] for number in (128, 129, 130, 131)},
    13: ("IMU", "QBff", "TimeUS,I,GyrX,AccX"),
    14: ("CMD", "Qf", "TimeUS,U"),
}
GYROS = (1, 2)
OFFSET = 100.0  # of the second gyro: a mixture shows at once
MANY = 600
RATE_HZ = 50
SUFFIXES = {"dataflash": ".bin", "tlog": ".tlog", "ulog": ".ulg", "mcap": ".mcap"}


def imu_log(gyros: tuple[int, ...] = GYROS, *, units: bool = True) -> bytes:
    """A command and gyros that follow it with a lag: their numbers as gains, `OFFSET` apart, at 50 Hz."""
    out = [dataflash.fmt(number, TYPES) for number in TYPES]
    out.append(dataflash.pack(129, 1, ord("#"), "instance", types=TYPES))
    if units:
        out.append(dataflash.pack(130, 1, 13, "s#Eo", "F---", types=TYPES))
    rate = 0.0
    for k in range(MANY):
        us = 10_000_000 + k * 1_000_000 // RATE_HZ
        command = math.sin(0.02 * k + 0.0006 * k * k)
        out.append(dataflash.pack(14, us, command, types=TYPES))
        rate += 0.2 * (command - rate)
        out += [
            dataflash.pack(13, us + 40 + g, g, g * rate + OFFSET * (g - 1), -9.8, types=TYPES) for g in gyros
        ]
    return b"".join(out)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "imu.bin").write_bytes(imu_log())
    (tmp_path / "alone.bin").write_bytes(imu_log((2,)))
    return tmp_path


def read(blob: bytes, kind: str) -> Flight:
    return collect(memoryview(blob), f"x.{kind}", find_format(kind), Limits())


def refused(done: Done) -> str:
    assert done.returncode == 2, (done.stdout, done.stderr)
    return done.stderr


# ------------------------------------------------------------------------------------------ every verb


@pytest.mark.parametrize(
    "words",
    [
        ("plot", "imu.bin", "IMU.GyrX", "--term"),
        ("plot", "imu.bin", "IMU", "--term"),
        ("plot", "imu.bin", "IMU.Gyr*", "--term"),
        ("show", "imu.bin", "IMU"),
        ("export", "imu.bin", "IMU", "-o", "out.csv"),
        ("tf", "imu.bin", "--from", "CMD.U", "--to", "IMU.GyrX"),
        ("tf", "imu.bin", "--from", "IMU.GyrX", "--to", "CMD.U"),
        ("step", "imu.bin", "--from", "CMD.U", "--to", "IMU.GyrX"),
        ("fit", "imu.bin", "--from", "CMD.U", "--to", "IMU.GyrX", "-o", "run"),
    ],
)
def test_a_message_of_several_things_is_refused_with_their_names(
    words: tuple[str, ...], folder: Path
) -> None:
    told = refused(call(*words, cwd=folder))
    assert all(f"IMU[{gyro}]" in told for gyro in GYROS), told


@pytest.mark.parametrize("gyro", GYROS)
def test_one_thing_is_fitted_alone(gyro: int, folder: Path) -> None:
    found = call("tf", "imu.bin", "--from", "CMD.U", "--to", f"IMU[{gyro}].GyrX", "--json", cwd=folder)
    assert found.returncode == 0, found.stderr
    y = flysid.dataset_from(folder / "imu.bin", "CMD.U", f"IMU[{gyro}].GyrX").segments[0].y
    assert np.all(np.abs(y - OFFSET * (gyro - 1)) < 3.0)


def test_the_rows_of_one_thing_are_shown_plotted_and_exported(folder: Path) -> None:
    shown = call("show", "imu.bin", "IMU[2]", "--rows", "3", cwd=folder)
    assert shown.returncode == 0, shown.stderr
    assert f"{MANY} rows" in shown.stdout
    drawn = call("plot", "imu.bin", "IMU[2].GyrX", "-o", "p.html", cwd=folder)
    assert drawn.returncode == 0, drawn.stderr
    assert "IMU[2].GyrX" in (folder / "p.html").read_text()
    assert "IMU[1].GyrX" not in (folder / "p.html").read_text()


def test_one_grid_has_a_column_of_every_thing(folder: Path) -> None:
    done = call("export", "imu.bin", "--rate", str(RATE_HZ), "-o", "grid.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    with (folder / "grid.csv").open() as file:
        rows = list(csv.DictReader(file))
    titles = {name.partition(" [")[0].partition("[rad")[0]: name for name in rows[0]}
    for gyro in GYROS:
        values = np.array([float(row[titles[f"IMU[{gyro}].GyrX"]] or "nan") for row in rows])
        assert np.nanmin(values) > OFFSET * (gyro - 1) - 3.0
        assert np.nanmax(values) < OFFSET * (gyro - 1) + 3.0


def test_a_message_of_one_thing_has_both_names(folder: Path) -> None:
    for stream in ("IMU", "IMU[2]"):
        done = call("tf", "alone.bin", "--from", "CMD.U", "--to", f"{stream}.GyrX", "--json", cwd=folder)
        assert done.returncode == 0, done.stderr
    flight = flysid.read(folder / "alone.bin")
    assert flight["IMU"] is flight["IMU[2]"]


def test_an_ingested_folder_holds_a_stream_of_every_thing(folder: Path) -> None:
    done = call("ingest", "imu.bin", "-o", "data", cwd=folder)
    assert done.returncode == 0, done.stderr
    (flight,) = open_lake(folder / "data").flights
    rows = {entry.stream: entry.rows for entry in flight.streams if entry.stream.startswith("IMU")}
    assert rows == {f"IMU[{gyro}]": MANY for gyro in GYROS}
    listed = call("show", "data", "--json", cwd=folder)
    assert {"IMU[1]", "IMU[2]"} <= {s["stream"] for s in json.loads(listed.stdout)["streams"]}
    assert "IMU[1]" in refused(call("plot", "data", "IMU.GyrX", "--term", cwd=folder))


# -------------------------------------------------------------------------------------------- recipes


def gyro(stream: str, **where: Any) -> SignalSpec:
    return SignalSpec("rad/s", (Source(stream, "GyrX", unit="rad/s", where=where),))


@pytest.mark.parametrize(
    ("spec", "thing"), [(gyro("IMU[2]"), 2), (gyro("IMU", I=2), 2), (gyro("IMU", I=1), 1)]
)
def test_a_recipe_names_a_thing_by_its_key_or_by_its_value(spec: SignalSpec, thing: int) -> None:
    loaded = load_signal("p", spec, FlightLog(read(imu_log(), "dataflash")))
    assert loaded.stream == f"IMU[{thing}]"
    assert len(loaded.boots[0].x) == MANY
    assert np.all(np.abs(loaded.boots[0].x - OFFSET * (thing - 1)) < 3.0)


def test_a_recipe_that_names_no_thing_is_refused_and_one_alone_is_taken() -> None:
    with pytest.raises(RecipeError, match="several things") as caught:
        load_signal("p", gyro("IMU"), FlightLog(read(imu_log(), "dataflash")))
    assert "IMU[1], IMU[2]" in caught.value.advice
    assert load_signal("p", gyro("IMU"), FlightLog(read(imu_log((2,)), "dataflash"))).stream == "IMU[2]"


def test_an_absent_thing_falls_back_to_the_only_one_and_never_to_one_of_several() -> None:
    sources = (*gyro("IMU", I=0).sources, *gyro("IMU").sources)
    alone = find_source(sources, FlightLog(read(imu_log((2,)), "dataflash")))
    assert alone is not None
    assert alone[1] == "IMU[2]"
    assert find_source(sources, FlightLog(read(imu_log(), "dataflash"))) is None


# --------------------------------------------------------------------------------------------- formats


@pytest.mark.parametrize("units", [True, False])
def test_instances_are_told_by_their_unit_or_as_ardupilot_lays_them_out(units: bool) -> None:
    flight = read(imu_log(units=units), "dataflash")
    assert [name for name in flight if name.startswith("IMU")] == ["IMU[1]", "IMU[2]"]


def test_a_unit_that_no_key_can_have_splits_nothing() -> None:
    types = {**{n: TYPES[n] for n in (128, 129, 130, 131)}, 15: ("LIST", "Qa", "TimeUS,Values")}
    out = [dataflash.fmt(number, types) for number in types if number != 15]
    out.append(dataflash.pack(128, 15, 3 + 8 + 64, "LIST", "Qa", "TimeUS,Values", types=types))
    out.append(dataflash.pack(130, 1, 15, "s#", "F-", types=types))
    rows = [b"\xa3\x95\x0f" + struct.pack("<Q32h", 1000 * k, *range(32)) for k in range(5)]
    assert read(b"".join([*out, *rows]), "dataflash")["LIST"].num_rows == len(rows)


def test_a_thing_is_what_the_last_brackets_hold() -> None:
    names = ["IMU[0]", "F[q[0]]", "1.1/F[a/b]", "/x[0]/y[1]", "F[[]", "F[a]b]", "F[]", "q", "[0]"]
    split = [(stem_of(name), thing_of(name), message_of(name)) for name in names]
    assert split == [
        ("IMU", "0", "IMU[0]"),
        ("F", "q[0]", "F[q[0]]"),
        ("1.1/F", "a/b", "F[a/b]"),
        ("/x[0]/y", "1", "y[1]"),
        ("F", "[", "F[[]"),
        ("F", "a]b", "F[a]b]"),
        ("F", "", "F[]"),
        ("q", "", "q"),
        ("[0]", "", "[0]"),
    ]


@pytest.mark.parametrize(
    ("address", "parts"),
    [
        ("IMU[0].GyrX", ("IMU[0]", "GyrX")),
        ("NAMED_VALUE_FLOAT[a.b].value", ("NAMED_VALUE_FLOAT[a.b]", "value")),
        ("vehicle_attitude.q[0]", ("vehicle_attitude", "q[0]")),
        ("GyrX", ("", "GyrX")),
    ],
)
def test_an_address_is_split_outside_its_brackets(address: str, parts: tuple[str, str]) -> None:
    assert split_address(address) == parts


def named_values(names: list[str]) -> bytes:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    told: list[tuple[tuple[int, int], Any]] = []
    for k, name in enumerate(names):
        told.append(((1, 1), mavlink.MAVLink_attitude_message(5000 + 20 * k, 0, 0, 0, 0, 0, 0)))
        told.append(
            ((1, 1), mavlink.MAVLink_named_value_float_message(5000 + 20 * k, name.encode(), float(k)))
        )
    return written(told)


def test_named_values_are_apart_whatever_their_names() -> None:
    names = ["alt_err", "a.b", "x/y", "q[0]", ""]
    flight = read(named_values(names * 4), "tlog")
    for k, name in enumerate(names):
        table = flight[f"NAMED_VALUE_FLOAT[{name}]"]
        assert table["value"].to_pylist() == [float(k + len(names) * i) for i in range(4)]
        fields = find_fields(FlightLog(flight), [f"NAMED_VALUE_FLOAT[{name}].value"])
        assert fields == [(f"1.1/NAMED_VALUE_FLOAT[{name}]", "value")]


def printed(kind: str, data: dict[str, Any], k: int) -> str:
    """A line of mavlogdump."""
    return json.dumps({"meta": {"type": kind, "timestamp": 1.7e9 + 0.1 * k}, "data": data})


def test_lines_of_mavlogdump_are_apart_by_what_they_declare() -> None:
    fmt = {"Type": 13, "Length": 3 + 8 + 1 + 4, "Name": "TEMP", "Format": "QBf", "Columns": "TimeUS,Nr,T"}
    lines = [printed("FMT", fmt, 0), printed("FMTU", {"FmtType": 13, "UnitIds": "s#O", "MultIds": "F--"}, 0)]
    for k in range(20):
        lines.append(printed("TEMP", {"TimeUS": 100_000 * k, "Nr": k % 2, "T": float(k)}, k))
        lines.append(printed("ESC_STATUS", {"index": 4 * (k % 2), "rpm": [k, k, k, k]}, k))
        lines.append(printed("DISTANCE_SENSOR", {"time_boot_ms": 100 * k, "id": k % 4}, k))
    flight = read("\n".join(lines).encode() + b"\n", "mavlogdump")
    rows = {name: table.num_rows for name, table in flight.tables.items() if "[" in name}
    assert rows == {
        **{f"TEMP[{nr}]": 10 for nr in (0, 1)},
        **{f"ESC_STATUS[{index}]": 10 for index in (0, 4)},
        **{f"DISTANCE_SENSOR[{nr}]": 5 for nr in range(4)},
    }
    assert flight["TEMP[1]"]["T"].to_pylist() == [float(k) for k in range(1, 20, 2)]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_of_one_message_is_apart_as_its_log_is(kind: str, tmp_path: Path) -> None:
    columns: dict[str, list[float]] = {
        "TimeUS": [10_000_000 + 10_000 * k for k in range(200)],
        "I": [k % 2 for k in range(200)],
        "GyrX": [0.5 * k + OFFSET * (k % 2) for k in range(200)],
    }
    path = tmp_path / f"imu.{kind}"
    (write_csv if kind == "csv" else write_table)(pa.table(columns), path)
    flight = flysid.read(path)
    assert {name: table.num_rows for name, table in flight.tables.items()} == {
        "table[0]": 100,
        "table[1]": 100,
    }
    assert flight["table[1]"]["GyrX"].to_pylist() == columns["GyrX"][1::2]
    assert "table[0].GyrX" in refused(call("tf", path, "--from", "GyrX", "--to", "I", cwd=tmp_path))


def test_more_things_than_are_kept_apart_stay_together_by_another_name() -> None:
    names = [f"n{k}" for k in range(12)]
    limits = Limits(max_things=10)
    flight = collect(memoryview(named_values(names)), "x.tlog", find_format("tlog"), limits)
    assert flight["NAMED_VALUE_FLOAT (others)"].num_rows == 2
    assert flight.rows == 2 * len(names)
    assert "2 of 1.1/NAMED_VALUE_FLOAT" in flight.info["keys_note"]
    with pytest.raises(UsageError):
        flight["NAMED_VALUE_FLOAT"]


def test_instances_of_ulog_topics_have_the_same_addresses() -> None:
    streams = {"gyro": 1, "gyro#1": 1, "baro": 1}
    assert [matching_streams(f"gyro[{k}]", streams) for k in (0, 1, 2)] == [["gyro"], ["gyro#1"], []]
    assert matching_streams("baro[0]", streams) == []


def test_live_rows_come_by_thing() -> None:
    decoder = Decoder({"NAMED_VALUE_FLOAT[b]"})
    rows = decoder.read(named_values(["a", "b"] * 3))
    assert [r.records["value"].tolist() for r in rows["1.1/NAMED_VALUE_FLOAT[b]"]] == [[1.0, 3.0, 5.0]]
    assert decoder.rows["1.1/NAMED_VALUE_FLOAT[a]"] == 3
    assert "1.1/NAMED_VALUE_FLOAT[a]" not in rows


@pytest.mark.parametrize("kind", list(KINDS))
def test_random_logs_are_ingested_and_looked_over_thing_by_thing(kind: str, tmp_path: Path) -> None:
    drawn = (draw(seed) for seed in count())
    trial = next(t for t in drawn if t.format == kind and len([n for n in t.streams if "[" in n]) > 1)
    log = tmp_path / f"log{SUFFIXES[kind]}"
    log.write_bytes(trial.blob)
    done = call("ingest", log.name, "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (flight,) = open_lake(tmp_path / "data").flights
    meant = {name: len(rows) for name, rows in trial.streams.items()}
    assert {e.stream: e.rows for e in flight.streams if e.stream in meant} == meant
    stored = read_flight(tmp_path / "data", flight.id)
    assert all(stored.tables[name].num_rows == rows for name, rows in meant.items())
    looked = survey(log).streams
    assert {name: found.rows for name, found in looked.items() if name in meant} == meant


def test_no_row_of_random_logs_is_lost_invented_or_mixed() -> None:
    outcome = trials(40, lambda: True)
    assert outcome.failures == []
    assert outcome.lost == 0
