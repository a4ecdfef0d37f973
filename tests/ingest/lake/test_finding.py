"""What lies in a folder of flights: every file is read, or named with what it is."""

from __future__ import annotations

import gzip
import json
import os
import tarfile
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.errors import UsageError
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.workers import Bounds
from tests.samplelogs import csv, dataflash, dataflash_text, mcap, rosbag, tlog, ulog

LOG = tlog.build()
KML = b"<?xml version='1.0'?><kml><coordinates>7.1,51.2,80</coordinates></kml>\n" * 20
PARAMETERS = b"ACRO_RP_P,4.5\nACRO_YAW_P,4.5\nAHRS_GPS_GAIN,1.0\nANGLE_MAX,4500\n" * 30


def cli(*words: str | Path) -> Result:
    return CliRunner().invoke(root, [str(w) for w in words], standalone_mode=False)


def put(path: Path, blob: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(blob)
    return path


def fill(folder: Path) -> None:
    """A folder as they are found on disks: six logs, and fifteen files that are none."""
    put(folder / "00000012.BIN", dataflash.build())
    put(folder / "2024" / "flight.tlog", LOG)
    put(folder / "2024" / "old name of a log", ulog.build())
    put(folder / "2024" / "record.bag.active", rosbag.build())
    put(folder / "2024" / "text of a log.txt", dataflash_text.build())
    put(folder / "table.CSV", csv.build())
    for name, blob in {
        "README.md": b"# Flights of 2024\n",
        "notes.txt": "Wind von West, böig\n".encode("latin-1"),
        "flight.tlog.kml": KML,
        "flight.param": PARAMETERS,
        "mission.waypoints": b"QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t51.2\t7.1\t80\t1\n",
        "mavproxy.log": b"Log Directory: \nTelemetry log: mav.tlog\nLoaded module console\n",
        "desktop.ini": b"\xff\xfe" + "[.ShellClassInfo]".encode("utf-16-le"),
        "map.png": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
        "photo.JPG": b"\xff\xd8\xff\xe0" + bytes(range(256)),
        "video.mp4": b"\0\0\0\x20ftypisom" + bytes(300),
        "Thumbs.db": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500),
        "report.pdf": b"%PDF-1.7\n" + bytes(300),
        "flight.mat": b"MATLAB 5.0 MAT-file, made by Mission Planner" + bytes(300),
        ".DS_Store": b"\0\0\0\1Bud1" + bytes(100),
        ".gitkeep": b"",
        "empty": b"",
    }.items():
        put(folder / name, blob)
    with zipfile.ZipFile(folder / "plan.kmz", "w") as archive:
        archive.writestr("doc.kml", KML)
    put(folder / ".git" / "HEAD", b"ref\n")


def test_a_real_folder_is_read_and_the_rest_is_named(tmp_path: Path) -> None:
    fill(tmp_path / "logs")
    found = find_logs([tmp_path / "logs"])
    assert sorted(path.name for path in found.paths) == [
        "00000012.BIN",
        "flight.tlog",
        "old name of a log",
        "record.bag.active",
        "table.CSV",
        "text of a log.txt",
    ]
    assert not found.unread
    there = {p for p in (tmp_path / "logs").rglob("*") if p.is_file() and p.parent.name != ".git"}
    named = {*found.paths, *(item.path for item in found.passed_over)}
    assert named == there | {tmp_path / "logs" / ".git"}
    done = cli("ingest", tmp_path / "logs", "-o", tmp_path / "data")
    assert done.return_value == 0, done.stderr
    assert len(done.stdout.split()) == 6
    told = " ".join(done.stderr.split())  # folded to the width of a terminal
    assert told.count("ignored ") == 1
    assert "ignored 18 files that are not logs: " in told
    assert "text (7): " in told
    assert "and 4 more" in told
    assert "picture (2): map.png, photo.JPG" in told
    document = json.loads(cli("ingest", tmp_path / "logs", "-o", tmp_path / "data", "--json").stdout)
    assert len(document["passed_over"]) == len(found.passed_over)
    assert {"path": str(tmp_path / "logs" / "empty"), "kind": "empty file"} in document["passed_over"]


def test_what_may_be_a_log_counts(tmp_path: Path) -> None:
    put(tmp_path / "good.tlog", LOG)
    with zipfile.ZipFile(tmp_path / "inner.zip", "w") as inner:
        inner.writestr("a.tlog", LOG)
    with tarfile.open(tmp_path / "logs.tar.gz", "w:gz") as tar:
        tar.add(tmp_path / "good.tlog", "good.tlog")
    bad = {
        "00000001.DAT": bytes(range(256)) * 9,
        "unknown.parquetish": b"XYZ1" + bytes(100),
        "zeros": bytes(5000),
        "logs.7z": b"7z\xbc\xaf\x27\x1c" + bytes(100),
        "page.tlog": b"<!doctype html><title>Sign in</title>" * 9,
        "empty.ulg": b"",
    }
    for name, blob in bad.items():
        put(tmp_path / name, blob)
    (tmp_path / "linked").symlink_to(tmp_path.parent)
    with zipfile.ZipFile(tmp_path / "outer.zip", "w") as outer:
        outer.write(tmp_path / "inner.zip", "inner.zip")
    done = cli("ingest", tmp_path, "-o", tmp_path / "data")
    assert done.return_value == 3
    skipped = {
        line.split(": ")[1].removeprefix(f"{tmp_path}/")
        for line in done.stderr.splitlines()
        if "skipped: /" in line
    }
    assert skipped == {*bad, "linked", "logs.tar.gz", "outer.zip/inner.zip", "inner.zip/a.tlog"}
    assert done.stderr.count("/zeros") == 1  # said once


