"""Tables as programs write them that nobody showed us: read as they were meant, with the names they have."""

from __future__ import annotations

import bz2
import decimal
import io
import lzma
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

import flysid
from flysid.flight import Flight
from tests.command import call

ROWS = 150
Row = Callable[[int], str]
OPTITRACK = (
    "Format Version,1.23,Take Name,Take 2024-05-03,Export Frame Rate,50.0,Length Units,Meters\n\n"
    ",Type" + ",Rigid Body" * 4 + "\n,Name,drone,drone,pole,pole\n,ID,1,1,2,2\n"
    ",,Rotation,Position,Rotation,Position\nFrame,Time (Seconds),X,X,X,X\n"
)
LABVIEW = (
    "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n"
    "Channels\t1\t\nSamples\t150\t\nX0\t0.0E+0\t\nTime [s]\troll\tComment\n"
)
QUALISYS = "NO_OF_FRAMES\t150\nNO_OF_CAMERAS\t12\nFREQUENCY\t50\nMARKER_NAMES\tm1\nFrame\tTime\tm1 X\tm1 Y\n"
VICON = "Trajectories\n50\n,,,drone:LED1,,drone:LED2,\nFrame,Sub Frame,t,X,Y,X,Y\n,,s,mm,mm,mm,mm\n"


def seconds(k: int) -> str:
    return f"{k / 50:.2f}"


def read_sound(folder: Path, blob: str | bytes, name: str = "t.csv") -> Flight:
    """A table at 50 Hz that is read without a loss."""
    (folder / name).write_bytes(blob.encode() if isinstance(blob, str) else blob)
    flight = flysid.read(folder / name)
    assert not flight.damage.lossy, flight.damage
    times = flight["table"]["time_ns"].to_numpy()
    assert list((times - times[0]) / 1e9) == pytest.approx([k / 50 for k in range(ROWS)], abs=2e-6)
    return flight


def lines(head: str, row: Row) -> str:
    return head + "".join(row(k) + "\n" for k in range(ROWS))


@pytest.mark.parametrize(
    ("head", "row", "names"),
    [
        (
            OPTITRACK,
            lambda k: f"{k},{seconds(k)},0.1,{k},0.2,1",
            ["Frame", "Time", "drone.Rotation.X", "drone.Position.X", "pole.Rotation.X", "pole.Position.X"],
        ),
        (
            VICON,
            lambda k: f"{k + 1},0,{seconds(k)},{k},1.5,{k},2.5",
            ["Frame", "Sub Frame", "t", "drone:LED1.X", "drone:LED1.Y", "drone:LED2.X", "drone:LED2.Y"],
        ),
        (QUALISYS, lambda k: f"{k}\t{seconds(k)}\t{k}.5\t1000", ["Frame", "Time", "m1 X", "m1 Y"]),
        (LABVIEW, lambda k: f"{seconds(k)}\t{k}.25\t", ["Time", "roll", "Comment"]),
        (
            "IMU,,,GPS,\nTime (s),Ax,Ay,Lat,Lon\n",
            lambda k: f"{seconds(k)},{k},0.1,47.1,8.1",
            ["Time", "Ax", "Ay", "Lat", "Lon"],
        ),
        (
            ",imu,imu,gps\n,x,y,x\ntime_s,,,\n",  # pandas: names in two lines, and that of the index
            lambda k: f"{seconds(k)},{k},0.1,47.1",
            ["time_s", "imu.x", "imu.y", "gps.x"],
        ),
        (
            "    Time     Roll Rate   Pitch Rate\n",
            lambda k: f"{k / 50:8.2f} {k:12d} {k / 3:12.5f}",
            ["Time", "Roll Rate", "Pitch Rate"],
        ),
        (
            "Clock:Tick#,Clock:offsetTime,roll\n",  # DatCon: which one tells no unit
            lambda k: f"{90_000 * k + 12_345},{k / 50 - 1:.3f},{k}",
            ["Clock:Tick#", "Clock:offsetTime", "roll"],
        ),
        ("", lambda k: f"{1_714_745_231_200_000 + 20_000 * k},{k},7", ["c1", "c2", "c3"]),
        (
            "",  # ros2 topic echo --csv
            lambda k: f"{1_714_745_231 + k // 50},{k % 50 * 20_000_000},base_link,{k}.5",
            ["c1", "c2", "c3", "c4"],
        ),
        ("time,x\n", lambda k: f"2024-124T14:07:{seconds(k):0>5},{k}", ["time", "x"]),
        ("time,x\n", lambda k: f"2024-05-03 14:07:{seconds(k):0>5} CEST,{k}", ["time", "x"]),
        (
            "time,x\n",
            lambda k: f"2024-05-03T14:07:{seconds(k):0>5}+02:00[Europe/Berlin],{k}",
            ["time", "x"],
        ),
        ("time,x\n", lambda k: f"2024-05-03T23:07:{seconds(k):0>5}-08:00,{k}", ["time", "x"]),
        (
            "time,note,x\n",
            lambda k: f"{seconds(k)},\u200f\u05e9\u05dc\u05d5\u05dd,{k}",
            ["time", "note", "x"],
        ),
        ("time,note,x\n", lambda k: f"{seconds(k)},\U0001f468\u200d\u2708\ufe0f,{k}", ["time", "note", "x"]),
    ],
)
def test_names_and_times_of_programs(tmp_path: Path, head: str, row: Row, names: list[str]) -> None:
    """Lines of names were rows; a nameless date was no time; a mark of direction lost a row."""
    flight = read_sound(tmp_path, lines(head, row))
    assert flight["table"].column_names[2:] == names


