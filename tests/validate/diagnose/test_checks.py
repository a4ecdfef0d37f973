"""Stability, conditioning and intervals of single models, against what is known of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.datasetfile import write_dataset
from flysid.model.arx import ARX
from flysid.model.mean import Mean
from flysid.model.ts import TS, over_lags
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.checks import check, conditions, intervals
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.diagnose.robustness import robustness
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.page.checktable import check_rows
from tests.bent_plant import flight
from tests.command import call
from tests.contest import linear_side
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


def test_conditions_rest_on_the_first_20_000_rows() -> None:
    """Of the third segment so many as are left; from there on two lags are nearly one signal."""
    rng = np.random.default_rng(5)
    us, ys = rng.normal(size=(2, 3, 9000))
    us[2, 500:] = np.repeat(rng.normal(size=17), 500)
    data = Dataset.from_arrays([u[:, None] for u in us], [y[:, None] for y in ys], 0.05)
    model = ARX(na=2, nb=2, nk=1, refine=False).fit(
        Dataset.from_arrays(us[0, :200, None], ys[0, :200, None], 0.05)
    )
    (found,) = conditions(model, data)
    used = [9000, 9000, 20_000 - 2 * 8998 + 2]
    rows = np.vstack(
        [
            np.column_stack([y[1 : n - 1], y[: n - 2], u[1 : n - 1], u[: n - 2]])
            for u, y, n in zip(us, ys, used, strict=True)
        ]
    )
    assert len(rows) == 20_000
    rows = rows - rows.mean(axis=0)
    assert found == pytest.approx(np.linalg.cond(rows / np.linalg.norm(rows, axis=0)), rel=1e-9)


def test_intervals_hold_the_gain_of_a_linear_plant() -> None:
    data = flown(TRUTH, [800] * 4, noise=0.05)
    for model, rules in (
        (ARX(na=1, nb=1, nk=1).fit(data), 1),
        (over_lags(TS(rules=2, na=1, nb=1, nk=1), data), 2),
    ):
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
    ts = over_lags(TS(rules=2, na=1, nb=1, nk=1), train)
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
    from flysid.validate.diagnose.document import to_json

    found = to_json({"c": c}, {"c": diagnose(c, train)})["diagnostics"]["c"]["checks"]["ts"]
    assert found["long_run"]["limits_s"] is None
    assert len(found["condition_per_rule"]) == 2
    assert np.shape(found["gain_95"]) == (2, 2, 1, 1)


@pytest.mark.parametrize("short_of_one", [1e-15, 1.1e-14, 1e-12])
def test_rules_on_the_border_of_stability_are_judged_without_a_certificate(
    short_of_one: float, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """What a fit of an integrating channel may find: the equations of a certificate are singular there."""
    parts = [flight(300, seed, noise=0.01) for seed in range(6)]
    data = Dataset.from_arrays([u for u, _ in parts], [y for _, y in parts], 0.05, name="v")
    write_dataset(tmp_path / "v.parquet", data)
    words = ("-m", "ts_lags", "--rules", "2", "--effort", "quick", "--no-rotate", "-q", "-o", "run")
    with linear_side("arx"):
        assert call("fit", "v.parquet", *words, cwd=tmp_path).returncode == 0
    file = tmp_path / "run" / "v" / "ts_lags.json"
    model = json.loads(file.read_text("utf-8"))
    for (rule,) in model["parameters"]["theta"]:
        rule[: model["na"]] = (-np.poly([1.0 - short_of_one, *[0.95] * (model["na"] - 1)])[1:]).tolist()
    model["operating_points"] = []
    file.write_text(json.dumps(model), "utf-8")
    done = call("validate", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "broke down" not in done.stderr
    assert "Warning" not in done.stderr
    assert not [w for w in recwarn if issubclass(w.category, RuntimeWarning)]
    report = json.loads((tmp_path / "run" / "report" / "report.json").read_text("utf-8"))
    found = report["diagnostics"]["v"]["checks"]["ts_lags"]["certificate"]
    assert not found["proved"]
    assert "by itself is" in found["words"]
    assert "missing" not in report
    assert found["words"] in (tmp_path / "run" / "report" / "report.html").read_text("utf-8")


def test_a_pole_on_the_circle_passes_and_one_beyond_does_not() -> None:
    """A position integrates its velocity: that is the plant's, and no fault of the model."""
    models = [FirstOrder(a=0.9, b=0.07), replace(TRUTH, structure="ts")]
    c = compare(models, flown(TRUTH, [300] * 2, noise=0.02))
    found = ReportContext.of({"y": c}).diagnoses["y"]
    for radius, passes in ((0.9, True), (1.0, True), (1.001, False)):
        rows = check_rows(c, replace(found, pole_radius={"arx": radius}), 0)
        poles = next(row for row in rows if row.label == "Poles")
        assert [(f.words, f.good) for f in poles.findings] == [(f"{radius:.4f}", passes), ("–", None)]
