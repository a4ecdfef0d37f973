"""Simulated flights of several tests, flown together: a step takes as long for one vehicle as for all."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.faulty_quadrotor import Flight, Quadrotor, critical_gain, draw_quadrotor
from bench.faulty_sensors import fly
from bench.review_faults import FAULTS
from tests.shared import make_once

FlightsOf = Callable[[str], Mapping[str, Flight]]


def drawn(seed: int) -> Quadrotor:
    return draw_quadrotor(np.random.default_rng(seed))


def fleet() -> dict[str, dict[str, Quadrotor]]:
    """Under the name of what a test looks at: one vehicle, sound and with faults."""
    power, estimator, happened, plain = drawn(11), drawn(21), drawn(31), drawn(4)
    return {
        "power": {
            "sound": power,
            "worn": replace(power, weak=1, weakness=0.2),
            "propeller": replace(power, weak=1, weakness=0.2, propeller=True),
            "heavy": replace(power, heavier=1.2),
            "stopped": replace(power, fails_s=33.0),
            "sagging": FAULTS["sagging battery"].spoil(power, np.random.default_rng(0)),
        },
        "estimator": {
            "sound": estimator,
            "glitch": replace(estimator, glitch_s=31.0, glitch_m=22.0),
            "loose": replace(estimator, loose_m_s2=50.0),
        },
        "happened": {
            "sound": happened,
            "motor": replace(happened, fails_s=34.0),
            "brown-out": replace(happened, browns_s=41.0),
            "dropped": replace(happened, hard_m_s=3.5),
            "fence": replace(happened, incident="fence", incident_s=30.0),
            "battery": replace(happened, incident="battery", incident_s=30.0),
        },
        "plain": {
            "sound": plain,
            "weak": replace(plain, weak=2, weakness=0.2),
            "glitch": replace(plain, glitch_s=30.0, glitch_m=30.0),
            "hot": replace(plain, gain=1.2 * critical_gain(plain)),
        },
    }


def _fly_fleet(folder: Path) -> None:
    vehicles = fleet()
    flown = iter(fly([vehicle for kinds in vehicles.values() for vehicle in kinds.values()]))
    for name, kinds in vehicles.items():
        (folder / name).write_bytes(pickle.dumps({kind: next(flown) for kind in kinds}))


@pytest.fixture(scope="session")
def flights_of(tmp_path_factory: pytest.TempPathFactory) -> FlightsOf:
    """The flights of a name of `fleet`, by kind."""
    folder = make_once(tmp_path_factory, "simulated-flights", _fly_fleet)
    return lambda name: pickle.loads((folder / name).read_bytes())
