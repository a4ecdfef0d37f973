"""Filters run again on a log's raw gyro, against independent filters that wrote the log's filtered one."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import signal

import flysid
from flysid.cli.filters import command as filters
from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.filters import gyro_chain, replayable
from flysid.reviews.gyro import logged_gyro
from flysid.reviews.logged import LoggedFlight
from flysid.spectra.replay import Replayed
from tests.flysid.spectra.gyro_logs import BETAFLIGHT, blackbox, dataflash_file, shaken, ulog_file

LOGS = Path("../shared/logs/blackbox")


def flight_of(raw: bytes, path: Path) -> LoggedFlight:
    path.write_bytes(raw)
    return LoggedFlight(FlightLog(flysid.read(path)))


def replayed(flight: LoggedFlight, axis: str = "roll") -> Replayed:
    gyro = logged_gyro(flight)
    return replayable(flight, gyro).compare(gyro_chain(flight, gyro), axis)


def first_order(x: FloatArray, hz: FloatArray | float, rate: float) -> FloatArray:
    """As a firmware writes it: y += k (x - y), k = dt / (RC + dt)."""
    y, out = x[0], np.empty(len(x))
    edges = np.broadcast_to(hz, len(x))
    for n in range(len(x)):
        rc = 1.0 / (2.0 * np.pi * edges[n])
        y += (1.0 / rate) / (rc + 1.0 / rate) * (x[n] - y)
        out[n] = y
    return out


def settled(law: tuple[FloatArray, FloatArray], x: FloatArray) -> FloatArray:
    b, a = law
    return np.asarray(signal.lfilter(b, a, x, zi=signal.lfilter_zi(b, a) * x[0])[0])


def notch(hz: float, edge: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """Betaflight's, of a centre and a cutoff."""
    q = hz * edge / (hz * hz - edge * edge)
    w = 2.0 * np.pi * hz / rate
    alpha = np.sin(w) / (2.0 * q)
    return (
        np.array([1.0, -2.0 * np.cos(w), 1.0]) / (1.0 + alpha),
        np.array([1.0, -2.0 * np.cos(w) / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha)]),
    )


def betaflight_log(
    path: Path, every: int, slower: float = 1.0, lie: dict[str, str] | None = None, fault: str = ""
) -> LoggedFlight:
    """Second low-pass at 8 kHz, then notch and dynamic low-pass at 4 kHz; a row every so many loops."""
    rate = 8000.0
    t, x = shaken(3.0, rate, [(190.0, 6.0), (420.0, 4.0)], 3.0, 7)
    fine = np.convolve(x, np.ones(9) / 9.0, "same")  # a sensor has an edge of its own
    opened = np.round(np.clip(0.45 + 0.25 * np.sin(2.0 * np.pi * 0.4 * t), 0.0, 1.0), 3)
    sampled = first_order(fine, 500.0, rate)[1::2]
    throttle = opened[1::2]
    behind = settled(notch(200.0, 150.0, rate / 2.0), sampled)
    held, steps, last = np.empty(len(behind)), np.rint(throttle * 100.0), -np.inf
    now = 0.0
    for n in range(len(behind)):
        held[n] = now  # the mixer sets it after the gyro was filtered
        if n / (rate / 2.0) - last >= 0.005 and steps[n] / 100.0 != now:
            now, last = steps[n] / 100.0, n / (rate / 2.0)
    edge = 200.0 + 300.0 * (held * (1.0 - held) * 0.5 + held)
    behind = first_order(behind, edge, rate / 2.0)
    rows = slice(0, len(behind), every)
    stamps = np.rint(1e6 + 250.0 * slower * np.arange(len(behind))).astype(int)
    raw = np.rint(10.0 * fine[1::2]).astype(int)
    columns = {f"gyroUnfilt[{k}]": raw[rows].tolist() for k in range(3)}
    columns |= {f"gyroADC[{k}]": np.rint(10.0 * behind).astype(int)[rows].tolist() for k in range(3)}
    columns |= {f"setpoint[{k}]": [0] * len(raw[rows]) for k in range(3)}
    columns["setpoint[3]"] = np.rint(1000.0 * throttle).astype(int)[rows].tolist()
    if fault == "no raw":
        columns = {name: values for name, values in columns.items() if "Unfilt" not in name}
    settings = BETAFLIGHT | {
        "gyro_lpf1_dyn_hz": "200,500",
        "gyro_lpf1_dyn_expo": "5",
        "gyro_lpf2_static_hz": "500",
        "gyro_notch_hz": "200,0",
        "gyro_notch_cutoff": "150,0",
        **(lie or {}),
    }
    return flight_of(blackbox(settings, columns, stamps[rows].tolist(), every), path)


