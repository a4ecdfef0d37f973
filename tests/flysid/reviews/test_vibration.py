"""Section "Vibration and filters" against scipy on rows of pymavlink and pyulog, and on logs made here."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import flysid
from flysid.dataset import FloatArray
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.fact import Fact, Grade, Section
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.vibration import review
from tests.flysid.spectra.gyro_logs import BETAFLIGHT, blackbox, dataflash_file, shaken

SHARED = Path("../shared/logs")
needs_logs = pytest.mark.skipif(not SHARED.exists(), reason="needs ../shared/logs")


def flight_of(path: Path, raw: bytes | None = None) -> LoggedFlight:
    if raw is not None:
        path.write_bytes(raw)
    return LoggedFlight(FlightLog(flysid.read(path)))


def facts(section: Section) -> dict[str, Fact]:
    return {fact.key.partition(".")[2]: fact for fact in section.facts}


def number(fact: Fact) -> float:
    assert isinstance(fact.value, float), fact
    return fact.value


def dataflash_rows(path: Path, message: str, fields: list[str]) -> FloatArray:
    """(N, 1 + fields) by pymavlink: seconds since boot, values."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    rows = []
    while (found := log.recv_match(type=message)) is not None:
        rows.append([found.TimeUS * 1e-6, *(getattr(found, name) for name in fields)])
    log.close()
    return np.array(rows)


def pyulog_data(path: Path, topic: str) -> dict[str, FloatArray]:
    """Columns of the first instance of a topic."""
    from pyulog import ULog

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found: dict[str, FloatArray] = ULog(str(path)).get_dataset(topic, 0).data
    return found


@needs_logs
def test_ardupilots_vibration_is_pymavlinks() -> None:
    path = SHARED / "dataflash/copter_437s.bin"
    flight = flight_of(path)
    found = facts(review(flight))
    rows = dataflash_rows(path, "VIBE", ["VibeX", "VibeY", "VibeZ", "Clip0"])
    first_s = flight.clock.begins_ns[0] * 1e-9
    air = flight.flying(rows[:, 0] - first_s)
    assert number(found["accel_level"]) == pytest.approx(np.median(rows[air, 1:4], axis=0).max())
    assert number(found["accel_peak"]) == pytest.approx(rows[air, 1:4].max())
    assert number(found["accel_clips"]) == np.ptp(rows[air, 4]) == 0.0
    assert found["accel_level"].grade is Grade.GOOD
    assert found["gyro_mid"].missing == "the gyro is logged too slowly"
    assert "INS_RAW_LOG_OPT" in found["gyro_mid"].remedy


@needs_logs
def test_an_oscillation_in_slow_rows_of_two_instances_has_no_certain_frequency() -> None:
    """SIM2 shows 15.05 Hz; each IMU is logged 25 times a second, where that is 9.95 Hz."""
    path = SHARED / "dataflash/sitl_copter_49s.BIN"
    flight = flight_of(path)
    section = review(flight)
    rows = dataflash_rows(path, "IMU", ["I", "GyrX"])
    one = rows[rows[:, 1] == 0.0]
    one = one[flight.flying(one[:, 0] - flight.clock.begins_ns[0] * 1e-9)]
    hz, density = signal.welch(np.degrees(one[:, 2]), 25.0, nperseg=512)
    found = facts(section)
    assert number(found["peak"]) == pytest.approx(hz[density.argmax()], abs=0.1)
    assert number(found["peak_rms"]) == pytest.approx(np.std(np.degrees(one[:, 2])), rel=0.05)
    assert "folded from 15, 35" in found["peak"].note
    (first, *others) = section.findings
    assert first.grade is Grade.BAD
    assert first.text.startswith("Roll and pitch shake by 9")
    assert first.text.endswith("; a log of 25 Hz does not show how fast")
    assert not others  # "vibration is low" would sound like praise
    assert not section.actions


