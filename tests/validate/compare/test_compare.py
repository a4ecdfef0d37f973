"""The comparison: fairness, divergence, the four verdicts, and its documents."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import flysid
from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError, UsageError
from flysid.model.start import estimate_start
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.models import Turn, across_channels
from flysid.validate.compare.trials import free_run, run_trials
from flysid.validate.compare.verdict import Evidence, Verdict, decide
from flysid.validate.compare.words import scope_words
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.diagnose.document import to_json
from flysid.validate.show.page import ReportContext, render
from flysid.validate.show.tables import to_markdown
from flysid.validate.show.terminal import summary, table
from tests.fakes import FirstOrder, flown

TRUTH = FirstOrder(a=0.9, b=0.1)
TS = FirstOrder(a=0.9, b=0.1, structure="ts", labels=("R1", "R2"))
WRONG = FirstOrder(a=0.9, b=0.07)


def verdict_of(comparison: Comparison) -> str:
    return str(comparison.verdict["y"].verdict)


def test_a_better_and_a_worse_model_are_told_apart() -> None:
    test = flown(TRUTH, [600] * 6, noise=0.02)
    better = flysid.compare([WRONG, TS], test)
    assert better.baseline == "arx"
    assert better.contender == "ts"
    pair = better.verdict["y"]
    assert pair.verdict == "better"
    assert pair.change_pct is not None
    assert pair.ci95 is not None
    assert pair.ci95[0] < pair.change_pct < pair.ci95[1] < 0
    assert pair.unit == "flights"
    worse = compare({"arx": TRUTH, "ts": replace(WRONG, structure="ts")}, test)
    assert verdict_of(worse) == "worse"


def test_a_rotation_speaks_of_the_compared_models_where_others_ended_elsewhere() -> None:
    """Two of five flights are judged by models worse than the baseline; the compared one is right."""
    data = flown(TRUTH, [300] * 5, noise=0.02)
    test = flown(TRUTH, [300] * 20, noise=0.02, seed=1)
    lost = replace(TS, b=0.04)
    turns = []
    for i, flight in enumerate(data.flights):
        parts = ([s for s in data.segments if (s.flight == flight) is out] for out in (True, False))
        unseen, seen = (data.with_segments(some) for some in parts)
        turns.append(Turn({"arx": WRONG, "ts": lost if i in (1, 3) else TS}, unseen, seen))
    models = {"arx": WRONG, "ts": TS}
    pair = compare(models, test, turns=turns).verdict["y"]
    truth = compare(models, test).verdict["y"].change_pct
    assert pair.basis.rotated
    assert pair.units == 5
    assert pair.verdict == "better"
    assert pair.ci95 is not None
    assert truth is not None
    assert pair.ci95[0] < truth < pair.ci95[1]
    assert any("what a fit finds depends on the flights it is given" in w for w in scope_words(pair))
    steady = [replace(t, models=models) for t in turns]
    alike = compare(models, test, turns=steady).verdict["y"]
    assert not any("depends on the flights" in w for w in scope_words(alike))


def test_change_is_of_a_typical_flight_and_scores_are_pooled() -> None:
    test = flown(TRUTH, [300, 500], noise=0.05)
    c = compare([WRONG, TS], test)
    entry = c.entry("y", "free_run")
    e = [s.y[20:] - free_run(WRONG, s, 20) for s in test.segments]
    rmse = float(np.sqrt(np.mean(np.concatenate(e) ** 2)))
    assert entry.models["arx"].scores.rmse == pytest.approx(rmse, rel=1e-12)
    ts = entry.models["ts"].scores.rmse
    assert entry.pairs["ts"].pooled_pct == pytest.approx(100 * (ts - rmse) / rmse, rel=1e-9)
    first, second = (
        b.scores.rmse / a.scores.rmse
        for a, b in zip(entry.models["arx"].segments, entry.models["ts"].segments, strict=True)
    )
    assert entry.pairs["ts"].change_pct == pytest.approx(100 * (np.sqrt(first * second) - 1), rel=1e-9)
    assert [s.scores.n for s in entry.models["ts"].segments] == [280, 480]


def test_the_headline_is_the_free_run_in_whatever_order_the_horizons_are_asked_for() -> None:
    test = flown(TRUTH, [300] * 5, noise=0.05)
    usual, turned = (compare([WRONG, TS], test, horizons=h) for h in (("free_run", 1), (1, "free_run")))
    assert turned.head == "free_run"
    assert summary({"roll": turned}) == summary({"roll": usual})
    assert "free run: RMSE" in summary({"roll": turned})
    lines = table({"roll": turned}).splitlines()
    free, ahead = (
        next(line for line in lines[lines.index(title) :] if line.startswith("  ts")).split()
        for title in (f"roll (m/s), {h}: verdicts on {Scope.LIKE}" for h in ("free run", "1 step (0.05 s)"))
    )
    assert free[-4:-2] == ["2", "3"]  # rules and parameters stand in the lines of the headline only
    assert ahead[-3].endswith("]")
    assert "10 steps (0.5 s): RMSE" in summary({"roll": compare([WRONG, TS], test, horizons=(10, 1))})


def test_the_same_samples_start_every_model_and_none_is_scored() -> None:
    test = flown(TRUTH, [100], noise=0.05)
    slow = replace(WRONG, n_init=7)
    (trial,) = run_trials({"arx": slow, "ts": TS}, test, "free_run")
    assert trial.first == 10
    assert len(trial.y) == 90
    u = test.segments[0].u
    y = test.segments[0].y
    for name, model in (("ts", TS), ("arx", slow)):
        start = estimate_start(model, u[:10], y[:10])
        np.testing.assert_array_equal(trial.yh[name], model.simulate(u, start)[10:])
    (ten,) = run_trials({"arx": slow, "ts": TS}, test, "10")
    assert ten.first == 19
    np.testing.assert_array_equal(ten.yh["ts"], TS.predict(u, y, 10)[19:])


def test_errors_below_the_resolution_are_the_same_however_large_their_ratio() -> None:
    test = flown(TRUTH, [2000], noise=0.0)
    almost = replace(TRUTH, b=0.1 + 1e-6)
    for arx, ts in ((TRUTH, almost), (almost, TRUTH), (TRUTH, TRUTH)):
        c = compare({"arx": arx, "ts": ts}, test)
        assert verdict_of(c) == "same"
        json.dumps(to_json({"channel": c}), allow_nan=False)


def test_divergence_is_a_loss_with_a_time() -> None:
    wild = replace(TRUTH, a=1.3, structure="ts", limit=50.0)
    test = flown(TRUTH, [400] * 6, noise=0.02)
    c = compare([TRUTH, wild], test)
    pair = c.verdict["y"]
    assert pair.verdict == "worse"
    assert pair.change_pct is None
    score = c.entry().models["ts"]
    assert len(score.diverged) == 6
    at = 20 + np.flatnonzero(np.abs(free_run(wild, test.segments[0], 20)) >= 50.0)[0]
    assert score.diverged[0].diverged_s == pytest.approx(at * 0.05)
    assert "diverged at t = " in table({"channel": c})
    other_way = compare({"arx": wild, "ts": TRUTH}, test)
    assert verdict_of(other_way) == "better"
    assert "TS better: ARX diverged" in table({"channel": other_way})
    assert "TS better: ARX diverged" in to_markdown({"channel": other_way})
    both = compare({"arx": wild, "ts": wild}, test)
    assert verdict_of(both) == "same"
    assert "both diverged" in table({"channel": both})


def test_not_enough_data() -> None:
    short = flown(TRUTH, [40], noise=0.05)
    assert verdict_of(compare([replace(WRONG, b=0.05), TS], short)) == "not enough data"
    rng = np.random.default_rng(0)
    flat = Segment(rng.normal(size=(500, 1)), np.full((500, 1), 3.0))
    constant = Dataset(0.05, TRUTH.inputs, TRUTH.outputs, (flat,))
    document = to_json({"c": compare([WRONG, TS], constant)})
    assert document["channels"]["c"]["free_run"]["verdict"] == "not enough data"
    assert document["channels"]["c"]["free_run"]["models"]["arx"]["fit_pct"] is None


def test_an_input_that_never_moves_shows_nothing() -> None:
    """Two models that both say zero were 'the same': 'the linear model is enough'."""
    test = flown(TRUTH, [300] * 6, noise=0.05)
    held = test.with_segments([replace(s, u=np.full_like(s.u, 0.5)) for s in test.segments])
    c = compare([WRONG, TS], held)
    assert (verdict_of(c), c.verdict["y"].reason) == (
        "not enough data",
        "no input moves on the held-out part",
    )
    text = [t.text for t in cautions({"roll": c}, {"roll": diagnose(c)})]
    assert "No input of y moves on the held-out part: the response to an input was not tested." in text
    page = render(ReportContext.of({"roll": c}))
    assert "nothing left that the input explains" not in page
    assert "the input does not move" in page
    stepped = [replace(s, u=np.full_like(s.u, i)) for i, s in enumerate(test.segments)]
    assert not compare([WRONG, TS], test.with_segments(stepped)).verdict["y"].evidence.still
    flat = test.with_segments([replace(s, y=np.full_like(s.y, 2.0)) for s in test.segments])
    flat_c = compare([WRONG, TS], flat)
    told = [t.text for t in cautions({"roll": flat_c}, {"roll": diagnose(flat_c)})]
    assert "The held-out output of y does not vary, so no model can be judged on it." in told


def test_a_segment_too_short_is_counted_and_none_long_enough_is_an_error() -> None:
    c = compare([WRONG, TS], flown(TRUTH, [300, 8, 300], noise=0.05))
    assert (c.scored_segments, c.unused_segments) == (2, 1)
    with pytest.raises(DataError, match="the longest has 8"):
        compare([WRONG, TS], flown(TRUTH, [8], noise=0.05))


def test_wrong_use_is_named() -> None:
    test = flown(TRUTH, [300], noise=0.05)
    with pytest.raises(UsageError, match="sample time"):
        compare([replace(TRUTH, dt_s=0.1)], test)
    with pytest.raises(UsageError, match="inputs"):
        compare([replace(TRUTH, inputs=(Signal("v"),))], test)
    with pytest.raises(UsageError, match="baseline 'oe'"):
        compare([TRUTH, TS], test, baseline="oe")
    with pytest.raises(UsageError, match="horizon"):
        compare([TRUTH, TS], test, horizons=["soon"])
    with pytest.raises(UsageError, match="no model"):
        compare([], test)


def test_more_than_two_models_and_the_contender() -> None:
    test = flown(TRUTH, [300] * 3, noise=0.05)
    c = compare([WRONG, TS, replace(WRONG, b=0.05, structure="line"), TS], test)
    assert list(c.models) == ["arx", "ts", "line", "ts-2"]
    assert set(c.entry().pairs) == {"ts", "line", "ts-2"}
    assert c.contender == "ts"
    assert compare([WRONG], test).verdict == {}
    lines = table({"channel": c}).splitlines()
    assert lines[1].startswith("channel (m/s), free run")
    assert lines[2].split()[0] == "ts"  # best first
    assert lines[5].split()[0] == "line"


def test_holm_over_channels_can_take_a_verdict_back_and_is_idempotent() -> None:
    test = flown(TRUTH, [600] * 6, noise=0.02)
    c = compare([WRONG, TS], test)
    pair = c.entry().pairs["ts"]
    entry = replace(c.entry(), pairs={"ts": replace(pair, p=0.03, p_holm=0.03)})
    weak = replace(c, entries=(entry, *c.entries[1:]))
    alone = across_channels({"a": weak})
    three = across_channels({"a": weak, "b": weak, "c": weak})
    assert alone["a"].verdict["y"].verdict == "better"
    assert three["a"].verdict["y"].verdict == "not enough data"
    assert three["a"].verdict["y"].p_holm == pytest.approx(0.09)
    assert across_channels(three) == three


def test_document_has_the_promised_shape_and_never_nan() -> None:
    test = flown(TRUTH, [300] * 3, noise=0.05)
    document = to_json({"roll": compare([WRONG, TS], test)})
    text = json.dumps(document, allow_nan=False)
    assert json.loads(text) == document
    roll = document["channels"]["roll"]
    assert list(roll) == ["free_run", "10", "1"]
    for horizon in roll.values():
        assert {"models", "change_pct", "ci95", "verdict"} <= set(horizon)
        assert {"rmse", "fit_pct", "vaf_pct"} <= set(horizon["models"]["arx"])
        assert len(horizon["ci95"]) == 2
        assert horizon["verdict"] in set(Verdict)


def test_document_with_diagnoses_has_cautions_and_tests() -> None:
    c = compare([WRONG, TS], flown(TRUTH, [300] * 3, noise=0.05))
    document = to_json({"roll": c}, {"roll": diagnose(c, flown(TRUTH, [300], noise=0.05, seed=9))})
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    found = document["diagnostics"]["roll"]
    assert found["largest_pole_radius"] == {"arx": 0.9, "ts": 0.9}
    assert {o["signal"] for o in found["outside_training"]} == {"u", "y"}
    assert found["outputs"]["y"]["dependence"]["arx"]["u"]["fails"]
    assert not found["outputs"]["y"]["dependence"]["ts"]["u"]["fails"]
    assert found["outputs"]["y"]["coherence"]["u"]["largest"] > 0.8
    assert any("still follows the input on y (ARX)" in c["text"] for c in document["cautions"])


def test_equal_input_equal_document() -> None:
    test = flown(TRUTH, [300] * 3, noise=0.05)
    one, two = (json.dumps(to_json({"c": compare([WRONG, TS], test)})) for _ in range(2))
    assert one == two


def test_hostile_names_stay_on_their_line() -> None:
    name = "\x1b[31mroll\n\u202eevil"
    outputs = (Signal(name, "m\ts"),)
    test = replace(flown(TRUTH, [300], noise=0.05), outputs=outputs, name=name)
    c = compare([replace(WRONG, outputs=outputs), replace(TS, outputs=outputs)], test)
    text = table({name: c}) + summary({name: c})
    assert "\x1b" not in text
    assert len(text.splitlines()) == 1 + 3 + 6 + 0
    assert "\u202e" not in text


@pytest.mark.parametrize(
    ("evidence", "expected"),
    [
        (Evidence(1.0, 0.7, 1e-3, low_pct=-38, high_pct=-24, p=0.001), "better"),
        (Evidence(1.0, 1.3, 1e-3, low_pct=24, high_pct=38, p=0.001), "worse"),
        (Evidence(1.0, 0.98, 1e-3, low_pct=-4, high_pct=-1, p=0.001), "same"),
        (Evidence(1.0, 1.03, 1e-3, low_pct=-0.1, high_pct=6, p=0.06), "same"),
        (Evidence(1.0, 1.03, 1e-3, low_pct=-20, high_pct=26, p=0.6), "not enough data"),
        (Evidence(1.0, 0.7, 1e-3, low_pct=-38, high_pct=-24, p=0.06), "not enough data"),
        (Evidence(1.0, 0.7, 0.5, low_pct=-38, high_pct=-24, p=0.001), "same"),
        (Evidence(1.0, 0.7, 1e-3), "not enough data"),
        (Evidence(1.0, 0.7, 1e-3, diverged_model=True), "worse"),
        (Evidence(1.0, 0.7, 1e-3, constant=True), "not enough data"),
        (Evidence(1.0, 1.0, 1e-3, still=True), "not enough data"),
    ],
)
def test_rule_of_the_verdict(evidence: Evidence, expected: str) -> None:
    assert decide(evidence)[0] == expected