def test_betaflights_chain_is_run_again_on_every_row(tmp_path: Path) -> None:
    found = replayed(betaflight_log(tmp_path / "a.bbl", 1))
    assert found.share < 0.03
    assert found.rows > 10_000


def test_rows_of_every_other_loop_are_nearly_as_good(tmp_path: Path) -> None:
    assert replayed(betaflight_log(tmp_path / "a.bbl", 2)).share < 0.10


@pytest.mark.parametrize(
    "lie", [{"gyro_notch_hz": "0,0"}, {"gyro_lpf2_static_hz": "200"}, {"gyro_lpf1_dyn_hz": "50,125"}]
)
def test_a_header_that_states_other_filters_shows(tmp_path: Path, lie: dict[str, str]) -> None:
    assert replayed(betaflight_log(tmp_path / "a.bbl", 1, lie=lie)).share > 0.10


def test_a_loop_that_runs_slower_has_lower_edges_and_the_same_replay(tmp_path: Path) -> None:
    one, other = betaflight_log(tmp_path / "a.bbl", 1), betaflight_log(tmp_path / "b.bbl", 1, slower=1.125)
    chains = [gyro_chain(flight, logged_gyro(flight)) for flight in (one, other)]
    assert chains[1].delay_s(10.0) == pytest.approx(1.125 * chains[0].delay_s(10.0), rel=0.01)
    assert replayed(other).share < 0.03


def test_notches_that_are_not_in_the_log_are_refused(tmp_path: Path) -> None:
    rpm = {"rpm_filter_harmonics": "3", "rpm_filter_q": "500", "rpm_filter_min_hz": "100", "dshot_bidir": "1"}
    with pytest.raises(DataError, match="does not hold the motors' RPM"):
        replayed(betaflight_log(tmp_path / "a.bbl", 1, lie=rpm))
    dynamic = {"dyn_notch_count": "3", "features": str(1 << 29)}
    with pytest.raises(DataError, match="dynamic notches"):
        replayed(betaflight_log(tmp_path / "b.bbl", 1, lie=dynamic))


def test_notches_that_are_set_and_never_ran_are_named(tmp_path: Path) -> None:
    """They were left out without a word: whoever set them believed in them."""
    off = {"rpm_filter_harmonics": "3", "rpm_filter_q": "500", "rpm_filter_min_hz": "100", "dshot_bidir": "0"}
    betaflight_log(tmp_path / "a.bbl", 1, lie=off)
    done = CliRunner().invoke(filters, [str(tmp_path / "a.bbl")], standalone_mode=False)
    assert done.exception is None
    assert "set, but did not run: 3 RPM notches for each motor: dshot_bidir is off" in " ".join(
        done.output.split()
    )


def test_a_log_without_the_raw_gyro_says_what_logs_it(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="only behind the filters") as refused:
        replayed(betaflight_log(tmp_path / "a.bbl", 1, fault="no raw"))
    assert "gyroUnfilt" in refused.value.hint