def test_zones_shift_the_date(tmp_path: Path) -> None:
    """16:07 in a zone west of Greenwich was a day of more than 24 hours, and so no time."""
    for zone, hour in (("-08:00", 22), (" PST", 22), (" CEST", 12), ("+05:30", 8.5)):
        text = lines("time,x\n", lambda k, zone=zone: f"2024-05-03 14:00:{seconds(k):0>5}{zone},{k}")  # type: ignore[misc]
        first = read_sound(tmp_path, text)["table"]["time_ns"][0].as_py() / 1e9
        assert first == pytest.approx(1_714_694_400 + 3600 * hour)


@pytest.mark.parametrize(
    ("spell", "factor"),
    [
        (lambda k: f"\u2212{k}.5", -1),
        (lambda k: f"{k + 0.5:.3E}".replace("E", "D"), 1),
        (lambda k: f'"{1 + k % 90},00,{k:03d}.5"', 0),
        (lambda k: "--.--" if k % 2 else f"{k}.5", 1),  # QGroundControl
    ],
)
def test_numbers_of_programs_stay_numbers(tmp_path: Path, spell: Row, factor: int) -> None:
    """A typeset minus made text of a column, exit 0; Fortran's exponents were refused."""
    flight = read_sound(tmp_path, lines("time_s,v,x\n", lambda k: f"{seconds(k)},{spell(k)},{k}"))
    values = flight["table"]["v"].to_pylist()
    meant = [factor * (k + 0.5) if factor else (1 + k % 90) * 100_000 + k + 0.5 for k in range(ROWS)]
    assert values == [
        None if spell(k) == "--.--" else pytest.approx(meant[k], abs=0.051) for k in range(ROWS)
    ]


@pytest.mark.parametrize("at", [75, ROWS])
def test_a_sector_of_zeros_costs_what_it_covers(tmp_path: Path, at: int) -> None:
    """ "binary data that lost the first bit of every byte": a logger that lost its power."""
    rows = [f"{seconds(k)},{k}\n" for k in range(ROWS)]
    (tmp_path / "t.csv").write_text("time_s,x\n" + "".join(rows[:at]) + "\0" * 512 + "".join(rows[at:]))
    done = call("ingest", "t.csv", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3
    flight = flysid.read(tmp_path / "t.csv")
    assert flight["table"].num_rows == ROWS - (at < ROWS)
    assert flight.damage.bytes_skipped == 512 + (len(rows[75]) if at < ROWS else 0)


def test_whole_seconds_of_a_faster_log_are_named(tmp_path: Path) -> None:
    """ "its values do not rise" sent people to look for a fault of the clock."""
    text = "time,x\n" + "".join(f"{1_714_745_231 + k // 50},{k}\n" for k in range(ROWS))
    (tmp_path / "t.csv").write_text(text)
    assert (
        "about 50 rows share each of its values"
        in flysid.read(tmp_path / "t.csv").damage.reasons["table.time"]
    )


def test_decimals_of_databases_are_times(tmp_path: Path) -> None:
    """Their rows were only numbered."""
    times = [decimal.Decimal(2 * k) / 100 for k in range(ROWS)]
    pq.write_table(pa.table({"time": times, "x": range(ROWS)}), tmp_path / "t.parquet")
    read_sound(tmp_path, (tmp_path / "t.parquet").read_bytes(), "t.parquet")


TABLE = lines("time_s,x\n", lambda k: f"{seconds(k)},{k}").encode()


def zipped(method: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        archive.writestr("logs/one.csv", TABLE)
        archive.writestr("__MACOSX/logs/._one.csv", b"\0\5\x16\7" + bytes(60))
    return out.getvalue()


@pytest.mark.parametrize(
    ("name", "blob"),
    [
        ("t.csv.xz", lzma.compress(TABLE)),
        ("t.csv.xz", lzma.compress(TABLE[:700]) + lzma.compress(TABLE[700:])),
        ("t.csv.bz2", bz2.compress(TABLE[:700]) + bz2.compress(TABLE[700:])),
        ("t.csv.zst", struct.pack("<II", 0x184D2A50, 4) + b"pzst" + zstandard.compress(TABLE)),
        ("t.zip", zipped(zipfile.ZIP_BZIP2)),
        ("t.zip", zipped(zipfile.ZIP_DEFLATED)),
    ],
)
def test_packings_of_programs(tmp_path: Path, name: str, blob: bytes) -> None:
    """xz, bzip2, pzstd; an archive of the Finder, whose notes were taken for a second log."""
    read_sound(tmp_path, blob, name)


@pytest.mark.parametrize("pack", [lzma.compress, lambda blob: bz2.compress(blob, 1)])
def test_a_cut_packing_gives_what_is_left(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    text = lines("time_s,x\n", lambda k: f"{seconds(k)},{hash((k, 1)) % 10**9}")
    blob = pack((text * 400).encode())
    (tmp_path / "t.csv.packed").write_bytes(blob[: len(blob) * 9 // 10])
    flight = flysid.read(tmp_path / "t.csv.packed")
    assert flight["table"].num_rows > ROWS
    assert flight.damage.truncated
