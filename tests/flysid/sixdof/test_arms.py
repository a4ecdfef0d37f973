"""Known places of motors: inertias over mass, the centre of mass, and motors that are elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import DataError, UsageError
from flysid.sixdof.fitted import FittedVehicle
from tests.flysid.sixdof.hidden_quad import MIX, HiddenQuad

GYRATION_M2 = 0.004
"""Inertia of roll over mass that is to be found."""
SHIFT_M = (0.01, -0.02)
"""Where the centre of mass lies in the places' file."""
PLACES = (
    np.column_stack([-MIX[:, 1] * HiddenQuad.pitch * HiddenQuad.inertia[1], MIX[:, 0] * HiddenQuad.roll])
    * (GYRATION_M2 / HiddenQuad.thrust)
    + SHIFT_M
)


def test_places_of_motors_add_inertias_and_the_centre_of_mass(vehicle: FittedVehicle) -> None:
    placed = vehicle.placed(PLACES)
    truth = dict(zip(("roll", "pitch", "yaw"), GYRATION_M2 * np.array(HiddenQuad.inertia), strict=True))
    for name, value in truth.items():
        number = placed[f"{name} inertia / mass"]
        assert number.is_determined
        assert number.value == pytest.approx(value, rel=0.03)
    for way, value in zip(("forward", "left"), SHIFT_M, strict=True):
        number = placed[f"centre of mass {way}"]
        assert abs(number.value - value) < max(2.0 * number.half_width, 2e-3)
    assert placed.body is not None
    assert not placed.body.doubts
    assert FittedVehicle.from_dict(placed.to_dict()).places == placed.places


def test_intervals_of_the_body_are_those_of_derivatives(vehicle: FittedVehicle) -> None:
    assert vehicle.placed(PLACES).body is not None
    sizes = np.sqrt(np.diag(vehicle.covariance))
    for name in ("pitch inertia / mass", "centre of mass left", "yaw inertia / mass"):
        slopes = np.zeros(len(vehicle.theta))
        for i in np.flatnonzero(sizes):
            ends = []
            for sign in (1.0, -1.0):
                theta = vehicle.theta.copy()
                theta[i] += sign * 1e-3 * sizes[i]
                ends.append(replace(vehicle, theta=theta).placed(PLACES)[name].value)
            slopes[i] = (ends[0] - ends[1]) / (2e-3 * sizes[i])
        width = 1.959964 * np.sqrt(slopes @ vehicle.covariance @ slopes)
        assert vehicle.placed(PLACES)[name].half_width == pytest.approx(width, rel=1e-3)


def test_motors_that_are_not_where_they_are_said_to_be(vehicle: FittedVehicle) -> None:
    doubts = " ".join(vehicle.placed(PLACES[[0, 1, 3, 2]]).lines())
    assert "motor 3 acts about pitch as if it were on the other side" in doubts
    turned = vehicle.placed(-PLACES)["roll inertia / mass"]
    assert turned.reason == "the motors turn it the other way than their places say"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("motor1 = [0.1, 0.1]\nmotor3 = [0.1, -0.1]\n", "it names motor1, motor3"),
        ("motor1 = [0.1]\nmotor2 = [0.1, -0.1]\n", "a motor's place is two numbers"),
        ("motor1 = [0.1, nan]\nmotor2 = [0.1, -0.1]\n", "a motor's place is two numbers"),
        ("motor1 = [0.1, 0.1]\nmotor2 = [0.1, -0.1]\n", "all motors lie on one line"),
        ("motor1 = ", "not a TOML file"),
        ("", "it names nothing"),
    ],
)
def test_a_file_that_places_no_motors(tmp_path: Path, text: str, words: str) -> None:
    arms = tmp_path / "arms.toml"
    arms.write_text(text, "utf-8")
    done = CliRunner().invoke(root, ["vehicle", str(arms), "--arms", str(arms)])
    assert isinstance(done.exception, DataError)
    assert words in str(done.exception)


def test_places_of_six_motors_are_of_no_quadrotor(vehicle: FittedVehicle) -> None:
    with pytest.raises(UsageError, match="places of 6 motors: this vehicle has 4"):
        vehicle.placed(np.vstack([PLACES, PLACES[:2]]))
