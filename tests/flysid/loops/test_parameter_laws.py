"""Laws of PX4 and ArduPilot from their parameters, and the terms that their logs record."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flysid.laws.described import parameter_law
from flysid.loops.judged import judge
from flysid.loops.parameter_checks import ardupilot_checks, px4_checks
from flysid.loops.parameter_laws import RELEASE, UNIT, ardupilot, px4
from tests.flysid.loops.autopilots import ARDUPILOT, PX4, VEHICLE, ardupilot_log, px4_log

STATED = {f"ATC_RAT_RLL_{name}": value for name, value in ARDUPILOT.items()}
F = np.array([1.0, 10.0, 30.0])


def test_the_setpoints_slope_is_fed_forward_behind_its_filter() -> None:
    plain, fed = ardupilot(STATED, "roll"), ardupilot(STATED | {"ATC_RAT_RLL_D_FF": 0.01}, "roll")
    s = 2j * np.pi * F
    added = UNIT * 0.01 * s / (1.0 + 1j * F / ARDUPILOT["FLTT"])
    np.testing.assert_allclose(fed.reference(F) - plain.reference(F), added)
    np.testing.assert_allclose(fed.feedback(F), plain.feedback(F))


def test_notches_of_target_and_error_are_those_that_their_numbers_name() -> None:
    notch = {"FILT2_NOTCH_FREQ": 10.0, "FILT2_NOTCH_Q": 2.0, "FILT2_NOTCH_ATT": 40.0}
    plain = ardupilot(STATED, "roll")
    target = ardupilot(STATED | notch | {"ATC_RAT_RLL_NTF": 2.0}, "roll")
    error = ardupilot(STATED | notch | {"ATC_RAT_RLL_NEF": 2.0}, "roll")
    assert np.abs(target.reference(F) / plain.reference(F))[1] == pytest.approx(0.01)
    np.testing.assert_allclose(target.feedback(F), plain.feedback(F))
    assert np.abs(error.feedback(F) / plain.feedback(F))[1] == pytest.approx(0.01)


def test_yaw_of_px4_goes_through_a_low_pass() -> None:
    stated = {f"MC_YAWRATE_{name}": value for name, value in PX4.items()} | {"IMU_DGYRO_CUTOFF": 30.0}
    plain, slow = px4(stated, "yaw"), px4(stated | {"MC_YAW_TQ_CUTOFF": 2.0}, "yaw")
    np.testing.assert_allclose(slow.feedback(F), plain.feedback(F) / (1.0 + 1j * F / 2.0))


@pytest.mark.parametrize(("release", "order"), [(0x010C0300, 2), (0x010D0000, 1), (0x01100000, 1)])
def test_the_filter_of_px4_is_that_of_its_release(release: int, order: int) -> None:
    stated = {f"MC_ROLLRATE_{name}": value for name, value in PX4.items()} | {"IMU_DGYRO_CUTOFF": 30.0}
    assert px4(stated | {RELEASE: float(release)}, "roll").filters == ((order, 30.0),)
    assert parameter_law("px4", (1, 12)).part("integral") == parameter_law("px4").part("integral")


def with_terms(log: Any, p: float = 1.0) -> Any:
    """A log with the terms of its PID, as 400 Hz rows of the simulated error."""
    rate = log.tables["RATE"]
    error = np.radians(np.asarray(rate["RDes"]) - np.asarray(rate["R"]))
    time = np.asarray(rate["time_ns"], dtype=np.int64)
    dt = np.diff(time * 1e-9, prepend=time[0] * 1e-9)
    log.tables["PIDR"] = {
        "time_ns": time,
        "Tar": np.radians(rate["RDes"]),
        "Err": error,
        "P": p * ARDUPILOT["P"] * error,
        "I": np.cumsum(ARDUPILOT["I"] * error * dt),
        "D": np.zeros(len(error)),
        "Dmod": np.ones(len(error)),
    }
    return log


def test_recorded_terms_of_ardupilot_are_compared_and_the_one_that_is_off_is_named() -> None:
    log = with_terms(ardupilot_log(40.0, 1, vehicle=VEHICLE))
    checks = {check.term: check for check in ardupilot_checks(log, "roll", STATED).checks}
    assert checks.keys() == {"P", "I"}  # 100 Hz are too slow for the derivative
    assert all(check.miss < 0.01 for check in checks.values())
    wrong = with_terms(ardupilot_log(40.0, 1, {"ATC_RAT_RLL_P": 0.3}, vehicle=VEHICLE))
    (found,) = judge([wrong], ["roll"])
    assert "the P term is" in found.refused
    assert "recorded over rebuilt is 0.45" in found.refused


def test_the_recorded_integral_of_px4_is_compared() -> None:
    log = px4_log(40.0, 1, vehicle=VEHICLE)
    rates = log.tables["vehicle_rates_setpoint"]
    time = np.asarray(rates["time_ns"], dtype=np.int64)
    rate = np.array([row[0] for row in log.tables["vehicle_angular_velocity"]["xyz"]])
    error = np.asarray(rates["roll"]) - rate
    faded = np.maximum(0.0, 1.0 - (np.degrees(error) / 400.0) ** 2)
    dt = np.diff(time * 1e-9, prepend=time[0] * 1e-9)
    log.tables["rate_ctrl_status"] = {
        "time_ns": time,
        "rollspeed_integ": np.cumsum(PX4["K"] * PX4["I"] * faded * error * dt),
    }
    stated = {f"MC_ROLLRATE_{name}": value for name, value in PX4.items()}
    (check,) = px4_checks(log, "roll", stated).checks
    assert check.term == "I"
    assert check.miss < 0.01
    (other,) = px4_checks(log, "roll", stated | {"MC_ROLLRATE_I": 2.0 * PX4["I"]}).checks
    assert other.slope == pytest.approx(0.5, rel=0.02)