def test_rpm_notches_follow_the_logged_motors(tmp_path: Path) -> None:
    """One motor of 14 poles; its second harmonic is notched, and fades in over 50 Hz."""
    rate = 4000.0
    t, x = shaken(5.0, rate, [], 2.0, 3)
    turns = 120.0 + 60.0 * np.sin(2.0 * np.pi * 0.3 * t)
    x = x + 10.0 * np.sin(4.0 * np.pi * np.cumsum(turns) / rate)
    erpm = np.rint(turns * 60.0 * 7.0 / 100.0)
    logged = erpm * 100.0 / 7.0 / 60.0
    y = x
    for harmonic in (1, 2):
        y = _moving_notch(
            y, np.maximum(harmonic * logged, 100.0), 5.0, (harmonic * logged - 100.0) / 50.0, rate
        )
    columns = {f"gyroUnfilt[{k}]": np.rint(10.0 * x).astype(int).tolist() for k in range(3)}
    columns |= {f"gyroADC[{k}]": np.rint(10.0 * y).astype(int).tolist() for k in range(3)}
    columns["eRPM[0]"] = erpm.astype(int).tolist()
    settings = BETAFLIGHT | {
        "gyro_lpf1_static_hz": "0",
        "rpm_filter_harmonics": "2",
        "rpm_filter_q": "500",
        "rpm_filter_min_hz": "100",
        "rpm_filter_fade_range_hz": "50",
        "rpm_filter_weights": "100,100,100",
        "dshot_bidir": "1",
        "motor_poles": "14",
    }
    stamps = (1_000_000 + 250 * np.arange(len(x))).tolist()
    assert replayed(flight_of(blackbox(settings, columns, stamps), tmp_path / "a.bbl")).share < 0.03


def _moving_notch(x: FloatArray, hz: FloatArray, q: float, share: FloatArray, rate: float) -> FloatArray:
    out = np.empty(len(x))
    x1 = x2 = y1 = y2 = x[0]
    for n in range(len(x)):
        w = 2.0 * np.pi * hz[n] / rate
        alpha, cosine = np.sin(w) / (2.0 * q), np.cos(w)
        y = (x[n] - 2.0 * cosine * x1 + x2 + 2.0 * cosine * y1 - (1.0 - alpha) * y2) / (1.0 + alpha)
        x2, x1, y2, y1 = x1, x[n], y1, y
        weight = min(max(share[n], 0.0), 1.0)
        out[n] = weight * y + (1.0 - weight) * x[n]
    return out


def test_ardupilots_harmonic_notch_is_run_again_on_the_gyro_before_it(tmp_path: Path) -> None:
    """INS_RAW_LOG_OPT 9: GYR 0 before, GYR 1 behind the notch (first and third harmonic) and the low-pass."""
    rate = 1000.0
    t, x = shaken(8.0, rate, [(80.0, 9.0), (240.0, 4.0)], 1.0, 11)
    x = np.radians(x)
    y = x
    octaves = np.log2(80.0 / (80.0 - 20.0)) * 2.0
    q = np.sqrt(2.0**octaves) / (2.0**octaves - 1.0)
    for centre in (80.0, 240.0):
        w = 2.0 * np.pi * centre / rate
        alpha, gain = np.sin(w) / (2.0 * q), 10.0 ** (-30.0 / 20.0)
        b = np.array([1.0 + alpha * gain, -2.0 * np.cos(w), 1.0 - alpha * gain])
        a = np.array([1.0 + alpha, -2.0 * np.cos(w), 1.0 - alpha])
        y = settled((b / (1.0 + alpha), a / (1.0 + alpha)), y)
    y = settled(signal.butter(2, 60.0, fs=rate), y)
    stamps = (5_000_000 + 1000 * np.arange(len(t))).tolist()
    rows = [
        (41, stamp, (instance, stamp, *[float(value)] * 3))
        for instance, values in ((0, x), (1, y))
        for stamp, value in zip(stamps, values, strict=True)
    ]
    stated = {
        "INS_RAW_LOG_OPT": 9.0,
        "INS_GYRO_FILTER": 60.0,
        "INS_HNTCH_ENABLE": 1.0,
        "INS_HNTCH_MODE": 0.0,
        "INS_HNTCH_FREQ": 80.0,
        "INS_HNTCH_BW": 40.0,
        "INS_HNTCH_ATT": 30.0,
        "INS_HNTCH_HMNCS": 5.0,
    }
    flight = flight_of(dataflash_file(rows, stated), tmp_path / "a.bin")
    assert replayed(flight).share < 0.01
    assert (
        replayed(
            flight_of(dataflash_file(rows, stated | {"INS_HNTCH_FREQ": 100.0}), tmp_path / "b.bin")
        ).share
        > 0.1
    )


