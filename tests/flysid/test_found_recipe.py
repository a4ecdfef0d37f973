"""`step` and `tf` of a log alone: the recipe that they find, and that both logs of a comparison share."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from flysid.errors import UsageError
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.recipe_choice import choose_recipe, commands_of
from tests.command import call

LOGS = Path(__file__).parents[2] / "sample_logs"
ONE = "01-steps-seed2.tlog"
OTHER = "copy.tlog"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    shutil.copy(LOGS / ONE, tmp_path)
    shutil.copy(LOGS / ONE, tmp_path / OTHER)
    return tmp_path


def test_a_step_of_a_log_alone_says_which_recipe_it_took(place: Path) -> None:
    done = call("step", ONE, cwd=place)
    assert done.returncode == 0, done.stderr
    assert "recipe ardupilot-attitude; ardrone-synthetic, ardupilot-rate" in done.stderr
    assert "--recipe chooses" in done.stderr
    assert [line.split(",")[0] for line in done.stdout.splitlines() if line[0] != " "] == ["pitch", "roll"]


def test_two_logs_are_compared_by_one_recipe(place: Path) -> None:
    done = call("step", ONE, "--against", OTHER, "-c", "roll", "--json", "--plot", "both.svg", cwd=place)
    assert done.returncode == 0, done.stderr
    body = json.loads(done.stdout)
    assert body["recipe"] == "ardupilot-attitude"
    assert [step["of"] for step in body["steps"]] == [ONE, OTHER]
    assert done.stderr.count("recipe ardupilot-attitude") == 1
    assert (place / "both.svg").is_file()


def test_logs_of_one_name_are_told_apart_by_their_folders(place: Path) -> None:
    for folder, log in (("before", ONE), ("after", OTHER)):
        (place / folder).mkdir()
        shutil.copy(place / log, place / folder / "flight.tlog")
    done = call(
        "step", "before/flight.tlog", "--against", "after/flight.tlog", "-c", "roll", "--json", cwd=place
    )
    assert done.returncode == 0, done.stderr
    assert [s["of"] for s in json.loads(done.stdout)["steps"]] == ["before/flight.tlog", "after/flight.tlog"]


def test_the_channel_that_is_asked_for_chooses_among_recipes(place: Path) -> None:
    done = call("tf", ONE, "-c", "longitudinal", "--json", "--poles", "1", "--zeros", "0", cwd=place)
    assert json.loads(done.stdout)["recipe"] == "ardrone-synthetic", done.stderr
    assert "recipe ardrone-synthetic" in done.stderr


def test_a_channel_that_no_fitting_recipe_gives_is_refused_with_those_that_fit(place: Path) -> None:
    done = call("step", ONE, "-c", "roll_motors", cwd=place)
    assert done.returncode == 2
    assert "error: no recipe gives roll_motors from these flights" in done.stderr
    assert "these fit: ardrone-synthetic (longitudinal, lateral, vertical); ardupilot-attitude" in done.stderr


def test_a_table_of_which_no_recipe_speaks_is_refused_with_its_fields(tmp_path: Path) -> None:
    rows = "".join(f"{k / 10},{k % 7},{k % 5}\n" for k in range(100))
    (tmp_path / "a.csv").write_text(f"t,u,y\n{rows}")
    done = call("step", "a.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert "error: neither a recipe nor fields are given" in done.stderr
    assert "fields: table.t, table.u, table.y" in done.stderr


class OfRecipes:
    """Flights that some recipes fit."""

    address = ""
    folder = Path("data")

    def __init__(self, *names: str) -> None:
        self._names = names

    def recipes(self) -> dict[str, tuple[str, ...]]:
        return {name: tuple(load_recipe(name).channels) for name in self._names}


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("betaflight-rate", "rotorcraft-motors"), "betaflight-rate"),
        (("px4-attitude", "px4-effort", "px4-rates", "px4-velocity"), "px4-attitude"),
        (("ardupilot-rate", "ardupilot-velocity"), "ardupilot-rate"),
        (("rotorcraft-rpm",), "rotorcraft-rpm"),
    ],
)
def test_the_recipe_is_that_of_commands_and_responses(names: tuple[str, ...], chosen: str) -> None:
    choice = choose_recipe(OfRecipes(*names))  # type: ignore[arg-type]
    assert choice.name == chosen
    assert set(choice.others) == set(names) - {chosen}


def test_recipes_without_commands_are_not_chosen_among() -> None:
    with pytest.raises(UsageError, match="2 recipes fit") as told:
        choose_recipe(OfRecipes("rotorcraft-motors", "rotorcraft-rpm"))  # type: ignore[arg-type]
    assert "--recipe rotorcraft-motors (motors_roll, " in told.value.hint


def test_only_commands_are_looked_at() -> None:
    assert commands_of(load_recipe("betaflight-rate")) == ("roll_rate", "pitch_rate", "yaw_rate")
    every = tuple(load_recipe("rotorcraft-motors").channels)
    assert commands_of(load_recipe("rotorcraft-motors")) == every
