"""The linear side: chosen by validation, not against the whole of the training data, references beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import FitError
from flysid.model.base import Fitted
from flysid.model.linear_choice import choose_baseline, confirm
from flysid.model.mean import Mean
from flysid.model.one_rule import linear_rivals
from flysid.model.persistence import Persistence
from flysid.progress import listening
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.models import across_channels
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.tables import to_csv, to_markdown
from flysid.validate.show.terminal import summary, table
from tests.fakes import FirstOrder, flown

TRUTH = FirstOrder(a=0.9, b=0.1)
TWO_RULES = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", "R2"))
TRAIN = flown(TRUTH, [300] * 6, noise=0.02)
TEST = flown(TRUTH, [300] * 6, noise=0.02, seed=5)


@dataclass(frozen=True)
class Gives:
    """An estimator that always learns the same model, or nothing."""

    model: FirstOrder | None

    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:  # noqa: ARG002
        if self.model is None:
            raise FitError("no stable model was found")
        return self.model


def test_the_best_by_validation_is_the_baseline() -> None:
    poor = Gives(FirstOrder(a=0.9, b=0.08))
    choice = choose_baseline(TRAIN, {"arx": poor, "oe": Gives(TRUTH), "bj": Gives(None)})
    assert choice.label == "oe"
    assert set(choice.rmse) == {"arx", "oe"}
    assert choice.rmse["oe"] < 0.7 * choice.rmse["arx"]
    assert "OE" in choice.words
    assert confirm(choice, {"arx": FirstOrder(a=0.9, b=0.08), "oe": TRUTH}, TRAIN) == choice


def test_the_error_of_every_linear_model_is_told_before_the_next_one_is_fitted() -> None:
    told: list[tuple[str, float | None]] = []
    with listening(lambda step: told.append((step.model, step.validation))):
        choice = choose_baseline(TRAIN, {"arx": Gives(FirstOrder(a=0.9, b=0.08)), "oe": Gives(TRUTH)})
    assert [model for model, _ in told] == ["arx", "arx", "oe", "oe"]
    assert [error for _, error in told[::2]] == [None, None]
    assert [error for _, error in told[1::2]] == pytest.approx([choice.rmse["arx"], choice.rmse["oe"]])


def test_arx_stays_where_nothing_is_clearly_better() -> None:
    near = Gives(FirstOrder(a=0.9, b=0.1004))
    nearer = Gives(FirstOrder(a=0.9, b=0.0999))
    for arx, other in ((near, nearer), (nearer, near)):
        choice = choose_baseline(TRAIN, {"arx": arx, "oe": other})
        assert choice.label == "arx"
        beaten = choice.rmse["oe"] < choice.rmse["arx"]
        assert choice.words.endswith("none is clearly better than ARX") is beaten
    with pytest.raises(FitError, match="no linear model"):
        choose_baseline(TRAIN, {"arx": Gives(None)})
    assert set(linear_rivals()) >= {"arx", "oe", "armax", "bj", "statespace"}


def test_a_winner_by_luck_is_not_kept() -> None:
    choice = choose_baseline(TRAIN, {"arx": Gives(FirstOrder(a=0.9, b=0.08)), "oe": Gives(TRUTH)})
    refitted = {"arx": FirstOrder(a=0.9, b=0.08), "oe": FirstOrder(a=0.9, b=0.05)}
    kept = confirm(choice, refitted, TRAIN)
    assert kept.label == "arx"
    assert "OE was not kept" in kept.words
    assert confirm(choice, {"arx": TRUTH}, TRAIN).label == "arx"  # its last fit failed


def test_compare_holds_models_against_the_linear_one_that_follows_training_best() -> None:
    models = {"arx": FirstOrder(a=0.9, b=0.08), "oe": TRUTH, "ts": TWO_RULES}
    assert compare(models, TEST, train=TRAIN).baseline == "oe"
    assert compare(models, TEST).baseline == "arx"  # nothing tells which is better
    near = {**models, "arx": FirstOrder(a=0.9, b=0.0999)}
    assert compare(near, TEST, train=TRAIN).baseline == "arx"
    assert compare({"ts": TWO_RULES, "mean": Mean().fit(TRAIN)}, TEST, train=TRAIN).baseline == "ts"
    one_rule = {"arx": FirstOrder(a=0.9, b=0.08), "ts": replace(TRUTH, structure="ts", labels=("R1",))}
    assert compare(one_rule, TEST, train=TRAIN).baseline == "arx"  # what is judged judges nothing


def test_data_too_short_to_choose_on_leave_arx() -> None:
    short = flown(TRUTH, [25], noise=0.02)
    assert choose_baseline(short, {"arx": Gives(TRUTH), "oe": Gives(TRUTH)}).label == "arx"


def test_references_do_what_their_names_say() -> None:
    mean = Mean().fit(TRAIN)
    held = Persistence().fit(TRAIN)
    u = TEST.segments[0].u
    y = TEST.segments[0].y
    level = np.mean(np.concatenate([s.y for s in TRAIN.segments]))
    assert np.allclose(mean.simulate(u, y[:0]), level, rtol=1e-12)
    assert np.allclose(mean.predict(u, y, 3)[2:], level, rtol=1e-12)
    assert np.array_equal(held.simulate(u, y[:1]), np.full_like(y, y[0, 0]))
    for k in (1, 7):
        assert np.allclose(held.predict(u, y, k)[k:], y[:-k], rtol=0, atol=1e-12)


def test_references_stand_beside_the_models_and_are_never_the_contender() -> None:
    c = compare([TRUTH, FirstOrder(b=0.08, structure="ts", labels=("R1", "R2"))], TEST, train=TRAIN)
    assert set(c.models) == {"arx", "ts", "mean", "persistence"}
    assert c.contender == "ts"
    assert compare({"arx": TRUTH, "mean": Mean().fit(TRAIN)}, TEST).contender is None
    for text in (table({"c": c}), to_markdown({"c": c})):
        assert text.count("reference") == 2
    assert ",persistence," in to_csv({"c": c})
    page = render(ReportContext({"c": c}, train={"c": TRAIN}))
    assert "A useful model has a smaller error than both" in page


def test_a_model_that_loses_to_the_mean_is_called_out() -> None:
    wrong = FirstOrder(a=0.9, b=-0.1, structure="ts", labels=("R1", "R2"))
    c = compare([FirstOrder(a=0.9, b=-0.09), wrong], TEST, train=TRAIN)
    said = cautions({"roll": c}, {"roll": diagnose(c, TRAIN)})
    assert said[0].level == "danger"
    assert "no better than the training mean on roll" in said[0].text
    two = cautions({"roll": c, "pitch": c}, dict.fromkeys(("roll", "pitch"), diagnose(c, TRAIN)))
    (once,) = (x.text for x in two if "no better than the training mean on" in x.text)
    assert "on roll (RMSE: " in once
    assert ", pitch (RMSE: " in once
    good = compare([TRUTH, FirstOrder(a=0.9, b=0.09, structure="ts")], TEST, train=TRAIN)
    assert not any("training mean" in x.text for x in cautions({"c": good}, {"c": diagnose(good, TRAIN)}))


def test_a_better_model_of_one_rule_is_called_linear_in_every_form() -> None:
    one = FirstOrder(a=0.9, b=0.1, structure="ts")
    c = compare([FirstOrder(a=0.9, b=0.07), one], TEST, train=TRAIN)
    pair = c.verdict["y"]
    assert pair.verdict == "better"
    assert pair.one_rule
    assert not pair.earned
    page = render(ReportContext({"roll": c}, train={"roll": TRAIN}))
    assert "A linear model is enough on another flight like these on roll." in page
    assert "not from fuzziness" in page
    assert "The fuzzy model is better" not in page
    for text in (table({"roll": c}), to_markdown({"roll": c}), page):
        assert (
            "TS better (one rule: linear)" in text or f"TS better on {Scope.LIKE} (one rule: linear)" in text
        )
    assert c.to_json()["channels"][c.channel]["free_run"]["one_rule"]
    said = cautions({"roll": c}, {"roll": diagnose(c, TRAIN)})
    assert any("has one rule: it is a linear model" in x.text for x in said)


def two_rules(b: float) -> FirstOrder:
    return FirstOrder(a=0.9, b=b, structure="ts", labels=("R1", "R2"))


def test_better_than_a_poor_baseline_is_not_better_than_every_linear_model() -> None:
    """State space was the wrong choice; ARX beside it does as well as the rules."""
    models = {
        "statespace": FirstOrder(a=0.9, b=0.07, structure="statespace"),
        "arx": TRUTH,
        "ts": two_rules(0.1),
    }
    c = compare(models, TEST, baseline="statespace", train=TRAIN)
    pair = c.verdict["y"]
    assert pair.verdict == "better"
    assert pair.short_of == ("arx",)
    assert pair.contested
    assert not pair.earned
    page = render(ReportContext({"roll": c}, train={"roll": TRAIN}))
    assert "The fuzzy model is better than the chosen linear model, not shown against ARX." in page
    for text in (summary({"roll": c}), to_markdown({"roll": c}), page):
        assert "TS better than STATESPACE on another flight like these, not shown against ARX" in text
    assert ",better,arx\n" in to_csv({"roll": c})
    found = c.to_json()["channels"][c.channel]["free_run"]
    assert found["short_of"] == ["arx"]
    assert found["rivals"]["arx"]["verdict"] == "same"
    said = cautions({"roll": c}, {"roll": diagnose(c, TRAIN)})
    assert said[0].text.startswith("Better than the linear model chosen on the training data, but not than")


def test_better_than_every_linear_model_is_a_headline() -> None:
    models = {
        "statespace": FirstOrder(a=0.9, b=0.07, structure="statespace"),
        "arx": FirstOrder(a=0.9, b=0.08),
        "ts": two_rules(0.1),
    }
    c = compare(models, TEST, baseline="statespace")
    pair = c.verdict["y"]
    assert pair.earned
    assert not pair.short_of
    assert c.entry().rivals["arx"].verdict == "better"
    assert not c.entry(horizon=1).rivals
    again = across_channels({"one": c})["one"]
    assert again.verdict == c.verdict
    assert "The fuzzy model is better on another flight like these, on roll." in render(
        ReportContext({"roll": c})
    )
