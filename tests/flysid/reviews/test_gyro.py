"""Where firmwares keep their gyro: batches, FIFOs, instances, debug fields."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.gyro import logged_gyro, motors_hz, throttle_of
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.vibration import review
from tests.flysid.spectra.gyro_logs import BETAFLIGHT, blackbox, dataflash_file, shaken


def flight_of(path: Path, raw: bytes) -> LoggedFlight:
    path.write_bytes(raw)
    return LoggedFlight(FlightLog(flysid.read(path)))


def batches(option: int = 0) -> bytes:
    """ISBH and ISBD: 1024 samples of 2 kHz of gyro 0 every second, others in between."""
    _, x = shaken(12.0, 2000.0, [(370.0, 12.0)], 1.0, 41)
    scale = 32767.0 / np.radians(2000.0)
    rows: list[tuple[int, int, tuple[object, ...]]] = []
    number = 0
    for second in range(2, 11):
        for kind, instance in ((1, 0), (0, 0), (1, 1)):
            begin = second * 2000
            counts = np.rint(np.radians(x[begin : begin + 1024]) * scale).astype(int)
            counts = counts if (kind, instance) == (1, 0) else np.zeros(1024, dtype=int)
            stamp = 1_000_000 * second + 700_000 + 10 * number
            rows.append((42, stamp, (number, kind, instance, round(scale), 1024, 1_000_000 * second, 2000.0)))
            for part in range(32):
                packed = np.asarray(counts[32 * part : 32 * part + 32], dtype="<i2").tobytes()
                rows.append((43, stamp + 1 + part, (number, part, packed, packed, packed)))
            number += 1
    stated = {"INS_GYRO_FILTER": 40.0, "INS_LOG_BAT_OPT": float(option), "INS_LOG_BAT_MASK": 1.0}
    return dataflash_file(rows, stated)


def test_batches_of_ardupilot_are_the_gyro_before_its_filters(tmp_path: Path) -> None:
    flight = flight_of(tmp_path / "a.bin", batches())
    gyro = logged_gyro(flight)
    assert gyro.raw["roll"].rate_hz == pytest.approx(2000.0)
    assert len(gyro.raw["roll"]) == 9 * 1024
    found = {fact.key: fact for fact in review(flight).facts}
    assert found["vibration.peak"].value == pytest.approx(370.0, abs=1.0)
    assert found["vibration.peak_rms"].value == pytest.approx(12.0 / np.sqrt(2.0), rel=0.05)
    assert "folded" not in found["vibration.peak"].note
    assert found["vibration.filter_noise"].value is not None


def test_batches_behind_the_filters_are_not_taken_for_raw(tmp_path: Path) -> None:
    assert not logged_gyro(flight_of(tmp_path / "a.bin", batches(option=2))).raw


def test_a_lost_part_of_a_batch_costs_that_batch_alone(tmp_path: Path) -> None:
    """A batch without its middle has no even samples."""
    whole = batches()
    head = b"\xa3\x95" + bytes([43])
    places = [k for k in range(len(whole) - 3) if whole[k : k + 3] == head]
    cut = places[10]
    flight = flight_of(tmp_path / "a.bin", whole[:cut] + whole[places[11] :])
    assert len(logged_gyro(flight).raw["roll"]) == 8 * 1024


def test_escs_that_state_nothing_are_no_motors(tmp_path: Path) -> None:
    """The simulator writes ESC rows of zeros."""
    still = [(46, 1_000_000 + 100_000 * k, (motor, 0.0)) for k in range(50) for motor in range(4)]
    assert motors_hz(flight_of(tmp_path / "a.bin", dataflash_file(still, {}))) == {}
    turning = [
        (46, 1_000_000 + 100_000 * k, (motor, 6000.0 * motor)) for k in range(50) for motor in range(4)
    ]
    found = motors_hz(flight_of(tmp_path / "b.bin", dataflash_file(turning, {})))
    assert list(found) == [2, 3, 4]
    assert found[4].values[0] == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("debug", "version", "raw"),
    [
        ("6", "4.2.9", True),
        ("0", "4.2.9", False),
        ("6", "3.5.7", False),
        ("6", "4.5.1", True),
        ("6", "4.6.0", False),
        ("6", "2025.12.1", False),
    ],
)
def test_debug_fields_are_the_raw_gyro_only_where_they_say_so(
    tmp_path: Path, debug: str, version: str, raw: bool
) -> None:
    t, x = shaken(2.0, 1000.0, [], 1.0, 1)
    columns = {
        f"{name}[{k}]": np.rint(x).astype(int).tolist() for name in ("gyroADC", "debug") for k in range(3)
    }
    columns["rcCommand[3]"] = (1500 + 0 * np.rint(x).astype(int)).tolist()
    settings = BETAFLIGHT | {
        "debug_mode": debug,
        "Firmware revision": f"Betaflight {version} (e097f4ab7) STM32F7X2",
        "blackbox_high_resolution": "0",
    }
    flight = flight_of(
        tmp_path / "a.bbl", blackbox(settings, columns, (1_000_000 + 1000 * np.arange(len(t))).tolist())
    )
    gyro = logged_gyro(flight)
    assert bool(gyro.raw) is raw
    if raw:
        assert gyro.raw["roll"].values.std() == pytest.approx(x.std(), rel=0.05)
    throttle = throttle_of(flight)
    assert throttle is not None
    assert throttle.values[0] == pytest.approx(0.5)
