"""What lies in a bucket is found as in a folder: archives, side files, files whose names do not tell."""

from __future__ import annotations

import io
import json
import random
import zipfile
from pathlib import Path

import pytest

import flysid
from flysid.place import Place
from tests.command import Done, call
from tests.flysid.fleet.fleet_logs import table
from tests.hostile_files import contents, lay, named, suffix_of
from tests.ingest.lake.sound_logs import SOUND, sound_table
from tests.killed_bags import unfinished
from tests.samplelogs import ulog

HOSTILE = ("zip, name empty name", "parquet, a column twice", "zip in zip", "csv.gz, cut", "mcap, anything")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def run(*words: str | Path) -> Done:
    """A command line, with its exit code."""
    return call(*words, cwd=Path.cwd())


def archive_of(*names: str) -> bytes:
    """Logs in a .zip archive, each with a content of its own, and a note."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("notes.txt", "windy")
        for number, name in enumerate(names):
            archive.writestr(name, table(number))
    return whole.getvalue()


def logs_of(lake: str) -> set[str]:
    """Names of the logs that became flights."""
    return {facts.log for facts in flysid.open(lake).facts}


def test_logs_in_an_archive_of_a_bucket_are_taken_in_once(bucket: str, tmp_path: Path) -> None:
    Place(bucket).put("in/flights.zip", archive_of("monday/one.csv", "two.csv"))
    Place(bucket).put("in/three.csv", table(3))
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 0, done.stderr
    assert "3 ingested" in done.stderr
    assert logs_of(f"{bucket}/lake") == {"one.csv", "two.csv", "three.csv"}
    sources = {facts.info["source_url"] for facts in flysid.open(f"{bucket}/lake").facts}
    assert f"{bucket}/in/flights.zip/monday/one.csv" in sources
    again = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert (again.returncode, "2 there already" in again.stderr) == (0, True), again.stderr

    (tmp_path / "flights.zip").write_bytes(archive_of("monday/one.csv", "two.csv"))
    here = run("doctor", tmp_path / "flights.zip")
    there = run("doctor", f"{bucket}/in/flights.zip")
    assert here.stdout == there.stdout
    member = run("doctor", f"{bucket}/in/flights.zip/monday/one.csv", "--json")
    assert json.loads(member.stdout)["logs"][0]["file"] == "flights.zip/monday/one.csv"
    local = tmp_path / "flights.zip" / "monday" / "one.csv"
    assert flysid.read(f"{bucket}/in/flights.zip/monday/one.csv").rows == flysid.read(local).rows


def test_what_cannot_be_read_of_an_archive_is_named_even_where_it_shall_be_quiet(bucket: str) -> None:
    Place(bucket).put("in/a.zip", named(b"locked.csv", flags=1))
    Place(bucket).put("in/b.zip", archive_of())
    Place(bucket).put("in/strange", bytes(range(256)) * 9)
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 3, done.stderr
    assert "locked.csv: in quarantine: is encrypted" in done.stderr
    assert "b.zip: ignored: archive without logs" in done.stderr
    assert f"skipped: {bucket}/in/strange: binary data that no reader knows" in done.stderr
    quiet = run("ingest", f"{bucket}/in", "-o", f"{bucket}/other", "-j", "1", "-q")
    assert quiet.returncode == 3
    assert "strange: binary data" in quiet.stderr


def test_a_log_whose_name_does_not_tell_is_found_by_its_bytes(bucket: str) -> None:
    Place(bucket).put("in/old name of a log", ulog.build())
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 0, done.stderr
    assert logs_of(f"{bucket}/lake") == {"old name of a log"}


@pytest.mark.parametrize(("mode", "suffix"), [("wal", "-wal"), ("delete", "-journal")])
def test_a_bag_in_a_bucket_is_read_with_what_lies_beside_it(
    bucket: str, tmp_path: Path, mode: str, suffix: str
) -> None:
    bag = unfinished(tmp_path / "bag.db3", mode, 300, 90)
    place = Place(bucket)
    place.put("in/bag.db3", bag.read_bytes())
    run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    place.put(f"in/bag.db3{suffix}", bag.with_name(bag.name + suffix).read_bytes())
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 3, done.stderr
    assert 300 in {facts.rows for facts in flysid.open(f"{bucket}/lake").facts}
    assert flysid.read(f"{bucket}/in/bag.db3").rows == 300


def test_hostile_files_in_a_bucket_cost_no_sound_log(bucket: str) -> None:
    place = Place(bucket)
    for number in range(SOUND):
        place.put(f"in/sound{number:02}.csv", sound_table(number))
    for k, kind in enumerate(HOSTILE):
        place.put(f"in/hostile{k}{suffix_of(kind)}", contents()[kind](random.Random(k)))
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 3, done.stderr
    assert {f"sound{number:02}.csv" for number in range(SOUND)} <= logs_of(f"{bucket}/lake")


def test_logs_of_this_machine_that_cannot_be_looked_into_are_named(bucket: str, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "sound.csv").write_bytes(sound_table(1))
    lay("unreadable", tmp_path / "logs", random.Random(1))
    done = run("ingest", tmp_path / "logs", "-o", f"{bucket}/lake", "-j", "1")
    assert done.returncode == 3, done.stderr
    assert "skipped: " in done.stderr
    assert logs_of(f"{bucket}/lake") == {"sound.csv"}
