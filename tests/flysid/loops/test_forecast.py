"""A loop under settings that were not flown, against the loop that is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli.predict import command, describe_forecast
from flysid.errors import DataError, UsageError
from flysid.loops.betaflight import NO_CONDITIONS, betaflight
from flysid.loops.flown_axis import Turning
from flysid.loops.forecast import forecast
from flysid.loops.known_axis import KnownAxis
from flysid.loops.law_parts import Means
from flysid.loops.moved_means import conditions_under
from flysid.loops.new_settings import read_settings, settings_in, with_settings
from flysid.loops.stick_response import closed_loop
from tests.flysid.loops.autopilots import ardupilot_log, px4_log
from tests.flysid.loops.simulated import Vehicle, truth
from tests.flysid.loops.test_loops import HEADER, log_of

LOGS = Path("../shared/logs/blackbox")
OTHER = {"p_roll": "70", "d_roll": "35"}
FOUR = {"Firmware revision": "Betaflight 4.6.0 (x) Y", "rollPID": "45,80,30", "d_max": "40,46,0"}


@pytest.fixture(scope="module")
def flights() -> list[Any]:
    """Of one vehicle, each with gusts of its own."""
    found = []
    for k in range(3):
        log = log_of(60.0, disturbance=30.0 + 10.0 * k)
        log.name = f"flight-{k}"
        found.append(log)
    return found


def test_a_loop_under_other_gains_is_the_one_that_they_make(flights: list[Any]) -> None:
    told = forecast(flights[:1], "roll", OTHER)
    vehicle = Vehicle(delay_steps=6)
    for side, gains in ((told.before, "46,45,25"), (told.after, "70,45,35")):
        true = truth(vehicle, betaflight(HEADER | {"rollPID": gains}, "roll", NO_CONDITIONS))
        for name in ("crossover_hz", "phase_deg", "ms"):
            figure = side.figures[name]
            assert figure.value is not None, name
            assert figure.value == pytest.approx(true[name], rel=0.12), name
    f = told.f
    new = betaflight(HEADER | {"rollPID": "70,45,35"}, "roll", NO_CONDITIONS)
    g = vehicle.response(f)
    true_response = g * new.reference(f) / (1.0 + g * new.feedback(f))
    assert np.median(np.abs(told.after.response / true_response - 1.0)) < 0.06
    assert np.median(np.abs(told.before.response / true_response - 1.0)) > 0.15
    assert told.off < 0.1


def test_three_flights_give_intervals_for_the_next(flights: list[Any]) -> None:
    one, three = forecast(flights[:1], "roll", OTHER), forecast(flights, "roll", OTHER)
    assert (one.next_flight, three.next_flight) == (False, True)
    assert len(three.flights) == 3


def test_more_gain_is_more_noise_and_a_loop_without_margin_is_named(flights: list[Any]) -> None:
    louder = forecast(flights[:1], "roll", {"d_roll": "50"})
    noise = louder.noise.value
    assert noise is not None
    assert 1.5 < noise < 2.1  # twice D, the same P
    wild = forecast(flights[:1], "roll", {"p_roll": "250", "d_roll": "20"})
    assert wild.after.unstable > 0.5
    assert wild.after.step.rise_s.value is None  # a step came out that rose in -94 ms
    assert "-> not determined, overshoot" in " ".join(describe_forecast(wild))
    assert wild.better < 0.5  # its error was called smaller, 0.2 times, with 100 %
    assert wild.tracking.value is None
    assert louder.before.unstable == 0.0


def test_what_moves_in_a_law_goes_with_the_error_that_the_new_gains_leave() -> None:
    """With P doubled the integral of a flight in the firmware came to 0.30 of itself; told was 0.47."""
    header = FOUR | {"dterm_lpf1_static_hz": "75", "dterm_lpf2_static_hz": "150", "looptime": "500"}
    header |= {"iterm_relax": "1", "iterm_relax_type": "1", "iterm_relax_cutoff": "15", "d_max_gain": "37"}
    log = log_of(20.0, header, disturbance=0.0)
    settings, plant = HEADER | header, Turning(12.0, 0.02, 0.003)
    log.tables["main"]["setpoint[3]"] = log.tables["main"]["rcCommand[3]"] - 1000.0

    def of(p: str) -> Means:
        new = settings | {"rollPID": f"{p},80,30"}
        means = conditions_under(log, "roll", settings, new, NO_CONDITIONS, plant).means
        assert means is not None
        return means

    assert of("90").i < 0.9 * of("45").i
    assert of("45").p == pytest.approx(1.0)


def test_nothing_that_changes_the_loop_is_refused(flights: list[Any]) -> None:
    with pytest.raises(UsageError, match="nothing of the roll rate loop changes"):
        forecast(flights[:1], "roll", {"p_pitch": "60"})


def test_flights_of_px4_and_ardupilot_are_predicted_too() -> None:
    vehicle = Vehicle(11.0, 0.04, 10)
    copter = forecast([ardupilot_log(60.0, 1, vehicle=vehicle)], "roll", {"ATC_RAT_RLL_P": "0.2"})
    assert copter.after.figures["crossover_hz"].value is not None
    px4 = forecast([px4_log(60.0, 1, vehicle=vehicle)], "roll", {"MC_ROLLRATE_D": "0.005"})
    assert px4.noise.low > 1.0


@pytest.mark.parametrize(
    ("changes", "line", "value"),
    [
        ({"p_roll": "58"}, "rollPID", "58,80,30"),
        ({"d_max_pitch": "50"}, "d_max", "40,50,0"),
        ({"dterm_lpf1_type": "PT3"}, "dterm_filter_type", "3"),
    ],
)
def test_a_setting_stands_where_the_header_states_it(changes: dict[str, str], line: str, value: str) -> None:
    assert with_settings(HEADER | FOUR, changes)[line] == value


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"p_rol": "58"}, "p_rol is no setting"),
        ({"gyro_lpf1_static_hz": "100"}, "gyro_lpf1_static_hz is no setting"),
        ({"p_roll": "high"}, "'high' is not a number"),
    ],
)
def test_a_setting_that_is_none_of_the_law_is_refused(changes: dict[str, str], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        with_settings(HEADER | FOUR, changes)


def test_settings_are_read_from_the_command_line_of_the_firmware(tmp_path: Path) -> None:
    file = tmp_path / "new.txt"
    file.write_text("# diff\nprofile 0\n\nset p_roll = 58\nset dterm_lpf1_type = PT2\n")
    assert read_settings(file) == {"p_roll": "58", "dterm_lpf1_type": "PT2"}
    file.write_text("ATC_RAT_RLL_P,0.15\n1\t1\tMC_ROLLRATE_P\t0.2\t9\n")
    assert read_settings(file) == {"ATC_RAT_RLL_P": "0.15", "MC_ROLLRATE_P": "0.2"}
    file.write_text("ATC_RAT_RLL_P\n")
    with pytest.raises(DataError, match="line 1 is not a parameter"):
        read_settings(file)
    with pytest.raises(UsageError, match="is not NAME=VALUE"):
        settings_in("p_roll")


def test_the_verb_predicts_a_flight_of_the_firmware_itself(firmware_log: Path, tmp_path: Path) -> None:
    picture = tmp_path / "new.svg"
    words = [str(firmware_log), "--set", "p_roll=60,d_roll=38,d_max_roll=50"]
    done = CliRunner().invoke(command, [*words, "--json", "--plot", str(picture)], standalone_mode=False)
    assert done.exception is None
    (axis,) = json.loads(done.stdout)["axes"]
    assert axis["law"] == "Betaflight 4.6"
    assert axis["off"] < 0.15
    assert 1.15 < axis["noise"]["value"] < 1.45
    assert axis["tracking"]["high"] < 1.0
    assert axis["better"] == 1.0
    assert (
        axis["after"]["figures"]["crossover_hz"]["value"] > axis["before"]["figures"]["crossover_hz"]["value"]
    )
    assert picture.stat().st_size > 1000
    told = CliRunner().invoke(command, words, standalone_mode=False).stdout
    assert "rollPID P 45 -> 60" in told
    assert "how flights differ takes three" in told


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
def test_a_real_flight_predicts_another_under_its_own_gains() -> None:
    """D 25 instead of 20: the response of the flight that had it, nearer than that of the flight without."""
    words = [str(LOGS / "hiro_highP_lowD.bfl"), "--set", "d_roll=25", "--json"]
    later = [str(LOGS / "hiro_highP_highD.bfl"), "--set", "d_roll=26", "--json"]
    told, seen = (
        json.loads(CliRunner().invoke(command, own, standalone_mode=False).stdout)["axes"][0]
        for own in (words, later)
    )
    f = np.array(told["f_hz"])
    f = f[f <= seen["f_hz"][-1]]
    real = np.interp(f, seen["f_hz"], seen["before"]["response"]["db"])
    off = [np.median(np.abs(told[side]["response"]["db"][: len(f)] - real)) for side in ("after", "before")]
    assert off[0] < off[1]
    assert off[0] < 1.2
    assert told["moved_db"] < told["known_to_db"]  # one flight alone does not tell so small a change
    printed = CliRunner().invoke(command, words[:-1], standalone_mode=False).stdout
    assert "not determined: the response changes by" in printed


def test_under_the_present_settings_the_response_is_the_measured_one() -> None:
    """Where the law misses by a tenth, both sides of a prediction missed by it."""
    log = log_of(60.0)
    log.tables["setpoint"]["setpoint[0]"] = 1.1 * log.tables["setpoint"]["setpoint[0]"]
    known = KnownAxis.of([log], "roll")
    lines = np.isin(known.last.loop.f, known.f)
    measured = closed_loop(known.last.loop.mean)[lines]
    told, draws = known.answers(known.last.controller)
    assert abs(np.median(np.abs(told / measured)) - 1.0) < 0.02
    assert np.median(np.abs(told / known.miss / measured)) > 1.06
    low, high = np.quantile(np.abs(draws), (0.025, 0.975), axis=0)
    bare = np.abs(told / known.miss)
    assert np.mean((low <= bare) & (bare <= high)) > 0.9  # the law alone is not ruled out


def test_a_log_too_slow_for_noise_says_so() -> None:
    """A ULog of 20 Hz: `--json` ended in a traceback, the text printed "nan times"."""
    log = LOGS.parent / "ulog" / "quad_stabilised_92s.ulg"
    if not log.exists():
        pytest.skip("no shared logs here")
    order = [str(log), "--set", "MC_ROLLRATE_P=0.16"]
    told = CliRunner().invoke(command, [*order, "--json"])
    assert told.exit_code == 0, told.output
    noise = json.loads(told.stdout)["axes"][0]["noise"]
    assert noise == {"value": None, "low": None, "high": None, "why": "the log is too slow"}
    assert (
        "noise to the motors not determined: the log is too slow" in CliRunner().invoke(command, order).stdout
    )
