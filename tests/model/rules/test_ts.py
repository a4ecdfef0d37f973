"""Dynamic TS models: truth on plants that are known, and the laws."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.base import load
from flysid.model.rules import learning
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.ts import TS, FittedTS, over_lags
from flysid.model.ts_state_space import TSStateSpace
from tests.contest import linear_side

pytestmark = pytest.mark.usefixtures("arx_alone")
DT = 0.05
QUICK = replace(EFFORTS["quick"], highest_order=2)  # no plant here is of a higher one


def second_order(n: int, seed: int, bend: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """A sampled oscillator whose stiffness grows with the output when bend > 0."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, n // 10), 10)
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + 0.1 * u[k - 1] - bend * y[k - 1] ** 3
    return u, y


@pytest.fixture(scope="module")
def bent() -> FittedTS:
    u, y = second_order(2000, 1, bend=0.1)
    with linear_side("arx"):
        return over_lags(TS(most_rules=3, search=QUICK), Dataset.from_arrays(u, y, DT))


def free_run_rmse(model: FittedTS, u: FloatArray, y: FloatArray) -> float:
    run = model.simulate(u, y[: model.n_init])
    return float(np.sqrt(np.mean((run[:, 0] - y) ** 2)))


def test_linear_plant_needs_one_rule() -> None:
    u, y = second_order(1200, 0)
    model = over_lags(TS(search=QUICK), Dataset.from_arrays(u, y, DT))
    assert len(model.rules()) == 1
    assert any("One rule is enough" in note for note in model.notes)
    fresh_u, fresh_y = second_order(800, 9)
    assert free_run_rmse(model, fresh_u, fresh_y) < 1e-8


def test_three_rules_on_a_linear_plant_are_nearly_equal() -> None:
    u, y = second_order(1200, 0)
    model = over_lags(TS(rules=3), Dataset.from_arrays(u, y, DT))
    assert len(model.rules()) == 3
    fresh_u, fresh_y = second_order(800, 9)
    assert free_run_rmse(model, fresh_u, fresh_y) < 1e-6 * np.ptp(fresh_y)


def test_nonlinear_plant_is_followed_better_with_rules(bent: FittedTS) -> None:
    u, y = second_order(1500, 7, bend=0.1)
    linear = over_lags(TS(rules=1, search=QUICK), Dataset.from_arrays(*second_order(2000, 1, bend=0.1), DT))
    assert len(bent.rules()) > 1
    assert free_run_rmse(bent, u, y) < 0.3 * free_run_rmse(linear, u, y)


def test_far_inputs_stay_finite_and_inside_the_limits(bent: FittedTS) -> None:
    u = np.full((500, 1), 1e6)
    u[::7] = -1e300
    run = bent.simulate(u)
    assert np.isfinite(run).all()
    assert (run >= bent.output_limits[0]).all()
    assert (run <= bent.output_limits[1]).all()


def test_start_is_kept_and_prediction_is_nan_before_it(bent: FittedTS) -> None:
    u, y = second_order(200, 3, bend=0.1)
    run = bent.simulate(u, y[: bent.n_init])
    assert np.array_equal(run[: bent.n_init, 0], y[: bent.n_init])
    for k in (1, 10):
        ahead = bent.predict(u, y, k)
        assert np.isnan(ahead[: bent.n_init + k - 1]).all()
        assert np.isfinite(ahead[bent.n_init + k - 1 :]).all()


def test_k_step_prediction_is_a_free_run_from_k_samples_before(bent: FittedTS) -> None:
    u, y = second_order(60, 3, bend=0.1)
    k = 6
    d = bent.n_init
    ahead = bent.predict(u, y, k)
    one = bent.predict(u[: d + k], np.r_[y[:d], np.zeros(k)], 1)
    # one step at a time, feeding predictions back by hand
    fed = np.r_[y[:d], np.zeros(k)]
    for i in range(d, d + k):
        fed[i] = bent.predict(u[: d + k], fed, 1)[i, 0]
    assert one.shape == (d + k, 1)
    assert ahead[d + k - 1, 0] == pytest.approx(fed[-1], abs=1e-12)


