"""`flysid fit` from disk: parts of a file without reading it, models that stream, words for all others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.dataset import Dataset, Segment, Signal
from flysid.datasetfile import DatasetFile, open_dataset, write_dataset
from flysid.errors import DataError, UsageError
from flysid.model.arx import ARX
from flysid.model.base import load
from flysid.model.oe import OE
from flysid.model.stream import OnDisk
from flysid.split import By, Piece
from flysid.validate.runs import diskparts, fitting
from flysid.validate.runs.diskparts import FilePart, parts_of, plan_on_disk, whole
from flysid.validate.runs.run import held_out, open_run
from tests.model_examples import data


def flown(flights: int, samples: int, seed: int = 0) -> Dataset:
    """One input, one output; flights of two segments each."""
    found: list[Segment] = []
    for number in range(flights):
        part = data(1, 1, samples=samples // 2, noise=0.05, seed=seed + number)
        found += [
            Segment(s.u, s.y, t0_ns=number * 10**12 + i * 10**11, flight=f"f{number}")
            for i, s in enumerate(part.segments[:2])
        ]
    return Dataset(0.02, (Signal("u", "rad"),), (Signal("y", "m/s"),), tuple(found), "pitch")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> DatasetFile:
    path = tmp_path_factory.mktemp("data") / "pitch.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flysid.datasetfile.ROWS_PER_GROUP", 700)
        write_dataset(path, flown(4, 1200))
    return open_dataset(path)


def test_a_part_is_its_pieces_whatever_the_blocks(file: DatasetFile) -> None:
    pieces = (Piece(0, 10, 400), Piece(0, 450, 590), Piece(3, 0, 600), Piece(5, 599, 600))
    part = FilePart(file, pieces)
    all_of_it = file.read()
    assert isinstance(part, OnDisk)
    assert len(part) == 390 + 140 + 600 + 1
    for piece, segment in zip(pieces, part.read().segments, strict=True):
        source = all_of_it.segments[piece.segment].slice(piece.start, piece.stop, 0.02)
        assert np.array_equal(segment.y, source.y)
        assert (segment.t0_ns, segment.flight) == (source.t0_ns, source.flight)
    assert [len(s) for s in part.head(500).segments] == [390, 110]
    assert np.array_equal(
        np.concatenate([y for _, _, y in whole(file).blocks()]), np.asarray(all_of_it)[:, 1:]
    )


@pytest.mark.parametrize("by", ["flight", "time"])
def test_the_held_out_part_is_none_of_the_training_part(file: DatasetFile, by: By) -> None:
    split = plan_on_disk(file, holdout=0.3, by=by, seed=1)
    train, test = parts_of(split, file)
    rows = {side: {(p.segment, i) for p in part.pieces for i in range(p.start, p.stop)}
            for side, part in (("train", train), ("test", test))}  # fmt: skip
    assert not rows["train"] & rows["test"]
    assert 0.2 < len(test) / len(file) < 0.4
    if by == "flight":
        assert not set(train.read().flights) & set(test.read().flights)
    else:  # a guard of one second on both sides
        assert not {(s, i + k) for s, i in rows["test"] for k in (-50, 50)} & rows["train"]
    assert plan_on_disk(file, holdout=0.3, by=by, seed=1) == split
    assert plan_on_disk(file, holdout=0.3, by=by, seed=3) != split


def test_a_held_out_part_is_bounded(file: DatasetFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diskparts, "MOST_HELD", 500)
    ways: tuple[By, ...] = ("flight", "time")
    for by in ways:
        split = plan_on_disk(file, holdout=0.3, by=by)
        assert 400 < sum(map(len, split.test)) <= 500


def test_another_file_is_noticed(file: DatasetFile, tmp_path: Path) -> None:
    split = plan_on_disk(file, holdout=0.3)
    write_dataset(tmp_path / "other.parquet", flown(4, 1200, seed=9))
    with pytest.raises(DataError, match="hash differs"):
        parts_of(split, open_dataset(tmp_path / "other.parquet"))
    write_dataset(tmp_path / "same.parquet", file.read())  # other row groups, the same samples
    assert parts_of(split, open_dataset(tmp_path / "same.parquet"))[1].read().content_hash()


def test_a_copy_on_the_other_side_is_refused(tmp_path: Path) -> None:
    once = flown(1, 4000)
    twice = [Segment(s.u, s.y, s.t0_ns, flight=name) for name in ("a", "b", "c") for s in once.segments]
    write_dataset(tmp_path / "copies.parquet", once.with_segments(twice))
    with pytest.raises(DataError, match="repeats training flight"):
        plan_on_disk(open_dataset(tmp_path / "copies.parquet"), holdout=0.3)


def test_a_file_is_fitted_from_disk_and_judged(file: DatasetFile, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = ["fit", str(file.path), "-o", str(out), "--memory", "0", "--models", "fir,oe", "--jobs", "1"]
    done = CliRunner().invoke(root, command)
    assert done.exit_code == 0, done.output
    assert "pitch from disk" in done.output
    assert "oe could not be fitted: needs its data in memory" in done.output
    run = open_run(out)
    assert set(run.channels[0].models) == {"mean", "persistence", "arx", "fir"}
    (held,) = held_out(run)
    assert len(held.test) == sum(stop - start for _, start, stop in run.channels[0].split["test"])
    arx = load(out / run.channels[0].models["arx"])
    train = FilePart(file, tuple(Piece(*p) for p in run.channels[0].split["train"])).read()
    assert arx.predict(train.segments[0].u, train.segments[0].y)[-1] == pytest.approx(
        ARX(refine=False).fit(train).predict(train.segments[0].u, train.segments[0].y)[-1], rel=1e-6
    )
    judged = CliRunner().invoke(root, ["validate", str(out)])
    assert judged.exit_code == 0, judged.output
    assert (out / "report" / "report.html").is_file()


def test_a_small_file_is_fitted_in_memory_by_all(
    file: DatasetFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fitting, "linear_rivals", lambda *_: {"arx": ARX(2, 2, 1), "oe": OE(2, 2, 1)})
    command = ["fit", str(file.path), "-o", str(tmp_path / "run"), "--models", "line"]
    done = CliRunner().invoke(root, command)
    assert done.exit_code == 0, done.output
    assert {"line", "oe"} <= set(open_run(tmp_path / "run").channels[0].models)
    assert CliRunner().invoke(root, ["validate", str(tmp_path / "run")]).exit_code == 0


def test_a_recipe_belongs_to_a_folder_and_not_to_a_file(file: DatasetFile, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        root, ["fit", str(file.path), "-r", "px4-attitude", "-o", str(tmp_path / "run")]
    )
    assert isinstance(done.exception, UsageError)
    assert not (tmp_path / "run").exists()
