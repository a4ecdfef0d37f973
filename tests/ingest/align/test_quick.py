"""From some fields to others, without a recipe: what `--from`, `--to` and `--dt` make of logs and tables."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import FormatError, RecipeError, UsageError
from flysid.flight import Flight
from flysid.ingest.align.align import align
from flysid.ingest.align.quick import quick_recipe
from flysid.ingest.align.recipe import Recipe, parse_recipe
from flysid.ingest.align.signals import FlightLog

ONE_POLE = ("--poles", "1", "--zeros", "0", "--dead-time", "0")  # the plant's own: nothing to search


def table(path: Path, header: str, timed: bool = True) -> Flight:
    """A first-order plant behind random steps, 400 rows 50 ms apart."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1, 1, 40), 10)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.2 * u[k - 1]
    columns = [u, y + 0.01 * rng.standard_normal(400)]
    rows = np.column_stack([np.arange(400) * 0.05, *columns] if timed else columns)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    return flysid.read(path)


def recipe_of(flight: Flight, source: str, target: str, dt: float | None = None) -> Recipe:
    return parse_recipe(tomllib.loads(quick_recipe([FlightLog(flight)], [source], [target], dt)))


def test_a_table_becomes_a_channel_with_its_units(tmp_path: Path) -> None:
    flight = table(tmp_path / "a.csv", "time,tilt cmd [deg],v.x [m/s]")
    data = align([flight], recipe_of(flight, "tilt cmd", "v.x"), "v_x").dataset
    assert (data.dt_s, data.inputs[0].unit, data.outputs[0].unit) == (0.05, "deg", "m/s")
    assert data.segments[0].u[:, 0] == pytest.approx(flight["table"]["tilt cmd"].to_numpy())
    assert data.segments[0].y[:, 0] == pytest.approx(flight["table"]["v.x"].to_numpy())


def test_rows_without_a_time_need_their_period_and_others_refuse_it(tmp_path: Path) -> None:
    flight = table(tmp_path / "a.csv", "u,y", timed=False)
    assert align([flight], recipe_of(flight, "u", "y", dt=4.0), "y").dataset.dt_s == 4.0
    with pytest.raises(RecipeError, match="no column that can be its time") as error:
        align([flight], recipe_of(flight, "u", "y"), "y")
    assert "--dt" in error.value.hint
    timed = table(tmp_path / "b.csv", "time,u,y")
    with pytest.raises(RecipeError, match="tells the time"):
        align([timed], recipe_of(timed, "u", "y", dt=4.0), "y")


def test_fields_are_found_by_name_by_stream_and_by_element() -> None:
    flight = flysid.read(next(Path("sample_logs").glob("*.tlog")))
    log = FlightLog(flight)
    for word in ("ATTITUDE.pitch", "1.1/ATTITUDE.pitch"):
        assert 'field = "pitch"' in quick_recipe([log], ["ATTITUDE_TARGET.thrust"], [word])
    text = quick_recipe([log], ["ATTITUDE_TARGET.q[1]"], ["ATTITUDE.roll", "ATTITUDE.pitch"])
    recipe = parse_recipe(tomllib.loads(text))
    assert list(recipe.channels) == ["roll", "pitch"]
    assert recipe.signals["roll"].unit == "rad"
    assert recipe.signals["q_1"].hold == "zero"


def test_a_word_that_means_nothing_or_too_much_names_what_is_near() -> None:
    log = FlightLog(flysid.read(next(Path("sample_logs").glob("*.tlog"))))
    with pytest.raises(RecipeError, match="field of") as error:
        quick_recipe([log], ["time_boot_ms"], ["pitch"])
    assert "ATTITUDE.time_boot_ms" in error.value.hint
    with pytest.raises(RecipeError, match="no log has a field 'pich'") as error:
        quick_recipe([log], ["pich"], ["pitch"])
    assert "pitch" in error.value.hint
    with pytest.raises(RecipeError, match="neither a recipe") as error:
        quick_recipe([log], [], [])
    assert "ATTITUDE" in error.value.hint


@pytest.mark.usefixtures("arx_alone")
def test_from_a_table_to_a_verdict(tmp_path: Path) -> None:
    table(tmp_path / "steps.csv", "time,u,y")
    run = tmp_path / "run"
    log = str(tmp_path / "steps.csv")
    words = ["fit", log, "--from", "u", "--to", "y", "-o", str(run), "-m", "arx", "-q"]
    assert CliRunner().invoke(root, words).exit_code == 0
    assert (tmp_path / "run.data").is_dir()
    assert CliRunner().invoke(root, ["validate", str(run), "-q"]).exit_code == 0
    again = CliRunner().invoke(root, [*words, "--force"])
    assert again.exit_code == 0
    assert CliRunner().invoke(root, ["tf", log, "--from", "u", "--to", "y", *ONE_POLE, "-q"]).exit_code == 0


