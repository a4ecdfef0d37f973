"""Betaflight's loop step by step against its closed form, and against what real logs of it recorded."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

from flysid.cli.gains import command
from flysid.errors import DataError, UsageError
from flysid.loops.axis_flight import SIDES, _slew
from flysid.loops.betaflight import BetaflightLaw, Conditions
from flysid.loops.flown_axis import FlownAxis, Turning, _mixed, _opened, flown_axis
from flysid.loops.prediction import Turnings, predict_flight, response_of
from flysid.loops.stick_response import Loop, plant

SINCE_3_4 = {
    "Firmware revision": "Betaflight 3.4.0 (x) Y",
    "rollPID": "46,45,25",
    "pitchPID": "46,45,25",
    "yawPID": "65,45,20",
    "dterm_filter_type": "0",
    "dterm_lowpass_hz": "100",
    "dterm_lowpass2_hz": "200",
    "dterm_setpoint_weight": "60",
    "setpoint_relaxation_ratio": "0",
    "looptime": "500",
    "pid_process_denom": "1",
    "motorOutput": "0,1000",
}
OF_3_1 = SINCE_3_4 | {
    "Firmware revision": "Betaflight 3.1.3 (x) Y",
    "dterm_filter_type": "1",
    "dterm_notch_hz": "260",
    "dterm_notch_cutoff": "160",
    "dterm_setpoint_weight": "190",
    "setpoint_relaxation_ratio": "30",
}
VEHICLE = Turning(70.0, 0.02, 0.004)
SLOWER = 1.1
ROW_S = 0.001


def flown(settings: dict[str, str], seconds: float = 40.0, size: float = 40.0, seed: int = 0) -> FlownAxis:
    """Quick, small sticks at half throttle; nothing of the flight is flown yet."""
    rng = np.random.default_rng(seed)
    n = round(seconds / ROW_S)
    held = rng.integers(10, 60, n)  # of many lengths: no frequency is left out
    stick = np.repeat(rng.uniform(-1.0, 1.0, n), held)[:n]
    stick = np.convolve(stick, np.ones(20) / 20.0, "same")
    nothing = np.zeros(n)
    return FlownAxis(
        "flight",
        BetaflightLaw.of(settings, "roll"),
        np.arange(n, dtype=np.float64) * ROW_S,
        size * stick,
        np.abs(stick),
        nothing + 1500.0,
        0,
        np.zeros((4, n)),
        nothing,
        nothing,
        True,
        SLOWER,
    )


@pytest.mark.parametrize("settings", [SINCE_3_4, OF_3_1], ids=["3.4", "3.1"])
def test_small_motions_answer_as_the_closed_form_says(settings: dict[str, str]) -> None:
    axis = flown(settings).fly(VEHICLE)
    loop = Loop.of([axis.record()])
    at = (loop.f >= 2.0) & (loop.f <= 30.0)
    f = loop.f[at]
    law = axis.law.controller(Conditions(axis.throttle, axis.setpoint, axis.stick, SLOWER))
    g = VEHICLE.response(f, axis.step_s)
    told = g * law.reference(f) / (1.0 + g * law.feedback(f))
    seen = response_of(axis, 2.0)[at]
    assert np.median(np.abs(seen / told - 1.0)) < 0.04  # half a step of 0.55 ms
    assert np.median(np.abs(plant(loop.mean)[at] / g - 1.0)) < 0.02


def test_the_weight_of_the_setpoint_grows_with_the_stick_up_to_its_ratio() -> None:
    law = BetaflightLaw.of(OF_3_1, "roll")
    seen = law.weighed(np.full(3, 100.0), np.array([0.0, 0.15, 0.6]))
    np.testing.assert_allclose(seen, [0.0, 95.0, 190.0])


def test_a_slow_loop_lowers_filters_and_in_3_1_the_integral() -> None:
    late = Conditions(np.zeros(0), np.zeros(0), np.zeros(0), 1.25)
    old = BetaflightLaw.of(OF_3_1, "roll")
    assert old.controller(late).i == pytest.approx(old.i / 1.25)
    assert old.controller(late).d == pytest.approx(old.d * 1.25)
    assert old.controller(late).filters == ((2, 80.0),)
    new = BetaflightLaw.of(SINCE_3_4, "roll")
    assert (new.controller(late).i, new.controller(late).d) == (new.i, new.d)


def test_a_flight_of_the_same_vehicle_is_predicted_and_its_plant_found() -> None:
    """Sticks large enough for every limit: windup, motors, output."""
    known = [
        flown(SINCE_3_4, size=600.0, seed=s).fly(replace(VEHICLE, gain=g)) for s, g in ((1, 66), (2, 74))
    ]
    found = Turnings.of(known)
    assert found.together.gain == pytest.approx(70.0, rel=0.05)
    assert found.together.lag_s == pytest.approx(0.02, rel=0.1)
    assert found.together.delay_s == pytest.approx(0.004, abs=0.0005)
    later = flown(SINCE_3_4 | {"rollPID": "70,45,40"}, size=600.0, seed=3).fly(VEHICLE)
    told = predict_flight(found, later)
    at = (told.f >= 1.0) & (told.f <= 30.0)
    true = response_of(later, 2.0)
    assert np.median(np.abs(told.response / true - 1.0)[at]) < 0.03
    assert np.mean((np.abs(told.response - true) <= told.radius())[at]) > 0.9
    with pytest.raises(DataError, match="one flight does not tell"):
        predict_flight(Turnings.of(known[:1]), later)


class Log:
    """As much of a stored log as is read."""

    name = "flight"

    @property
    def rows(self) -> dict[str, int]:
        return dict.fromkeys(self.tables, 1)

    def columns(self, stream: str) -> list[str]:
        return list(self.tables[stream])

    def __init__(self, tables: dict[str, dict[str, Any]]) -> None:
        self.tables = tables
        self.facts = SimpleNamespace(streams=dict.fromkeys(tables, 1))

    def table(self, stream: str, columns: list[str]) -> Any:
        return pa.table({name: self.tables[stream][name] for name in columns})


def log_of(airmode: bool, swapped: bool = False) -> Log:
    """Roll and pitch at low throttle, where the mixers of both modes differ."""
    rng = np.random.default_rng(0)
    n = 2000
    sums = np.round(100.0 * rng.standard_normal((3, n)))
    throttle = rng.uniform(1000.0, 1400.0, n)
    wanted = np.einsum("am,an->mn", SIDES, sums)
    motors = 1000.0 * _mixed(wanted, _opened(throttle), airmode)
    order = [1, 0, 2, 3] if swapped else [0, 1, 2, 3]
    nothing = np.zeros(n)
    main: dict[str, Any] = {"time_ns": np.arange(n) * 1_000_000, "loopIteration": np.arange(n) * 2}
    main |= {f"axisP[{k}]": sums[k] for k in range(3)} | {f"axisI[{k}]": nothing for k in range(3)}
    main |= {
        "gyroADC[0]": nothing,
        "axisD[0]": nothing,
        "axisD[1]": nothing,
        "rcCommand[0]": nothing,
        "rcCommand[3]": throttle,
    }
    main |= {f"motor[{i}]": motors[j] for i, j in enumerate(order)}
    return Log({"main": main, "setpoint": {"time_ns": main["time_ns"], "setpoint[0]": nothing}})


@pytest.mark.parametrize("airmode", [False, True])
def test_whether_airmode_is_on_is_read_off_the_motors(airmode: bool) -> None:
    assert flown_axis(log_of(airmode), "roll", SINCE_3_4).airmode == airmode


def test_a_setpoint_follows_its_limit_of_acceleration() -> None:
    time, asked = np.array([0.0, 1.0, 1.5, 1.5, 4.0]), np.array([0.0, 10.0, 10.0, -10.0, -2.0])
    np.testing.assert_array_equal(_slew(time, asked, 4.0), [0.0, 4.0, 6.0, 6.0, -2.0])
    np.testing.assert_array_equal(_slew(time, asked, 0.0), asked)


def test_what_cannot_be_flown_again_is_refused() -> None:
    with pytest.raises(DataError, match="not what a quad X makes of the PID sums"):
        flown_axis(log_of(True, swapped=True), "roll", SINCE_3_4)
    with pytest.raises(UsageError, match="yaw cannot be flown again"):
        flown_axis(log_of(True), "yaw", SINCE_3_4)
    with pytest.raises(DataError, match="does not state its looptime"):
        flown_axis(log_of(True), "roll", SINCE_3_4 | {"looptime": ""})


LOGS = Path("../shared/logs/blackbox")


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
def test_the_law_of_3_1_gives_what_a_real_log_recorded() -> None:
    """With one weight of the setpoint for all stick positions it was 21 to 30 % off."""
    arguments = [str(LOGS / "hiro_highP_lowD.bfl"), "--axis", "roll", "--json"]
    done = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert done.exception is None
    assert json.loads(done.stdout)[0]["controller_miss"] < 0.05
