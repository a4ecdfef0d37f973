"""A recording that its recorder split over several files is one log, wherever the files lie."""

from __future__ import annotations

import gzip
import json
import random
import shutil
import zipfile
from pathlib import Path

import pytest

import flysid
from tests.command import call
from tests.samplelogs import pcap, pcapng
from tests.split_recordings import MAKERS, bag_of, compare, lay, metadata

PARTS = [range(0, 40), range(40, 77), range(77, 120)]
ENDINGS = pytest.mark.parametrize("ending", MAKERS)


def rows_of(path: Path) -> int:
    return flysid.read(path).rows


@ENDINGS
def test_split_files_are_one_flight_to_every_verb(ending: str, tmp_path: Path) -> None:
    parts = lay(tmp_path / "logs", "flight", ending, PARTS)
    (tmp_path / "whole").mkdir()
    whole = tmp_path / "whole" / f"whole{ending}"
    whole.write_bytes(MAKERS[ending](range(120)))
    for part in parts:
        flight = flysid.read(part)
        assert flight.rows == rows_of(whole) == 120
        assert flight.info["files"] == ", ".join(path.name for path in parts)
        assert not flight.damage.lossy
    alike = flysid.read(whole)
    assert {name: table.num_rows for name, table in flight.tables.items()} == {
        name: table.num_rows for name, table in alike.tables.items()
    }
    assert all(flight.tables[name].equals(alike.tables[name]) for name in alike.tables)
    done = call("ingest", "logs", "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (facts,) = flysid.open(tmp_path / "data").facts
    assert (facts.log, facts.rows) == (parts[0].name, 120)
    assert f"part of {parts[0].name} (2): {parts[1].name}, {parts[2].name}" in done.stderr
    assert facts.sha256 == flight.source.sha256
    for given in (["logs"], [f"logs/{path.name}" for path in parts], [f"logs/{parts[2].name}"]):
        seen = call("doctor", *given, "--json", cwd=tmp_path)
        assert seen.returncode == 0, seen.stderr
        assert len(json.loads(seen.stdout)["logs"]) == 1
    again = call("ingest", f"logs/{parts[1].name}", "-o", "data", cwd=tmp_path)
    assert "unchanged" in again.stdout + again.stderr
    shown = call("show", f"logs/{parts[1].name}", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr


@ENDINGS
def test_numbered_flights_are_never_joined(ending: str, tmp_path: Path) -> None:
    """A pause longer than any inside, an overlap, another order, a number left out: each is a flight."""
    cases = {
        "pause": [range(200, 240), range(245, 280)],
        "overlap": [range(300, 340), range(320, 380)],
        "order": [range(440, 480), range(400, 440)],
    }
    for name, parts in cases.items():
        for path, numbers in zip(lay(tmp_path / "logs", name, ending, parts), parts, strict=True):
            assert rows_of(path) == len(numbers), name
    gap = lay(tmp_path / "logs", "gap", ending, PARTS)
    gap[1].unlink()
    assert [rows_of(gap[0]), rows_of(gap[2])] == [40, 43]
    done = call("ingest", "logs", "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(flysid.open(tmp_path / "data").facts) == 8


@pytest.mark.parametrize("ending", [".db3", ".mcap"])
@pytest.mark.parametrize("absent", [0, 1, 2])
def test_a_file_that_the_list_names_and_that_is_gone_is_a_loss(
    ending: str, absent: int, tmp_path: Path
) -> None:
    parts = lay(tmp_path / "logs", "bag", ending, PARTS)
    (tmp_path / "logs" / "metadata.yaml").write_text(metadata(parts, [len(part) for part in PARTS]))
    parts[absent].unlink()
    done = call("ingest", "logs", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    (facts,) = flysid.open(tmp_path / "data").facts
    assert facts.rows == 120 - len(PARTS[absent])
    assert f"{parts[absent].name}: metadata.yaml lists it, and it is not there" in done.stderr
    left = next(path for path in parts if path.exists())
    assert flysid.read(left).damage.undecoded == {parts[absent].name: len(PARTS[absent])}
    assert f"part of {left.name}" in done.stderr
    assert "metadata.yaml" in done.stderr


@pytest.mark.parametrize("ending", [".db3", ".mcap"])
def test_a_recorders_own_folder_needs_no_list(ending: str, tmp_path: Path) -> None:
    parts = lay(tmp_path / "bag", "bag", ending, PARTS)
    parts[1].unlink()
    flight = flysid.read(parts[2])
    assert flight.rows == 120 - len(PARTS[1])
    assert flight.damage.undecoded == {parts[1].name: 1}
    assert "it is not there" in flight.damage.reasons[parts[1].name]


def test_a_list_that_is_old_or_of_another_bag_joins_nothing_and_loses_nothing(tmp_path: Path) -> None:
    parts = lay(tmp_path / "old", "bag", ".db3", PARTS)
    (tmp_path / "old" / "metadata.yaml").write_text(metadata(parts[:2]))
    assert rows_of(parts[0]) == rows_of(parts[2]) == 120
    (tmp_path / "other").mkdir()
    alone = tmp_path / "other" / "flight.db3"
    shutil.copy(parts[0], alone)
    (tmp_path / "other" / "metadata.yaml").write_text(metadata(parts))
    flight = flysid.read(alone)
    assert (flight.rows, flight.damage.lossy) == (40, False)
    assert call("ingest", "other", "-o", "data", cwd=tmp_path).returncode == 0


@ENDINGS
def test_parts_lie_packed_and_in_archives_too(ending: str, tmp_path: Path) -> None:
    parts = lay(tmp_path / "logs", "flight", ending, PARTS)
    with zipfile.ZipFile(tmp_path / "logs.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in parts:
            archive.write(path, f"monday/{path.name}")
    for path in parts[1:]:
        path.with_name(path.name + ".gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    assert rows_of(parts[0]) == 120
    assert rows_of(tmp_path / "logs.zip" / "monday" / parts[1].name) == 120
    done = call("ingest", "logs.zip", "logs", "-o", "data", cwd=tmp_path)
    same = f"skipped: logs/{parts[0].name}: the same content as logs.zip/monday/{parts[0].name}"
    assert same in done.stderr
    assert [facts.rows for facts in flysid.open(tmp_path / "data").facts] == [120]


@ENDINGS
def test_an_empty_or_foreign_part_is_named_and_costs_no_other(ending: str, tmp_path: Path) -> None:
    for number, blob in enumerate((b"", b"no log at all\n" * 20)):
        parts = lay(tmp_path / str(number), "bag", ending, PARTS)
        (tmp_path / str(number) / "metadata.yaml").write_text(metadata(parts))
        parts[1].write_bytes(blob)
        if ending == ".bag":
            assert rows_of(parts[0]) == len(PARTS[0])
            continue
        flight = flysid.read(parts[0])
        assert flight.rows == 120 - len(PARTS[1])
        assert set(flight.damage.undecoded) == {parts[1].name}


def test_dated_bags_of_one_prefix_are_recordings_of_their_own(tmp_path: Path) -> None:
    names = ["imu_2026-05-04-10-00-00_0", "imu_2026-05-04-10-00-01_1", "imu_2026-05-04-12-00-00_0"]
    for name, numbers in zip(names, [range(40), range(40, 80), range(9000, 9040)], strict=True):
        (tmp_path / f"{name}.bag").write_bytes(bag_of(numbers))
    assert [rows_of(tmp_path / f"{name}.bag") for name in names] == [80, 80, 40]
    (tmp_path / f"{names[0]}.bag").unlink()
    lacking = flysid.read(tmp_path / f"{names[1]}.bag")
    assert lacking.rows == 40
    assert lacking.damage.undecoded == {"imu_*_0.bag": 1}
    (tmp_path / "alone").mkdir()
    alone = shutil.copy(tmp_path / f"{names[1]}.bag", tmp_path / "alone")
    assert not flysid.read(alone).damage.lossy


@ENDINGS
def test_recordings_cut_at_random_are_whole_again(ending: str, tmp_path: Path, fresh_seed: int) -> None:
    rng = random.Random(fresh_seed)
    said = [compare(tmp_path / str(trial), ending, rng) for trial in range(6)]
    assert said == [""] * 6


CAPTURES = {
    "tcpdump": ["x.pcap", "x.pcap1", "x.pcap2"],
    "ring": ["x.pcap0", "x.pcap1", "x.pcap2"],
    "dumpcap": [f"x_0000{k}_2026050410111{k}.pcap" for k in (1, 2, 3)],
    "wireshark": [f"x_0000{k}_2026050410111{k}.pcapng" for k in (1, 2, 3)],
}


@pytest.mark.parametrize("program", CAPTURES)
def test_split_captures_are_one_flight(program: str, tmp_path: Path) -> None:
    maker = pcapng if program == "wireshark" else pcap
    blob = maker.build()
    head, *packets = [blob[record.start : record.end] for record in maker.records(blob)]
    (tmp_path / "logs").mkdir()
    paths = [tmp_path / "logs" / name for name in CAPTURES[program]]
    for path, part in zip(paths, (packets[:40], packets[40:90], packets[90:]), strict=True):
        path.write_bytes(head + b"".join(part))
    (tmp_path / "whole.cap").write_bytes(blob)
    whole = flysid.read(tmp_path / "whole.cap")
    for path in paths:
        flight = flysid.read(path)
        assert not flight.damage.lossy
        assert {name: table.to_pylist() for name, table in flight.tables.items()} == {
            name: table.to_pylist() for name, table in whole.tables.items()
        }
    done = call("ingest", "logs", "-o", "data", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [facts.rows for facts in flysid.open(tmp_path / "data").facts] == [whole.rows]
    paths[1].write_bytes(head + b"".join(packets[60:90]))  # a pause longer than any inside
    assert flysid.read(paths[0]).rows < whole.rows // 2