@pytest.mark.usefixtures("arx_alone")
def test_a_log_that_was_read_with_losses_is_fitted_and_said_so(tmp_path: Path) -> None:
    log = tmp_path / "steps.csv"
    table(log, "time,u,y")
    log.write_bytes(log.read_bytes() + b"too,many,cells,in,this\n")

    def told(*words: str) -> tuple[object, str]:
        more = ONE_POLE if words[0] == "tf" else ()
        done = CliRunner().invoke(
            root, [*words, *more, "--from", "u", "--to", "y", "-q"], standalone_mode=False
        )
        return done.return_value, done.stderr

    code, words = told("fit", str(log), "-m", "arx", "-o", str(tmp_path / "run"))
    assert code == 3
    assert "lost: " in words
    assert (tmp_path / "run" / "run.json").is_file()
    assert told("tf", str(log))[0] == 3
    assert told("tf", str(tmp_path / "run.data"))[0] == 0  # what it lost was told when it was ingested


def test_a_failed_fit_leaves_nothing_behind(tmp_path: Path) -> None:
    table(tmp_path / "steps.csv", "time,u,y")
    words = ["fit", str(tmp_path / "steps.csv"), "--from", "x", "--to", "y", "-o", str(tmp_path / "run")]
    with pytest.raises(RecipeError):
        CliRunner().invoke(root, words, catch_exceptions=False, standalone_mode=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["steps.csv"]


def test_in_python_a_file_is_enough(tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "time,u,y")
    table(tmp_path / "b.csv", "u,y", timed=False)
    data = flysid.dataset_from(tmp_path / "a.csv", "u", "y")
    assert (data.dt_s, len(data), [s.name for s in data.inputs]) == (0.05, 400, ["u"])
    assert flysid.dataset_from([tmp_path / "b.csv"], ["u"], ["y"], dt_s=0.05).segments[0].y == pytest.approx(
        data.segments[0].y
    )
    log = flysid.read(next(Path("sample_logs").glob("*.tlog")))
    both = flysid.dataset_from(log, "ATTITUDE.rollspeed", ["ATTITUDE.roll", "ATTITUDE.pitch"])
    assert [s.name for s in both.outputs] == ["roll", "pitch"]
    assert both.outputs[0].unit == "rad"


def test_a_time_in_two_possible_units_is_asked_for_on_every_verb(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    table(path, "time,u,y")
    lines = path.read_text().splitlines()
    rows = [f"{2 * k},{line.split(',', 1)[1]}" for k, line in enumerate(lines[1:])]
    path.write_text("\n".join([lines[0], *rows]) + "\n")
    run = str(tmp_path / "run")
    words = ["--from", "u", "--to", "y"]
    verbs = (
        ["doctor", str(path)],
        ["ingest", str(path), "-o", str(tmp_path / "data")],
        ["tf", str(path), *words],
        ["fit", str(path), *words, "-m", "arx", "-o", run],
        ["show", str(path)],
        ["plot", str(path), "table.u", "-o", str(tmp_path / "u.html")],
        ["export", str(path), "-o", str(tmp_path / "u.csv")],
    )
    for verb in verbs:
        asked = CliRunner().invoke(root, verb, standalone_mode=False)
        assert asked.return_value == 1 or isinstance(asked.exception, FormatError)
        said = asked.stderr + repr(asked.exception) + getattr(asked.exception, "hint", "")
        assert "798 s at 0.5 Hz in s, or 0.798 s at 500 Hz in ms" in said
        assert "--time-unit ms" in said
    for unit, length_s in (("ms", 0.798), ("s", 798.0)):
        CliRunner().invoke(root, [*verbs[1], "--time-unit", unit], standalone_mode=False)
        (flight,) = flysid.open(tmp_path / "data").flights
        assert flight.duration_s == pytest.approx(length_s)
    for verb in ([*verbs[2], *ONE_POLE, "-q"], *verbs[4:]):
        told = CliRunner().invoke(root, [*verb, "--time-unit", "ms"], standalone_mode=False)
        assert told.exception is None
    with pytest.raises(UsageError, match="already have their format and times"):
        CliRunner().invoke(
            root,
            ["tf", str(tmp_path / "data"), *words, "--time-unit", "s"],
            standalone_mode=False,
            catch_exceptions=False,
        )
    assert flysid.dataset_from(path, "u", "y", time_unit="ms").dt_s == pytest.approx(0.002)
