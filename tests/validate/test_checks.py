"""Stability, conditioning and intervals of single models, against what is known of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.mean import Mean
from flysid.model.ts import TS
from flysid.validate.cautions import cautions
from flysid.validate.checks import check
from flysid.validate.compare_models import compare
from flysid.validate.conditioning import conditions
from flysid.validate.diagnostics import diagnose
from flysid.validate.parameters import intervals
from flysid.validate.report import ReportContext, render
from flysid.validate.report.checktable import check_rows
from flysid.validate.robustness import robustness
from tests.fakes import FirstOrder, flown

TRUTH = FirstOrder(a=0.9, b=0.1)


def test_the_start_is_forgotten_as_fast_as_the_pole_says() -> None:
    data = flown(TRUTH, [400] * 2, noise=0.0)
    for a in (0.5, 0.9, 0.98):
        found = robustness(FirstOrder(a=a, b=1.0 - a), data)
        steps = np.ceil(np.log(0.01) / np.log(a)) + 1
        assert found.forget_s == pytest.approx(steps * TRUTH.dt_s, abs=1.1 * TRUTH.dt_s)
        assert found.limits_s is None
    assert robustness(FirstOrder(a=1.0, b=0.0), data).forget_s is None


def test_a_model_that_runs_away_is_caught_and_told_of() -> None:
    data = flown(TRUTH, [400] * 2, noise=0.02)
    wild = FirstOrder(a=1.001, b=0.1, structure="ts", limit=60.0)  # slow: the record ends before it is lost
    found = robustness(wild, data)
    assert found.limits_s is not None
    assert 0.0 < found.limits_s < found.long_s
    c = compare([TRUTH, wild], flown(TRUTH, [60] * 5, noise=0.02))
    assert not c.entry().models["ts"].diverged
    said = [x.text for x in cautions({"c": c}, {"c": diagnose(c, data)})]
    assert any("long free run under random steps" in text and "TS" in text for text in said)
    twice = compare({"arx": wild, "ts": wild}, flown(TRUTH, [60] * 5, noise=0.02))
    (told,) = [
        x.text for x in cautions({"c": twice}, {"c": diagnose(twice, data)}) if "long free run" in x.text
    ]
    assert "ARX and TS reach their output limits on c" in told  # one model, once


def test_the_condition_is_that_of_the_lagged_signals() -> None:
    rng = np.random.default_rng(3)
    us = rng.normal(size=(2, 500, 1))
    ys = rng.normal(size=(2, 500, 1))
    white = Dataset.from_arrays(list(us), list(ys), 0.05)
    model = ARX(na=2, nb=1, nk=1, refine=False).fit(white)
    (found,) = conditions(model, white)
    columns = [np.column_stack([y[1:-1, 0], y[:-2, 0], u[1:-1, 0]]) for u, y in zip(us, ys, strict=True)]
    rows = np.vstack(columns)
    rows = rows - rows.mean(axis=0)
    assert found == pytest.approx(np.linalg.cond(rows / np.linalg.norm(rows, axis=0)), rel=1e-9)
    assert found < 1.2
    twins = Dataset.from_arrays([np.repeat(u, 2, axis=1) for u in us], list(ys), 0.05)
    double = ARX(na=1, nb=1, nk=1, refine=False)
    assert conditions(replace(double).fit(twins), twins)[0] > 1e6
    assert conditions(Mean().fit(white), white) == (1.0,)  # of no signal at all


def test_intervals_hold_the_gain_of_a_linear_plant() -> None:
    data = flown(TRUTH, [800] * 4, noise=0.05)
    for model, rules in ((ARX(na=1, nb=1, nk=1).fit(data), 1), (TS(rules=2, na=1, nb=1, nk=1).fit(data), 2)):
        found = intervals(model, data)
        assert found is not None
        assert found.gain.shape == (2, rules, 1, 1)
        assert (found.gain[0] < 1.05).all()
        assert (found.gain[1] > 0.95).all()
        assert {x.regressor for x in found.coefficients} >= {"y(k-1)", "u(k-1)"}
        assert all(x.half_width > 0.0 for x in found.coefficients)
    assert intervals(TRUTH, data) is None


def test_the_page_and_the_document_tell_the_checks() -> None:
    train = flown(TRUTH, [600] * 3, noise=0.05)
    test = flown(TRUTH, [400] * 5, noise=0.05, seed=1)
    ts = TS(rules=2, na=1, nb=1, nk=1).fit(train)
    assert "yapunov" in check(ts, test, train).certificate
    c = compare([ARX(na=1, nb=1, nk=1).fit(train), ts], test, train=train)
    page = render(ReportContext({"c": c}, train={"c": train}))
    for words in (
        "Any blend of the rules",
        "Long free run",
        "Condition of the regressors",
        "Every coefficient",
    ):
        assert words in page
    checks = c.to_json()
    assert "diagnostics" not in checks
    from flysid.validate.document import to_json

    found = to_json({"c": c}, {"c": diagnose(c, train)})["diagnostics"]["c"]["checks"]["ts"]
    assert found["long_run"]["limits_s"] is None
    assert len(found["condition_per_rule"]) == 2
    assert np.shape(found["gain_95"]) == (2, 2, 1, 1)


def test_a_pole_on_the_circle_passes_and_one_beyond_does_not() -> None:
    """A position integrates its velocity: that is the plant's, and no fault of the model."""
    models = [FirstOrder(a=0.9, b=0.07), replace(TRUTH, structure="ts")]
    c = compare(models, flown(TRUTH, [300] * 2, noise=0.02))
    found = ReportContext.of({"y": c}).diagnoses["y"]
    for radius, passes in ((0.9, True), (1.0, True), (1.001, False)):
        rows = check_rows(c, replace(found, pole_radius={"arx": radius}), 0)
        poles = next(row for row in rows if row.label == "Poles")
        assert [(f.words, f.good) for f in poles.findings] == [(f"{radius:.4f}", passes), ("–", None)]
