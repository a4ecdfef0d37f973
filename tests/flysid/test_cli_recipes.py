"""`flysid recipes`: every shipped recipe is listed and explained; which fit a log."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.errors import RecipeError, UsageError
from flysid.ingest.align.recipe import load_recipe, shipped_recipes
from tests.samplelogs import csv, dataflash


def recipes(*arguments: str | Path) -> Result:
    return CliRunner().invoke(root, ["recipes", *map(str, arguments)])


def test_every_recipe_is_listed() -> None:
    lines = recipes().stdout.splitlines()
    assert tuple(line.partition(":")[0] for line in lines if line[0] != " ") == shipped_recipes()
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize("name", shipped_recipes())
def test_every_recipe_is_explained_in_full(name: str) -> None:
    text = recipes(name).stdout
    recipe = load_recipe(name)
    for channel in recipe.channels:
        assert f"channel {channel}: " in text
    for signal in recipe.signals.values():
        for source in signal.sources:
            assert f"{source.stream}.{source.fields[0]}" in text
    assert tomllib.loads(recipes(name, "--toml").stdout)["name"] == recipe.name


def test_only_what_fits_a_log_is_listed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(csv.build())
    done = recipes("--for", tmp_path / "a.csv")
    assert done.stdout == ""
    assert "no recipe fits" in done.stderr
    (tmp_path / "a.BIN").write_bytes(dataflash.build())
    for line in recipes("--for", tmp_path / "a.BIN").stdout.splitlines()[1:]:
        assert line.startswith("ardupilot")


def test_a_log_in_the_place_of_a_name_is_a_log(tmp_path: Path) -> None:
    log = Path(__file__).resolve().parents[2] / "sample_logs" / "01-multisine-seed1.tlog"
    assert recipes(log).stdout == recipes("--for", log).stdout != ""
    own = tmp_path / "own.toml"
    own.write_text(recipes("px4-rates", "--toml").stdout)
    assert "channel roll_rate: " in recipes(own).stdout


def test_wrong_orders_are_refused() -> None:
    assert isinstance(recipes("px4-rats").exception, RecipeError)
    assert isinstance(recipes("--toml").exception, UsageError)
    assert isinstance(recipes("px4-rates", "--for", "x").exception, UsageError)
