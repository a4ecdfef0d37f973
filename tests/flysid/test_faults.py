"""Killed, out of room, out of handles: nothing partial shows, and the same command goes on."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.files import exchange, put_in_place
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.validate.runs import fitting
from flysid.validate.runs.diskparts import FilePart
from flysid.validate.runs.fitting import MemoryJob, _fit, fit_run
from flysid.validate.runs.judge import judge_run
from flysid.validate.runs.run import FitSettings
from soak import Outcome
from tests.contest import fit_beside_arx
from tests.fault_trials import (
    Write,
    full_disks,
    killed_ingests,
    limited,
    read_only_disks,
    small_data,
    visible,
    write_logs,
    write_newer_logs,
)


@pytest.mark.parametrize("write", [write_logs, write_newer_logs])
def test_kill_during_ingest_then_the_same_command_again(tmp_path: Path, write: Write) -> None:
    outcome = killed_ingests(tmp_path, 2, write=write)
    assert outcome.failures == []
    assert outcome.trials == 2


@pytest.mark.parametrize(
    ("trials", "refused"),
    [
        (lambda folder: full_disks(folder, ["96k"]), 1),
        (read_only_disks, 1),
        (lambda folder: limited(folder, ["-f 8"]), 1),
        (lambda folder: limited(folder, ["-f 8"], write=write_newer_logs), 1),
    ],
    ids=["full disk", "read-only disk", "ulimit", "ulimit, newer formats"],
)
def test_no_room_is_named_and_nothing_partial_shows(
    tmp_path: Path, trials: Callable[[Path], Outcome], refused: int
) -> None:
    try:
        outcome = trials(tmp_path)
    except PermissionError:
        pytest.skip("this user may not mount a small disk")
    assert outcome.failures == []
    assert outcome.raised >= refused


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Four short flights, to be read only."""
    return open_lake(small_data(tmp_path_factory.mktemp("small")))


@pytest.mark.usefixtures("arx_alone")
def test_one_and_two_workers_fit_and_judge_alike(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fitting, "_run", fit_beside_arx)
    settings = FitSettings(
        channels=("vertical", "lateral"), models=("ts",), rules=1, effort="quick", rotate=False
    )
    found = []
    for jobs in (1, 2):
        run = fit_run(lake, "ardrone-synthetic", tmp_path / f"run{jobs}", settings, jobs=jobs)
        document = {k: v for k, v in judge_run(run).document.items() if k != "fit_seconds"}
        found.append((visible(run.folder), document))
    assert found[0] == found[1]


class Deadly:
    """Ends the process that it is brought to."""

    def __reduce__(self) -> tuple[object, ...]:
        return os._exit, (9,)


def test_a_fit_whose_process_dies_costs_that_channel_only() -> None:
    short = Dataset.from_arrays([np.ones((4, 1))], [np.ones((4, 1))], 0.1)
    jobs = [
        MemoryJob(replace(short, name=name), Path(), FitSettings(), doubts=cast("tuple[Any, ...]", more))
        for name, more in (("short", ()), ("deadly", (Deadly(),)))
    ]
    reasons, _ = _fit(jobs, 2)
    assert "ended with code 9" in str(reasons["deadly"])
    assert "ended with" not in str(reasons["short"])


@dataclass(frozen=True)
class Greedy:
    """ARX, which asks for more memory than there is where the channel has one of these names."""

    channels: tuple[str, ...]

    def fit(self, train: Any, validation: Dataset | None = None) -> Fitted:
        del validation
        if (train.file if isinstance(train, FilePart) else train).name in self.channels:
            raise MemoryError("Unable to allocate 9 TiB")
        return ARX(2, 2, 1).fit(train)


@pytest.mark.parametrize("on_disk", [False, True])
@pytest.mark.parametrize("models", ["all", "one"])
def test_no_memory_costs_a_model_or_a_channel_only(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, models: str, on_disk: bool
) -> None:
    greedy = Greedy(("vertical",))
    modest = Greedy(())
    known: dict[str, Any] = {"arx": greedy if models == "all" else modest, "iv": greedy}
    for name in ("fitting.linear_rivals", "fitting.estimators", "fitdisk.streaming_estimators"):
        monkeypatch.setattr(f"flysid.validate.runs.{name}", lambda *_: known)
    settings = FitSettings(channels=("vertical", "lateral"), memory_mb=0.0 if on_disk else 64.0)
    run = fit_run(lake, "ardrone-synthetic", tmp_path / "run", settings)
    fitted = {channel.name: channel for channel in run.channels}
    assert fitted["lateral"].failed == {}
    assert fitted["lateral"].on_disk == on_disk
    if models == "all":
        assert set(fitted) == {"lateral"}
        why = run.skipped["vertical"]
    else:
        assert run.skipped == {}
        assert set(fitted["vertical"].models) == {"arx"}
        why = fitted["vertical"].failed["iv"]
    assert "out of memory: Unable to allocate 9 TiB" in why
    assert "--memory" in why


def test_no_memory_to_align_costs_that_channel_only(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    align = type(lake).align

    def greedy(self: Lake, recipe: Any, channel: str) -> Any:
        if channel == "vertical":
            raise MemoryError
        return align(self, recipe, channel)

    monkeypatch.setattr(Lake, "align", greedy)
    monkeypatch.setattr("flysid.validate.runs.fitting.linear_rivals", lambda *_: {"arx": Greedy(())})
    monkeypatch.setattr("flysid.validate.runs.fitting.estimators", lambda *_: {"arx": Greedy(())})
    settings = FitSettings(channels=("vertical", "lateral"), rotate=False)
    run = fit_run(lake, "ardrone-synthetic", tmp_path / "run", settings)
    assert [channel.name for channel in run.channels] == ["lateral"]
    assert run.skipped["vertical"].startswith("out of memory. Try: ")


def test_a_folder_takes_the_place_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for has_exchange in (True, False):
        if not has_exchange:
            monkeypatch.setattr("flysid.files.exchange", lambda *_: False)
        for name in ("new", "old"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "is").write_text(name)
        put_in_place(tmp_path / "new", tmp_path / "old")
        assert (tmp_path / "old" / "is").read_text() == "new"
        assert [p.name for p in tmp_path.iterdir()] == ["old"]
        (tmp_path / "old" / "is").unlink()
        (tmp_path / "old").rmdir()


def test_what_cannot_be_exchanged_stays(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    assert not exchange(tmp_path / "here", tmp_path / "nowhere")
    assert (tmp_path / "here").is_dir()
