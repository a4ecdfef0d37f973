"""Dry friction in a position: a mass and two rules that differ in a constant are among the candidates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.drawn_plants import drawn as drawn_plant
from bench.dry_friction import drawn
from flysid.dataset import Dataset
from flysid.model.rules import learning
from flysid.model.rules.friction import CHANGE, rubbing
from flysid.model.rules.judging import Family
from flysid.model.rules.learning import Search
from flysid.model.rules.search_settings import SearchSettings
from flysid.model.ts import TS

QUICK = TS(search=replace(SearchSettings.of("quick"), highest_order=2))
STICKS = 140_002


def begun_on(data: Dataset) -> Search:
    """Linear starts of two flights, and no rules yet."""
    return learning.lag_starts(QUICK, data.with_segments(data.segments[:2]), None)


@pytest.fixture(scope="module")
def sticking() -> Search:
    """Of a position that sticks."""
    return begun_on(drawn(STICKS).train)


@pytest.fixture(scope="module")
def offered(sticking: Search) -> list[Family]:
    """What dry friction offers beside the linear starts."""
    return rubbing(sticking.context, sticking.starts)


def test_the_search_takes_the_rules_on_the_direction(sticking: Search) -> None:
    found = learning.select(learning.grow(sticking))
    assert [m.stage.rules for m in found.models] == [1, 2]
    assert found.chosen.stage.layout.antecedents == (CHANGE,)
    assert found.chosen.mean < 0.1 * found.plain.linear.mean


def test_the_two_rules_differ_in_their_constants_alone(offered: list[Family]) -> None:
    (family,) = offered
    stage = family.folds[0][1].stage
    backward, forward = stage.problem.parameters(stage.body).theta[:, 0]
    away = np.abs(forward - backward) / np.abs(stage.problem.basis).max(axis=0)
    assert away[-1] > 20.0 * away[:-1].max()
    assert np.abs([backward[:2].sum() - 1.0, forward[:2].sum() - 1.0]).max() < 1e-9  # the pole at one is held


@pytest.mark.parametrize("kind", [4, 8], ids=["three lags", "an integrator"])
def test_linear_plants_show_no_sign_of_it(kind: int) -> None:
    found = begun_on(drawn_plant(140_000 + kind).train)
    assert rubbing(found.context, found.starts) == []


@pytest.mark.parametrize("given", [{"na": 2}, {"nk": 1}, {"antecedents": ("u(k-1)",)}, {"rules": 2}])
def test_what_is_given_is_kept(given: dict[str, object], sticking: Search) -> None:
    asked = replace(sticking.context, settings=replace(QUICK, **given))  # type: ignore[arg-type]
    assert rubbing(asked, sticking.starts) == []
