"""INAV's law against flights of a controller that is written here once more."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from flysid.loops.betaflight import BetaflightLaw
from flysid.loops.judged import judge
from tests.flysid.loops.test_loops import Log

STEP_S = 0.001
HEADER = {
    "Firmware revision": "INAV 7.1.2 (8ae2c5b) X",
    "rollPID": "40,75,25,0",
    "pitchPID": "40,75,25,0",
    "yawPID": "85,45,0,0",
    "dterm_lpf_hz": "110",
    "dterm_lpf_type": "2",
    "yaw_lpf_hz": "0",
    "tpa_rate": "20",
    "tpa_breakpoint": "1200",
    "maxthrottle": "2000",
    "looptime": "1000",
    "pid_process_denom": "1",
}


def inav_log(seed: int = 0, p: float = 40.0, later: float = 0.0) -> Any:
    """A minute of roll: P, I, D of INAV on an integrator with a lag of 20 ms, at 1 kHz.

    With `later`, another P from 25 s on.
    """
    rng = np.random.default_rng(seed)
    n = 60_000
    held = np.repeat(rng.standard_normal(n), rng.integers(60, 500, n))[:n]
    setpoint = 120.0 * np.convolve(held, np.ones(40) / 40.0, "same")
    gusts = 30.0 * np.convolve(rng.standard_normal(n), np.ones(50) / 7.0, "same")
    throttle = 1500.0
    kept = 1.0 - 0.2 * (throttle - 1200.0) / 800.0
    share = STEP_S / (STEP_S + 1.0 / (2.0 * np.pi * 110.0 / np.sqrt(np.sqrt(2.0) - 1.0)))
    one = two = rate = torque = total = before = low = 0.0
    rows = np.zeros((5, n))
    relax = STEP_S / (STEP_S + 1.0 / (2.0 * np.pi * 15.0))
    for k in range(n):
        seen = rate + 0.5 * rng.standard_normal()
        error = setpoint[k] - seen
        low += relax * (setpoint[k] - low)
        one += share * (seen - one)
        two += share * (one - two)
        flown = later if later and k >= 25_000 else p
        proportional = flown / 31.0 * kept * error
        derivative = -25.0 / 1905.0 * kept * (two - before) / STEP_S if k else 0.0
        before = two
        total += 75.0 / 4.0 * error * STEP_S * max(0.0, 1.0 - abs(setpoint[k] - low) / 40.0)
        rows[:, k] = seen, proportional, total, derivative, setpoint[k]
        torque += STEP_S / 0.02 * (proportional + total + derivative + gusts[k] - torque)
        rate += 70.0 * torque * STEP_S
    seen, proportional, total, derivative, setpoint = np.trunc(rows)
    nothing = np.zeros(n)
    main = {"time_ns": np.arange(n) * 1_000_000, "loopIteration": np.arange(n), "axisRate[0]": setpoint}
    main |= {"gyroADC[0]": seen, "axisP[0]": proportional, "axisI[0]": total, "axisD[0]": derivative}
    main |= {f"{field}[{k}]": nothing for k in (1, 2) for field in ("gyroADC", "axisI")}
    main |= {"rcCommand[0]": nothing, "rcCommand[3]": nothing + throttle}
    return Log("inav", {"main": main, "parameters": {"name": list(HEADER), "text": list(HEADER.values())}})


def test_a_flight_of_inav_is_judged_by_its_own_law() -> None:
    (found,) = judge([inav_log()], ["roll"])
    assert found.refused == ""
    assert found.law == "INAV 7.1"
    assert {check.term for check in found.checks} == {"P", "I", "D"}
    assert max(check.miss for check in found.checks) < 0.08
    assert found.margins is not None
    assert found.margins.crossover_hz.value is not None


def test_a_gain_of_inav_that_was_not_flown_is_named() -> None:
    (found,) = judge([inav_log(p=60.0)], ["roll"])
    assert "the P term is" in found.refused
    (wrong,) = (check for check in found.checks if not check.fits)
    assert wrong.term == "P"
    assert wrong.slope == pytest.approx(1.5, rel=0.05)


def test_another_profile_in_the_middle_of_a_flight_is_named_with_its_time() -> None:
    (found,) = judge([inav_log(later=60.0)], ["roll"])
    assert re.search(
        r"is 1\.00 until 2[56] s and 1\.50 from there: gains were changed in flight", found.refused
    )


def test_tpa_ends_at_the_full_throttle_that_the_header_states() -> None:
    """It ended at 2000 us, and up to 7.1 `max_throttle` is 1850 by default: P counted as up to 5 % higher."""
    throttle = np.array([1200.0, 1525.0, 1850.0, 2000.0])
    stated = BetaflightLaw.of(HEADER | {"maxthrottle": "1850"}, "roll")
    assert stated.kept(throttle) == pytest.approx([1.0, 0.9, 0.8, 0.8])
    assert BetaflightLaw.of(HEADER, "roll").kept(throttle)[-1] == pytest.approx(0.8)


@pytest.mark.parametrize(("version", "limit"), [("6.1.1", 500.0), ("7.1.2", 165.0), ("8.0.1", 165.0)])
def test_the_integral_ends_where_its_version_ends_it(version: str, limit: float) -> None:
    law = BetaflightLaw.of(HEADER | {"Firmware revision": f"INAV {version} (8ae2c5b) X"}, "roll")
    assert law.largest_i == limit


def test_what_headers_of_inav_never_state_is_named_with_the_term_that_misses() -> None:
    """A Smith predictor gives another P, and no header of 6 to 8 says that it is on."""
    (found,) = judge([inav_log(p=60.0)], ["roll"])
    assert "the log's header does not state smith_predictor_delay, tpa_on_yaw" in found.refused


def test_a_low_pass_of_an_unknown_type_counts_as_not_described() -> None:
    """INAV 8 has a LULU filter, type 4, which was taken for a PT1."""
    assert BetaflightLaw.of(HEADER | {"dterm_lpf_type": "4"}, "roll").not_described == ("D low-pass type 4",)
    assert not BetaflightLaw.of(HEADER, "roll").not_described
