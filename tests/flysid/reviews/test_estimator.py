"""Estimator and sensors: each figure against an independent computation on rows of other readers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import Flight
from bench.faulty_ulog import ulog_bytes
from flysid.reviews.estimator import review
from flysid.reviews.fact import Fact, Grade, Section
from flysid.reviews.gps import Receiver, find_jump
from flysid.reviews.logged import Column
from tests.flysid.reviews.quadrotors import FlightsOf
from tests.flysid.reviews.shared_logs import dataflash_values, logged, needs_shared, open_logged, ulog_values

COPTER = "dataflash/copter_437s.bin"
STABILISED = "ulog/quad_stabilised_92s.ulg"
AGGRESSIVE = "ulog/quad_manual_aggressive_80s.ulg"


def fact_of(section: Section, key: str) -> Fact:
    return next(fact for fact in section.facts if fact.key == f"estimator.{key}")


def value_of(section: Section, key: str) -> float:
    value = fact_of(section, key).value
    assert isinstance(value, float)
    return value


# ------------------------------------------------------------------------------------- real flights


@needs_shared
def test_a_copter_that_another_reader_reads() -> None:
    section = review(logged(COPTER))
    ratios = dataflash_values(COPTER, "NKF4", "SV", "SP", "SH", "SM")[:, 1:]
    assert value_of(section, "test_ratio") == pytest.approx(ratios.max(), abs=0.01)
    gps = dataflash_values(COPTER, "GPS", "NSats", "HDop")
    assert value_of(section, "satellites") == pytest.approx(np.percentile(gps[:, 1], 5.0), abs=1.0)
    assert value_of(section, "hdop") == pytest.approx(np.percentile(gps[:, 2], 95.0), abs=0.08)
    first, second = (
        dataflash_values(COPTER, name, "AccX", "AccY", "AccZ")[:, 1:] for name in ("IMU", "IMU2")
    )
    assert value_of(section, "accel_disagreement") == pytest.approx(
        np.linalg.norm(np.median(first, axis=0) - np.median(second, axis=0)), abs=0.02
    )
    height = dataflash_values(COPTER, "BARO", "Alt")
    above = dataflash_values(COPTER, "GPS", "Alt")
    apart = above[:, 1] - np.interp(above[:, 0], height[:, 0], height[:, 1])
    drift = np.polyval(np.polyfit(above[:, 0], apart, 1), above[:, 0])
    assert value_of(section, "baro_gps") == pytest.approx(np.std(apart - drift), rel=0.1)


@needs_shared
def test_a_receiver_without_a_fix_says_only_that() -> None:
    section = review(logged(STABILISED))
    assert value_of(section, "gps_fix") == 0.0
    keys = {fact.key for fact in section.facts}
    assert not keys & {
        "estimator.eph",
        "estimator.satellites",
        "estimator.gps_jump",
    }  # 4.29e6 m is no accuracy
    assert any(finding.text == "No GPS fix" for finding in section.findings)


@needs_shared
def test_jamming_of_a_real_flight() -> None:
    _, jamming = ulog_values(AGGRESSIVE, "sensor_gps", "jamming_indicator")
    found = value_of(review(logged(AGGRESSIVE)), "jamming")
    assert np.percentile(jamming, 85.0) < found <= jamming.max()


@needs_shared
def test_a_field_that_changes_indoors_is_not_blamed_on_the_current() -> None:
    section = review(logged("ulog/quad_position_76s.ulg"))
    assert fact_of(section, "compass_change").value is None
    assert value_of(section, "field_change") > 60.0
    assert not section.actions


# ------------------------------------------------------------------------------------- simulated flights


@pytest.fixture(scope="module")
def flights(flights_of: FlightsOf) -> Mapping[str, Flight]:
    """One vehicle, sound, with a GPS that jumps, and with a loose accelerometer."""
    return flights_of("estimator")


def reviewed(flight: Flight, suffix: str, folder: Path, *, second: bool = True) -> Section:
    path = folder / f"flight{suffix}"
    path.write_bytes(dataflash_bytes(flight) if suffix == ".bin" else ulog_bytes(flight, second=second))
    return review(open_logged(path))


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_a_jump_is_the_gravest_finding(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["glitch"], suffix, tmp_path)
    first = max(section.findings, key=lambda finding: (finding.grade.rank, finding.weight))
    assert re.fullmatch("The GPS jumps 2[12] m at 31 s", first.text)
    assert "7 satellites" in first.more
    assert fact_of(section, "gps_jump").at_s == pytest.approx(31.0, abs=0.3)


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_a_loose_accelerometer_is_named(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["loose"], suffix, tmp_path)
    assert any(f.text.startswith("Accelerometer 1 shakes") for f in section.findings)
    assert section.actions[0].title.startswith("Fasten")


def test_one_accelerometer_has_none_to_differ_from(flights: Mapping[str, Flight], tmp_path: Path) -> None:
    section = reviewed(flights["loose"], ".ulg", tmp_path, second=False)
    assert not any(fact.key == "estimator.shake_ratio" for fact in section.facts)


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_sound_sensors_are_found_sound(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["sound"], suffix, tmp_path)
    assert not section.actions
    assert {finding.grade for finding in section.findings} == {Grade.GOOD}


# ------------------------------------------------------------------------------------- small series


@pytest.mark.parametrize("seed", range(6))
def test_speed_is_no_jump(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 30.0, 0.2)
    speed = np.full(len(time_s), rng.uniform(5.0, 25.0))
    north = speed * time_s + 0.1 * rng.normal(size=len(time_s))
    jumped = north.copy()
    jumped[100:120] += 17.0

    def receiver(values: np.ndarray) -> Receiver:
        of = [Column("", "m", time_s, v) for v in (values, np.zeros(len(time_s)), speed)]
        return Receiver(None, None, None, None, None, None, of[0], of[1], of[2])

    assert find_jump(receiver(north))[0] < 1.0
    size, at_s = find_jump(receiver(jumped))
    assert at_s == pytest.approx(20.0)
    assert size == pytest.approx(17.0, abs=1.0)


@needs_shared
def test_a_log_without_a_second_in_the_air_is_reviewed() -> None:
    section = review(logged("ulog/corrupt_actuator_armed_wrong_size.ulg"))
    assert not section.findings
    assert fact_of(section, "compass_change").missing
