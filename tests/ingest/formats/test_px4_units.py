"""Units of PX4's fields: true of real flights, those of the recipes, from definitions where these tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.flight import Flight, field_unit
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common import px4_units
from flysid.ingest.formats.common.px4_units import px4_topic, px4_unit
from flysid.ingest.formats.common.units import is_known
from flysid.ingest.formats.registry import FORMATS
from tests.samplelogs.mcap import mcap_file, ros2_topic

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "ulog"
FLIGHTS = ("quad_stabilised_92s", "quad_position_76s", "quad_manual_aggressive_80s")
ONLY_LABELS = {"degC", "gauss", "Pa", "mAh", "Wh"}
needs_logs = pytest.mark.skipif(not LOGS.exists(), reason="no ../shared/logs/ulog here")


def flight(name: str) -> Flight:
    return flysid.read(LOGS / f"{name}.ulg")


def test_a_field_has_one_unit_and_it_is_one_that_flysid_writes() -> None:
    for topic, stated in px4_units._STATED.items():
        fields = [field for names in stated.values() for field in names.split()]
        assert len(fields) == len(set(fields)), topic
        assert all(is_known(unit) or unit in ONLY_LABELS for unit in stated), topic
    assert set(px4_units._SAME.values()) <= {*px4_units._STATED, "vehicle_attitude"}


@pytest.mark.parametrize("name", ["px4-attitude", "px4-rates", "px4-velocity"])
def test_the_recipes_state_the_same_units(name: str) -> None:
    checked = 0
    for signal in load_recipe(name).signals.values():
        for source in signal.sources:
            if source.unit and source.stream.startswith("vehicle_"):
                assert px4_unit(source.stream, source.fields[0]) == source.unit, source
                checked += 1
    assert checked > 1


@needs_logs
def test_velocities_are_the_derivatives_of_positions() -> None:
    table = flight("quad_position_76s")["vehicle_local_position"]
    units = {n: field_unit(table.schema.field(n)) for n in ("x", "vx", "heading", "timestamp")}
    assert units == {"x": "m", "vx": "m/s", "heading": "rad", "timestamp": "us"}
    seconds = np.array(table["timestamp"].to_pylist()) * 1e-6
    for place, speed in (("x", "vx"), ("y", "vy"), ("z", "vz")):
        velocity = np.array(table[speed].to_pylist())
        moved = np.diff(np.array(table[place].to_pylist())) / np.diff(seconds)
        steady = np.abs(moved) < 20  # resets of the origin apart
        mean = (velocity[1:] + velocity[:-1]) / 2
        assert np.median(np.abs(moved - mean)[steady]) < 0.1


@needs_logs
@pytest.mark.parametrize("name", FLIGHTS)
def test_accelerometers_show_gravity_and_gyros_the_attitudes_rate(name: str) -> None:
    log = flight(name)
    sensors = log["sensor_combined"]
    assert field_unit(sensors.schema.field("accelerometer_m_s2")) == "m/s/s"
    assert field_unit(sensors.schema.field("gyro_rad")) == "rad/s"
    norm = np.linalg.norm(np.array(sensors["accelerometer_m_s2"].to_pylist()), axis=1)
    assert 9.3 < np.median(norm) < 12.5  # the aggressive flight climbs and turns
    attitude = log["vehicle_attitude"]
    q = np.array(attitude["q"].to_pylist())
    seconds = np.array(attitude["timestamp"].to_pylist()) * 1e-6
    turned = 2 * np.arccos(np.clip(np.abs((q[1:] * q[:-1]).sum(axis=1)), 0, 1)) / np.diff(seconds)
    times = np.array(sensors["timestamp"].to_pylist()) * 1e-6
    gyro = np.array(sensors["gyro_rad"].to_pylist())
    angle = np.cumsum(gyro[:-1] * np.diff(times)[:, None], axis=0)
    between = np.stack([np.diff(np.interp(seconds, times[1:], angle[:, k])) for k in range(3)], axis=1)
    rate = np.linalg.norm(between, axis=1) / np.diff(seconds)
    moving = rate > 0.3
    assert moving.sum() > 20
    assert 0.9 < np.median(turned[moving] / rate[moving]) < 1.1


@needs_logs
def test_two_ways_to_tell_a_place_agree() -> None:
    log = flight("quad_manual_aggressive_80s")
    degrees = {}
    for stream, name in (("vehicle_gps_position", "latitude_deg"), ("vehicle_global_position", "lat")):
        column = log[stream].schema.field(name)
        assert field_unit(column) == "deg"
        degrees[stream] = float(np.median(log[stream][name].to_pylist()))
    first, second = degrees.values()
    assert abs(first - second) < 0.01


DEFINITION = """uint64 timestamp  # time since system start (microseconds)
float32[3] xyz  # angular velocity
float32 load  # [m/s] of the rope
float32 range # [-1, 1]
float32 either # [m] or [ft] or [km]
float32 vibration_metric
"""


def test_units_of_ros_messages_are_those_of_the_comments_then_of_px4() -> None:
    payload = b"\x00\x01\x00\x00" + bytes(36)
    kinds = ("px4_msgs/msg/VehicleAngularVelocity", "other/msg/VehicleAngularVelocity")
    found = []
    for kind in kinds:
        raw = mcap_file([ros2_topic("/t", kind, DEFINITION, [payload])])
        schema = collect(memoryview(raw), "t.mcap", FORMATS["mcap"], Limits())["/t"].schema
        names = ("timestamp", "xyz", "load", "range", "either", "vibration_metric")
        found.append([field_unit(schema.field(name)) for name in names])
    assert found[0] == ["us", "rad/s", "m/s", "", "", ""]
    assert found[1] == ["", "", "m/s", "", "", ""]


def test_names_of_messages_and_topics() -> None:
    assert px4_topic("px4_msgs/msg/SensorGps") == "sensor_gps"
    assert px4_unit("estimator_local_position", "vx") == "m/s"
    assert px4_unit("vehicle_angular_velocity_groundtruth", "xyz") == "rad/s"
    assert px4_unit("esc_status", "esc[7].timestamp") == "us"
    assert px4_unit("airspeed", "true_airspeed_m_s") == "m/s"
    assert px4_unit("sensor_baro", "pressure") == ""
