"""Files that are recognised and not read: each is named, with the way out."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import FormatError
from flysid.ingest.formats.registry import detect
from flysid.ingest.lake.finding import find_logs
from tests.format_trials import FORMATS, sample


@pytest.mark.parametrize(
    ("head", "name", "title", "hint"),
    [
        (b"ULogEnc\x01" + bytes(range(200)), "log.ulge", "encrypted ULog", "decrypt it first"),
        (b"\0" * 16 + b"BUILD 2016-01-05" + b"\x55" * 400, "FLY001.DAT", "DJI", "DatCon"),
        (b"\0" * 242 + b"DJI_LOG_V3" + b"\x55" * 400, "FLY120.DAT", "DJI", "DatCon"),
        (b"\0\0\0\x20ftypisom\0\0\2\0isomiso2" + bytes(300), "DJI_0001.MP4", "video", "SD card"),
        (b"\0\0\0\x08wide\0\1\2\3mdat" + bytes(300), "GOPR.MOV", "video", "SD card"),
        (b"RIFF\x00\x10\0\0AVI LIST" + bytes(300), "dvr.avi", "video", "SD card"),
        (b"\x1aE\xdf\xa3\x93B\x82\x88matroska", "dvr.mkv", "video", "SD card"),
        ((b"G" + bytes(187)) * 9, "dvr.ts", "video", "SD card"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "photo.jpg", "picture", "give the log"),
        (
            b"PK\3\4\x14\0\6\0" + bytes(22) + b"[Content_Types].xml",
            "log.xlsx",
            "office",
            "save the table as CSV",
        ),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "log.mat", "MATLAB", "writetable"),
        (b"\x89HDF\r\n\x1a\n" + bytes(90), "log.h5", "HDF5", "to_parquet"),
        (b"\x93NUMPY\1\0v\0{'descr': '<f8'", "log.npy", "NumPy", "from_arrays"),
        ("t,u\n0,1\n1,2\n".encode("utf-16"), "log.csv", "UTF-16", "UTF-8"),
        (b"$GPGGA,123519,4807.038,N,01131.000,E*47\r\n" * 9, "gps.csv", "NMEA", "gpsbabel"),
        (b"<?xml version='1.0'?>\n<gpx version='1.1'>", "track.gpx", "GPS track", "autopilot"),
        (b"\n<!DOCTYPE html>\n<html>", "flight.ulg", "web page", "download again"),
        (b"QGC WPL 110\n0\t1\t0\t16\t0\t0\n", "mission.txt", "plan", "give the log"),
        (b"rosbag2_bagfile_information:\n  version: 5\n", "metadata.yaml", "metadata", ".db3 or .mcap"),
    ],
)
def test_it_is_named_with_the_way_out(head: bytes, name: str, title: str, hint: str) -> None:
    with pytest.raises(FormatError) as raised:
        detect(head, name)
    assert title in raised.value.message
    assert hint in raised.value.hint


def test_a_spreadsheet_is_no_archive_of_logs(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["time_s", "u", "y"])
    path = tmp_path / "flights" / "log.xlsx"
    path.parent.mkdir()
    book.save(path)
    for verb in ("doctor", "ingest"):
        done = CliRunner().invoke(
            root,
            [verb, str(path), *(["-o", str(tmp_path / "data")] * (verb == "ingest"))],
            standalone_mode=False,
        )
        assert done.return_value in (1, 3)
        assert "a spreadsheet or document of an office program" in done.output
        assert "save the table as CSV" in done.output
    with zipfile.ZipFile(tmp_path / "flights" / "notes.zip", "w") as archive:
        archive.write(path, "log.xlsx")
    (path.parent / "one.tlog").write_bytes(sample("tlog"))
    found = find_logs([path.parent])
    assert found.paths == (path.parent / "one.tlog",)
    assert {item.path.name: item.kind for item in found.passed_over} == {
        "log.xlsx": "document",
        "notes.zip": "archive without logs",
    }


@pytest.mark.parametrize("name", FORMATS)
def test_no_log_is_taken_for_one_of_them(name: str) -> None:
    assert detect(sample(name)[:65536], "log").name == name