@pytest.mark.parametrize(
    "name", ["a.BIN.gz", "a.ulg.gz", "a.bag.active", "a.whatever", "a.mcap.zst", "a.TLOG"]
)
def test_no_log_vanishes_for_its_name(tmp_path: Path, name: str) -> None:
    blobs = {".BIN": dataflash.build(), ".ulg": ulog.build(), ".bag": rosbag.build(), ".mcap": mcap.build()}
    blob = next((blob for mark, blob in blobs.items() if mark in name), LOG)
    if name.endswith(".gz"):
        blob = gzip.compress(blob)
    elif name.endswith(".zst"):
        import zstandard

        blob = zstandard.compress(blob)
    put(tmp_path / "logs" / name, blob)
    done = cli("ingest", tmp_path / "logs", "-o", tmp_path / "data")
    assert done.return_value == 0, done.stderr
    assert len(done.stdout.split()) == 1


def test_an_empty_folder_among_others_costs_nothing_else(tmp_path: Path) -> None:
    put(tmp_path / "full" / "a.tlog", LOG)
    (tmp_path / "empty").mkdir()
    for order in (("empty", "full"), ("full", "empty")):
        done = cli("ingest", *(tmp_path / name for name in order), "-o", tmp_path / order[0] / "data")
        assert done.return_value == 3
        assert len(done.stdout.split()) == 1
        assert f"skipped: {tmp_path}/empty: no flight log in there" in done.stderr
    with pytest.raises(UsageError, match="no flight log in there"):
        find_logs([tmp_path / "empty"])
    with pytest.raises(UsageError, match=r"no flight log in there.*an ingested folder: 'flysid ls"):
        find_logs([tmp_path / "full" / "data"])


def test_an_archive_is_a_folder(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("one.tlog", LOG)
        archive.writestr("__MACOSX/._one.tlog", b"\0\5\26\7")
        archive.writestr("notes.txt", "windy\n")
        archive.writestr("odd", bytes(range(256)))
    with zipfile.ZipFile(tmp_path / "letters.docx", "w") as archive:
        archive.writestr("word/document.xml", "<w/>")
    found = find_logs([tmp_path])
    assert found.paths == (tmp_path / "a.zip" / "one.tlog",)
    assert [item.path for item in found.unread] == [tmp_path / "a.zip" / "odd"]
    assert {(item.path.name, item.kind) for item in found.passed_over} == {
        ("._one.tlog", "hidden file"),
        ("notes.txt", "text"),
        ("letters.docx", "document"),
    }
    named = find_logs([tmp_path / "letters.docx"])
    assert named.paths == (tmp_path / "letters.docx",)  # what is named itself is tried, and refused by name


def test_what_was_ingested_before_is_not_found_again(tmp_path: Path) -> None:
    put(tmp_path / "a.tlog", LOG)
    cli("ingest", tmp_path, "-o", tmp_path / "data")
    found = find_logs([tmp_path])
    assert found.paths == (tmp_path / "a.tlog",)
    assert [(item.path.name, item.kind) for item in found.passed_over] == [("data", "ingested folder")]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_what_may_not_be_opened_counts(tmp_path: Path) -> None:
    put(tmp_path / "a.tlog", LOG)
    put(tmp_path / "secret", LOG).chmod(0)
    found = find_logs([tmp_path])
    assert [item.reason for item in found.unread] == ["cannot be read: Permission denied"]


def test_the_truth_of_a_simulated_flight_is_no_log(tmp_path: Path) -> None:
    put(tmp_path / "a.tlog", LOG)
    put(tmp_path / "a.truth.parquet", b"PAR1" + bytes(100) + b"PAR1")
    found = find_logs([tmp_path])
    assert [path.name for path in found.paths] == ["a.tlog"]
    assert [other.kind for other in found.passed_over] == ["truth of a simulated flight"]
    assert not found.unread


def test_looking_into_an_archive_is_bounded(tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("one.tlog", LOG)
            archive.writestr("notes.txt", "calm air\n")
    put(tmp_path / "c.zip", b"PK\3\4" + bytes(range(200)))
    assert find_logs([tmp_path], Bounds()) == find_logs([tmp_path])
    with zipfile.ZipFile(tmp_path / "many.zip", "w") as archive:
        for number in range(8000):
            archive.writestr(f"{number}.odd", b"\0\1\2")
    late = find_logs([tmp_path / "many.zip"], Bounds(seconds=0.1))
    assert not late.paths
    assert [(item.path.name, item.reason[:21]) for item in late.unread] == [
        ("many.zip", "took longer than 0.1 ")
    ]
