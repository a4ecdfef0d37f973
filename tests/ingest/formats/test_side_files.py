"""What a killed recorder leaves beside a bag is read as SQLite reads it, wherever the bag lies."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import pytest

import flysid
from flysid.errors import FormatError
from tests.command import call
from tests.killed_bags import compare, rows_by_flysid, rows_by_sqlite, unfinished

STATES = 60
ROWS = 300
WORDS = {
    "head": "the head of its write-ahead log is damaged",
    "frame": "its write-ahead log is damaged at byte ",
    "cut": "pages of an unfinished transaction in its write-ahead log are left out",
}
MODES = {"wal": "-wal", "delete": "-journal"}


def test_killed_bags_hold_the_rows_that_sqlite_reads(tmp_path: Path, fresh_seed: int) -> None:
    seeds = range(fresh_seed, fresh_seed + STATES)
    assert [said for seed in seeds if (said := compare(tmp_path, seed))] == []


@pytest.mark.parametrize(("mode", "begun"), [("wal", 0), ("wal", 90), ("delete", 90)])
def test_every_finished_message_is_ingested_from_a_folder(tmp_path: Path, mode: str, begun: int) -> None:
    (tmp_path / "bags").mkdir()
    bag = unfinished(tmp_path / "bags" / "bag.db3", mode, ROWS, begun)
    side = bag.with_name("bag.db3" + MODES[mode])
    assert side.stat().st_size
    done = call("ingest", "bags", "-o", "data", cwd=tmp_path)
    assert done.returncode == (3 if begun else 0), done.stderr
    (facts,) = flysid.open(tmp_path / "data").facts
    assert facts.rows == ROWS
    assert f"part of bag.db3 (1): {side.name}" in done.stderr or f", {side.name}" in done.stderr
    assert "no reader knows" not in done.stderr
    assert ("unfinished transaction" in done.stderr) == bool(begun)


@pytest.mark.parametrize("mode", MODES)
def test_what_lies_beside_a_bag_in_an_archive_or_packed_is_read_too(tmp_path: Path, mode: str) -> None:
    bag = unfinished(tmp_path / "bag.db3", mode, ROWS, 90)
    files = [bag, bag.with_name(bag.name + MODES[mode])]
    with zipfile.ZipFile(tmp_path / "bags.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, f"monday/{file.name}")
    for file in files:
        (tmp_path / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
    true = rows_by_sqlite(bag, tmp_path / "copy")
    for place in (bag, tmp_path / "bags.zip" / "monday" / "bag.db3", tmp_path / "bag.db3.gz"):
        assert rows_by_flysid(place)[0] == true, place
    assert len(true or ()) == ROWS
    done = call("ingest", "bags.zip", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert flysid.open(tmp_path / "data").facts[0].rows == ROWS


def test_a_copy_without_private_data_has_the_messages_of_the_log_beside_it(tmp_path: Path) -> None:
    unfinished(tmp_path / "bag.db3", "wal", ROWS)
    done = call("scrub", "bag.db3", "-o", "copy.db3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert flysid.read(tmp_path / "copy.db3").rows == ROWS


@pytest.mark.parametrize("harm", ["frame", "head", "cut"])
def test_a_damaged_log_beside_a_bag_is_named_as_a_loss(tmp_path: Path, harm: str) -> None:
    unfinished(tmp_path / "bag.db3", "wal", ROWS)
    wal = tmp_path / "bag.db3-wal"
    blob = bytearray(wal.read_bytes())
    if harm == "cut":
        del blob[len(blob) // 2 :]
    else:
        blob[len(blob) // 2 if harm == "frame" else 9] ^= 1
    wal.write_bytes(blob)
    done = call("doctor", "bag.db3", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert "side files: " in done.stderr
    assert WORDS[harm] in done.stderr
    assert rows_by_flysid(tmp_path / "bag.db3")[0] == rows_by_sqlite(tmp_path / "bag.db3", tmp_path / "copy")


def test_a_log_or_journal_alone_is_named_for_what_it_is(tmp_path: Path) -> None:
    for mode, suffix in MODES.items():
        bag = unfinished(tmp_path / f"{mode}.db3", mode, ROWS, 90)
        bag.unlink()
        with pytest.raises(FormatError, match="write-ahead log or the journal of a database") as raised:
            flysid.read(bag.with_name(bag.name + suffix))
        assert "beside its .db3 file" in raised.value.hint
