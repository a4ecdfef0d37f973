"""`flysid show` on a log and on a folder: facts, ranges, parameters, events, the track."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import UsageError
from flysid.flight import ClockMap, Source, field_metadata
from flysid.ingest.formats.base import Parts, StreamPart, Summary
from flysid.ingest.lake.events import written
from flysid.store import create_data_folder, write_flight
from tests.samplelogs import dataflash

T_NS = np.arange(100, dtype=np.int64) * 100_000_000


def stream(name: str, **columns: pa.Array) -> StreamPart:
    n = len(next(iter(columns.values())))
    fields = [pa.field("time_ns", pa.int64()), pa.field("boot", pa.int32())]
    fields += [
        pa.field(key, a.type, metadata=field_metadata(unit="deg", scale=0.5) if key == "Roll" else None)
        for key, a in columns.items()
    ]
    return StreamPart(name, pa.table([T_NS[:n], np.zeros(n, np.int32), *columns.values()], pa.schema(fields)))


def parts() -> Parts:
    roll = np.arange(100.0)
    roll[7] = np.nan
    yield stream("ATT", Roll=pa.array(roll))
    yield stream("MODE", ModeNum=pa.array([0] * 40 + [5] * 10))
    yield stream("MSG", Message=pa.array(["Takeoff"]))
    yield stream("PARM", Name=pa.array(["P", "P"]), Value=pa.array([0.25, 0.5]))
    yield stream("GPS", Lat=pa.array([0, 521234567]), Lng=pa.array([0, 51234567]), Alt=pa.array([0.0, 8.5]))
    clock = ClockMap(0, 0, int(T_NS[-1]), utc_offset_ns=1_700_000_000_000_000_000)
    return Summary(clocks=(clock,), info={"autopilot": "ardupilot", "vehicle": "copter"})


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = create_data_folder(tmp_path / "data")
    write_flight(folder, Source("0001.BIN", "dataflash", 1, "0" * 64), parts())
    return folder


def show(*arguments: str | Path) -> str:
    done = CliRunner().invoke(root, ["show", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def test_a_flight_says_when_it_was_and_which_modes_were_flown(data: Path) -> None:
    text = show(data)
    assert "date       2023-11-14 22:13:20 UTC" in text
    assert "modes      STABILIZE 00:04, LOITER 00:06" in text


def test_a_stream_says_its_ranges_in_units(data: Path) -> None:
    [line] = [row for row in show(data, "ATT").splitlines() if row.startswith("Roll")]
    assert line.split() == ["Roll", "double", "deg", "0.5", "0", "24.9646", "49.5", "1"]
    assert show(data, "0001", "ATT") == show(data, "ATT")


def test_all_fields_of_a_flight_are_listed_with_their_ranges(data: Path) -> None:
    lines = [line.split() for line in show(data, "--fields").splitlines()]
    assert ["ATT:", "100", "rows,", "10.0", "Hz"] in lines
    assert ["Roll", "deg", "0", "24.9646", "49.5", "1"] in lines
    assert ["ModeNum", "0", "1", "5"] in lines
    assert ["Name"] in lines
    assert not [line for line in lines if line[:1] in (["time_ns"], ["boot"])]


def test_parameters_events_and_track(data: Path) -> None:
    assert show(data, "--params") == "P 0.5\n"
    events = [line.split() for line in show(data, "--events").splitlines()]
    assert [row[2] for row in events] == ["mode", "message", "parameter", "mode"]
    assert events[2][3:] == ["P", "=", "0.5", "(was", "0.25)"]
    assert [line.split() for line in show(data, "--messages").splitlines()] == [events[1]]
    assert show(data, "--track").splitlines()[1:] == ["0.1,0,52.1234567,5.1234567,8.5"]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.46000000834465027, "0.46"),
        (20.0, "20"),
        (16777217.0, "16777217"),
        (1e300, "1e+300"),
        (1e-7, "1e-07"),
        ("on", "on"),
    ],
)
def test_a_parameter_in_single_precision_is_written_in_its_own_digits(value: float | str, shown: str) -> None:
    assert written(value) == shown


def test_a_log_is_shown_like_a_folder(tmp_path: Path) -> None:
    (tmp_path / "0001.BIN").write_bytes(dataflash.build())
    assert "ATT" in show(tmp_path / "0001.BIN")
    assert "Roll" in show(tmp_path / "0001.BIN", "ATT")


def test_what_cannot_be_meant_is_refused(data: Path) -> None:
    for arguments in (["--params", "--events"], ["a", "b", "c"], ["0001", "ATTT"], ["ATTT"]):
        done = CliRunner().invoke(root, ["show", str(data), *arguments])
        assert isinstance(done.exception, UsageError), arguments


def test_an_error_names_the_log_as_the_user_did(tmp_path: Path) -> None:
    """Not the folder that it was read into, which is gone by then."""
    log = tmp_path / "rig.csv"
    log.write_text("Time (s),Speed [rad/s]\n" + "".join(f"{k / 50},{k}\n" for k in range(200)))
    run = str(tmp_path / "run")
    for words in (["show", str(log), "no", "flight"], ["fit", str(log), "-r", "px4-rates", "-o", run]):
        error = CliRunner().invoke(root, words).exception
        assert isinstance(error, UsageError)
        assert error.path == str(log)


def test_a_table_is_shown_and_drawn_whole(tmp_path: Path) -> None:
    """Of one stream, without a recipe, no field need be named; the time itself is not drawn."""
    log = tmp_path / "rig.csv"
    log.write_text(
        "Time (s),Motor [V],Speed [rad/s]\n" + "".join(f"{k / 50},{k % 9},{k}\n" for k in range(200))
    )
    text = show(log)
    assert "Motor    double  V" in text
    drawn = CliRunner().invoke(root, ["plot", str(log), "--term"], catch_exceptions=False)
    assert "table.Motor, V" in drawn.stdout
    assert "table.Speed, rad/s" in drawn.stdout
    assert "Time" not in drawn.stdout
