"""Power and motors: each figure against an independent computation on rows of other readers."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy import signal, stats

from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import Flight
from bench.faulty_ulog import ulog_bytes
from flysid.dataset import FloatArray
from flysid.reviews.battery import lowest, measure_resistance, share_at_end
from flysid.reviews.fact import Grade, MotorPlan, Section
from flysid.reviews.logged import Column
from flysid.reviews.power import review
from tests.flysid.reviews.quadrotors import FlightsOf
from tests.flysid.reviews.shared_logs import (
    SHARED,
    dataflash_values,
    logged,
    needs_shared,
    open_logged,
    ulog_values,
)

STABILISED = "ulog/quad_stabilised_92s.ulg"
AGGRESSIVE = "ulog/quad_manual_aggressive_80s.ulg"
COPTER = "dataflash/copter_437s.bin"


def value_of(section: Section, key: str) -> float:
    found = next(fact for fact in section.facts if fact.key == f"power.{key}")
    assert isinstance(found.value, float), f"{key}: {found.words}"
    return found.value


def texts(section: Section) -> list[str]:
    return [finding.text for finding in section.findings]


# ------------------------------------------------------------------------------------- real flights


@needs_shared
def test_motors_of_a_real_flight_are_those_of_another_reader() -> None:
    section = review(logged(STABILISED))
    time_s, _ = ulog_values(STABILISED, "actuator_motors", "control[0]")
    boot_s = time_s[0] - logged(STABILISED).column("actuator_motors.control[0]").time_s[0]  # type: ignore[union-attr]
    first, last = (edge + boot_s for edge in logged(STABILISED).air_s[0])
    inside = (time_s > first + 2.0) & (time_s < last - 2.0)
    controls = [ulog_values(STABILISED, "actuator_motors", f"control[{i}]")[1] for i in range(4)]
    means = np.array([control[inside].mean() for control in controls])
    found = np.array([value_of(section, f"motor_{i}") for i in range(1, 5)])
    assert found == pytest.approx(100.0 * means, rel=0.01)
    yaw = (means[0] + means[1] - means[2] - means[3]) / means.sum()
    assert value_of(section, "trim_yaw") == pytest.approx(100.0 * yaw, abs=0.5)
    more = (means[0] + means[1]) / (means[2] + means[3]) - 1.0
    assert f"Motors 1 and 2 carry {100.0 * more:.0f} % more than 3 and 4" in texts(section)


@needs_shared
def test_hover_throttle_of_real_flights() -> None:
    _, thrust = ulog_values(STABILISED, "hover_thrust_estimate", "hover_thrust")
    assert value_of(review(logged(STABILISED)), "hover_throttle") == pytest.approx(
        np.nanmedian(thrust), abs=0.01
    )
    rows = dataflash_values(COPTER, "CTUN", "ThO", "CRt")
    still = (rows[:, 1] > 0.1) & (np.abs(rows[:, 2]) < 150.0)
    hover = value_of(review(logged(COPTER)), "hover_throttle")
    assert hover == pytest.approx(np.median(rows[still, 1]), abs=0.01)


@needs_shared
def test_an_estimate_at_its_end_is_not_taken_for_the_hover_throttle() -> None:
    """PX4's may not go further than HTE_THR_RANGE from its parameter: 0.35 - 0.2 is not the truth."""
    section = review(logged(AGGRESSIVE))
    controls = [ulog_values(AGGRESSIVE, "actuator_motors", f"control[{i}]")[1] for i in range(4)]
    assert value_of(section, "hover_throttle") == pytest.approx(np.mean(controls), abs=0.02)
    change = next(action.changes[0] for action in section.actions if action.changes)
    assert change.name == "MPC_THR_HOVER"
    assert change.new == pytest.approx(0.175)  # a factor of two, no more


