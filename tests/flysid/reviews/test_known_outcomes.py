"""Logs of every firmware whose outcome is known: the first sentence of `flysid LOG` names it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from bench import faulty_blackbox, faulty_dataflash, faulty_ulog
from bench.faulty_carriers import travel
from bench.faulty_kinds import CARRIERS
from bench.faulty_logging import DEFAULT, TUNING
from bench.faulty_quadrotor import Flight, Quadrotor
from bench.review_faults import Trial, write
from flysid.ingest.lake.failures import failure_messages, plain_words
from flysid.ingest.lake.motors import read_motors
from flysid.reviews.motor_loss import find_thrust_loss
from tests.command import call
from tests.flysid.reviews.quadrotors import FlightsOf, known
from tests.flysid.reviews.shared_logs import logged, needs_shared
from tests.ingest.lake.test_stretches import log, stream

FAULTY = known()
SOUND = FAULTY["sound"]


@pytest.fixture(scope="module")
def flights(flights_of: FlightsOf) -> Mapping[str, Flight]:
    return flights_of("known")


def first_sentence(path: Path) -> str:
    """As a person reads it: the first line below the log's name."""
    done = call(path.name, cwd=path.parent)
    assert done.returncode == 0, done.stderr
    return done.stdout


CASES = [
    ("motor", "betaflight", "Crashed: impact 157 m/s2", "motor 2 failed"),
    ("propeller", "betaflight", "Crashed: impact", "propeller 2 lost"),
    ("slip", "betaflight", "Motor 3 turns at less than half", "at 23.0 s"),
    ("slip", "px4", "towards motor 2", "while that is driven up"),
    ("brown", "betaflight", "The log ends in the air", "empty battery"),
    ("radio", "betaflight", "Failsafe at 25 s", "radio lost"),
    ("motor", "inav", "Tipped over", "thrust of motor 2 lost"),
    ("dropped", "inav", "Landed hard", "m/s2"),
    ("jam", "inav", "The GPS has only", "satellites at 2"),
    ("jam", "px4", "Something jams the GPS at 25 s", "indicator"),
    ("wires", "copter", "The current turns the compass's field", "%"),
    ("radio", "copter", "Failsafe at 26 s: radio failsafe", "then RTL"),
    ("EKF", "px4", "Failsafe at 28 s: estimate of velocity lost", "then DESCEND"),
]


def check_lead(trial: Trial, flight: Flight, folder: Path, begin: str, end: str) -> None:
    """The review of the trial's log leads with such a line."""
    text = first_sentence(write(trial, flight, folder, "log"))
    line = next(line for line in text.splitlines() if begin in line)
    assert end in line
    assert text.index(begin) < 200


@pytest.mark.parametrize(("kind", "firmware", "begin", "end"), CASES)
def test_a_quadrotor(
    flights: Mapping[str, Flight], kind: str, firmware: str, begin: str, end: str, tmp_path: Path
) -> None:
    trial = Trial(kind, FAULTY[kind], firmware, rpm=True)
    check_lead(trial, flights[kind], tmp_path, begin, end)


BY_DEFAULT = [
    ("propeller", "px4", "at 30 s", "thrust of motor 1 lost"),
    ("flyaway", "copter", "Flew away from its target from 2", " m"),
    ("flyaway", "px4", "Flew away from its target from 2", " m"),
    ("flyaway", "inav", "Flew away from its target from 2", " m"),
    ("starved", "copter", "The log ends in the air at 33 s", "its power was lost, or the log was cut"),
    ("station", "px4", "Failsafe at 27 s", "ground station lost"),
    ("lively", "copter", "Roll and pitch follow", ""),
    ("lively", "px4", "Roll and pitch follow", ""),
    ("lively", "inav", "Roll and pitch follow", ""),
    ("bent", "px4", "a log of 200 Hz does not show how fast", ""),
]


@pytest.mark.parametrize(("kind", "firmware", "begin", "end"), BY_DEFAULT)
def test_a_log_as_its_firmware_logs_it_by_default(
    flights: Mapping[str, Flight], kind: str, firmware: str, begin: str, end: str, tmp_path: Path
) -> None:
    trial = Trial(kind, FAULTY[kind], firmware, rpm=False, logging=DEFAULT.get(firmware, TUNING))
    check_lead(trial, flights[kind], tmp_path, begin, end)


WITHOUT_IMU = [
    ("collision", "deg away from its commanded tilt, and never back"),
    ("loose", "Accelerometer 1 shakes"),
]


@pytest.mark.parametrize(("kind", "words"), WITHOUT_IMU)
def test_a_log_without_its_accelerometers(
    flights: Mapping[str, Flight], kind: str, words: str, tmp_path: Path
) -> None:
    logging = replace(DEFAULT["copter"], lacks=frozenset({"IMU"}))
    trial = Trial(kind, FAULTY[kind], "copter", False, logging=logging)
    text = first_sentence(write(trial, flights[kind], tmp_path, "log"))
    assert words in text
    assert text.index(words) < 200  # it leads


def test_a_hard_landing_without_an_attitude_is_no_crash(
    flights: Mapping[str, Flight], tmp_path: Path
) -> None:
    logging = replace(DEFAULT["px4"], lacks=frozenset({"vehicle_attitude"}))
    trial = Trial("dropped", FAULTY["dropped"], "px4", False, logging=logging)
    text = first_sentence(write(trial, flights["dropped"], tmp_path, "log"))
    assert "Landed hard" in text
    assert "Crashed" not in text


