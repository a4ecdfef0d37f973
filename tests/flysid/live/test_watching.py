"""`flysid watch`: a run's models beside a log and beside a link."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import FloatArray, Segment, Signal
from flysid.ingest.align.recipe import load_recipe
from flysid.live.causes import likely, likely_of_effort, meaning_of, visibility
from flysid.live.following import Follower
from flysid.live.spool import SpoolPiece, whole_records
from flysid.live.watching import ChannelWatch, known_inputs
from flysid.validate.diagnose.detect import LEVEL_EVERY_S, LEVEL_S, Thresholds, calibrate
from tests.command import ROOT, call, shell
from tests.flysid.live.flown import FAULT_S, play
from tests.link_trials import free_port
from tests.validate.diagnose.test_detect import MODEL, flown


@cache
def calibrated() -> tuple[tuple[Thresholds, ...], FloatArray]:
    flights = [flown(k, 300) for k in range(6)]
    return calibrate(MODEL, flights, 0.1), known_inputs(flights)


def made() -> ChannelWatch:
    return ChannelWatch("roll", MODEL, *calibrated())


def with_fault(seed: int = 70, size: float = 0.2) -> tuple[Segment, float]:
    """A flight whose plant is pushed from half its time on, and that time."""
    before = flown(seed, 60)
    after = flown(seed + 1, 60, offset=size)
    u, y = (np.concatenate([getattr(s, n) for s in (before, after)]) for n in ("u", "y"))
    return Segment(u, y, t0_ns=5_000_000_000), 65.0


def test_a_fault_is_one_alarm_with_its_size() -> None:
    segment, at_s = with_fault()
    events = [e for e in made().run(segment) if e.kind == "alarm"]
    assert len(events) == 1
    assert at_s <= events[0].time_s < at_s + 2.0
    assert abs(events[0].since_s - at_s) < 1.0
    assert events[0].shift > 0.0
    assert "left its band" in events[0].text


def test_the_level_finds_what_is_wrong_from_take_off_as_soon_as_it_has_its_seconds() -> None:
    segment = flown(70, 30)
    limits, known = calibrated()
    deaf = tuple(replace(one, cusum=1e9, glr=1e9) for one in limits)
    watch = ChannelWatch("roll", MODEL, deaf, known)
    pushed = Segment(segment.u, segment.y + 0.5)
    [alarm] = [e for e in watch.run(pushed) if e.kind == "alarm"]
    assert alarm.detector == "level"
    assert LEVEL_S - LEVEL_EVERY_S <= alarm.time_s <= LEVEL_S + LEVEL_EVERY_S


def test_nominal_flight_is_quiet() -> None:
    watch = made()
    assert [e for k in range(3) for e in watch.run(flown(200 + k, 200)) if e.kind == "alarm"] == []


def test_an_alarm_ends_where_the_fault_does() -> None:
    segment, _ = with_fault()
    after = flown(90, 90)
    joined = Segment(np.concatenate([segment.u, after.u]), np.concatenate([segment.y, after.y]))
    assert [e.kind for e in made().run(joined)][:2] == ["alarm", "over"]


def test_an_input_outside_the_flights_is_said_and_is_no_alarm() -> None:
    segment = flown(60, 60)
    wild = Segment(segment.u * 100.0, segment.y)  # the output does not answer: surely no nominal flight
    watch = made()
    events = watch.run(wild)
    assert {e.kind for e in events} == {"outside"}
    assert watch.run(wild) == events  # the next flight is told of, too
    assert "outside what the model knows: u" in events[0].text
    assert "likely" not in events[0].text  # a command beyond the range is the pilot's


def test_an_effort_outside_the_flights_has_likely_causes() -> None:
    model = replace(MODEL, inputs=(Signal("yaw_torque", "mN m"),), outputs=(Signal("r", "deg/s"),))
    limits, known = calibrated()
    segment = flown(60, 60)
    events = ChannelWatch("yaw", model, limits, known).run(Segment(segment.u * 100.0, segment.y))
    assert "likely: a motor or propeller" in events[0].text


def test_pieces_find_what_the_whole_finds() -> None:
    segment, _ = with_fault()
    watch = made()
    whole = [e.time_s for e in watch.run(segment) if e.kind == "alarm"]
    watch.restart()
    pieces = []
    for k in range(0, len(segment), 3):
        time_s = segment.t0_ns * 1e-9 + k * MODEL.dt_s
        pieces += watch.feed(segment.u[k : k + 3], segment.y[k : k + 3], time_s)
    assert [e.time_s for e in pieces if e.kind == "alarm"] == pytest.approx(whole, abs=0.2)


EFFORT = Signal("throttle")


@pytest.mark.parametrize(
    ("output", "inputs", "kind"),
    [
        (EFFORT, (Signal("vz_in", "m/s"),), "effort"),
        (Signal("q", "deg/s"), (Signal("pitch_torque"),), "turning"),
        (Signal("q", "deg/s"), (Signal("q_in", "deg/s"),), "attitude"),
        (Signal("theta", "deg"), (Signal("theta_in", "deg"),), "attitude"),
        (Signal("v_z", "m/s"), (Signal("vz_in", "m/s"),), "climb"),
        (Signal("v_x", "m/s"), (Signal("theta_in", "deg"),), "horizontal speed"),
        (Signal("level", "m"), (Signal("pump"),), "output"),
    ],
)
def test_what_an_output_is(output: Signal, inputs: tuple[Signal, ...], kind: str) -> None:
    assert meaning_of(output, inputs).kind == kind


def test_words_name_causes_and_what_cannot_be_seen() -> None:
    more = likely(meaning_of(EFFORT, ()), 0.2)
    assert more.startswith("more mass")
    assert more.endswith("cannot tell which")
    assert "less mass" in likely(meaning_of(EFFORT, ()), -0.2)
    assert "hides" in visibility("vertical", Signal("v_z", "m/s"), (Signal("vz_in", "m/s"),))
    turning = meaning_of(Signal("r", "deg/s"), (Signal("yaw_torque"),))
    assert "a motor or propeller" in likely_of_effort(Signal("yaw_torque"), turning, 3.0)
    assert likely_of_effort(Signal("thrust"), meaning_of(Signal("v_z", "m/s"), ()), 3.0) == more
    assert likely_of_effort(Signal("theta_in", "deg"), turning, 3.0) == ""
    assert "while they last" in visibility("thrust", EFFORT, (Signal("vz_in", "m/s"),))


# ------------------------------------------------------------------------------------- the whole way


def test_a_log_that_is_as_it_was(place: Path) -> None:
    done = call("watch", "run", "good.tlog", "--fail", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "v_x <- theta_in: shows faults as they occur" in done.stderr


def test_a_log_with_a_fault_says_when_and_what(place: Path) -> None:
    hook = place / "hook.json"
    words = ("watch", "run", "bad.tlog", "--fail", "--json")
    done = shell(*words, "--exec", f"sh -c 'cat >> {hook}'", cwd=place)
    assert done.returncode == 6, done.stdout + done.stderr
    alarms = [e for e in map(json.loads, done.stdout.splitlines()) if e["kind"] == "alarm"]
    assert alarms[0]["output"] == "v_x"
    assert 12.0 + FAULT_S <= alarms[0]["time_s"] < 12.0 + FAULT_S + 3.0  # 12 s before the first sample
    until = time.monotonic() + 60.0
    while (not hook.exists() or "alarm" not in hook.read_text()) and time.monotonic() < until:
        time.sleep(0.05)
    assert json.loads(hook.read_text().splitlines()[0])["channel"] == "longitudinal"


def test_a_link_is_watched_and_recorded(place: Path) -> None:
    """The faulty flight over UDP, five times as fast as it was flown."""
    port = free_port()
    copy = place / "copy.tlog"
    command = [sys.executable, "-m", "flysid", "watch", str(place / "run"), f"udp:127.0.0.1:{port}"]
    command += ["-o", str(copy), "--json", "--for", "90"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    timer = threading.Timer(120.0, process.kill)
    timer.start()
    try:
        while not copy.exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(0.2)
        threading.Thread(target=play, args=(place / "bad.tlog", port, 5.0), daemon=True).start()
        alarm = next((e for e in map(json.loads, process.stdout) if e["kind"] == "alarm"), None)
        process.terminate()
        process.communicate()
    finally:
        timer.cancel()
        process.kill()
    assert alarm is not None
    assert 12.0 + FAULT_S <= alarm["time_s"] < 12.0 + FAULT_S + 3.0
    assert whole_records(copy.read_bytes(), copy.stat().st_size)[0] > 1000


def test_a_channel_that_does_not_exist_is_named(place: Path) -> None:
    done = call("watch", "run", "good.tlog", "--channel", "lateral", cwd=place)
    assert done.returncode == 2
    assert "no channel 'lateral'" in done.stderr


def test_of_two_senders_one_is_followed() -> None:
    """Two vehicles with one number: their samples are never mixed."""
    follower = Follower([], load_recipe("ardrone-synthetic"), lambda _: None)
    for peer in (3, 4, 3):
        follower.listen(SpoolPiece(bytes([peer]), 1, peer=peer))
    assert follower._waiting == [b"\x03", b"\x03"]
