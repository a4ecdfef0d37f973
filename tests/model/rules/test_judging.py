"""The judge of candidates: free runs over parts of the data that a model was refined without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.ts_intervals import known_model
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.judging import AWAY, BLOCKS, PARTS, Candidate, fewest, in_words, left_out
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage
from tests.known_rules import context_of, stage_of


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


@pytest.fixture(scope="module")
def context(truth: FittedTS) -> SearchContext:
    return replace(context_of(truth), check=None)


@pytest.fixture(scope="module")
def trained(truth: FittedTS, context: SearchContext) -> Stage:
    return stage_of(context, truth, 0.0).refined(20, 1e-8)


def test_a_part_that_is_left_out_judges_as_if_the_model_had_never_seen_it(trained: Stage) -> None:
    """Against a model that was refined on the rows before the last part alone, until nothing moved."""
    (W,) = trained.problem.runs
    depth = trained.layout.depth
    begin = depth + (PARTS - 1) * (len(W) - depth) // PARTS
    apart = trained.under(runs=(W[:begin],)).refined(30, 1e-10)
    run = started_run(trained.layout, W, trained.initial[0], apart.problem.parameters(apart.body))
    gap = (run - W)[begin:, :1]
    errors = left_out(trained)
    assert len(errors) == BLOCKS
    assert errors[-BLOCKS // PARTS :].mean() == pytest.approx(float((gap * gap).mean()), rel=0.02)
    assert errors.mean() > trained.mean_square()


def _candidates(stage: Stage, *errors: list[float]) -> list[Candidate]:
    return [Candidate(stage, np.array(e)) for e in errors]


def test_the_sweep_tells_how_sure_its_distances_are(trained: Stage) -> None:
    poor, good = _candidates(trained, [0.04, 0.08], [0.01, 0.03])
    gaps = np.log([4.0, 8.0 / 3.0])
    error = 0.5 * poor.rmse * gaps.std(ddof=1) / np.sqrt(2.0)
    assert in_words([poor, good]) == f"2: {poor.rmse:.3g} +- {error:.2g}, 2: {good.rmse:.3g}"
    away = replace(poor, stable=False)
    assert away.errors.max() < AWAY
    assert in_words([good, away]).endswith(", 2: not bounded")


def test_what_helps_in_one_block_alone_is_not_worth_it(trained: Stage) -> None:
    even = [0.01] * 16
    assert fewest(_candidates(trained, even, [0.005] * 16), 0.05) == 1
    assert fewest(_candidates(trained, even, [0.0001, *even[1:]]), 0.05) == 0
    assert fewest(_candidates(trained, even, [0.0098] * 16), 0.05) == 0