@needs_logs
@pytest.mark.parametrize(
    ("name", "grade"),
    [
        ("quad_position_76s", Grade.WATCH),
        ("quad_stabilised_92s", Grade.GOOD),
        ("quad_manual_aggressive_80s", Grade.BAD),
    ],
)
def test_px4s_vibration_is_pyulogs(name: str, grade: Grade) -> None:
    path = SHARED / f"ulog/{name}.ulg"
    flight = flight_of(path)
    found = facts(review(flight))
    status = pyulog_data(path, "vehicle_imu_status")
    stamps = status["timestamp"] * 1e-6 - flight.clock.begins_ns[0] * 1e-9
    air = flight.flying(stamps)
    assert number(found["accel_level"]) == pytest.approx(
        np.median(status["accel_vibration_metric"][air]), rel=1e-6
    )
    clips = max(np.ptp(status[f"accel_clipping[{axis}]"][air].astype(float)) for axis in range(3))
    assert number(found["accel_clips"]) == clips
    assert found["accel_level"].grade is grade


@needs_logs
def test_a_folded_peak_is_known_from_the_onboard_spectrum() -> None:
    """sensor_combined at 221 Hz shows 85 to 110 Hz; the onboard FFT sees 98 to 142 Hz and folds to it."""
    section = review(flight_of(SHARED / "ulog/quad_position_76s.ulg"))
    assert "the onboard FFT's peak, folded" in facts(section)["peak"].note
    (first, *_) = section.findings
    assert first.text == "Roll, pitch and yaw shake by 7.65 deg/s at 132 Hz"
    seen = pyulog_data(SHARED / "ulog/quad_position_76s.ulg", "sensor_gyro_fft")["peak_frequencies_y[0]"]
    assert np.nanmedian(seen) == pytest.approx(132.0, abs=1.0)
    assert "logged at 221 Hz, where it shows at 109 Hz" in first.more


@needs_logs
def test_gyro_noise_of_a_racer_is_welchs() -> None:
    flight = flight_of(SHARED / "blackbox/greenreaper_flight14.bfl")
    column = flight.quantity("main.gyroADC[2]", unit="deg/s")
    assert column is not None
    hz, density = signal.welch(column.values, 969.7, nperseg=970, detrend="constant")
    inside = (hz >= 20.0) & (hz < 80.0)
    expected = np.sqrt(density[inside].sum() * (hz[1] - hz[0]))
    found = facts(review(flight))
    assert number(found["gyro_mid"]) == pytest.approx(expected, rel=0.1)
    assert number(found["gyro_rate"]) == pytest.approx(969.7, rel=2e-3)
    assert number(found["filter_delay"]) == pytest.approx(2.18, rel=0.01)
    assert found["filter_delay"].note.startswith("without: dynamic notches")
    assert "low-passed at 10 Hz" in found["accel_level"].missing


def test_clips_count_from_take_off_and_a_counter_may_start_above_zero(tmp_path: Path) -> None:
    rows = [
        (
            45,
            1_000_000 + 100_000 * k,
            (imu, 10.0, 12.0, 35.0 if k == 70 else 20.0, 44 + max(0, k - 60) * (imu == 1)),
        )
        for k in range(100)
        for imu in (0, 1)
    ]
    found = facts(review(flight_of(tmp_path / "a.bin", dataflash_file(rows, {"INS_GYRO_FILTER": 20.0}))))
    assert number(found["accel_clips"]) == 39.0
    assert found["accel_clips"].fields == ("VIBE[1].Clip",)
    assert found["accel_peak"].at_s == pytest.approx(8.0, abs=1e-3)
    assert found["accel_peak"].grade is Grade.WATCH


