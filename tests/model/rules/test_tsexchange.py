"""A rule in the wrong place moves by way of one rule more; what is not surely better replaces nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.ts_intervals import known_model
from flysid.model.rules.edits import merge_and_split
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import skip_refining
from flysid.model.rules.judging import Candidate, Family, fewest_rules, sweep_in_words
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage, insert
from tests.known_rules import context_of, stage_of


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


@pytest.fixture(scope="module")
def context(truth: FittedTS) -> SearchContext:
    return context_of(truth)


def one_more_than(stage: Stage) -> Stage:
    """The stage with a third rule beside its first, which says what the others say there."""
    grown = insert(stage, 0.8 * stage.body.centre[0] + 0.2 * stage.body.centre[1], stage.body.width[0])
    return skip_refining(grown.problem, grown.body)


def test_a_poor_model_becomes_a_good_one_with_as_many_rules(truth: FittedTS, context: SearchContext) -> None:
    good = stage_of(context, truth, 0.0)
    poor = context.judge(stage_of(context, truth, 0.8))
    larger = context.judge(one_more_than(good))
    one = context.judge(stage_of(context, truth, 1.0))
    found = merge_and_split(context, [one, poor, larger], 1)
    assert found.stage.rules == poor.stage.rules == 2
    assert found.stage.cost < 1.05 * good.cost < 0.8 * poor.stage.cost
    assert found.mean < 0.8 * poor.mean


def test_a_good_model_stays(truth: FittedTS, context: SearchContext) -> None:
    good, poor = (context.judge(stage_of(context, truth, share)) for share in (0.0, 0.9))
    larger = context.judge(one_more_than(poor.stage))
    settled = replace(good, stage=replace(good.stage, cost=0.9 * good.stage.cost))
    assert merge_and_split(context, [poor, settled, larger], 1) is settled


def test_the_sweep_tells_how_sure_its_distances_are(truth: FittedTS, context: SearchContext) -> None:
    good, poor = (context.judge(stage_of(context, truth, share)) for share in (0.0, 0.8))
    models = (replace(poor, errors=np.array([0.04, 0.08])), replace(good, errors=np.array([0.01, 0.03])))
    grown = Family((models,))
    root = np.sqrt(0.06)  # the gaps 0.03 and 0.05 have a standard error of 0.01
    assert sweep_in_words(grown, grown) == f"1: {root:.3g} +- {0.01 / (2 * root):.2g}, 2: {np.sqrt(0.02):.3g}"
    assert "+-" not in sweep_in_words(Family((models[:1],)), grown)
    away = Family(((models[1], replace(models[0], stable=False)),))
    assert sweep_in_words(away, away).endswith(", 2: not bounded")  # "2: 1e+03 +- 8.2e-07" before


def test_a_rule_that_helps_in_one_window_is_not_worth_it(truth: FittedTS, context: SearchContext) -> None:
    """Four folds of four windows; one fold hides what the others have, and the mean looks at nothing else."""
    one = context.judge(stage_of(context, truth, 0.0))
    even = np.full(4, 0.01)
    helped = Family(tuple((replace(one, windows=w), replace(one, windows=0.5 * w)) for w in [even] * 4))
    assert fewest_rules(helped, helped, 0.2) == 1
    rare = [np.array([1.0, 0.01, 0.01, 0.01]), even, even, even]
    lucky = [np.array([0.5, 0.01, 0.01, 0.01]), even, even, even]
    once = Family(
        tuple((replace(one, windows=a), replace(one, windows=b)) for a, b in zip(rare, lucky, strict=True))
    )
    assert fewest_rules(once, once, 0.2) == 0


def test_little_data_and_single_rules_are_left_alone(truth: FittedTS, context: SearchContext) -> None:
    good, poor = (context.judge(stage_of(context, truth, share)) for share in (0.0, 0.8))
    models: list[Candidate] = [poor, poor, context.judge(one_more_than(good.stage))]
    little = replace(context, folds=((context.fit_part, context.check_part),))
    assert merge_and_split(little, models, 1) is poor
    single = replace(poor, stage=replace(poor.stage, body=replace(poor.stage.body, a=poor.stage.body.a[:1])))
    assert merge_and_split(context, [single], 0) is single