@needs_shared
def test_resistance_of_a_real_battery() -> None:
    rows = dataflash_values(COPTER, "CURR", "Volt", "Curr")
    width = round(5.0 / np.median(np.diff(rows[:, 0])))
    fast = rows[:, 1:] - signal.convolve(rows[:, 1:], np.ones((width, 1)) / width, "same")
    slope = stats.linregress(fast[width:-width, 1], fast[width:-width, 0]).slope
    section = review(logged(COPTER))
    assert value_of(section, "resistance") == pytest.approx(-1e3 * slope, rel=0.05)
    assert value_of(section, "voltage_lowest") == pytest.approx(rows[:, 1].min(), abs=0.05)
    assert value_of(section, "used") == pytest.approx(
        np.ptp(dataflash_values(COPTER, "CURR", "CurrTot")[:, 1])
    )


@needs_shared
def test_a_sensor_without_a_battery_is_not_a_battery() -> None:
    section = review(logged("ulog/quad_position_76s.ulg"))
    found = next(fact for fact in section.facts if fact.key == "power.voltage_lowest")
    assert found.value is None
    assert "nothing is connected" in found.missing
    assert "BAT1" in found.remedy


@needs_shared
def test_a_racer_whose_current_sensor_ends() -> None:
    section = review(logged("blackbox/greenreaper_flight38.bfl"))
    sag = next(fact for fact in section.facts if fact.key == "power.sag")
    assert "sensor ends" in sag.note
    assert any(text.startswith("Motor 4 is driven") and "less" in text for text in texts(section))
    assert not [action for action in section.actions if "motor" in action.title.lower()]


@needs_shared
def test_a_simulated_battery_has_no_resistance() -> None:
    section = review(logged("dataflash/sitl_copter_49s.BIN"))
    found = next(fact for fact in section.facts if fact.key == "power.resistance")
    assert found.value is None
    assert 15.0 < value_of(section, "at_minimum") < 35.0


@needs_shared
@pytest.mark.parametrize("name", sorted(p.name for p in (SHARED / "ulog").glob("pyulog*")) or [""])
def test_logs_without_flight_complain_of_nothing(name: str) -> None:
    section = review(logged(f"ulog/{name}"))
    assert not section.findings
    assert not section.actions


# ------------------------------------------------------------------------------------- simulated flights


@pytest.fixture(scope="module")
def flights(flights_of: FlightsOf) -> Mapping[str, Flight]:
    """One vehicle, sound and with faults of its power train."""
    return flights_of("power")


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("worn", "Motor 2 is driven"),
        ("propeller", "Motor 2 is driven"),
        ("heavy", "Hovering takes"),
        ("sagging", "The battery sags"),
    ],
)
def test_a_fault_is_the_gravest_finding(
    flights: Mapping[str, Flight], kind: str, words: str, suffix: str, tmp_path: Path
) -> None:
    section = reviewed(flights[kind], suffix, tmp_path)
    first = max(section.findings, key=lambda finding: (finding.grade.rank, finding.weight))
    assert first.text.startswith(words), texts(section)
    assert first.grade.rank >= Grade.WATCH.rank


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_a_sound_vehicle_gets_no_action(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["sound"], suffix, tmp_path)
    assert not section.actions
    assert all(finding.grade is Grade.GOOD for finding in section.findings)
    (plan,) = (shown for shown in section.shown if isinstance(shown, MotorPlan))
    assert plan.places[0][0] > 0.0 < plan.places[0][1]
    assert plan.places[2][1] < 0.0


def test_only_speeds_tell_a_weak_motor_from_a_propeller(
    flights: Mapping[str, Flight], tmp_path: Path
) -> None:
    motor = reviewed(flights["worn"], ".bin", tmp_path)
    assert any("to turn as fast" in text for text in texts(motor))
    propeller = reviewed(flights["propeller"], ".bin", tmp_path)
    assert any("faster" in text for text in texts(propeller))
    commands = reviewed(flights["worn"], ".ulg", tmp_path)
    (finding,) = (f for f in commands.findings if f.fact == "power.motor_spread")
    assert "do not tell" in finding.more


def test_a_motor_that_stops_is_named_where_its_speed_is_logged(
    flights: Mapping[str, Flight], tmp_path: Path
) -> None:
    section = reviewed(flights["stopped"], ".bin", tmp_path)
    beat = next(fact for fact in section.facts if fact.key == "power.desync")
    assert str(beat.value).startswith("motor 1 at 33.")
    assert any(action.title.startswith("Check motor 1") for action in section.actions)
    for kind in ("sound", "worn", "heavy", "sagging"):
        quiet = reviewed(flights[kind], ".bin", tmp_path)
        assert next(f for f in quiet.facts if f.key == "power.desync").value == "none", kind


