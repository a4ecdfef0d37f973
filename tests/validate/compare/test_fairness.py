"""A small version of bench/verdict_fairness.py: real fits, plants whose nature is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.verdict_fairness import (
    Journal,
    Outcome,
    exact_interval,
    flights,
    linear_plant,
    nonlinear_plant,
    row,
    totals,
)
from flysid.model.arx import ARX
from flysid.model.one_rule import OneRule
from flysid.model.ts import TS, over_lags
from flysid.validate.compare_models import compare


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_fuzzy_is_not_called_better_on_a_linear_plant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = linear_plant(rng)
    train = flights(plant, 3, rng, "t")
    test = flights(plant, 6, rng, "h")
    ts = over_lags(TS(rules=2, na=2, nb=2, nk=1), train)
    pair = compare([ARX(refine=False).fit(train), ARX().fit(train), ts], test, baseline="arx-2").verdict["y"]
    assert pair.verdict != "better"


def test_a_true_advantage_is_found_with_real_fits() -> None:
    rng = np.random.default_rng(4)
    plant = nonlinear_plant(rng)
    train = flights(plant, 3, rng, "t")
    test = flights(plant, 8, rng, "h")
    pair = compare([ARX().fit(train), over_lags(TS(rules=3, na=2, nb=2, nk=1), train)], test).verdict["y"]
    assert pair.verdict == "better"
    assert pair.ci95 is not None
    assert -35.0 < pair.ci95[0] < pair.ci95[1] < -5.0


@pytest.mark.parametrize("seed", [61, 137])
def test_one_rule_of_little_data_is_no_worse_than_arx(seed: int) -> None:
    """Orders chosen on one quarter of it were: worse by a third on one plant, and on the other it rang on."""
    rng = np.random.default_rng(seed)
    plant = nonlinear_plant(rng)
    train = flights(plant, 4, rng, "t")
    test = flights(plant, 8, rng, "h")
    pair = compare([ARX().fit(train), OneRule().fit(train)], test).verdict["y"]
    assert pair.change_pct is not None
    assert pair.change_pct < 5.0


def test_totals_state_exact_intervals() -> None:
    assert exact_interval(0, 200) == pytest.approx((0.0, 1.828), abs=1e-3)
    assert exact_interval(200, 200) == pytest.approx((98.172, 100.0), abs=1e-3)
    assert exact_interval(10, 40) == pytest.approx((12.69, 41.20), abs=1e-2)
    said = [Outcome(i, "linear", "better", 1 + i % 2, "arx", -9.0, -12.0, -6.0, -9.0, 1.0) for i in range(4)]
    text = totals("linear", said, {})
    assert "better: 4 of 4" in text
    assert "with more than one rule: 2 of 4" in text
    assert "holds the truth: 4 of 4" in text
    assert row("linear", said, range(4)) == (
        "| linear, seeds 0 to 3 | 4 | 4 (40 to 100 %), of them 2 with one rule | 0 | 0 | 0 "
        "| 4 of 4 (40 to 100 %) |"
    )


def test_an_interrupted_campaign_goes_on_with_the_same_plants_only(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    first = Journal("linear", path)
    first.read()
    outcome = Outcome(3, "linear", "same", 1, "arx", None, None, None, 0.5, 1.0)
    first.add(3, outcome)
    first.add(4, "could not be fitted")
    again = Journal("linear", path)
    again.read()
    assert again.found == {3: outcome, 4: "could not be fitted"}
    with pytest.raises(SystemExit, match="name a new file"):
        Journal("nonlinear", path).read()