def test_json_round_trip_is_exact(bent: FittedTS, tmp_path: Path) -> None:
    u, y = second_order(300, 4, bend=0.1)
    bent.save(tmp_path / "ts.json")
    again = load(tmp_path / "ts.json")
    assert np.array_equal(again.simulate(u, y[:9]), bent.simulate(u, y[:9]))
    assert np.array_equal(again.predict(u, y, 3), bent.predict(u, y, 3), equal_nan=True)
    assert json.dumps(again.to_dict()) == json.dumps(bent.to_dict())


def test_firing_sums_to_one_and_weighs_rule_outputs(bent: FittedTS) -> None:
    u, y = second_order(300, 4, bend=0.1)
    phi = bent.firing(u, y)
    assert np.allclose(phi.sum(axis=1), 1.0, atol=1e-12)
    mean = np.einsum("nr,nri->ni", phi, bent.rule_outputs(u, y))
    one = replace(bent, noise=None).predict(u, y, 1)  # on measured lags
    assert np.allclose(mean[bent.n_init :], one[bent.n_init :], atol=1e-12)


def test_rules_speak(bent: FittedTS) -> None:
    """All coefficients stand in the words: where those break, a rule says "y(k) = ..." and goes on."""
    for rule, (row,) in zip(bent.rules(), bent.consequents, strict=True):
        assert "'" in rule.condition
        assert rule.conclusion.startswith("y(k) = ")
        said = re.findall(
            r"(-?) ?([\d.e-]+)(?: [yu]\(k(?:-\d+)?\))?(?= [+-]|$)", rule.conclusion.partition(" = ")[2]
        )
        np.testing.assert_allclose([float(sign + value) for sign, value in said], row, rtol=5e-3)
        assert rule.dc_gain.shape == (1, 1)
        assert 0 <= rule.support <= 1
    assert sum(r.support for r in bent.rules()) == pytest.approx(1.0)


def test_a_last_refinement_that_was_not_taken_is_not_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    data = Dataset.from_arrays(*second_order(600, 0, bend=0.1), DT)
    settings = TS(rules=2, na=2, nb=1, nk=1)
    claim = "refined once more on the held-out part"
    assert any(claim in note for note in settings.fit(data).notes)
    monkeypatch.setattr(learning, "refit", lambda chosen, *_: chosen.stage)
    notes = settings.fit(data).notes
    assert not any(claim in note for note in notes)
    assert any("it was no longer stable" in note for note in notes)


def test_named_antecedents_are_used() -> None:
    u, y = second_order(1200, 1, bend=0.1)
    model = over_lags(TS(rules=2, antecedents=["u(k-1)"]), Dataset.from_arrays(u, y, DT))
    assert model.antecedents == ("u(k-1)",)
    with pytest.raises(UsageError, match="not understood"):
        over_lags(TS(antecedents=["nothing(k-1)"]), Dataset.from_arrays(u, y, DT))


@pytest.mark.parametrize("name", ["u(k)-u(k-1)", "y(k-1)-y(k-1)"])
def test_an_antecedent_that_stands_still_is_named(name: str) -> None:
    """A ramp: its change is the same but for rounding, and sets along it were of no width."""
    ramp = 1e3 + 0.01 * np.arange(600)
    y = np.random.default_rng(0).normal(size=600)
    with pytest.raises(DataError, match=re.escape(f"the antecedent {name} stays at")):
        over_lags(TS(rules=2, antecedents=[name]), Dataset.from_arrays(ramp, y, DT))
    slow = ramp + 1e-3 * np.sin(0.05 * np.arange(600))
    model = over_lags(TS(rules=2, antecedents=["u(k)-u(k-1)"]), Dataset.from_arrays(slow, y, DT))
    assert model.antecedents == ("u(k)-u(k-1)",)


def test_bad_input_is_named() -> None:
    u, y = second_order(400, 1)
    with pytest.raises(DataError, match="'u' never changes"):
        over_lags(TS(), Dataset.from_arrays(np.ones(400), y, DT))
    with pytest.raises(DataError, match="longest segment"):
        over_lags(TS(), Dataset.from_arrays(u[:8], y[:8], DT))
    with pytest.raises(UsageError, match="rules"):
        over_lags(TS(rules=0), Dataset.from_arrays(u, y, DT))


