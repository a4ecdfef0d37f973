"""The command line as a user meets it: streams, exit codes, errors that say what to try."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import flysid
from tests.command import ROOT, call, shell

VERBS = (
    "compare",
    "demo",
    "doctor",
    "fit",
    "ingest",
    "ls",
    "reproduce",
    "runs",
    "scrub",
    "show",
    "synth",
    "tf",
    "validate",
)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_that_names_its_options(verb: str, tmp_path: Path) -> None:
    done = call(verb, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "Usage: flysid" in done.stdout
    assert "--help" in done.stdout


def test_version(tmp_path: Path) -> None:
    assert flysid.__version__ in shell("--version", cwd=tmp_path).stdout


def test_a_process_ends_with_the_code_and_writes_to_the_right_streams(tmp_path: Path) -> None:
    helped = shell("fit", "--help", cwd=tmp_path)
    assert helped.stdout.split() == call("fit", "--help", cwd=tmp_path).stdout.split()
    assert (helped.returncode, helped.stderr) == (0, "")
    refused = shell("ingest", "absent.tlog", "-o", "data", cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == call("ingest", "absent.tlog", "-o", "data", cwd=tmp_path).stderr


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["ingst"], 2, "Did you mean 'ingest'"),
        (["ingest", "absent.tlog", "-o", "data"], 2, "absent.tlog"),
        (["ingest", "notes.txt", "-o", "data"], 1, "notes.txt: one line of text"),
        (["ingest", "empty.tlog", "-o", "data"], 1, "empty"),
        (["ingest", "folder", "-o", "data"], 2, "no flight log"),
        (["fit", "folder", "--recipe", "ardrone-synthetic", "-o", "run"], 2, "no flight log"),
        (["fit", "absent", "--recipe", "ardrone-synthetic", "-o", "run"], 2, "absent"),
        (["validate", "absent"], 2, "no such run"),
        (["validate", "folder"], 2, "not a run"),
        (["reproduce", "moon-landing"], 2, "ardrone-ts"),
        (["compare", "absent", "folder"], 2, "no such run"),
        (["runs", "absent"], 2, "no such folder"),
        (["runs", "folder"], 2, "no run found"),
        (["synth", "-o", "logs", "--plan", "aerobatics"], 2, "aerobatics"),
    ],
)
def test_a_mistake_is_one_clear_message_and_leaves_nothing(
    args: list[str], code: int, words: str, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("I flew on Tuesday. " * 50)
    (tmp_path / "empty.tlog").touch()
    (tmp_path / "folder").mkdir()
    before = {p.name for p in tmp_path.iterdir()}
    done = call(*args, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    left = {p.name for p in tmp_path.iterdir()} - before
    assert not left - {"data"}
    assert not list((tmp_path / "data").glob("flights/*"))


@pytest.mark.usefixtures("arx_alone")
def test_from_synth_to_verdict_on_one_channel(tmp_path: Path) -> None:
    made = call("synth", "-o", "logs", "--duration", "20", "--format", "mcap", "-q", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert len(made.stdout.splitlines()) == 6
    assert call("synth", "-o", "logs", "--duration", "20", "--format", "mcap", cwd=tmp_path).returncode == 2
    assert call("ingest", "logs", "-o", "data", cwd=tmp_path).returncode == 0
    fitted = call(
        *(
            "fit",
            "data",
            "-r",
            "ardrone-synthetic",
            "-c",
            "lateral",
            "--rules",
            "2",
            "--effort",
            "quick",
            "--no-rotate",
            "-o",
            "run",
        ),
        cwd=tmp_path,
    )
    assert (fitted.returncode, fitted.stdout) == (0, "run\n"), fitted.stderr
    again = call("fit", "data", "-r", "ardrone-synthetic", "-o", "run", cwd=tmp_path)
    assert again.returncode == 2
    assert "--force" in again.stderr
    for verb in (("validate", "run"), ("compare", "run", "run", "-o", "both")):
        misspelt = call(*verb, "--fail-if", "free_run.chnage_pct > 5", cwd=tmp_path)
        assert (misspelt.returncode, misspelt.stdout) == (2, "")
        assert "did you mean 'free_run.change_pct'" in misspelt.stderr
        assert "writing" not in misspelt.stderr
    assert not (tmp_path / "run/report").exists()
    assert not (tmp_path / "both").exists()
    judged = call(
        "validate", "run", "--json", "-q", "--fail-if", "free_run.models.arx.fit_pct < 50", cwd=tmp_path
    )
    assert (judged.returncode, judged.stderr) == (0, "")
    free = json.loads(judged.stdout)["channels"]["lateral"]["free_run"]
    assert {"rmse", "fit_pct", "vaf_pct"} <= set(free["models"]["ts"])
    assert free["verdict"] in ("better", "worse", "same", "not enough data")
    assert (tmp_path / "run/report/report.html").is_file()
    assert call("validate", "run", "-o", "data", cwd=tmp_path).returncode == 2
    failed = call("validate", "run", "--fail-if", "free_run.models.arx.fit_pct > 50", cwd=tmp_path)
    assert failed.returncode == 4  # its own report is made anew
    shutil.rmtree(tmp_path / "run/report")
    markdown = call(*("validate", "run", "-o", "r3", "--markdown", "--figures", "svg", "-q"), cwd=tmp_path)
    assert markdown.returncode == 0, markdown.stderr
    assert markdown.stdout.startswith("- **v\\_y**: ")
    assert {p.name for p in (tmp_path / "r3").iterdir()} == {"report.html", "report.json", "channel-1-1.svg"}
    [listed] = json.loads(call("runs", "run", "--json", cwd=tmp_path).stdout)["runs"]
    assert listed["rank"] == 1  # the verdict is found, although its page lies elsewhere
    both = call("validate", "run", "-o", "r4", "--csv", "--json", cwd=tmp_path)
    assert (both.returncode, both.stdout) == (2, "")
    assert "json and csv" in both.stderr
    compared = call("compare", "run", "run", "--csv", "-q", "-o", "both", cwd=tmp_path)
    assert (compared.returncode, compared.stderr) == (0, "")
    assert ",b:ts," in compared.stdout
    assert (tmp_path / "both/report.html").is_file()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/run.json").write_text("{")
    listed = call("runs", cwd=tmp_path)
    assert listed.returncode == 3
    assert "broken" in listed.stderr
    assert [line.split()[:2] for line in listed.stdout.splitlines()[1:]] == [["ardrone-synthetic", "lateral"]]
    assert json.loads(call("runs", "run", "--json", cwd=tmp_path).stdout)["runs"][0]["rank"] == 1
    unexcited = call("fit", "data", "-r", "ardrone-synthetic", "-c", "yaw", "-o", "run2", cwd=tmp_path)
    assert unexcited.returncode == 2
    assert not (tmp_path / "run2").exists()


@pytest.fixture(scope="module")
def piloted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flights of 5 s, ingested."""
    root = tmp_path_factory.mktemp("piloted")
    call("synth", "-o", "logs", "--duration", "5", "--plan", "pilot", "-q", cwd=root)
    call("ingest", "logs", "-o", "data", "-q", cwd=root)
    return root / "data"


