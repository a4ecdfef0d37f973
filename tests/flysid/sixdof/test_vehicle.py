"""The whole vehicle from flights: hidden numbers are found, gusts turn no sign, axes are found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.dataset import Dataset, Signal
from flysid.errors import DataError, UsageError
from flysid.sixdof import layout, rotations
from flysid.sixdof import vehicle as vehicle_fit
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.rigid_body import run
from tests.flysid.sixdof.hidden_quad import MIX, HiddenQuad, dataset

HIDDEN = HiddenQuad()
TRUTH = {
    "thrust of a motor": HIDDEN.thrust,
    "motor lag": HIDDEN.lag,
    "thrust curve": HIDDEN.curve,
    "rotor drag x": HIDDEN.drag,
    "rotor drag y": HIDDEN.drag,
    "inertia pitch / roll": HIDDEN.inertia[1] / HIDDEN.inertia[0],
    "inertia yaw / roll": HIDDEN.inertia[2] / HIDDEN.inertia[0],
    **{f"roll of motor {i + 1}": HIDDEN.roll * MIX[i, 0] for i in range(4)},
    **{f"pitch of motor {i + 1}": HIDDEN.pitch * MIX[i, 1] for i in range(4)},
    **{f"yaw of motor {i + 1}": HIDDEN.yaw * MIX[i, 2] for i in range(4)},
}


@pytest.mark.parametrize("name", TRUTH)
def test_a_hidden_number_is_found(vehicle: FittedVehicle, name: str) -> None:
    found = vehicle[name]
    assert found.is_determined
    assert found.value == pytest.approx(TRUTH[name], rel=0.05)


def test_what_no_instrument_tells_is_held_and_named(vehicle: FittedVehicle) -> None:
    power = vehicle["voltage power"]
    assert not power.is_determined
    assert "no voltage" in power.reason
    assert "voltage" in power.flight
    assert any("voltage power" in line for line in vehicle.lines())


def test_it_predicts_a_flight_that_it_has_not_seen(vehicle: FittedVehicle) -> None:
    segment = dataset(replace(HIDDEN, noise=0.0), 1, 6.0, 77).segments[0]
    commands, rows = segment.u, segment.y
    first = 100
    measured = np.hstack([rows[:, 13:16], rows[:, 10:13], rows[:, 6:10], rows[:, :3]])
    settled = vehicle.shares(commands, None, 0.01)[2 * first :]
    states = run(measured[first], settled, 0.01, vehicle.theta)
    apart = np.linalg.norm(states[:300, :3] - measured[first : first + 300, :3], axis=1)
    assert apart[-1] < 0.3


def test_gusts_turn_no_sign_and_bend_no_effect(gusty: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Free runs would bend them, as a fifth of the samples that they are tried on shows already."""
    monkeypatch.setattr(vehicle_fit, "TRIAL_STEPS", vehicle_fit.TRIAL_STEPS // 5)
    found = flysid.Vehicle().fit(gusty)
    assert found.method == "regression"
    assert any("gusts that the controller answers bend them" in note for note in found.notes)
    effects = layout.effects(found.theta)
    assert (np.sign(effects) == np.sign(MIX.T)).all()
    size = np.abs(effects).mean(axis=1)
    np.testing.assert_allclose(size, [HIDDEN.roll, HIDDEN.pitch, HIDDEN.yaw], rtol=0.15)
    assert 0.0 <= found["delay"].value < 0.05


def turned(data: Dataset, body_down: bool, world_down: bool, inverse: bool) -> Dataset:
    """The same flights as another program would log them."""
    over = np.array([1.0, -1.0, -1.0])
    half = np.array([0.0, 1.0, 0.0, 0.0])
    segments = []
    for segment in data.segments:
        y = segment.y.copy()
        q = rotations.unit(y[:, 6:10])
        if body_down:
            y[:, :3] *= over
            y[:, 3:6] *= over
            q = rotations.product(q, half)
        if world_down:
            y[:, 10:13] *= over
            y[:, 13:16] *= over
            q = rotations.product(half, q)
        y[:, 6:10] = rotations.inverse(q) if inverse else q
        segments.append(replace(segment, y=y))
    return data.with_segments(segments)


@pytest.mark.parametrize(
    ("body_down", "world_down", "inverse"), [(True, True, False), (False, True, False), (True, False, True)]
)
def test_axes_are_found_and_said(
    still: Dataset, regressed: FittedVehicle, body_down: bool, world_down: bool, inverse: bool
) -> None:
    other = flysid.Vehicle(free_runs=False).fit(turned(still, body_down, world_down, inverse))
    np.testing.assert_allclose(other.theta, regressed.theta, rtol=1e-4, atol=1e-6)
    said = " ".join(other.frames)
    assert ("forward, right, down" in said) == body_down
    assert ("z points down" in said) == world_down
    assert ("world into the body" in said) == inverse
    assert regressed.frames == ()


def test_gyro_and_motors_alone_hold_what_cannot_be_known(still: Dataset) -> None:
    alone = replace(
        still,
        outputs=still.outputs[:3],
        segments=tuple(replace(segment, y=segment.y[:, :3]) for segment in still.segments),
    )
    found = flysid.Vehicle().fit(alone)
    assert "1 g" in found["thrust of a motor"].reason
    assert "log velocities" in found["rotor drag x"].flight
    assert found["roll of motor 1"].value == pytest.approx(-HIDDEN.roll, rel=0.35)


def test_the_file_holds_the_same(vehicle: FittedVehicle, tmp_path: Path) -> None:
    vehicle.save(tmp_path / "vehicle.json")
    again = flysid.load_vehicle(tmp_path)
    assert again.to_dict() == vehicle.to_dict()
    assert repr(again) == repr(vehicle)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("motors", 5),
        ("format", "x"),
        ("covariance", []),
        ("reference_v", "x"),
        ("numbers", [{}]),
        ("inside", 3),
    ],
)
def test_a_damaged_file_is_refused(vehicle: FittedVehicle, key: str, value: object) -> None:
    with pytest.raises(DataError, match="not a vehicle"):
        FittedVehicle.from_dict({**vehicle.to_dict(), key: value})


def test_a_flight_on_the_ground_is_refused(still: Dataset) -> None:
    segments = []
    for segment in still.segments:
        y = segment.y.copy()
        y[:, 13:16] = 0.001 * y[:, 13:16]
        segments.append(replace(segment, y=y))
    with pytest.raises(DataError, match="nothing flies"):
        flysid.Vehicle().fit(still.with_segments(segments))


def test_signals_that_no_vehicle_has_are_refused(still: Dataset) -> None:
    with pytest.raises(UsageError, match="motor1"):
        flysid.Vehicle().fit(replace(still, inputs=tuple(Signal(f"u{i}") for i in range(4))))
    with pytest.raises(UsageError, match="gyro_x"):
        flysid.Vehicle().fit(replace(still, outputs=tuple(Signal(f"y{i}") for i in range(16))))