@pytest.mark.parametrize("samples", [70, 80, 88, 95])
def test_a_short_record_leaves_no_window_to_judge_on_and_is_fitted(samples: int) -> None:
    u, y = second_order(100, 1)
    noisy = y + 0.01 * np.random.default_rng(samples).standard_normal(len(y))
    model = over_lags(TS(), Dataset.from_arrays(u[:samples], noisy[:samples], DT))
    assert np.isfinite(model.simulate(u[:samples], noisy[: model.n_init])).all()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"nb": None}, "nb is"),
        ({"nb": (1.5,)}, "nb is"),
        ({"nk": -1}, "nk is"),
        ({"na": "two"}, "na is .*, not 'two'"),
        ({"most_rules": "few"}, "most_rules is"),
        ({"iterations": 2.5}, "iterations is"),
        ({"refine": "no"}, "refine is True or False"),
        ({"antecedents": [3]}, "antecedents is a list of texts"),
        ({"antecedents": ["y(k-1)", "y"]}, "'y' is named twice"),
    ],
)
def test_settings_that_cannot_be_are_named(settings: dict[str, Any], word: str) -> None:
    u, y = second_order(400, 1)
    with pytest.raises(UsageError, match=word):
        over_lags(TS(**settings), Dataset.from_arrays(u, y, DT))


def test_more_rules_than_data_are_refused_before_they_are_grown(monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = second_order(400, 1)

    def never(*_: object) -> None:
        raise AssertionError("growing hundreds of rules takes hours")

    monkeypatch.setattr(learning, "search", never)
    with pytest.raises(DataError, match="90 rules of 3 numbers need more than the"):
        over_lags(TS(rules=90, na=1, nb=1, nk=1), Dataset.from_arrays(u, y, DT))


def test_numbers_of_numpy_will_do(tmp_path: Path) -> None:
    u, y = second_order(400, 1)
    settings = TS(rules=1, na=np.int64(2), nb=np.int64(1), nk=np.array([1]), refine=False)  # type: ignore[arg-type]
    settings.fit(Dataset.from_arrays(u, y, DT)).save(tmp_path / "m.json")
    assert load(tmp_path / "m.json").layout.depth == 2  # type: ignore[attr-defined]


def test_without_refinement_the_free_run_is_worse(bent: FittedTS) -> None:
    data = Dataset.from_arrays(*second_order(2000, 1, bend=0.1), DT)
    plain = over_lags(TS(rules=len(bent.rules()), na=2, nb=2, nk=1, refine=False), data)
    u, y = second_order(1500, 7, bend=0.1)
    assert len(plain.rules()) == len(bent.rules())
    assert free_run_rmse(bent, u, y) < free_run_rmse(plain, u, y)
    assert any("not refined" in note for note in plain.notes)


def test_a_model_reads_as_text(bent: FittedTS) -> None:
    text = str(bent)
    title, first, *rest = text.splitlines()
    assert "rules" in title
    level = r"-?\d+(?:\.\d+)?"
    known = rf"({level}) \(({level}) to ({level})\)"
    answer = rf"one unit more of u adds {known} to y; 63 % of that is reached after {level} s \({level} to"
    found = re.match(rf"  \* (?:From|Near) y = {level}(?:, {level})* (?:to|and) {level}, {answer}", first)
    assert found, first
    gain, low, high = map(float, found.groups())
    assert low < gain < high
    assert low < 1.0 < high  # the plant's at rest at 0: 0.1 / (1 - 1.6 + 0.7)
    rules = [line for line in rest if re.match(r"  R\d+\. If y\(k-1\) is .* then y\(k\) = ", line)]
    assert len(rules) == len(bent.rules())
    assert re.search(rf"at rest near y = {level}: gain {level}, 63 % after {level} s", rules[0])


def test_an_input_without_a_lag_is_the_one_after_its_delay() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1, 1, 60), 10)
    y = np.asarray(lfilter([0.0, 0.3], [1.0, -0.7], np.tanh(2.0 * u)))
    data = Dataset.from_arrays(u, y, DT)
    late = TS(rules=2, na=1, nb=1, nk=1, iterations=5)
    assert over_lags(replace(late, antecedents=["u"]), data).antecedents == ("u(k-1)",)
    assert over_lags(replace(late, antecedents=["u", "u(k)"]), data).antecedents[0].startswith("u(k")
    hidden = TSStateSpace(states=2, rules=2, nk=1, ridge=0.1, antecedents=("u",)).fit(data)
    assert hidden.antecedents == ("u(k-1)",)
    with pytest.raises(UsageError, match="named twice"):
        replace(late, antecedents=["u", "u(k-1)"]).fit(data)
