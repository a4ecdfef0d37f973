"""Rules judged on several parts of little data: a search that fails on one part must not decide."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.ts_intervals import known_model
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.judging import Candidate
from flysid.model.rules.search import not_astray
from flysid.model.rules.search_context import SearchContext
from tests.known_rules import context_of, stage_of


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


@pytest.fixture(scope="module")
def fold(truth: FittedTS) -> SearchContext:
    return context_of(truth)


def candidate(fold: SearchContext, model: FittedTS, share: float) -> Candidate:
    return fold.judge(stage_of(fold, model, share))


def test_a_search_that_went_astray_is_replaced_by_refits(truth: FittedTS, fold: SearchContext) -> None:
    """Of all models: one rule that was grown must not stand beside two that saw more."""
    model = candidate(fold, truth, 0.0)
    astray = candidate(fold, truth, 1.0)
    assert astray.stage.cost > 1.5 * model.stage.cost
    first, second = not_astray(fold, [model, model], [model, astray])
    assert second.stage.cost < 1.05 * model.stage.cost
    assert second.mean < 0.7 * astray.mean
    assert first.mean == second.mean


def test_rules_that_were_found_are_kept(truth: FittedTS, fold: SearchContext) -> None:
    model = candidate(fold, truth, 0.0)
    found = candidate(fold, truth, 0.02)
    assert not_astray(fold, [model], [found]) == [found]


def test_a_model_that_is_no_better_replaces_nothing(truth: FittedTS, fold: SearchContext) -> None:
    """The cost elsewhere was low, but a refit to this part is not: the part is hard."""
    poor = candidate(fold, truth, 1.0)
    grown = candidate(fold, truth, 0.0)
    flattered = replace(poor, stage=replace(poor.stage, cost=1e-9))
    assert not_astray(fold, [flattered], [grown]) == [grown]
