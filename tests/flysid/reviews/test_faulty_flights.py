"""The simulated flights that reviews are judged by: they fly, and their logs say what was simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flysid
from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import Flight
from bench.faulty_ulog import ulog_bytes
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.logged import LoggedFlight
from tests.flysid.reviews.quadrotors import FlightsOf


@pytest.fixture(scope="module")
def flights(flights_of: FlightsOf) -> list[Flight]:
    """A sound vehicle, and the same with a weak motor, a GPS glitch, and with gains that are too high."""
    return list(flights_of("plain").values())


def test_a_sound_vehicle_follows_and_hovers_as_its_parameter_says(flights: list[Flight]) -> None:
    sound = flights[0]
    flying = (sound.time_s > 10.0) & (sound.time_s < 55.0)
    error = np.degrees(sound["wanted_rates"] - sound["rates"])[flying]
    assert (error.std(axis=0) < 5.0).all()
    hover = sound["thrusts"][flying].mean()
    assert hover == pytest.approx(sound.vehicle.stated_hover, rel=0.08)


def test_a_weak_motor_is_commanded_more(flights: list[Flight]) -> None:
    flying = slice(4000, 22000)
    means = flights[1]["thrusts"][flying].mean(axis=0)
    assert np.argmax(means) == 2
    assert means[2] / np.delete(means, 2).mean() == pytest.approx(1.0 / 0.8, rel=0.06)


def test_gains_above_the_critical_one_oscillate(flights: list[Flight]) -> None:
    flying = slice(4000, 22000)
    hot, sound = (np.diff(flights[i]["rates"][flying, 0]).std() for i in (3, 0))
    assert hot > 2.0 * sound


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_logs_hold_what_was_flown(flights: list[Flight], suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"flight{suffix}"
    path.write_bytes(dataflash_bytes(flights[2]) if suffix == ".bin" else ulog_bytes(flights[2]))
    logged = LoggedFlight(FlightLog(flysid.read(path)))
    assert logged.flown.seconds == pytest.approx(54.0, abs=0.5)
    hover = logged.parameters["MOT_THST_HOVER" if suffix == ".bin" else "MPC_THR_HOVER"]
    assert hover == pytest.approx(flights[2].vehicle.stated_hover)
    rate = logged.quantity("RATE.R", "vehicle_angular_velocity.xyz[0]", unit="deg/s", stated="rad/s")
    assert rate is not None
    truth = np.interp(rate.time_s, flights[2].time_s, np.degrees(flights[2]["rates"][:, 0]))
    assert np.abs(rate.values - truth).max() < 0.1
    satellites = logged.column("GPS.NSats", "sensor_gps.satellites_used")
    assert satellites is not None
    assert satellites.at(np.array([20.0, 32.0])).tolist() == [17.0, 7.0]
