"""`flysid review LOG`, and `flysid LOG`, as a user types them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import UsageError
from tests.flysid.reviews.copter_log import ARMED, DISARMED, FLYING, copter_log, even

SAMPLES = Path(__file__).resolve().parents[3] / "sample_logs"
LOG = SAMPLES / "01-multisine-seed1.tlog"


def run(*arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr."""
    result = CliRunner().invoke(root, [str(a) for a in arguments], standalone_mode=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.return_value or 0, result.stdout, result.stderr


def test_a_log_in_place_of_a_verb_is_reviewed() -> None:
    assert run(LOG)[1] == run("review", LOG)[1]


def test_json_holds_every_fact_with_its_evidence() -> None:
    document = json.loads(run("review", LOG, "--json")[1])
    assert document["format"] == "flysid-review"
    assert document["sections"]["trust"]["facts"]["lost"]["value"] == "nothing"


def test_the_page_is_written_once(tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    run("review", LOG, "-o", page)
    assert "<h1" in page.read_text("utf-8")
    with pytest.raises(Exception, match="the target exists"):
        run("review", LOG, "-o", page)


def test_of_a_log_that_shows_nothing_the_next_step_says_what_to_log(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("t,a\n" + "".join(f"{0.1 * k:.1f},{k % 7}\n" for k in range(200)))
    code, shown, said = run("review", table)
    assert (code, "Nothing in this log can be judged" in shown) == (3, True)
    assert f"next: what to log, and what a log is good for as it is: flysid doctor {table}" in " ".join(
        said.split()
    )
    assert "name two of its columns" in " ".join(run("doctor", table)[1].split())


OWN_RECIPE = """
name = "own"

[signals]
cmd = { unit = "rad", sources = [{ stream = "table", field = "roll_sp", unit = "rad" }] }
angle = { unit = "rad", sources = [{ stream = "table", field = "phi", unit = "rad" }] }
roll_rate = { unit = "rad/s", sources = [{ stream = "table", field = "p", unit = "rad/s" }] }
pitch_rate = { unit = "rad/s", sources = [{ stream = "table", field = "q", unit = "rad/s" }] }
yaw_rate = { unit = "rad/s", sources = [{ stream = "table", field = "r", unit = "rad/s" }] }

[channels.roll]
inputs = ["cmd"]
outputs = ["angle"]
"""


def test_a_table_is_reviewed_by_a_recipe_of_ones_own(tmp_path: Path) -> None:
    """Its lag and its error are those that it was written with, in degrees."""
    rng = np.random.default_rng(3)
    setpoint = np.repeat(rng.normal(0.0, 0.2, 60), 100)
    angle = np.concatenate([np.zeros(8), setpoint])[: len(setpoint)]
    rates = 0.1 * rng.standard_normal((len(setpoint), 3))
    rows = np.column_stack([0.005 * np.arange(len(setpoint)), setpoint, angle, rates])
    table, recipe = tmp_path / "table.csv", tmp_path / "own.toml"
    np.savetxt(table, rows, "%.6g", ",", header="time,roll_sp,phi,p,q,r", comments="")
    recipe.write_text(OWN_RECIPE)
    found = flysid.review(table, recipe=str(recipe))
    error_deg = np.degrees(np.sqrt(np.mean((setpoint - angle)[100:] ** 2)))
    values = {fact.key: fact.value for fact in found.facts}
    assert values["tracking.attitude_roll_rms"] == pytest.approx(error_deg, rel=0.05)
    assert values["tracking.attitude_roll_lag"] == pytest.approx(40.0, abs=5.0)
    assert values["vibration.gyro_rate"] == pytest.approx(200.0, rel=0.01)
    code, shown, _ = run("review", table, "--recipe", recipe, "-o", tmp_path / "r.html")
    assert (code, "Nothing in this log stands out" in shown) == (0, True)
    assert f"--recipe {recipe}" in (tmp_path / "r.html").read_text("utf-8")


@pytest.mark.parametrize(("condition", "code"), [("trust.duration > 1", 4), ("trust.duration > 1e9", None)])
def test_a_condition_guards(condition: str, code: int | None) -> None:
    found = run("review", LOG, "--fail-if", condition)[0]
    assert found == code if code else found != 4


def test_several_flights_are_no_single_review() -> None:
    with pytest.raises(UsageError, match="it holds 4 flights"):
        flysid.review(SAMPLES)


def test_a_figure_that_is_not_determined_fails_its_guard() -> None:
    code, _, said = run("review", LOG, "--fail-if", "trust.flown > 1e9")
    assert code in (0, 3, 4)
    assert (code == 4) == ("does not exist" in said)


def test_a_condition_is_looked_at_before_the_log_is_read() -> None:
    with pytest.raises(Exception, match="condition"):
        run("review", "sample_logs/absent.tlog", "--fail-if", "5 +")


def test_a_file_that_is_not_there_is_no_verb() -> None:
    with pytest.raises(Exception, match="no verb and no file"):
        run("absent.bin")


def test_own_limits_grade_the_figure(tmp_path: Path) -> None:
    time_s = even(30.0, 10.0)
    rates = {name: 0.5 * np.sin(time_s) for name in ("RDes", "R", "ROut")}
    copter_log(tmp_path, {"RATE": (time_s, rates)})
    log, key = tmp_path / "flight.bin", "controller_roll_at_limit"
    words: tuple[list[str], ...] = ([], ["--limit", "tracking.at_limit=0,0.5"])
    documents = [json.loads(run("review", log, "--json", *more)[1]) for more in words]
    grades = [document["sections"]["tracking"]["facts"][key]["grade"] for document in documents]
    assert grades == ["good", "watch"]


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("power.motor_spred=1,2", "no figure 'power.motor_spred' has a limit"),
        ("power.motor_spread", "is no limit"),
        ("power.motor_spread=1", "is no limit"),
        ("trust.flown=1,2", "no figure 'trust.flown' has a limit"),
    ],
)
def test_a_limit_that_is_none_is_refused_before_a_log_is_read(limit: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        run("review", "absent.bin", "--limit", limit)


def flown_copter(folder: Path, seconds: float, roll_deg: float = 0.0) -> Path:
    """A copter that oscillates, errs in roll beside a setpoint that stands, and states when it flies."""
    time_s = even(seconds + 2.0, 100.0)
    rates = {"R": 40.0 * np.sin(30.0 * time_s), "RDes": np.sin(3.0 * time_s)}
    angles = {"Roll": np.full(len(time_s), roll_deg), "DesRoll": np.full(len(time_s), 1e-15)}
    events = [(time_s[0], ARMED), (time_s[0], FLYING), (time_s[0] + seconds, DISARMED)]
    copter_log(folder, {"RATE": (time_s, rates), "ATT": (time_s, angles)}, events=events)
    return folder / "flight.bin"


@pytest.mark.parametrize("seconds", [0.1, 1.3])
def test_a_moment_of_flight_leads_with_that_and_holds_no_statistics(seconds: float, tmp_path: Path) -> None:
    code, text, _ = run("review", flown_copter(tmp_path, seconds, 30.0))
    assert code == 3
    assert "in the air: too short to judge. (fly a minute" in text
    assert "root mean square" not in text
    assert "Oscillates" not in text
    assert "misses" not in text


def test_what_happens_in_a_moment_of_flight_is_stated(tmp_path: Path) -> None:
    document = json.loads(run("review", flown_copter(tmp_path, 1.3), "--json")[1])
    facts = document["sections"]["tracking"]["facts"]
    assert {fact["value"] for fact in facts.values()} == {None}
    assert "2 s are needed" in facts["rate_roll_rms"]["missing"]
    assert document["sections"]["happened"]["facts"]["failsafes"]["value"] == "none"


def test_some_seconds_of_flight_are_judged_and_called_short(tmp_path: Path) -> None:
    code, text, _ = run("review", flown_copter(tmp_path, 8.0))
    assert code == 0
    assert "Oscillates in roll" in text
    assert "in the air: too short to judge how it follows" in text


def test_an_angle_without_a_setpoint_that_moves_is_not_missed(tmp_path: Path) -> None:
    assert "misses" not in run("review", flown_copter(tmp_path, 20.0, 30.0))[1]
