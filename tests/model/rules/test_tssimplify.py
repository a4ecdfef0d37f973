"""Simplifying TS models: what says nothing goes for free, what matters has its price."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.ts_intervals import experiment, known_model
from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.model.rules.edits import simplifications
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.regressor_layout import Antecedent


@pytest.fixture(scope="module")
def truth() -> FittedTS:
    return known_model()


def with_twin(model: FittedTS) -> FittedTS:
    """The second rule said twice."""
    p = model.parameters
    rows = [0, 1, 1]
    twins = p._replace(theta=p.theta[rows].copy(), centre=p.centre[rows].copy(), width=p.width[rows].copy())
    return replace(model, parameters=twins, support=np.array([0.5, 0.25, 0.25]))


def test_a_rule_said_twice_is_merged_for_nothing(truth: FittedTS) -> None:
    train = experiment(truth, 1)
    validation = experiment(truth, 2)
    cheapest = simplifications(with_twin(truth), train, validation)[0]
    assert len(cheapest.model.rules()) == 2
    assert cheapest.what == "R2 and R3 merged"
    assert cheapest.loss_pct < 2.0
    assert "R2 and R3 merged: free run" in str(cheapest)


def test_rules_that_matter_stay_and_their_price_is_told(truth: FittedTS) -> None:
    train = experiment(truth, 1)
    validation = experiment(truth, 2)
    [offer] = simplifications(truth, train, validation)
    assert len(offer.model.rules()) == 1
    assert offer.loss_pct > 20.0


def test_a_condition_that_says_nothing_is_left_out(truth: FittedTS) -> None:
    p = truth.parameters
    both = replace(truth.layout, antecedents=(*truth.layout.antecedents, Antecedent(0, 1)))
    wide = p._replace(
        centre=np.hstack([p.centre, np.zeros((2, 1))]),
        width=np.hstack([p.width, np.full((2, 1), 5.0)]),
        z_range=np.hstack([p.z_range, np.array([[-3.0], [3.0]])]),
    )
    chatty = replace(truth, layout=both, parameters=wide)
    cheapest = simplifications(chatty, experiment(truth, 1), experiment(truth, 2))[0]
    assert cheapest.model.layout.antecedents == truth.layout.antecedents
    assert cheapest.what == "conditions on y(k-1) left out"


def test_one_rule_has_nothing_to_simplify(truth: FittedTS) -> None:
    data = experiment(truth, 1)
    [offer] = simplifications(truth, data)
    assert simplifications(offer.model, data) == []


def test_segments_too_short_to_simulate_are_refused(truth: FittedTS) -> None:
    short = Dataset.from_arrays(np.zeros((1, 1)), np.zeros(1), truth.dt_s)
    with pytest.raises(DataError, match="no segment"):
        simplifications(truth, short)
    with pytest.raises(DataError, match="too few"):
        simplifications(truth, Dataset.from_arrays(np.zeros((6, 1)), np.zeros(6), truth.dt_s))
