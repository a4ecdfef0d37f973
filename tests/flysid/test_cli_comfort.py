"""What makes the command line easy: grouped verbs, examples that parse, settings in a file, completion."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from flysid.cli import complete, root
from flysid.cli.verbs import FLEET_VERBS, VERBS
from flysid.errors import FlysidError, RecipeError, UsageError
from flysid.validate.runs.run import FitSettings
from flysid.validate.runs.wanted_models import estimators
from tests.command import call

EXAMPLES = {verb: row.examples for verb, row in VERBS.items()} | {
    f"fleet {verb}": row.examples for verb, row in FLEET_VERBS.items() if row.examples
}


def context_of(*words: str) -> click.Context:
    """What click makes of a command line, without doing it."""
    outer = root.make_context("flysid", list(words), auto_envvar_prefix="FLYSID")
    root.invoke_without_command = False
    verb, command, rest = root.resolve_command(outer, list(words))
    assert command is not None
    return command.make_context(verb, rest, parent=outer)


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_every_example_is_understood(line: str) -> None:
    words = shlex.split(line)
    assert words[0] == "flysid"
    context_of(*words[1:])


def test_every_example_stands_in_the_help_of_its_verb() -> None:
    for verb, lines in EXAMPLES.items():
        assert len(lines) == 2
        assert all(line.startswith(f"flysid {verb}") for line in lines)
        shown = CliRunner().invoke(root, [verb, "--help"], terminal_width=200).stdout
        assert all(f"  {line}\n" in shown for line in lines)


def test_the_help_lists_every_verb_once_by_step() -> None:
    shown = CliRunner().invoke(root, ["--help"]).stdout
    first = [line.split()[0] for line in shown.splitlines() if line.startswith("  ") and line.split()]
    assert sorted(word for word in first if word in VERBS) == sorted(VERBS)
    assert shown.index("Look:") < shown.index("Prepare:") < shown.index("Fit:") < shown.index("Judge:")


def settings(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "flysid.toml").write_text(text, "utf-8")
    monkeypatch.chdir(folder)


def holdout(folder: Path, *words: str, env: dict[str, str] | None = None) -> Any:
    """The share that a fit would hold out."""
    return option("holdout", folder, *words, env=env).share


def option(name: str, folder: Path, *words: str, env: dict[str, str] | None = None) -> Any:
    """An option as a fit would get it."""
    found: list[Any] = []
    command = root.get_command(click.Context(root), "fit")
    assert command is not None
    known = command.callback
    command.callback = lambda **options: found.append(options[name])
    try:
        CliRunner().invoke(root, ["fit", str(folder), "-o", "run", *words], env=env, catch_exceptions=False)
    finally:
        command.callback = known
    return found[0]


def test_the_line_wins_over_the_environment_over_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert holdout(tmp_path) == 0.3
    settings(tmp_path, "[fit]\nholdout = 0.25\n", monkeypatch)
    assert holdout(tmp_path) == 0.25
    assert holdout(tmp_path, env={"FLYSID_FIT_HOLDOUT": "0.4"}) == 0.4
    assert holdout(tmp_path, "--holdout", "0.5", env={"FLYSID_FIT_HOLDOUT": "0.4"}) == 0.5


def test_options_that_may_be_repeated_take_a_word_or_a_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert option("channels", tmp_path, env={"FLYSID_FIT_CHANNEL": "roll pitch"}) == ("roll", "pitch")
    settings(tmp_path, '[fit]\nchannel = "roll"\n', monkeypatch)
    assert option("channels", tmp_path) == ("roll",)
    settings(tmp_path, '[fit]\nchannel = ["roll", "pitch"]\n', monkeypatch)
    assert option("channels", tmp_path) == ("roll", "pitch")


def test_flights_and_their_parts_are_held_out_by_name(tmp_path: Path) -> None:
    words = ("--holdout", "0042", "--holdout", "7@1:00..2:00")
    assert option("holdout", tmp_path, *words).parts == ("0042", "7@1:00..2:00")
    for wrong in (("--holdout", "0.9"), ("--holdout", "0.3", "--holdout", "0042")):
        assert CliRunner().invoke(root, ["fit", str(tmp_path), "-o", "run", *wrong]).exit_code == 2


def test_a_variable_that_names_no_option_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="FLYSID_FIT_HOLDOT is set") as caught:
        holdout(tmp_path, env={"FLYSID_FIT_HOLDOT": "0.4"})
    assert caught.value.hint == "did you mean 'holdout'?"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("[fit]\nholdot = 0.25\n", "did you mean 'holdout'?"),
        ("[fitt]\nholdout = 0.25\n", "did you mean 'fit'?"),
        ("[fit\n", ""),
    ],
)
def test_an_unknown_setting_names_the_nearest(
    text: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings(tmp_path, text, monkeypatch)
    with pytest.raises(UsageError) as caught:
        holdout(tmp_path)
    assert caught.value.hint == hint
    assert "flysid.toml" in caught.value.where


def test_the_labels_that_are_offered_are_those_that_can_be_fitted() -> None:
    with pytest.raises(FlysidError) as caught:
        estimators(FitSettings(models=("?",)))
    assert sorted(caught.value.hint.removeprefix("one of ").split(", ")) == offered("models", "")


def offered(name: str, incomplete: str, **params: str) -> list[str]:
    context = click.Context(click.Command("fit"))
    context.params = dict(params)
    found: list[str] = getattr(complete, name)(context, click.Option(["--x"]), incomplete)
    return found


def test_tab_offers_recipes_models_flights_and_channels(tmp_path: Path) -> None:
    assert offered("recipes", "px4-r") == ["px4-rates"]
    assert offered("models", "arx,ts_") == ["arx,ts_lags", "arx,ts_ss"]
    assert offered("channels", "", recipe="ardupilot-attitude") == ["roll", "pitch"]
    assert offered("channels", "", recipe="no-such-recipe") == []
    (tmp_path / "flights/hover-1").mkdir(parents=True)
    (tmp_path / "flights/.incoming-x").mkdir()
    assert offered("flights", "h", data=str(tmp_path)) == ["hover-1"]
    for words in (f"ls {tmp_path} --flight h", f"show {tmp_path} h"):
        line = {"COMP_WORDS": f"flysid {words}", "COMP_CWORD": str(len(words.split()))}
        told = CliRunner().invoke(root, prog_name="flysid", env=line | {"_FLYSID_COMPLETE": "bash_complete"})
        assert told.output == "plain,hover-1\n"


def test_a_recipe_that_is_none_is_named_before_a_log_is_read(tmp_path: Path) -> None:
    log = Path(__file__).parents[2] / "sample_logs" / "01-steps-seed2.tlog"
    done = call("fit", log, "-r", "px4-rate", "-o", "run", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: no recipe 'px4-rate'")


def test_a_recipe_that_does_not_fit_names_those_that_do(tmp_path: Path) -> None:
    assert (
        call("synth", "-o", "logs", "--duration", "20", "--format", "mcap", "-q", cwd=tmp_path).returncode
        == 0
    )
    assert call("ingest", "logs", "-o", "data", "-q", cwd=tmp_path).returncode == 0
    with pytest.raises(RecipeError, match="no flight has the streams of recipe 'px4-rates'") as caught:
        CliRunner().invoke(
            root,
            ["fit", str(tmp_path / "data"), "-r", "px4-rates", "-o", str(tmp_path / "run")],
            catch_exceptions=False,
        )
    assert "ardrone-synthetic (longitudinal, lateral, vertical" in caught.value.hint
