"""The inner loop's small motions agree with (10), (11) and (12) as far as docs/vehicle.md says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.ingest.synth.inner_loop import InnerLoop
from flysid.ingest.synth.plants import LOOPS, fly
from flysid.ingest.synth.rigid_body import ALL, SimulatedVehicle, fly_vehicle
from flysid.ingest.synth.tuning import compare_loop, linearise, tune

DRONE = SimulatedVehicle()
# What docs/vehicle.md promises from 0.1 rad/s to the loop's bandwidth: decibels, degrees.
PROMISED = {"longitudinal": (0.7, 2.5), "lateral": (0.4, 3.0), "vertical": (0.9, 2.0)}


@pytest.mark.parametrize("loop", sorted(LOOPS))
def test_bode_plots_agree_within_the_stated_tolerances(loop: str) -> None:
    bode = compare_loop(DRONE, loop)
    gain_db, phase_deg = PROMISED[loop]
    assert np.abs(bode.gain_db).max() <= gain_db
    assert np.abs(bode.phase_deg).max() <= phase_deg


def test_the_linearised_loop_does_not_run_away() -> None:
    poles = np.linalg.eigvals(linearise(DRONE).a)
    assert poles.real.max() < 1e-3  # position, heading and battery drift
    assert np.sum(np.abs(poles) > 0.01) == 21


@pytest.mark.parametrize(("loop", "column"), [("longitudinal", 0), ("lateral", 1), ("vertical", 2)])
def test_small_motions_flown_are_the_papers(loop: str, column: int) -> None:
    """In the time domain, through all effects but the link's delay: the paper's signal (13), made small."""
    t = 0.02 * np.arange(3000)
    u = 0.05 * sum(np.sin(w * t) for w in (0.1, 0.2, 0.3, 0.4, 0.5))
    commands = np.zeros((len(t), 3))
    commands[:, column] = u
    vehicle = replace(DRONE, effects=replace(ALL, delay=False, battery_sag=False))
    flown = fly_vehicle(vehicle, commands).series()[LOOPS[loop].output]
    paper = fly(LOOPS[loop], u, 0.02)
    assert np.std(flown - paper) < 0.06 * np.std(paper)


def test_tuning_again_finds_the_gains_that_are_set() -> None:
    roll = replace(DRONE.loop.roll, gain=0.66, kp=0.014)
    found = tune(replace(DRONE, loop=replace(InnerLoop(), roll=roll)))
    for name in ("gain", "lag_s", "kp"):
        assert getattr(found.pitch, name) == pytest.approx(getattr(DRONE.loop.pitch, name), rel=1e-3)
        assert getattr(found.roll, name) == pytest.approx(getattr(DRONE.loop.roll, name), rel=1e-2)
