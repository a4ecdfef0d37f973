"""Run folders listed and ranked: only like with like, damaged ones named, nothing else entered."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from flysid.errors import StoreError, UsageError
from flysid.validate.runs import runindex
from flysid.validate.runs.history import RunChannel, find_runs, ranked, run_channels
from flysid.validate.runs.run import ChannelRun, FitSettings, Run, run_document
from flysid.validate.runs.runindex import INDEX, list_runs


def make_run(folder: Path, recipe: str = "r", channels: tuple[str, ...] = ("roll",)) -> Path:
    folder.mkdir(parents=True)
    runs = tuple(ChannelRun(name, {}, {}) for name in channels)
    run = Run(folder, "data", recipe, ("f",), FitSettings(), runs, {}, {})
    (folder / "run.json").write_bytes(run_document(run))
    return folder


def judge(folder: Path, held_out: str, channels: dict[str, dict[str, float | None]]) -> Path:
    """A report as `flysid validate` writes it, as far as it is read here."""
    body: dict[str, Any] = {
        name: {
            "free_run": {
                "models": {m: {"rmse": v} for m, v in rmse.items()},
                "change_pct": -3.0,
                "verdict": "same",
                "reason": "",
                "unit": "m/s",
            }
        }
        for name, rmse in channels.items()
    }
    about = {name.split("/")[0]: {"test_sha256": held_out} for name in channels}
    (folder / "report").mkdir()
    (folder / "report/report.json").write_text(json.dumps({"channels": body, "about": about}))
    return folder


def test_runs_are_ranked_only_on_the_same_held_out_part(tmp_path: Path) -> None:
    for name, held_out, ts in (("a", "1" * 64, 0.3), ("b", "1" * 64, 0.2), ("c", "2" * 64, 0.1)):
        judge(make_run(tmp_path / name), held_out, {"roll": {"arx": 0.4, "ts": ts}})
    make_run(tmp_path / "d")
    found = ranked([c for folder in find_runs([tmp_path]) for c in run_channels(folder)])
    assert [(Path(c.folder).name, c.rank) for c in found] == [("b", 1), ("a", 2), ("c", 1), ("d", None)]
    assert found[-1].verdict == "not judged"
    assert found[0].rmse == {"arx": 0.4, "ts": 0.2}


def test_outputs_of_one_channel_are_listed_apart(tmp_path: Path) -> None:
    judge(make_run(tmp_path / "a"), "1", {"xy/vx": {"arx": 1.0}, "xy/vy": {"arx": 2.0, "ts": None}})
    assert [(c.channel, dict(c.rmse)) for c in run_channels(tmp_path / "a")] == [
        ("xy/vx", {"arx": 1.0}),
        ("xy/vy", {"arx": 2.0}),
    ]


def test_hidden_and_ingested_folders_are_not_entered(tmp_path: Path) -> None:
    make_run(tmp_path / "runs/one")
    make_run(tmp_path / ".old/one")
    make_run(tmp_path / "data/one")
    (tmp_path / "data/flysid-data.json").write_text("{}")
    make_run(tmp_path / "runs/one/report/inner")
    assert find_runs([tmp_path, tmp_path / "runs"]) == [tmp_path / "runs/one"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"channels": {"roll": {}}, "about": {}}', "[" * 100_000])
def test_a_damaged_report_is_named(tmp_path: Path, text: str) -> None:
    folder = judge(make_run(tmp_path / "a"), "1", {"roll": {"arx": 1.0}})
    (folder / "report/report.json").write_text(text)
    with pytest.raises(StoreError, match="damaged") as caught:
        run_channels(folder)
    assert caught.value.path == str(folder / "report/report.json")


def test_a_folder_without_runs_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no run found") as caught:
        find_runs([tmp_path])
    assert "flysid fit" in caught.value.hint
    with pytest.raises(UsageError, match="no such folder"):
        find_runs([tmp_path / "absent"])


def listed(root: Path) -> list[tuple[str, str, str]]:
    return [(Path(c.folder).name, c.channel, c.verdict) for c in list_runs([root])[0]]


def test_the_index_answers_until_a_run_changes_or_vanishes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge(make_run(tmp_path / "a"), "1" * 64, {"roll": {"arx": 0.4, "ts": 0.3}})
    make_run(tmp_path / "b")
    first = list_runs([tmp_path])[0]
    assert (tmp_path / INDEX).is_file()
    opened: list[str] = []

    def opening(folder: Path) -> list[RunChannel]:
        opened.append(folder.name)
        return run_channels(folder)

    monkeypatch.setattr(runindex, "run_channels", opening)
    assert list_runs([tmp_path])[0] == first
    assert opened == []
    judge(tmp_path / "b", "1" * 64, {"roll": {"arx": 0.2}})
    assert listed(tmp_path) == [("a", "roll", "same"), ("b", "roll", "same")]
    assert opened == ["b"]
    shutil.rmtree(tmp_path / "a")
    assert listed(tmp_path) == [("b", "roll", "same")]
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == [INDEX]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"not parquet at all", b"\x00" * 5000])
def test_a_damaged_index_is_made_anew(tmp_path: Path, content: bytes) -> None:
    judge(make_run(tmp_path / "a"), "1" * 64, {"roll": {"arx": 0.4, "ts": 0.3}})
    before = list_runs([tmp_path])
    (tmp_path / INDEX).write_bytes(content)
    assert list_runs([tmp_path]) == before
    assert (tmp_path / INDEX).read_bytes() != content


def test_damaged_runs_are_named_every_time_and_never_indexed(tmp_path: Path) -> None:
    judge(make_run(tmp_path / "a"), "1" * 64, {"roll": {"arx": 0.4}})
    (make_run(tmp_path / "b") / "run.json").write_text("{")
    for _ in range(2):
        channels, damaged = list_runs([tmp_path])
        assert [Path(c.folder).name for c in channels] == ["a"]
        assert len(damaged) == 1


def test_a_folder_that_cannot_be_written_is_listed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:  # noqa: ARG001
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(runindex, "write_atomically", full)
    judge(make_run(tmp_path / "a"), "1" * 64, {"roll": {"arx": 0.4}})
    assert listed(tmp_path) == [("a", "roll", "same")]
    assert not (tmp_path / INDEX).exists()