def test_an_unknown_key_in_a_recipe_names_the_nearest(piloted: Path, tmp_path: Path) -> None:
    recipe = (ROOT / "ingest/align/recipes/ardrone-synthetic.toml").read_text()
    (tmp_path / "mine.toml").write_text(recipe.replace("inputs =", "inpts =", 1))
    done = call("fit", piloted, "-r", "mine.toml", "-o", "run", cwd=tmp_path)
    assert done.returncode == 2
    assert "inpts" in done.stderr
    assert "inputs" in done.stderr


@pytest.mark.parametrize("stream", ["ATTITUDE_TARGT", "NOTHING"])
def test_a_recipe_naming_a_stream_that_is_not_there(stream: str, piloted: Path, tmp_path: Path) -> None:
    recipe = (ROOT / "ingest/align/recipes/ardrone-synthetic.toml").read_text()
    for name in ("ATTITUDE_TARGET", "/ardrone/command", "SET_POSITION_TARGET_LOCAL_NED"):
        recipe = recipe.replace(f'"{name}"', f'"{stream}"')
    (tmp_path / "mine.toml").write_text(recipe)
    done = call("fit", piloted, "-r", "mine.toml", "-o", "run", cwd=tmp_path)
    assert done.returncode == 2
    assert stream in done.stderr
    assert "these fit: ardrone-synthetic (" in done.stderr
    assert not (tmp_path / "run").exists()
