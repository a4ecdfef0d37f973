"""Flights that resemble their neighbours, odd flights, flights of one day: of which flights a verdict is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.verdict_few import POLE, claim, draw_gains, flight_of
from flysid.dataset import BEGAN, Dataset
from flysid.validate.compare.intervals import Scope, change
from flysid.validate.compare.neighbours import (
    KINDS,
    correlation_of_neighbours,
    effective_flights,
    ends_of_odd,
    mean_of_neighbours,
    sum_of_correlations,
)
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.words import scope_words, verdict_words
from flysid.validate.compare_models import compare
from tests.drawn import is_rarer, is_seldom
from tests.fakes import FirstOrder

TRIALS = 60
SEVERAL_DAYS_S = 3 * 86_400.0


@pytest.mark.parametrize("count", [2, 3, 4, 6, 10, 20])
@pytest.mark.parametrize("kind", ["drift", "one in six odd"])
def test_equally_good_models_are_not_told_apart_on_another_flight(
    kind: str, count: int, fresh_seed: int
) -> None:
    """With drift 4, 12, 21, 25, 25 of 40 were, one in six odd 4, 6, 9, 11, 10 of 40."""
    rng = np.random.default_rng(fresh_seed)
    wrong = sum(claim(draw_gains(kind, count, rng), 300, rng) is Scope.ANOTHER for _ in range(TRIALS))
    assert not is_rarer(wrong, TRIALS, 0.05), f"{wrong} of {TRIALS}"


def test_true_differences_are_found(fresh_seed: int) -> None:
    """On flights like these with six, on another flight with 30."""
    rng = np.random.default_rng(fresh_seed)
    six, many = (
        [claim(draw_gains("a true difference", count, rng), 300, rng) for _ in range(TRIALS)]
        for count in (6, 30)
    )
    assert not is_seldom(six.count(Scope.LIKE), TRIALS, 0.9)
    assert not is_seldom(many.count(Scope.ANOTHER), TRIALS, 0.8)


def test_kinds_by_hand() -> None:
    """A kind of one in six is missing from 16 flights with 5.4 %, from 17 with 4.5 %."""
    assert (5.0 / 6.0) ** KINDS < 0.05 < (5.0 / 6.0) ** (KINDS - 1)


def test_neighbours_count_as_many_as_their_correlation_says() -> None:
    assert sum_of_correlations(0.0, 9) == 1.0
    assert sum_of_correlations(1.0, 9) == pytest.approx(9.0)
    assert sum_of_correlations(0.5, 3) == pytest.approx(1.0 + 2.0 * (2.0 / 3.0 * 0.5 + 1.0 / 3.0 * 0.25))
    rng = np.random.default_rng(3)
    found = [correlation_of_neighbours(rng.normal(size=20))[0] for _ in range(400)]
    assert np.mean(found) == pytest.approx(0.0, abs=0.05)
    assert effective_flights(list(np.arange(20.0))) < 4.0
    assert effective_flights([1.0, -1.0] * 10) == 20.0
    assert effective_flights([2.0] * 8) == 8.0


def test_the_mean_of_neighbours_is_known_less_well_than_that_of_independent_flights() -> None:
    rng = np.random.default_rng(5)
    slow = np.cumsum(rng.normal(size=30))
    mixed = rng.permutation(slow)
    assert mean_of_neighbours(list(slow))[0] > 2.0 * mean_of_neighbours(list(mixed))[0]
    assert mean_of_neighbours([0.0] * 5) == (0.0, 1.0)
    assert mean_of_neighbours([1.0] * 5) == (0.0, 0.0)


def test_odd_flights_count_by_the_share_they_may_have() -> None:
    """By hand: one of twenty makes up 0.13 to 24.9 % (Clopper and Pearson)."""
    values = [*np.linspace(-0.11, -0.09, 19), 0.9]
    low, high = ends_of_odd(values)
    assert low == pytest.approx(-0.1 + 0.00127, abs=1e-4)
    assert high == pytest.approx(-0.1 + 0.2487, abs=1e-3)
    even = list(np.linspace(0.0, 1.0, 9))
    assert ends_of_odd(even) == (0.5, 0.5)


def test_the_order_is_that_of_the_dates_where_these_are_known() -> None:
    """A slow drift, read in a shuffled order: only with its dates it is seen."""
    rng = np.random.default_rng(8)
    names = [str(i) for i in range(20)]
    drift = np.linspace(0.5, 2.0, 20)
    shuffled = rng.permutation(20)
    ea = [rng.normal(size=300) for _ in names]
    eb = [drift[i] * rng.normal(size=300) for i in shuffled]
    began = {name: SEVERAL_DAYS_S * i for name, i in zip(names, shuffled, strict=True)}
    assert change(ea, eb, names).effective is None
    dated = change(ea, eb, names, began=began)
    assert dated.effective is not None
    assert dated.effective < 5.0


@pytest.mark.parametrize(
    ("apart_s", "scope"), [(600.0, Scope.DAY), (SEVERAL_DAYS_S, Scope.LIKE), (None, Scope.LIKE)]
)
def test_flights_of_one_day_speak_of_that_day(apart_s: float | None, scope: Scope) -> None:
    rng = np.random.default_rng(4)
    flown = [flight_of(1.1 + 0.005 * rng.normal(), 400, rng) for _ in range(6)]
    data = Dataset.from_arrays([u for u, _ in flown], [y for _, y in flown], 0.05)
    if apart_s is not None:
        marked = [replace(s, marks={BEGAN: 1.7e9 + i * apart_s}) for i, s in enumerate(data.segments)]
        data = data.with_segments(marked)
    low, high = (FirstOrder(a=POLE, b=gain * (1.0 - POLE), dt_s=0.05) for gain in (0.9, 1.1))
    named = {"arx": low, "ts": replace(high, structure="ts", labels=("R1", "R2"))}
    pair = compare(named, data, horizons=[FREE_RUN]).verdict["y"]
    assert (str(pair.verdict), pair.scope) == ("better", scope)
    assert verdict_words(pair) == f"TS better on {scope}"


def test_neighbours_that_are_alike_are_named() -> None:
    rng = np.random.default_rng(6)
    flown = [flight_of(gain, 400, rng) for gain in np.linspace(1.02, 1.12, 12)]
    data = Dataset.from_arrays([u for u, _ in flown], [y for _, y in flown], 0.05)
    low, high = (FirstOrder(a=POLE, b=gain * (1.0 - POLE), dt_s=0.05) for gain in (0.9, 1.1))
    named = {"arx": low, "ts": replace(high, structure="ts", labels=("R1", "R2"))}
    pair = compare(named, data, horizons=[FREE_RUN]).verdict["y"]
    said = "flights next to each other are alike: for other days these 12 count as about 1"
    assert said in scope_words(pair)
