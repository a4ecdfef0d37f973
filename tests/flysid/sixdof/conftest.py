"""Flights of a hidden vehicle, flown once."""

from __future__ import annotations

import pytest

from flysid.dataset import Dataset
from tests.flysid.sixdof.hidden_quad import HiddenQuad, dataset


@pytest.fixture(scope="session")
def still() -> Dataset:
    """A flight in calm air."""
    return dataset(HiddenQuad(), 1, 25.0, 1)


@pytest.fixture(scope="session")
def gusty() -> Dataset:
    """Two flights whose gusts turn the vehicle as much as its controller does."""
    return dataset(HiddenQuad(gust=8.0), 2, 25.0, 2)
