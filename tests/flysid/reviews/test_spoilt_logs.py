"""Reviews of a few spoilt logs; row 38 of the soak tries many."""

from __future__ import annotations

import random

import pytest

from tests.flysid.reviews.quadrotors import FlightsOf
from tests.review_trials import KINDS, compare, logged


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("trial", range(3))
def test_a_spoilt_log_is_reviewed(kind: str, trial: int, flights_of: FlightsOf) -> None:
    rng = random.Random(trial)
    flown = rng.choice([*flights_of("spoilt").values()])
    assert not compare(logged(kind, flown), rng)
