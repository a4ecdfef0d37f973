"""A small version of bench/verdict_few.py: equal models are not told apart by few flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.verdict_fairness import DT_S
from bench.verdict_few import POLE, equal_verdict, flight_of, told_apart
from flysid.dataset import Dataset
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.words import scope_words, verdict_words
from flysid.validate.compare_models import compare
from tests.fakes import FirstOrder


@pytest.mark.parametrize("count", [2, 4])
def test_equal_models_are_called_better_or_worse_about_as_rarely_as_it_says(count: int) -> None:
    """Blocks of time instead of flights called 35, 17 and 15 % of them so, with 2, 3 and 4 flights."""
    rng = np.random.default_rng(count)
    said = [equal_verdict(count, 400, rng) for _ in range(25)]
    assert sum(p.verdict in ("better", "worse") for p in said) <= 4
    assert {p.scope for p in said} == {Scope.LIKE}


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_equal_models_are_not_told_apart_where_flights_are_spread_evenly(count: int) -> None:
    """Student's t called 7 to 8 % of them so; 5 %, and two and a half standard errors."""
    rng = np.random.default_rng(count)
    wrong = sum(told_apart(rng.uniform(0.83, 1.17, count), 200, rng) for _ in range(1500))
    assert wrong <= 0.064 * 1500


def test_a_verdict_says_which_flights_may_be_missing() -> None:
    """By hand: of eight flights 0.95 hold one of a kind that is 31 % of all, of three 63 %."""
    rng = np.random.default_rng(4)
    for count, share in ((8, 31), (3, 63)):
        flown = [flight_of(1.1, 400, rng) for _ in range(count)]
        data = Dataset.from_arrays([u for u, _ in flown], [y for _, y in flown], DT_S)
        low, high = (FirstOrder(a=POLE, b=gain * (1.0 - POLE), dt_s=DT_S) for gain in (0.9, 1.1))
        named = {"arx": low, "ts": replace(high, structure="ts", labels=("R1", "R2"))}
        pair = compare(named, data, horizons=[FREE_RUN]).verdict["y"]
        kind = f"a kind of flight that makes up less than {share} % of all"
        said = f"among {count} flights {kind} may be missing"
        assert pair.verdict == "better"
        assert (said in scope_words(pair)) is (share < 50)


def test_one_flight_shows_what_it_shows_and_says_so() -> None:
    """Its gain of 1.1 suits one of the two models; the flights of the vehicle have a mean gain of 1."""
    pair = equal_verdict(1, 4000, np.random.default_rng(2))
    assert pair.scope is Scope.THIS
    assert pair.verdict in ("better", "worse")
    assert "on this flight" in verdict_words(pair)
    assert "one flight does not show whether another would agree" in scope_words(pair)
