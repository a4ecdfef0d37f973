"""Logs whose loop cannot be known: every one is refused, with the reason and what to fly or log next."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flysid.loops.judged import Judged, judge, sets_of_gains
from tests.flysid.loops.autopilots import ardupilot_log, px4_log
from tests.flysid.loops.simulated import Vehicle
from tests.flysid.loops.test_loops import log_of

VEHICLE = Vehicle(12.0, 0.04, 8)


def px4(seconds: float = 40.0, changed: dict[str, float] | None = None, **flight: Any) -> Any:
    """A PX4 log that is judged as it is."""
    return px4_log(seconds, 1, changed, vehicle=VEHICLE, **flight)


def ardupilot(seconds: float = 40.0, changed: dict[str, float] | None = None, **flight: Any) -> Any:
    """An ArduCopter log that is judged as it is."""
    return ardupilot_log(seconds, 1, changed, vehicle=VEHICLE, **flight)


def without(log: Any, stream: str, field: str = "") -> Any:
    """A log that lacks a stream, or a field of one."""
    if field:
        del log.tables[stream][field]
    else:
        del log.tables[stream]
    return log


def without_parameter(log: Any, name: str) -> Any:
    """A PX4 log that does not state a parameter."""
    table = log.tables["parameters"]
    kept = [k for k, own in enumerate(table["name"]) if own != name]
    log.tables["parameters"] = {field: [values[k] for k in kept] for field, values in table.items()}
    return log


def changed_in_flight() -> Any:
    """A PX4 log in which P was raised."""
    log = px4()
    for field, value in (("name", "MC_ROLLRATE_P"), ("value", 0.2), ("origin", "changed")):
        log.tables["parameters"][field].append(value)
    return log


def older_ardupilot() -> Any:
    """One filter instead of three: ArduCopter 3.5."""
    log = ardupilot()
    names = [name.replace("FLTD", "FILT") for name in log.tables["PARM"]["Name"]]
    log.tables["PARM"]["Name"] = [name.replace("FLTT", "OLDT").replace("FLTE", "OLDE") for name in names]
    return log


def scaled(log: Any, stream: str, field: str, by: float) -> Any:
    """A log whose field is in another unit."""
    log.tables[stream][field] = (np.asarray(log.tables[stream][field], dtype=np.float64) * by).tolist()
    return log


def torn(log: Any, every: int) -> Any:
    """A blackbox log that lacks the rows of a tenth of a second, over and over."""
    main = log.tables["main"]
    torn_before = np.arange(len(main["time_ns"])) // every
    main["time_ns"] = main["time_ns"] + 100_000_000 * torn_before
    main["loopIteration"] = main["loopIteration"] + 50 * torn_before
    return log


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    # the controller is not known
    "another law": (
        lambda: log_of(40.0, {"Firmware revision": "INAV 7.0.0 (x) Y"}),
        "not state dterm_lpf_hz",
    ),
    "a fork": (lambda: log_of(40.0, {"Firmware revision": "EmuFlight 0.4.1 (x) Y"}), "is not described"),
    "unnamed firmware": (lambda: log_of(40.0, {"Firmware revision": ""}), "unnamed firmware"),
    "no header": (lambda: without(log_of(40.0), "parameters"), "records no rate loop"),
    "gains missing": (lambda: log_of(40.0, {"rollPID": ""}), "does not state rollPID"),
    "filter missing": (lambda: log_of(40.0, {"dterm_lowpass_hz": ""}), "not state dterm_lowpass_hz"),
    "no parameters": (lambda: without(px4(), "parameters"), "states no parameters"),
    "parameter missing": (lambda: without_parameter(px4(), "MC_ROLLRATE_K"), "not state MC_ROLLRATE_K"),
    "older ArduCopter": (older_ardupilot, "before 4.0, with a single filter .ATC_RAT_RLL_FILT"),
    "notch not stated": (lambda: ardupilot(40.0, {"ATC_RAT_RLL_NTF": 1.0}), "not state FILT1_NOTCH_FREQ"),
    "slope not fed forward": (lambda: ardupilot(40.0, {"ATC_RAT_RLL_D_FF": 0.1}), "do not give what"),
    # the stated gains are not those that flew
    "gains changed in flight": (changed_in_flight, r"was changed from 0\.15 to 0\.2"),
    "another profile": (lambda: log_of(40.0, {"rollPID": "92,45,25"}), "do not give what the log"),
    "another vehicle's parameters": (lambda: px4(40.0, {"MC_ROLLRATE_P": 0.3}), "do not give what the log"),
    # units of the channel do not match the loop
    "gyro in raw counts": (lambda: scaled(log_of(40.0), "main", "gyroADC[0]", 16.4), "do not give what"),
    "output in microseconds": (lambda: scaled(ardupilot(), "RATE", "ROut", 0.5), "do not give what"),
    "setpoint in degrees": (
        lambda: scaled(px4(), "vehicle_rates_setpoint", "roll", 180.0 / np.pi),
        "do not give what",
    ),
    # signals are missing or too slow
    "no output": (lambda: without(px4(), "vehicle_torque_setpoint"), "lacks actuator_controls_0"),
    "no angle setpoint": (lambda: without(px4(), "vehicle_attitude_setpoint"), "lacks vehicle_attitude"),
    "no gyro": (lambda: without(log_of(40.0), "main", "gyroADC[0]"), "lacks a field of the rate loop"),
    "logged slowly": (lambda: ardupilot(rate_hz=10.0), "at 10 Hz: too slow"),
    # the flight does not identify the loop
    "closed loop without excitation": (lambda: log_of(40.0, stick=0.0), "sticks never move"),
    "quiet sticks": (lambda: px4(60.0, stick=0.5), "stick inputs|known between"),
    "too short": (lambda: log_of(8.0), "too short to identify a loop"),
    "torn by gaps": (lambda: torn(log_of(40.0), 1500), "too short to identify a loop"),
    "controller at its limit": (lambda: log_of(40.0, {"pidsum_limit": "100"}), "at its limit"),
    "motors at their limit": (lambda: px4(60.0, stick=3000.0), "at its limit"),
}
TO_DO = re.compile(r"\b(fly|log|cut|set|gains)\b")


def judged(log: Any) -> Judged:
    """The roll axis of one log."""
    return judge([log], ["roll"])[0]


@pytest.mark.parametrize("made", [lambda: log_of(40.0), px4, ardupilot])
def test_the_logs_that_the_cases_are_made_of_are_judged(made: Callable[[], Any]) -> None:
    found = judged(made())
    assert found.margins is not None, found.refused


@pytest.mark.parametrize("case", list(REFUSED))
def test_what_cannot_be_known_is_refused_with_what_to_do(case: str) -> None:
    made, reason = REFUSED[case]
    found = judged(made())
    assert found.margins is None
    assert re.search(reason, found.refused), found.refused
    assert TO_DO.search(found.hint), found.hint
    assert [line.split(":")[0].strip() for line in found.lines()[1:]] == ["refused", "try"]


def test_a_header_without_looptime_leaves_a_law_that_moves_unchecked() -> None:
    """Its integral was taken as never relaxed, and no term was compared, without a word."""
    new = {"Firmware revision": "Betaflight 4.5.1 (x) Y", "d_min": "20,20,0", "iterm_relax": "1"}
    new |= {"iterm_relax_cutoff": "15", "dterm_lpf1_static_hz": "75", "dterm_lpf2_static_hz": "150"}
    found = judged(log_of(40.0, new))
    assert "does not state looptime" in found.refused


def test_how_to_log_faster_is_told_in_the_firmware_s_own_words() -> None:
    assert "LOG_BITMASK" in judged(ardupilot(rate_hz=10.0)).hint
    assert "SDLOG" not in judged(ardupilot(rate_hz=10.0)).hint
    assert "SDLOG_PROFILE" in judged(px4(rate_hz=10.0)).hint


def test_sets_of_gains_are_counted() -> None:
    assert sets_of_gains([px4(), px4()]) == 1
    assert sets_of_gains([px4(), px4(40.0, {"MC_ROLLRATE_P": 0.3})]) == 2
    assert sets_of_gains([without(log_of(40.0), "main")]) == 0