@pytest.mark.parametrize(
    ("firmware", "words"),
    [
        ("copter", "EKF3 lane switch 1"),
        ("copter", "Yaw Imbalance 82%"),
        ("px4", "Compass needs calibration - Land now!"),
    ],
)
def test_a_warning_of_the_firmware_leads(
    flights: Mapping[str, Flight], firmware: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It acts on none of them, and states no error beside."""
    monkeypatch.setitem(faulty_dataflash.INCIDENTS, "yaw", ((), (words,), 0))
    monkeypatch.setitem(faulty_ulog.INCIDENTS, "yaw", (words, faulty_ulog.INCIDENTS["yaw"][1]))
    warned = replace(FAULTY["station"], incident="yaw")
    flight = replace(flights["station"], vehicle=warned)
    check_lead(Trial("warning", warned, firmware, rpm=True), flight, tmp_path, "At 27 s: ", words)


def test_an_emergency_landing_that_drifts_is_no_flyaway(
    flights: Mapping[str, Flight], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """INAV holds no position then: the target in the log is that of the mode before."""
    monkeypatch.setattr(faulty_blackbox, "HOLDING", 23.0)
    trial = Trial("flyaway", FAULTY["flyaway"], "inav", rpm=True)
    text = first_sentence(write(trial, flights["flyaway"], tmp_path, "log"))
    assert "Flew away" not in text


def test_a_blackbox_without_speeds_names_the_motor_that_was_driven_up(
    flights: Mapping[str, Flight], tmp_path: Path
) -> None:
    path = write(Trial("motor", FAULTY["motor"], "betaflight", rpm=False), flights["motor"], tmp_path, "log")
    assert "thrust of motor 2 lost" in first_sentence(path)


@pytest.mark.parametrize("firmware", ["betaflight", "inav"])
def test_a_sound_quadrotor(flights: Mapping[str, Flight], firmware: str, tmp_path: Path) -> None:
    text = first_sentence(write(Trial("sound", SOUND, firmware, True), flights["sound"], tmp_path, "log"))
    assert "Roll and pitch follow well" in text


OF_CARRIERS: dict[str, tuple[Quadrotor, dict[str, str]]] = {
    "motor": (FAULTY["motor"], {"plane": "The motor stops at", "rover": "The motor stops at"}),
    "crash": (
        replace(SOUND, incident="crash", incident_s=30.0),
        {"plane": "Crashed: impact", "rover": "The drive ended badly at 31 s: crash"},
    ),
    "brown": (
        FAULTY["brown"],
        {"plane": "in the air at 33 s: brown-out", "rover": "on the way at 33 s: brown-out"},
    ),
    "radio": (
        FAULTY["radio"],
        {"plane": "26 s: RC Short Failsafe On, then CIRCLE", "rover": "radio failsafe, then HOLD"},
    ),
    "jam": (FAULTY["jam"], {"plane": "The GPS has only", "rover": "The GPS has only"}),
}  # fmt: skip


@pytest.mark.parametrize("firmware", CARRIERS)
@pytest.mark.parametrize("kind", OF_CARRIERS)
def test_a_plane_and_a_rover(kind: str, firmware: str, tmp_path: Path) -> None:
    vehicle, sentences = OF_CARRIERS[kind]
    flight = travel(vehicle, CARRIERS[firmware])
    trial = Trial(kind, vehicle, firmware, rpm=False, imu_hz=50.0)
    text = first_sentence(write(trial, flight, tmp_path, "log"))
    assert sentences[firmware] in text
    assert text.index(sentences[firmware]) < 200
    assert "hover throttle" not in text


def test_messages_that_only_sound_like_failures() -> None:
    texts = [
        "PreArm: Battery 1 low voltage",
        "[logger] Opened full log file: /fs/microsd/log/lost.ulg",
        "EKF3 IMU0 is using GPS",
        "GPS Glitch cleared",
        "primary EKF changed 0 -> 1 (user selected)",
        "Compass calibration failed",
        "EKF primary changed:0",
        "Mission: 3 WP",
    ]
    told = log(MSG=stream([1.0 + i for i in range(len(texts))], Message=texts))
    assert not failure_messages(told)


@pytest.mark.parametrize(
    "text",
    [
        "Battery 1 is low 13.92V used 3104 mAh",
        "[health_and_arming_checks] Low battery\t",
        "Potential Thrust Loss (3)",
        "GPS Glitch or Compass error",
        "RC Short Failsafe On",
        "Crash: Going to HOLD",
        "EKF variance: over thresholds",
        "EKF3 lane switch 1",
        "NavEKF2: lane switch 1",
        "primary EKF changed 0 (filter fault) -> 1",
        "Yaw Imbalance 82%",
        "Compass needs calibration - Land now!\t",
        "[health_and_arming_checks] Compass 0 fault",
    ],
)
def test_messages_of_failures(text: str) -> None:
    (found,) = failure_messages(log(MSG=stream([3.0], Message=[text])))
    assert plain_words(found.text) == text.strip().rpartition("] ")[2]


@needs_shared
def test_no_real_flight_falls_towards_a_motor() -> None:
    for name in ("ulog/quad_position_76s.ulg", "ulog/quad_stabilised_92s.ulg"):
        flight = logged(name)
        assert find_thrust_loss(flight, read_motors(flight)) is None
