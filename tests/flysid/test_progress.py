"""What long work tells while it runs, and what a keyboard's interrupt leaves of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from flysid.cli import display
from flysid.cli.display import Display, State, drawn
from flysid.ingest.lake.workers import Bounds, run_bounded
from flysid.progress import Step, listening, part, tell
from flysid.validate.runs.fitplan import FitPlan
from tests.command import ROOT, call

CHANNELS = ("lateral", "vertical")


def test_parts_place_shares_and_name_what_steps_are_about() -> None:
    heard: list[Step] = []
    with listening(heard.append), part(0.5, 1.0, channel="roll"), part(0.0, 0.5, model="ts"):
        tell("2 rules", share=0.5, validation=0.25)
        tell("choosing", model="oe")
    assert heard == [
        Step("2 rules", channel="roll", model="ts", share=0.625, validation=0.25),
        Step("choosing", channel="roll", model="oe"),
    ]
    tell("nobody listens")


def test_the_time_left_falls_while_a_step_takes_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    state = State(started=now[0])
    now[0] += 10.0
    state.hear(Step("choosing", share=0.4))
    said = [state.left]
    for _ in range(2):
        now[0] += 10.0
        state.hear(Step("choosing", share=0.4))
        said.append(state.left)
    assert said == ["about 15 s left", "about 5 s left", ""]
    state.hear(Step("choosing", share=0.5))
    assert state.left == "about 30 s left"


def test_less_than_a_third_of_the_work_tells_no_time_left() -> None:
    state = State(started=time.monotonic() - 10.0)
    state.hear(Step("choosing", share=0.3))
    assert state.left == ""
    state.hear(Step("choosing", share=0.4))
    assert state.left


def told_from_a_worker(number: int) -> int:
    tell("half", log=str(number), share=0.5)
    return number


def test_what_a_task_tells_in_a_worker_is_heard_here() -> None:
    heard: list[Step] = []
    with listening(heard.append):
        done = [outcome for _, outcome in run_bounded(told_from_a_worker, [1, 2], 2, Bounds(None, None))]
    assert sorted(map(str, done)) == ["1", "2"]
    assert sorted(step.log for step in heard) == ["1", "2"]


def test_a_plan_covers_the_work_once_in_order() -> None:
    plan = FitPlan(("arx", "ts"), folds=2)
    heard: list[Step] = []
    with listening(heard.append):
        for block in (plan.choice(), *(plan.model(m, fold) for fold in range(3) for m in plan.labels)):
            with block:
                tell("begun", share=0.0)
                tell("done", share=1.0)
    shares = [step.share for step in heard]
    assert shares[0] == 0.0
    assert shares[-1] == pytest.approx(1.0)
    assert shares[1:-1:2] == pytest.approx(shares[2::2])


def test_a_pipe_hears_at_least_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert display.SILENCE_S == 10.0
    monkeypatch.setattr(display, "SILENCE_S", 0.2)
    began = time.monotonic()
    said = ""
    with Display().shown():
        tell("fitting", channel="roll", model="ts", share=0.25)
        while said.count("\n") < 4 and time.monotonic() < began + 15.0:
            time.sleep(0.05)
            said += capsys.readouterr().err
    lasted = time.monotonic() - began
    assert lasted < 10.0
    lines = (said + capsys.readouterr().err).splitlines()
    assert 4 <= len(lines) <= 2 + 2 * lasted / display.SILENCE_S
    assert all("25 %  roll: ts: fitting" in line for line in lines)


def test_results_are_said_at_once_and_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    for shown, lines in ((Display(), 1), (Display(quiet=True), 0), (Display(verbose=True), 2)):
        with shown.shown():
            tell("fitting", channel="roll", model="oe")
            tell("best linear model", channel="roll", model="oe", validation=0.5, result=object())
        said = capsys.readouterr().err.splitlines()
        assert len(said) == lines
        assert all("oe" in line for line in said)


def test_the_table_has_a_column_for_every_model_and_marks_the_best() -> None:
    state = State(started=time.monotonic() - 10.0)
    for model, error in (("arx", 0.5), ("oe", 0.25)):
        state.hear(Step("free run", channel="roll", model=model, validation=error, share=0.5))
    state.hear(Step("waiting", channel="pitch"))
    from rich.console import Console

    console = Console(width=100, record=True)
    with console.capture() as captured:
        console.print(drawn(state))
    lines = captured.get().splitlines()
    assert lines[0].split() == ["CHANNEL", "arx", "oe", "NOW"]
    assert lines[1].split() == ["roll", "0.5", "0.25", "oe:", "free", "run"]
    assert lines[2].split() == ["pitch", "waiting"]
    assert "50 % done" in lines[-1]
    assert "left" in lines[-1]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    assert (
        call("synth", "-o", "logs", "--duration", "20", "--format", "mcap", "-q", cwd=folder).returncode == 0
    )
    assert call("ingest", "logs", "-o", "data", "-q", cwd=folder).returncode == 0
    return folder / "data"


def steps(process: subprocess.Popen[str]) -> Iterator[dict[str, Any]]:
    """The steps that a process tells, as they come."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("{"):
            yield json.loads(line)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupt_leaves_a_usable_run(data: Path, tmp_path: Path, jobs: str) -> None:
    words: list[str | Path] = [
        "fit",
        data,
        "-r",
        "ardrone-synthetic",
        "-o",
        "run",
        "-j",
        jobs,
        "--progress",
        "json",
    ]
    words += [word for name in CHANNELS for word in ("-c", name)]
    seen: list[dict[str, Any]] = []
    with started(tmp_path, *words) as process:
        for step in steps(process):
            seen.append(step)
            if step["model"] == "ts" and step["stage"] == "fitting":
                os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers too
                break
        try:
            out, rest = process.communicate(timeout=20)
        except (
            subprocess.TimeoutExpired
        ):  # it fell into a callback of Python's, which loses it; one presses again
            os.killpg(process.pid, signal.SIGINT)
            out, rest = process.communicate(timeout=20)
    assert process.returncode == 130, rest
    assert out == "run\n"
    assert "interrupted: run holds what was finished" in rest
    assert "Traceback" not in rest
    assert all({"channel", "model", "stage", "share", "seconds"} <= step.keys() for step in seen)
    assert next(s for s in seen if s["stage"] == "best linear model")["validation"] < 1.0
    shares = [step["share"] for step in seen]
    assert shares == sorted(shares)
    assert shares[-1] < 1.0
    run = json.loads((tmp_path / "run/run.json").read_text())
    assert run["interrupted"]
    channel = next(c for c in run["channels"] if c["name"] == seen[-1]["channel"])
    assert channel["models"].keys() == {"arx", "line", "mean"}
    assert channel["failed"] == {"ts": "the fit was interrupted"}
    kept = {f for c in run["channels"] for f in c["models"].values()}
    assert {str(p.relative_to(tmp_path / "run")) for p in (tmp_path / "run").glob("*/**/*.json")} == kept
    judged = call("validate", "run", "-q", cwd=tmp_path)
    assert judged.returncode == 0, judged.stderr
    assert not list(tmp_path.glob(".*"))


@contextmanager
def started(folder: Path, *words: str | Path) -> Iterator[subprocess.Popen[str]]:
    """A process of its own group, as a shell starts it, with models that are quick but for the last.

    Neither it nor its workers outlive the block, nor do its pipes: a later test would be blamed for them.
    """
    with subprocess.Popen(
        [sys.executable, "-m", "tests.slow_flysid", *map(str, words)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):  # all have ended
                os.killpg(process.pid, signal.SIGKILL)


def test_an_interrupt_before_anything_is_fitted_leaves_nothing(data: Path, tmp_path: Path) -> None:
    words: list[str | Path] = ["fit", data, "-r", "ardrone-synthetic", "-o", "run", "--progress", "json"]
    with started(tmp_path, *words) as process:
        next(steps(process))
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "safe to run the same command again" in rest
    assert not list(tmp_path.iterdir())