def raw_log(
    tmp_path: Path, tones: list[tuple[float, float]], moves: bool = True, notch: str = "0,0"
) -> Section:
    """4 kHz gyro before and behind a low-pass of 250 Hz; the throttle moves."""
    rate = 4000.0
    t, x = shaken(15.0, rate, tones, 1.0, 21)
    throttle = 0.45 + (0.2 if moves else 0.0) * np.sin(2.0 * np.pi * t / 7.0)
    w = 2.0 * np.pi * 250.0 / rate
    behind = signal.lfilter([w / (w + 1.0)], [1.0, w / (w + 1.0) - 1.0], x)
    columns = {f"gyroUnfilt[{k}]": np.rint(10.0 * x).astype(int).tolist() for k in range(3)}
    columns |= {f"gyroADC[{k}]": np.rint(10.0 * behind).astype(int).tolist() for k in range(3)}
    columns |= {f"setpoint[{k}]": [0] * len(t) for k in range(3)}
    columns["setpoint[3]"] = np.rint(1000.0 * throttle).astype(int).tolist()
    settings = BETAFLIGHT | {"gyro_notch_hz": notch, "gyro_notch_cutoff": "100,0"}
    stamps = (1_000_000 + 250 * np.arange(len(t))).tolist()
    return review(flight_of(tmp_path / "a.bbl", blackbox(settings, columns, stamps)))


def test_a_steady_tone_before_the_filters_gets_a_notch_with_its_effect(tmp_path: Path) -> None:
    section = raw_log(tmp_path, [(150.0, 25.0)])
    (action,) = section.actions
    assert [change.name for change in action.changes] == ["gyro_notch1_hz", "gyro_notch1_cutoff"]
    assert action.changes[0].new == 150.0
    _, x = shaken(15.0, 4000.0, [(150.0, 25.0)], 1.0, 21)
    w, edge = 2.0 * np.pi * 250.0 / 4000.0, action.changes[1].new
    behind = signal.lfilter([w / (w + 1.0)], [1.0, w / (w + 1.0) - 1.0], x)
    width = 150.0 / (150.0 * edge / (150.0**2 - edge**2))
    notched = signal.lfilter(*signal.iirnotch(150.0, 150.0 / width, fs=4000.0), behind)
    high = signal.butter(4, 20.0, "high", fs=4000.0, output="sos")
    left = np.std(signal.sosfilt(high, notched)[4000:]) / np.std(signal.sosfilt(high, behind)[4000:])
    stated = float(action.predicted.rpartition("-")[2].split()[0])
    assert stated == pytest.approx(100.0 * (1.0 - left), abs=3.0)
    found = facts(section)
    assert number(found["filter_noise"]) == pytest.approx(
        np.std(signal.sosfilt(high, behind)[4000:]), rel=0.1
    )
    assert number(found["peak"]) == pytest.approx(150.0, abs=0.5)


def test_no_notch_without_evidence(tmp_path: Path) -> None:
    assert not raw_log(tmp_path, []).actions
    assert not raw_log(tmp_path, [(150.0, 25.0)], moves=False).actions  # it may follow the motors
    assert not raw_log(tmp_path, [(150.0, 25.0)], notch="200,300").actions  # both notches are taken


def test_a_log_without_a_gyro_says_so(tmp_path: Path) -> None:
    rows = [(44, 1_000_000 + 100_000 * k, (0.5, 0.5)) for k in range(100)]
    section = review(flight_of(tmp_path / "a.bin", dataflash_file(rows, {})))
    found = facts(section)
    assert found["gyro_rate"].missing == "the log holds no gyro"
    assert found["accel_level"].missing
    assert "VIBE" in found["accel_level"].remedy
    assert not section.shown
    assert not section.findings


def test_ten_rows_a_second_are_too_few_for_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rows = [
        (47, 1_000_000 + 100_000 * k, (0, *rng.normal(0.0, 0.1, 6), 0, 0, 20.0, 1, 1, 1000, 1000))
        for k in range(300)
    ]
    found = facts(review(flight_of(tmp_path / "a.bin", dataflash_file(rows, {"INS_GYRO_FILTER": 20.0}))))
    assert found["gyro_mid"].missing == "the gyro is logged too slowly"
    assert number(found["gyro_rate"]) == pytest.approx(10.0, rel=1e-3)


