"""Flights of a hidden vehicle, flown once, and the vehicles that are found in them."""

from __future__ import annotations

import pytest

import flysid
from flysid.dataset import Dataset
from flysid.sixdof.fitted import FittedVehicle
from tests.flysid.sixdof.hidden_quad import HiddenQuad, dataset
from tests.shared import find_once


@pytest.fixture(scope="session")
def still(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A flight in calm air."""
    return find_once(tmp_path_factory, "still", lambda: dataset(HiddenQuad(), 1, 25.0, 1))


@pytest.fixture(scope="session")
def short(still: Dataset) -> Dataset:
    """Its beginning, for what is printed of any vehicle."""
    return still.with_segments(
        [segment.slice(0, len(segment) // 2, still.dt_s) for segment in still.segments]
    )


@pytest.fixture(scope="session")
def gusty(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two flights whose gusts turn the vehicle as much as its controller does."""
    return find_once(tmp_path_factory, "gusty", lambda: dataset(HiddenQuad(gust=8.0), 2, 25.0, 2))


@pytest.fixture(scope="session")
def vehicle(still: Dataset, tmp_path_factory: pytest.TempPathFactory) -> FittedVehicle:
    """Of the flight in calm air, by free runs."""
    return find_once(tmp_path_factory, "vehicle", lambda: flysid.Vehicle().fit(still))


@pytest.fixture(scope="session")
def regressed(still: Dataset, tmp_path_factory: pytest.TempPathFactory) -> FittedVehicle:
    """Of the same flight, by regression alone."""
    return find_once(tmp_path_factory, "regressed", lambda: flysid.Vehicle(free_runs=False).fit(still))


@pytest.fixture(scope="session")
def gusty_regressed(gusty: Dataset, tmp_path_factory: pytest.TempPathFactory) -> FittedVehicle:
    """Of the flights in gusts, by regression alone."""
    return find_once(tmp_path_factory, "gusty-regressed", lambda: flysid.Vehicle(free_runs=False).fit(gusty))
