"""Logs of loops that another hand wrote, judged from their files: roll and yaw, by ArduCopter and by PX4."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench.second_laws import Flown, Loop
from bench.second_margins import ENDINGS
from bench.second_vehicles import draw_loops, fly_vehicle, log_bytes
from flysid.cli.gains import command as gains
from flysid.cli.predict import command as predict
from flysid.loops.parameterlogs import ardupilot_record, px4_record
from tests.flysid.loops.autopilots import VEHICLE, ardupilot_log, px4_log

YAW_P = {"arducopter": "ATC_RAT_YAW_P", "px4": "MC_YAWRATE_P"}
Judged = tuple[str, Path, list[Loop], list[dict[str, Any]]]


@pytest.fixture(scope="module", params=list(ENDINGS))
def judged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Judged:
    """Firmware, log, loops, and what `flysid gains` states of roll and yaw."""
    firmware = request.param
    rng = np.random.default_rng((5, len(firmware)))
    loops = draw_loops(firmware, rng)
    log = tmp_path_factory.mktemp("second") / f"flight.{ENDINGS[firmware]}"
    log.write_bytes(log_bytes(loops, fly_vehicle(loops, 80.0, rng), rng))
    words = [str(log), "--json", "--axis", "roll", "--axis", "yaw"]
    done = CliRunner().invoke(gains, words, standalone_mode=False)
    assert done.exception is None
    return firmware, log, loops, json.loads(done.stdout)


@pytest.mark.parametrize("k", [0, 1], ids=["roll", "yaw"])
def test_the_truth_of_another_implementation_is_found(judged: Judged, k: int) -> None:
    """ArduCopter's law in continuous time missed Ms by 2.5 half widths of its interval, and yaw was refused.

    One flight's interval may miss; how many do is measured by `python -m bench.second_margins`.
    """
    _, _, loops, found = judged
    assert found[k]["refused"] is None
    true = loops[2 * k].truth()
    for name in ("crossover_hz", "phase_deg", "ms", "bandwidth_hz"):
        own = found[k]["figures"][name]
        half = 0.5 * (own["high"] - own["low"])
        assert own["value"] == pytest.approx(true[name], abs=2.0 * half), name
    assert found[k]["controller_miss"] < 0.08


def test_yaw_is_predicted_under_another_gain(judged: Judged) -> None:
    firmware, log, loops, _ = judged
    words = [str(log), "--set", f"{YAW_P[firmware]}={1.2 * loops[2].p:.9g}", "--json"]
    done = CliRunner().invoke(predict, words, standalone_mode=False)
    assert done.exception is None
    (axis,) = json.loads(done.stdout)["axes"]
    assert axis["axis"] == "yaw"


def test_gains_that_changed_in_flight_are_named_with_the_time(tmp_path: Path) -> None:
    """As by a switch to another profile: the log states the first gains alone."""
    rng = np.random.default_rng(8)
    loops = draw_loops("arducopter", rng)
    others = [replace(loop, p=0.5 * loop.p, d=0.5 * loop.d) for loop in loops]
    parts = [fly_vehicle(own, 25.0, rng) for own in (loops, others)]
    flown = [join(one, other) for one, other in zip(*parts, strict=True)]
    log = tmp_path / "switched.bin"
    log.write_bytes(log_bytes(loops, flown, rng))
    done = CliRunner().invoke(gains, [str(log), "--axis", "roll"], standalone_mode=False)
    assert done.exception is None
    told = " ".join(done.stdout.split())
    assert (
        "recorded over rebuilt is 1.00 until 25 s and 0.50 from there: gains were changed in flight" in told
    )


def join(one: Flown, other: Flown) -> Flown:
    """One flight behind another."""
    pairs = ((getattr(one, f.name), getattr(other, f.name)) for f in fields(Flown))
    return Flown(*(np.concatenate(pair, axis=-1) for pair in pairs))


def test_a_setpoint_that_comes_rarely_slows_no_record() -> None:
    """At its 250 Hz every row lay where the setpoint had just moved: the plant's gain was 2 % too small."""
    log = px4_log(20.0, 1, rate_hz=1000.0, outer=5.0, vehicle=VEHICLE)
    for stream in ("vehicle_rates_setpoint", "vehicle_attitude_setpoint"):
        log.tables[stream] = {name: values[::4] for name, values in log.tables[stream].items()}
    assert px4_record(log, "roll").rate_hz == 1000.0


def test_an_output_belongs_to_the_sample_it_was_computed_from() -> None:
    """PX4 publishes gyro and output some 0.1 ms apart."""
    log = px4_log(20.0, 1, vehicle=VEHICLE)
    plain = px4_record(log, "roll").pieces[0]
    for stream, late_us in (("vehicle_angular_velocity", 150), ("vehicle_torque_setpoint", 900)):
        table = log.tables[stream]
        sampled = table["time_ns"] // 1000
        table["time_ns"] = table["time_ns"] + 1000 * late_us
        table |= {"timestamp": sampled + late_us, "timestamp_sample": sampled + 1}
    late = px4_record(log, "roll").pieces[0]
    np.testing.assert_allclose(late[1][:1900], plain[1][:1900], atol=1e-3)


def test_a_heading_that_passes_north_is_no_jump() -> None:
    log = ardupilot_log(20.0, 1, vehicle=VEHICLE)
    rate = log.tables["RATE"]
    rate |= {"Y" + name: rate["R" + name] for name in ("", "Des", "Out")}
    turned = np.cumsum(rate["RDes"]) / 100.0
    log.tables["ATT"]["DesYaw"] = turned % 360.0
    asked = ardupilot_record(log, "yaw").pieces[0][3]
    assert np.ptp(turned) > 1.0
    assert np.abs(np.diff(asked)).max() < 10.0


def test_a_stick_that_turns_px4_stands_for_the_heading_that_follows_it() -> None:
    log = px4_log(20.0, 1, outer=5.0, vehicle=VEHICLE)
    stick = np.sin(np.arange(len(log.tables["vehicle_attitude_setpoint"]["time_ns"])) / 30.0)
    log.tables["vehicle_attitude_setpoint"]["yaw_sp_move_rate"] = stick
    log.tables["vehicle_rates_setpoint"]["yaw"] = stick
    np.testing.assert_allclose(px4_record(log, "yaw").pieces[0][3][:1900], stick[:1900], atol=0.01)
