"""Vehicles drawn anew: is what flies found, are signs those of the airframe, and is damage left out?"""

from __future__ import annotations

import random

import numpy as np

import flysid
from flysid.errors import FlysidError
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from tests.flysid.sixdof.hidden_quad import MIX, HiddenQuad, dataset
from tests.flysid.sixdof.test_cleaning import damaged

NEAR = 0.1
"""Share by which thrust, roll and pitch may be off in calm air."""


def drawn(rng: random.Random) -> HiddenQuad:
    """A vehicle of any usual size, half of them in gusts."""
    return HiddenQuad(
        thrust=rng.uniform(4.0, 7.0),
        roll=rng.uniform(70.0, 180.0),
        pitch=rng.uniform(70.0, 180.0),
        yaw=rng.uniform(10.0, 25.0),
        lag=rng.uniform(0.015, 0.06),
        delay=rng.choice([0.0, 0.01, 0.02]),
        curve=rng.uniform(0.0, 1.0),
        drag=rng.uniform(0.03, 0.12),
        inertia=(1.0, rng.uniform(0.8, 1.4), rng.uniform(1.7, 2.1)),
        gust=rng.choice([0.0, 4.0]),
    )


def judge(seed: int) -> str:
    """What is wrong with the fit of the vehicle of a seed; "" where nothing is."""
    rng = random.Random(seed)
    quad = drawn(rng)
    data = dataset(quad, 1, 20.0, seed % 2**31)
    if np.abs(data.segments[0].y[:, 13:]).max() > 20.0:
        return ""  # the controller lost it
    if rng.random() < 0.5:
        data = damaged(data, rng.randrange(300, 1200), rng.randrange(20, 300), rng.uniform(1.5, 70.0))
    try:
        vehicle = flysid.Vehicle().fit(data)
    except FlysidError as error:
        return f"{type(error).__name__}: {error.message}"
    again = FittedVehicle.from_dict(vehicle.to_dict())
    effects = layout.effects(vehicle.theta)
    if again.to_dict() != vehicle.to_dict():
        return "the stored form is another vehicle"
    if not (np.sign(effects) == np.sign(MIX.T)).all():
        return f"signs of torques: {effects.round(1).tolist()}"
    off = np.abs(np.abs(effects[:2]).mean(axis=1) / np.array([quad.roll, quad.pitch]) - 1.0).max()
    lift = abs(vehicle["thrust of a motor"].value / quad.thrust - 1.0)
    most = NEAR if quad.gust == 0.0 else 3.0 * NEAR
    return f"off by {max(off, lift):.3f}, {quad}" if max(off, lift) > most else ""
