"""How much of a log was flown: one rule for `doctor` and `ls --suggest`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.suggest import suggest
from flysid.ingest.lake.survey import survey, verdict
from tests.command import call
from tests.samplelogs import tlog

DISARMED, ARMED = 81, 81 | 128


def log(path: Path, modes: list[int], attitude_s: int | None = None) -> Path:
    """Attitude at 10 Hz and a heartbeat every second, in the given base modes, and a ground station.

    With `attitude_s`, the attitude ends then, and the system's time goes on.
    """
    vehicle, station = tlog.sender(), tlog.sender(255, 190)
    out = []
    for second, mode in enumerate(modes):
        for tenth in range(10 if attitude_s is None or second < attitude_s else 0):
            ms = 5000 + 1000 * second + 100 * tenth
            micros = tlog.EPOCH_US + 1000 * ms
            angle = 0.2 * ((second // 2) % 2)
            out.append(
                tlog.stamped(micros, tlog.frame(vehicle, vehicle.attitude_encode(ms, angle, 0, 0, 0, 0, 0)))
            )
            out.append(
                tlog.stamped(
                    micros + 10,
                    tlog.frame(vehicle, vehicle.nav_controller_output_encode(angle, 0, 0, 0, 0, 0, 0, 0)),
                )
            )
        if attitude_s is not None:
            ms = 5000 + 1000 * second
            micros = tlog.EPOCH_US + 1000 * ms
            out.append(tlog.stamped(micros, tlog.frame(vehicle, vehicle.system_time_encode(micros, ms))))
        out.append(tlog.stamped(micros + 20, tlog.frame(vehicle, vehicle.heartbeat_encode(2, 3, mode, 5, 4))))
        out.append(tlog.stamped(micros + 30, tlog.frame(station, station.heartbeat_encode(6, 8, 0, 0, 4))))
    path.write_bytes(b"".join(out))
    return path


def test_a_log_that_was_never_armed_is_excluded_by_doctor_too(tmp_path: Path) -> None:
    """`doctor` said "ok" of six real logs for which `ls --suggest` had no use at all."""
    path = log(tmp_path / "ground.tlog", [DISARMED] * 70)
    words, advice = verdict(survey(path))
    assert words.startswith("excluded: condition 'armed' never holds (bits 128)")
    assert "remove the condition" in advice
    found = suggest([FlightLog(flysid.read(path))], ["ardupilot-attitude"])
    assert {s.verdict for s in found} == {"excluded"}
    assert found[0].advice in words


@pytest.mark.parametrize("armed_s", [5, 30])
def test_only_time_in_the_air_counts(tmp_path: Path, armed_s: int) -> None:
    """A log of 80 s of which 5 s or 30 s were flown."""
    path = log(tmp_path / "hop.tlog", [DISARMED] * 20 + [ARMED] * armed_s + [DISARMED] * (60 - armed_s))
    found = survey(path)
    assert found.usable_s == pytest.approx(armed_s, abs=0.1)
    words, advice = verdict(found)
    assert words == ("too short: flown for 5 s" if armed_s == 5 else "ok")
    more = "fly a minute of manoeuvres, or five such flights"
    assert advice == (more if armed_s == 5 else f"30 s alone will hardly give a verdict: {more}")


def test_flight_without_the_stream_of_interest_does_not_count(tmp_path: Path) -> None:
    """`doctor` said "ok" of a log of seven minutes with 50 s of attitude, where `ls --suggest` got 50 s."""
    path = log(tmp_path / "cut.tlog", [ARMED] * 300, attitude_s=20)
    found = survey(path)
    assert found.usable_s == pytest.approx(299.0, abs=1.1)
    words, advice = verdict(found)
    assert words == "ok"
    assert advice.startswith("attitude logged for 19 of 298 s flown; 19 s alone will hardly give a verdict")
    suggested = suggest([FlightLog(flysid.read(path))], ["ardupilot-attitude"])
    suggested = [s for s in suggested if s.duration_s]
    assert {round(s.duration_s) for s in suggested} == {19}
    assert all(s.advice in advice for s in suggested)


def test_a_log_that_states_no_arming_was_flown_for_an_unknown_time(tmp_path: Path) -> None:
    """All of such a log counted as flown."""
    vehicle = tlog.sender()
    path = tmp_path / "bare.tlog"
    sent = (vehicle.attitude_encode(5000 + 20 * k, 0.1 * (k % 7), 0, 0, 0, 0, 0) for k in range(1000))
    frames = (
        tlog.stamped(tlog.EPOCH_US + 20_000 * k, tlog.frame(vehicle, one)) for k, one in enumerate(sent)
    )
    path.write_bytes(b"".join(frames))
    assert survey(path).flown.seconds is None
    document = json.loads(call("doctor", path, "--json", cwd=tmp_path).stdout)["logs"][0]
    assert document["flown_s"] is None
    shown = call("show", path, cwd=tmp_path).stdout
    assert "unknown: the log states neither arming nor landing" in shown