def test_px4s_filters_run_on_the_samples_of_the_fifo(tmp_path: Path) -> None:
    """Eight samples a row at 8 kHz; vehicle_angular_velocity is the filtered value of a row's last sample."""
    rate, a_row = 8000.0, 8
    t, x = shaken(4.0, rate, [(130.0, 8.0)], 2.0, 13)
    counts = np.rint(np.radians(x) / 0.001).astype(int)
    seen = counts * 0.001
    y = settled(signal.iirnotch(130.0, 130.0 / 20.0, fs=rate), seen)
    y = settled(signal.butter(2, 80.0, fs=rate), y)
    fifo, filtered = [], []
    for k in range(0, len(t) - a_row + 1, a_row):
        last_us = 2_000_000 + 125 * (k + a_row - 1)
        samples = list(counts[k : k + a_row]) + [0] * (32 - a_row)
        fifo.append(
            struct.pack("<QQIffB32h32h32h", last_us + 80, last_us, 7, 125.0, 0.001, a_row, *samples * 3)
        )
        filtered.append(struct.pack("<QQ3f", last_us + 300, last_us, *[y[k + a_row - 1]] * 3))
    fields = "uint64_t timestamp_sample;"
    topics = {
        "sensor_gyro_fifo": (
            fields + "uint32_t device_id;float dt;float scale;uint8_t samples;"
            "int16_t[32] x;int16_t[32] y;int16_t[32] z;",
            fifo,
        ),
        "vehicle_angular_velocity": (fields + "float[3] xyz;", filtered),
    }
    stated = {"IMU_GYRO_CUTOFF": 80.0, "IMU_GYRO_NF0_FRQ": 130.0, "IMU_GYRO_NF0_BW": 20.0}
    flight = flight_of(ulog_file(topics, stated), tmp_path / "a.ulg")
    assert replayed(flight).share < 0.01
    assert (
        replayed(flight_of(ulog_file(topics, stated | {"IMU_GYRO_NF0_FRQ": 0.0}), tmp_path / "b.ulg")).share
        > 0.05
    )


@pytest.mark.skipif(not LOGS.exists(), reason="needs ../shared/logs")
def test_real_logs_state_their_chains() -> None:
    """hiro's loop runs 140.7 us where 125 are nominal; btfl_002 hides its notches."""
    hiro = LoggedFlight(FlightLog(flysid.read(LOGS / "hiro_highP_highD.bfl")))
    chain = gyro_chain(hiro, logged_gyro(hiro))
    assert chain.fastest_hz == pytest.approx(1e6 / 140.7, rel=0.002)
    analog = signal.TransferFunction([1.0], [1.0 / (2.0 * np.pi * 90.0 / 1.1256), 1.0])
    alone = -np.angle(signal.freqresp(analog, [2.0 * np.pi * 10.0])[1][0]) / (2.0 * np.pi * 10.0)
    assert chain.delay_s(10.0) > alone  # two notches besides
    assert chain.delay_s(10.0) == pytest.approx(3.58e-3, rel=0.01)
    hidden = LoggedFlight(FlightLog(flysid.read(LOGS / "btfl_002.bbl")))
    with pytest.raises(DataError, match=r"RPM.*dynamic notches"):
        replayed(hidden)
