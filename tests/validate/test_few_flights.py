"""A small version of bench/verdict_few.py: equal models are not told apart by few flights."""

from __future__ import annotations

import numpy as np
import pytest

from bench.verdict_few import equal_verdict
from flysid.validate.intervals import Scope
from flysid.validate.words import scope_words, verdict_words


@pytest.mark.parametrize("count", [2, 4])
def test_equal_models_are_called_better_or_worse_about_as_rarely_as_it_says(count: int) -> None:
    """Blocks of time instead of flights called 35, 17 and 15 % of them so, with 2, 3 and 4 flights."""
    rng = np.random.default_rng(count)
    said = [equal_verdict(count, 400, rng) for _ in range(25)]
    assert sum(p.verdict in ("better", "worse") for p in said) <= 4
    assert {p.scope for p in said} == {Scope.ANOTHER}


def test_one_flight_shows_what_it_shows_and_says_so() -> None:
    """Its gain of 1.1 suits one of the two models; the flights of the vehicle have a mean gain of 1."""
    pair = equal_verdict(1, 4000, np.random.default_rng(2))
    assert pair.scope is Scope.THIS
    assert pair.verdict in ("better", "worse")
    assert "on this flight" in verdict_words(pair)
    assert "one flight does not show whether another would agree" in scope_words(pair)
