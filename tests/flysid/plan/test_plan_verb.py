"""`flysid plan`: of nothing, of flights, of a run; and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.dataset import Signal
from flysid.errors import FlysidError
from flysid.files import write_atomically
from flysid.ingest.align.quick import dataset_from
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.run import FitSettings, Run
from tests.contest import linear_side


def plan(*words: Any) -> tuple[int, str]:
    """Exit code and what was printed; errors come through."""
    done = CliRunner().invoke(root, ["plan", *map(str, words)], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return int(done.return_value or 0), done.stdout


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six flights of 20 s, ingested."""
    folder = tmp_path_factory.mktemp("flights")
    for recording in flights(Order(duration_s=20.0)):
        write_atomically(folder / f"{recording.name}.tlog", WRITERS["tlog"][1](recording))
    list(ingest_logs(find_logs([folder]), folder / "data"))
    return folder / "data"


@pytest.fixture(scope="module")
def run(data: Path) -> Run:
    settings = FitSettings(channels=("longitudinal",), models=("arx",), rotate=False)
    with linear_side("arx"):
        return fit_run(open_lake(data), "ardrone-synthetic", data.parent / "run", settings)


def test_of_nothing_but_axes_and_a_band(tmp_path: Path) -> None:
    code, shown = plan("--axis", "roll=5deg", "--axis", "pitch=5deg", "--band", 0.2, 4, "--seconds", 30,
                       "--to", "p", "-o", tmp_path / "plan")  # fmt: skip
    assert code == 0
    assert "All axes at once" in shown
    flown = dataset_from(tmp_path / "plan" / "plan.csv", "roll", "pitch")
    assert flown.inputs == (Signal("roll", "deg", flown.inputs[0].resolution),)
    assert len(flown) == 1500
    assert (tmp_path / "plan" / "recipe.toml").is_file()


def test_a_chirp_comes_with_an_autopilots_parameters(tmp_path: Path) -> None:
    code, shown = plan("--kind", "chirp", "--axis", "roll=0.1", "--band", 0.5, 10, "--ardupilot", "mixer",
                       "--px4-plane", "-o", tmp_path / "plan")  # fmt: skip
    assert code == 0
    assert "SYSTEMID" in shown
    names = {p.name for p in (tmp_path / "plan").iterdir()}
    assert names == {"plan.csv", "ardupilot-roll.param", "px4-plane.params"}


def test_of_flights_amplitudes_are_the_last_ones_within_limits(data: Path) -> None:
    code, shown = plan(data, "-r", "ardrone-synthetic", "-c", "longitudinal", "--band", 0.2, 1,
                       "--limit", "theta_in=1deg", "--json")  # fmt: skip
    assert code == 0
    document = json.loads(shown)
    (axis,) = document["plan"]["axes"]
    assert axis["name"] == "theta_in"
    assert 0.0 < axis["peak"] <= 1.0
    assert document["plan"]["files"] == ["plan.csv", "recipe.toml"]


def test_of_a_run_what_is_known_and_what_more_makes_of_it(run: Run, tmp_path: Path) -> None:
    code, shown = plan(run.folder, "--more", 2, "--aim", 1, "--rate", 20, "-o", tmp_path / "next")
    assert "longitudinal (arx): gain of theta_in to v_x" in shown
    assert "2 min more of the same make it" in shown
    assert "Begin with a third" in shown
    assert code == 0
    assert (tmp_path / "next" / "recipe.toml").read_text() == (run.folder / "recipe.toml").read_text()
    document = json.loads(plan(run.folder, "--rate", 20, "--json")[1])
    (known,) = document["known"]
    assert known["after_pct"] < known["known_pct"]
    assert known["seconds"] > 100.0


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ((), "no band"),
        (("--band", 0.2, 4), "no axis to fly"),
        (("--axis", "roll=0.1"), "no band"),
        (("nowhere",), "no such run"),
        (("--axis", "a=1furlong", "--band", 1, 5), "unknown unit 'furlong' of a"),
        (("--axis", "a=1", "--limit", "b=1", "--band", 1, 5), "does not command"),
        (("--axis", "a=1", "--band", 1, 5, "--ardupilot", "mixer"), "cannot fly multisine"),
    ],
)
def test_bad_input_is_refused_with_what_to_try(words: tuple[Any, ...], match: str) -> None:
    with pytest.raises(FlysidError, match=match):
        plan(*words)


def test_a_run_of_other_channels_is_refused(run: Run) -> None:
    with pytest.raises(FlysidError, match="no channel 'wing'"):
        plan(run.folder, "-c", "wing")