def turning_log(tmp_path: Path, size: float, seed: int, apart: float = 0.06) -> Section:
    """Four motors whose turns the log holds; the third shakes by this size, the others a little."""
    rate = 2000.0
    rng = np.random.default_rng(seed)
    t, x = shaken(20.0, rate, [], 1.0, seed)
    base = 110.0 + 12.0 * np.interp(t, np.arange(0.0, 40.0, 2.0), rng.normal(size=20))
    own = [np.interp(t, np.arange(0.0, 40.0, 1.5), rng.normal(size=27)) for _ in range(4)]
    turns = [base * (1.0 + apart * one) for one in own]
    for number, hz in enumerate(turns):
        x = x + (size if number == 2 else 1.0) * np.sin(2.0 * np.pi * np.cumsum(hz) / rate)
    raw = np.rint(10.0 * x).astype(int).tolist()
    columns = {f"{name}[{k}]": raw for name in ("gyroUnfilt", "gyroADC") for k in range(3)}
    columns |= {
        f"eRPM[{k}]": np.rint(hz * 60.0 * 7.0 / 100.0).astype(int).tolist() for k, hz in enumerate(turns)
    }
    settings = BETAFLIGHT | {"motor_poles": "14", "looptime": "500", "pid_process_denom": "1"}
    stamps = (1_000_000 + 500 * np.arange(len(t))).tolist()
    return review(flight_of(tmp_path / f"{seed}.bbl", blackbox(settings, columns, stamps)))


def test_a_bent_shaft_is_that_motors(tmp_path: Path) -> None:
    for seed in (51, 52):
        section = turning_log(tmp_path, 12.0, seed)
        (first, *_) = section.findings
        assert first.text.startswith("Motor 3 shakes")
        assert first.grade is Grade.WATCH
        assert [action.title for action in section.actions] == ["Check motor 3: propeller, shaft, bearings"]


def test_sound_motors_are_not_accused(tmp_path: Path) -> None:
    for seed in (61, 62):
        section = turning_log(tmp_path, 1.0, seed)
        assert facts(section)["worst_motor"].value == "none stands out"
        assert not section.findings
        assert not section.actions
    alike = turning_log(tmp_path, 12.0, 64, apart=0.0)
    assert facts(alike)["worst_motor"].value == "none stands out"  # four motors that turn alike
    assert not any("motor" in action.title for action in alike.actions)


def oscillating(tmp_path: Path, stick_hz: float) -> Section:
    """Roll turns by 40 deg/s at 6 Hz; the stick moves at a frequency."""
    rate = 500.0
    t, x = shaken(25.0, rate, [(6.0, 40.0)], 0.5, 71)
    columns = {f"gyroADC[{k}]": np.rint(10.0 * x).astype(int).tolist() for k in range(3)}
    stick = 150.0 * np.sin(2.0 * np.pi * stick_hz * t)
    columns |= {f"rcCommand[{k}]": np.rint(10.0 * stick).astype(int).tolist() for k in range(3)}
    stamps = (1_000_000 + 2000 * np.arange(len(t))).tolist()
    settings = BETAFLIGHT | {"looptime": "2000", "pid_process_denom": "1"}
    return review(flight_of(tmp_path / f"{stick_hz:g}.bbl", blackbox(settings, columns, stamps)))


def test_what_the_pilot_asks_for_is_no_oscillation(tmp_path: Path) -> None:
    (own, *_) = oscillating(tmp_path, 0.5).findings
    assert own.grade is Grade.WATCH
    assert own.text == "Roll, pitch and yaw shake by 27.5 deg/s at 6 Hz"  # 494 Hz would be 85,000 deg/s2
    assert not oscillating(tmp_path, 6.0).findings
