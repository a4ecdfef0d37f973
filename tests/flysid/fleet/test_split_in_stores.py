"""Recordings that are split over several objects of a bucket are one log, as on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

import flysid
from flysid.place import Place
from tests.command import call
from tests.split_recordings import MAKERS, lay, metadata

PARTS = [range(0, 40), range(40, 77), range(77, 120)]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def send(bucket: str, folder: str, paths: list[Path]) -> None:
    for path in paths:
        Place(bucket).put(f"{folder}/{path.name}", path)


@pytest.mark.parametrize("ending", MAKERS)
def test_parts_in_a_bucket_are_one_log_to_every_verb(ending: str, bucket: str, tmp_path: Path) -> None:
    """Each file was a flight of its own, cut at a moment that means nothing to the vehicle."""
    parts = lay(tmp_path / "in", "flight", ending, PARTS)
    send(bucket, "in", parts)
    here = flysid.read(parts[0])
    there = flysid.read(f"{bucket}/in/{parts[1].name}")
    assert (there.rows, there.source.sha256) == (here.rows, here.source.sha256) == (120, there.source.sha256)
    for given in (f"{bucket}/in", f"{bucket}/in/{parts[2].name}"):
        done = call("ingest", given, "-o", f"{bucket}/lake", "-j", "1", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        (facts,) = flysid.open(f"{bucket}/lake").facts
        assert (facts.log, facts.rows, facts.sha256) == (parts[0].name, 120, here.source.sha256)
    again = call("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1", cwd=tmp_path)
    assert "1 there already" in again.stderr, again.stderr


def test_a_list_in_a_bucket_names_what_is_missing(bucket: str, tmp_path: Path) -> None:
    parts = lay(tmp_path / "bag", "other", ".db3", PARTS)
    (tmp_path / "bag" / "metadata.yaml").write_text(metadata(parts))
    send(bucket, "bag", [parts[0], parts[2], tmp_path / "bag" / "metadata.yaml"])
    done = call("doctor", f"{bucket}/bag/{parts[2].name}", cwd=tmp_path)
    assert done.returncode == 3
    assert f"{parts[1].name}: metadata.yaml lists it" in " ".join(done.stderr.split()), done.stderr
    done = call("ingest", f"{bucket}/bag", "-o", f"{bucket}/lake", "-j", "1", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    (facts,) = flysid.open(f"{bucket}/lake").facts
    assert (facts.log, facts.rows) == (parts[0].name, 83)


def test_numbered_flights_in_a_bucket_stay_apart(bucket: str, tmp_path: Path) -> None:
    """They are fetched together, and their times part them; one that cannot be read costs no other."""
    flights = lay(tmp_path / "in", "flight", ".mcap", [range(0, 40), range(9000, 9040), range(0, 9)])
    flights[2].write_bytes(b"\x89MCAP0\r\n" + bytes(99))
    send(bucket, "in", flights)
    done = call("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert {facts.log for facts in flysid.open(f"{bucket}/lake").facts} == {f.name for f in flights[:2]}
    again = call("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1", cwd=tmp_path)
    assert "1 log in quarantine since before" in again.stderr, again.stderr
