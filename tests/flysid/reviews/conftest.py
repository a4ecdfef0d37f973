"""Simulated flights of several tests, flown together: a step takes as long for one vehicle as for all."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from bench.faulty_sensors import fly
from tests.flysid.reviews.quadrotors import FlightsOf, fleet
from tests.shared import make_once


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
