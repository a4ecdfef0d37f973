"""What happens to a vehicle shows in its efforts, as physics says, and from its flight on only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.cli.synth import parse_change
from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.synth.rigid_body import SimulatedVehicle, fly_vehicle
from flysid.ingest.synth.synth import WRITERS, Change, Order, fly_one
from flysid.ingest.synth.vehicles import CHANGES, change


@pytest.mark.parametrize(
    ("name", "factor", "throttle"), [("mass", 1.25, 1.25), ("thrust", 0.8, 1.25), ("drag", 1.6, 1.0)]
)
def test_hover_throttle_is_weight_over_thrust(name: str, factor: float, throttle: float) -> None:
    still = np.zeros((1000, 3))
    before = fly_vehicle(SimulatedVehicle(), still).series()["throttle"][-1]
    after = fly_vehicle(change(SimulatedVehicle(), name, factor), still).series()["throttle"][-1]
    assert after / before == pytest.approx(throttle, rel=0.03)  # the battery sags a little more under load


def test_a_change_begins_with_its_flight_and_stays_on_its_vehicle() -> None:
    order = Order("ardrone", "routine", 4.0, fleet=2, changes=(Change(2, 3, "mass", 1.25),))
    plain = Order("ardrone", "routine", 4.0, fleet=2)
    same = [
        np.array_equal(fly_one(order, i).truth["throttle"], fly_one(plain, i).truth["throttle"])
        for i in range(8)
    ]
    assert same == [True] * 6 + [False] * 2


def test_changes_are_checked() -> None:
    assert parse_change("3:2:mass:1.25") == Change(3, 2, "mass", 1.25)
    for text in ("3:2:mass", "a:2:mass:1", "1:1:colour:2", "0:1:mass:2", "1:1:mass:0"):
        with pytest.raises(UsageError):
            parse_change(text)
    with pytest.raises(UsageError):
        Order("ardrone", fleet=2, changes=(Change(3, 1, "mass", 2.0),))
    with pytest.raises(UsageError):
        Order(changes=(Change(1, 1, "mass", 2.0),))
    assert all(change(SimulatedVehicle(), name, 1.0) == SimulatedVehicle() for name in CHANGES)


def test_ulog_holds_efforts_and_whose_it_is(tmp_path: Path) -> None:
    recording = fly_one(Order("ardrone", "routine", 4.0, fleet=2, sensor="autopilot"), 5)
    path = tmp_path / "flight.ulg"
    path.write_bytes(WRITERS["ulog"][1](recording))
    flight = flysid.read(path)
    state = recording.state

    def xyz(topic: str) -> FloatArray:
        return np.array(flight[topic]["xyz"].to_pylist())

    np.testing.assert_allclose(-2 * xyz("vehicle_thrust_setpoint")[:, 2], state["throttle"], atol=1e-6)
    np.testing.assert_allclose(2 * xyz("vehicle_torque_setpoint")[:, 1], state["pitch_effort"], atol=1e-6)
    np.testing.assert_allclose(np.degrees(xyz("vehicle_angular_velocity"))[:, 1], -state["q"], atol=1e-4)
    assert flight.info["sys_uuid"].endswith("02")
    assert flight.info["firmware"] == "1.15.2"
