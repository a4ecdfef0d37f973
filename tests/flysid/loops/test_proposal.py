"""Settings that are proposed: within a factor of two, inside their bounds, and better in flight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli.design import command
from flysid.cli.predict import command as predict
from flysid.loops.betaflight import NO_CONDITIONS, betaflight
from flysid.loops.gain_bounds import RateBounds
from flysid.loops.new_settings import read_settings, with_settings
from flysid.loops.proposal import Proposal, propose
from flysid.loops.tunable import Setting, list_tunable
from tests.flysid.loops.autopilots import ardupilot_log, px4_log
from tests.flysid.loops.simulated import Vehicle, truth
from tests.flysid.loops.test_loops import HEADER, log_of

LOGS = Path("../shared/logs/blackbox")
FOUR = {
    "Firmware revision": "Betaflight 4.6.0 (x) Y",
    "rollPID": "45,80,30",
    "yawPID": "45,80,0",
    "d_max": "40,46,0",
    "dterm_lpf1_dyn_hz": "75,150",
    "dterm_lpf1_static_hz": "75",
    "dterm_lpf2_static_hz": "150",
}


@pytest.fixture(scope="module")
def proposed() -> Proposal:
    """Of a loop whose P and I are too large for its D."""
    return propose([log_of(60.0)], ["roll"], RateBounds())


def test_a_proposal_is_better_and_keeps_its_bounds_on_the_vehicle_itself(proposed: Proposal) -> None:
    (axis,) = proposed.axes
    assert axis.tracking.high < 1.0
    vehicle = Vehicle(delay_steps=6)
    settings = with_settings(HEADER, proposed.new)
    true = truth(vehicle, betaflight(settings, "roll", NO_CONDITIONS))
    assert true["ms"] < 1.7
    assert true["gain_db"] > 4.0
    noise = axis.noise.value
    assert noise is not None
    assert noise <= 1.5 + 1e-9


def test_no_setting_moves_by_more_than_a_factor_of_two(proposed: Proposal) -> None:
    assert proposed.new
    for name, value in proposed.new.items():
        assert 0.5 <= float(value) / float(proposed.old[name]) <= 2.0, name


def test_filters_that_another_axis_shares_stay(proposed: Proposal) -> None:
    """Roll alone was designed, and pitch has the same D low-pass."""
    assert not [name for name in proposed.new if "lowpass" in name or "lpf" in name]


@pytest.mark.parametrize(
    ("log", "names"),
    [
        (ardupilot_log, {"ATC_RAT_RLL_P", "ATC_RAT_RLL_I", "ATC_RAT_RLL_D", "ATC_RAT_RLL_FLTD"}),
        (px4_log, {"MC_ROLLRATE_P", "MC_ROLLRATE_I", "MC_ROLLRATE_D", "IMU_DGYRO_CUTOFF"}),
    ],
)
def test_px4_and_ardupilot_are_designed_by_their_parameters(log: Any, names: set[str]) -> None:
    found = propose([log(90.0, 3, vehicle=Vehicle(11.0, 0.04, 10))], ["roll"], RateBounds(noise=2.0))
    assert found.new, found.refused
    assert set(found.new) <= names
    assert not found.command_line
    assert found.axes[0].tracking.high < 1.0


def test_the_angle_loop_gets_what_the_new_rate_loop_carries() -> None:
    """A gain that made the angle overshoot goes down, a timid one up; neither beyond a factor of two."""
    found = {}
    for gain in (3.0, 30.0):
        log = px4_log(90.0, 3, {"MC_ROLL_P": gain}, vehicle=Vehicle(11.0, 0.04, 10))
        (found[gain],) = propose([log], ["roll"], RateBounds(noise=2.0)).angles
    assert 3.0 < found[3.0].new <= 6.0
    assert 15.0 <= found[30.0].new < 30.0
    assert found[3.0].peak[1] <= 1.1
    assert found[30.0].peak[0] > 1.1
    assert "roll angle: MC_ROLL_P 3 -> " in found[3.0].line()


def test_what_the_sticks_do_not_show_is_refused_with_the_flight_to_fly() -> None:
    found = propose([log_of(60.0, stick=2.0, disturbance=300.0)], ["roll"])
    assert not found.new
    assert "fly" in found.refused["roll"].hint


def test_settings_are_those_in_use() -> None:
    named = {own.name: own.part for own in list_tunable(HEADER | FOUR, "roll")}
    assert named == {
        "p_roll": "p",
        "i_roll": "i",
        "d_roll": "d",
        "d_max_roll": "d",
        "dterm_lpf1_dyn_min_hz": "filters",
        "dterm_lpf1_dyn_max_hz": "filters",
        "dterm_lpf2_static_hz": "filters",
    }
    assert [own.name for own in list_tunable(HEADER | FOUR, "yaw")] == ["p_yaw", "i_yaw"]


@pytest.mark.parametrize("factor", [0.5, 0.517, 0.77, 1.0, 1.26, 1.999, 2.0])
@pytest.mark.parametrize("value", [0.0036, 0.135, 45.0, 75.0])
def test_a_value_is_rounded_towards_the_present_one(value: float, factor: float) -> None:
    new = float(Setting("x", "p", value, value > 1.0).times(factor)) / value
    assert min(1.0, factor) - 1e-9 <= new <= max(1.0, factor) + 1e-9


def test_the_verb_writes_lines_for_the_command_line(firmware_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "design"
    words = [str(firmware_log), "--axis", "roll", "--axis", "pitch", "--ms", "1.9", "-o", str(out)]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.exception is None
    assert done.return_value == 0
    new = read_settings(out / "new.txt")
    old = read_settings(out / "old.txt")
    assert new.keys() == old.keys()
    assert [line for line in done.stdout.splitlines() if line.startswith("set ")] == [
        f"set {name} = {value}" for name, value in new.items()
    ]
    assert "save" in (out / "new.txt").read_text().splitlines()
    told = CliRunner().invoke(
        predict, [str(firmware_log), "--file", str(out / "new.txt"), "--json"], standalone_mode=False
    )
    body = json.loads((out / "design.json").read_text())
    again = {own["axis"]: own["tracking"]["value"] for own in json.loads(told.stdout)["axes"]}
    for own in body["axes"]:
        assert np.isclose(own["tracking"]["value"], again[own["axis"]])


def test_options_of_a_run_are_refused_with_logs() -> None:
    done = CliRunner().invoke(command, [str(Path("sample_logs")), "-c", "x"], standalone_mode=False)
    assert "--channel: not for logs" in str(done.exception)


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
def test_a_real_flight_gets_gains_that_lower_its_sensitivity() -> None:
    words = [str(LOGS / "hiro_highP_lowD.bfl"), "--json"]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    body = json.loads(done.stdout)
    (roll,) = body["axes"]
    assert roll["before"]["figures"]["ms"]["value"] > 1.7
    assert roll["after"]["figures"]["ms"]["high"] < 1.75
    assert body["refused"].keys() == {"pitch", "yaw"}
    assert all(why["try"] for why in body["refused"].values())


def test_an_angle_gain_that_changed_in_flight_leaves_the_rate_loop_its_proposal() -> None:
    log = px4_log(90.0, 3, {"MC_ROLL_P": 6.0}, vehicle=Vehicle(11.0, 0.04, 10))
    table = log.tables["parameters"]
    for column, values in table.items():
        more = {"name": "MC_ROLL_P", "value": 7.0}.get(column, values[-1])
        table[column] = [*values, more]
    place = [k for k, name in enumerate(table["name"]) if name == "MC_ROLL_P"]
    for column in table.keys() - {"name", "value"}:
        table[column][place[-1]] = table[column][place[0]]
    found = propose([log], ["roll"], RateBounds(noise=2.0))
    assert found.new
    assert not found.angles
    assert "MC_ROLL_P was changed from 6 to 7 in flight" in found.refused["roll angle"].message