@needs_shared
def test_escs_of_a_real_flight() -> None:
    section = review(logged(AGGRESSIVE))
    counts = [ulog_values(AGGRESSIVE, "esc_status", f"esc[{i}].esc_errorcount")[1] for i in range(4)]
    assert value_of(section, "esc_errors") == max(np.ptp(count) for count in counts)
    heat = [ulog_values(AGGRESSIVE, "esc_status", f"esc[{i}].esc_temperature")[1] for i in range(4)]
    assert np.max(heat) - 2.0 <= value_of(section, "esc_temperature") <= np.max(heat)
    assert next(f for f in section.facts if f.key == "power.desync").value == "none"


def test_the_resistance_is_the_simulated_one(flights: Mapping[str, Flight], tmp_path: Path) -> None:
    for kind in ("sound", "sagging"):
        section = reviewed(flights[kind], ".ulg", tmp_path)
        truth = 1e3 * flights[kind].vehicle.resistance_ohm
        assert value_of(section, "resistance") == pytest.approx(truth, rel=0.1)


def reviewed(flight: Flight, suffix: str, folder: Path) -> Section:
    path = folder / f"flight{suffix}"
    path.write_bytes(dataflash_bytes(flight) if suffix == ".bin" else ulog_bytes(flight))
    return review(open_logged(path))


# ------------------------------------------------------------------------------------- small series


def column(values: FloatArray, period_s: float = 0.1) -> Column:
    return Column("A.B", "", period_s * np.arange(len(values), dtype=np.float64), values)


def test_the_lowest_voltage_passes_over_a_single_wrong_sample() -> None:
    values = np.full(200, 15.0)
    values[77] = 3.0
    values[120:140] = 14.0
    assert lowest(column(values))[0] == 14.0


@pytest.mark.parametrize("seed", range(5))
def test_a_slow_fall_is_no_resistance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    amps = 20.0 + 4.0 * np.cumsum(rng.normal(size=1200)) / 30.0 + rng.normal(size=1200)
    ohm = rng.uniform(0.01, 0.1)
    volts = 16.0 - 0.002 * np.arange(1200) - ohm * amps + 0.02 * rng.normal(size=1200)
    found = measure_resistance(column(volts), column(amps))
    assert found.ohm == pytest.approx(ohm, rel=0.15)
    assert found.interval[0] < ohm * 1.05
    assert found.interval[1] > ohm * 0.95


def test_a_sensor_that_ends_stays_there() -> None:
    rng = np.random.default_rng(0)
    wave = 40.0 + 15.0 * rng.normal(size=5000)
    assert share_at_end(column(wave)) < 0.005
    assert share_at_end(column(np.minimum(wave, 60.0))) > 0.05


def test_a_rover_has_no_motors_that_carry_it(flights: Mapping[str, Flight], tmp_path: Path) -> None:
    """Its FRAME_CLASS is 1, too."""
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash_bytes(flights["worn"]).replace(b"ArduCopter V4.5.7", b"ArduRover V4.5.7 "))
    section = review(open_logged(path))
    keys = {fact.key for fact in section.facts if fact.value is not None}
    assert not keys & {"power.hover_throttle", "power.motor_spread", "power.motor_1", "power.at_minimum"}
    assert "power.resistance" in keys


def test_every_frame_is_balanced() -> None:
    """Motors around the middle, as many turning one way as the other."""
    frames = tomllib.loads(files("flysid.ingest.lake").joinpath("frames.toml").read_text("utf-8"))
    for firmware, layouts in frames.items():
        for name, layout in layouts.items():
            angles, spins = np.array(layout, dtype=float).T
            assert spins.sum() == 0.0, (firmware, name)
            turned = np.exp(1j * np.radians(angles))
            assert abs(turned.sum()) < 1e-9, (firmware, name)
            assert abs((spins * turned).sum()) < 1e-9, (firmware, name)
