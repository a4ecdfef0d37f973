"""Rules judged on several parts of little data: a search that fails on one part must not decide."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flysid.model.fuzzy.choice import Candidate
from flysid.model.fuzzy.grow import unrefined
from flysid.model.fuzzy.model import FittedTS
from flysid.model.fuzzy.problem import runs_of
from flysid.model.fuzzy.refit import restated
from flysid.model.fuzzy.search import not_astray
from flysid.model.fuzzy.workshop import Workshop
from flysid.model.ts import TS
from tests.bench.ts_intervals import experiment, known_model


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


@pytest.fixture(scope="module")
def fold(truth: FittedTS) -> Workshop:
    layout = truth.layout
    return Workshop(
        TS(), experiment(truth, 1), experiment(truth, 2), layout.shift, layout.scale, truth.n_init + 10
    )


def candidate(fold: Workshop, model: FittedTS, share: float) -> Candidate:
    """The model's rules, `share` of the way to being all equal, unrefined."""
    theta = (1.0 - share) * model.parameters.theta + share * model.parameters.theta.mean(axis=0)
    runs = runs_of(model.layout, fold.fit_part.segments, fold.least)
    return fold.judge(unrefined(*restated(model.layout, model.parameters._replace(theta=theta), runs)))


def test_a_search_that_went_astray_is_replaced_by_refits(truth: FittedTS, fold: Workshop) -> None:
    """Of all models: one rule that was grown must not stand beside two that saw more."""
    model, astray = candidate(fold, truth, 0.0), candidate(fold, truth, 1.0)
    assert astray.stage.cost > 1.5 * model.stage.cost
    first, second = not_astray(fold, [model, model], [model, astray])
    assert second.stage.cost < 1.05 * model.stage.cost
    assert second.mean < 0.7 * astray.mean
    assert first.mean == second.mean


def test_rules_that_were_found_are_kept(truth: FittedTS, fold: Workshop) -> None:
    model, found = candidate(fold, truth, 0.0), candidate(fold, truth, 0.02)
    assert not_astray(fold, [model], [found]) == [found]


def test_a_model_that_is_no_better_replaces_nothing(truth: FittedTS, fold: Workshop) -> None:
    """The cost elsewhere was low, but a refit to this part is not: the part is hard."""
    poor, grown = candidate(fold, truth, 1.0), candidate(fold, truth, 0.0)
    flattered = replace(poor, stage=replace(poor.stage, cost=1e-9))
    assert not_astray(fold, [flattered], [grown]) == [grown]
