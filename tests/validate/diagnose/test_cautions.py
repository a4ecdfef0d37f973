"""Before you rely on this: what is said, in which order, and once only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, Segment
from flysid.ingest.align.doubts import Doubt
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare.words import verdict_words
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import MOST, WEIGHTS, cautions
from flysid.validate.diagnose.diagnostics import diagnose
from tests.fakes import flown
from tests.validate.show.page.test_report import ARX, TS, compared


def test_cautions_are_at_most_six_worst_first() -> None:
    test = flown(TS, [300] * 2, noise=0.02, flights=1)
    wild = replace(TS, a=1.4, limit=30.0)
    comparisons = {f"c{i}": compare([ARX, wild], test) for i in range(8)}
    diagnoses = {n: diagnose(c) for n, c in comparisons.items()}
    doubts = [Doubt(kind, f"{kind} told", "fly.") for kind in WEIGHTS]
    found = cautions(comparisons, diagnoses, dict.fromkeys(comparisons, doubts))
    assert len(found) == MOST
    assert [c.level for c in found].count("danger") == 1  # one model diverged, on however many channels
    assert found[0].text.startswith(
        "TS diverged in free run on c0, in 2 of 2 held-out segments, first at t = "
    )
    assert "; c2, in" in found[0].text
    assert found[0].text.endswith("; and on 5 more. It is counted as a loss.")
    beside = {"c": compare({"arx": ARX, "ts": TS, "bj": replace(wild, structure="bj")}, test)}
    (told,) = [c for c in cautions(beside, {"c": diagnose(beside["c"])}) if "diverged in" in c.text]
    assert told.level == "warning"
    assert "loss" not in told.text
    calm = {"c": compared()}
    levels = [c.level for c in cautions(calm, {"c": diagnose(compared())})]
    assert levels == sorted(levels, key=["danger", "warning", "note", "good"].index)
    assert levels[-1] == "good"
    one = compare([ARX], test)
    static = {**diagnose(one).pole_radius, "line": 0.0}
    said = cautions({"c": one}, {"c": replace(diagnose(one), pole_radius=static)})[-1].text
    assert said.startswith("The model is stable")  # a line has no poles, and no merit of being stable


def test_a_difference_that_is_shown_and_small_is_called_small() -> None:
    (pair,) = compared().verdict.values()
    same = replace(pair, verdict=Verdict.SAME, ci95=(-2.8, -0.2))
    assert verdict_words(same) == f"same within 5 % on {Scope.LIKE}"
    assert verdict_words(replace(same, ci95=(-2.8, 8.2))) == f"same within 10 % on {Scope.LIKE}"
    assert (
        verdict_words(replace(same, ci95=(0.2, 7.0))) == f"same within 10 % on {Scope.LIKE}"
    )  # Holm took it back
    below = replace(pair.evidence, resolution=1.0)
    assert verdict_words(replace(same, evidence=below)) == f"same on {Scope.LIKE}"


def test_low_coherence_is_no_warning_where_a_free_run_follows_the_output() -> None:
    test = flown(TS, [300] * 2, noise=0.02)
    for gain, warned in ((1.0, False), (0.0, True)):
        models = {"arx": replace(ARX, b=gain * TS.b), "ts": replace(TS, b=gain * TS.b)}
        c = compare(models, test)
        d = diagnose(c)
        (out,) = d.outputs
        faint = tuple(r and replace(r, coherence=np.zeros_like(r.coherence)) for r in out.responses)
        told = cautions({"c": c}, {"c": replace(d, outputs=(replace(out, responses=faint),))})
        assert any("coherence below 0.5" in t.text for t in told) is warned


def test_one_caution_speaks_of_all_channels_and_tells_equal_names_apart() -> None:
    """Six cautions are shown: one kind must not take the room of another."""
    found = diagnose(compared(), flown(TS, [500], noise=0.02, seed=9))
    wild = replace(
        found, pole_radius={"ts": 1.2}, outside=tuple(replace(o, share=0.05) for o in found.outside)
    )
    said = [c.text for c in cautions({"roll": compared(), "yaw": compared()}, {"roll": wild, "yaw": wild})]
    (unstable,) = [t for t in said if "unit circle" in t]
    assert "on roll (TS, largest pole radius 1.2000), yaw (TS" in unstable
    (outside,) = [t for t in said if "training range" in t]
    assert "u of roll (5.0 %)" in outside
    assert "u of yaw (5.0 %)" in outside
    (alone,) = [
        t for t in (c.text for c in cautions({"r": compared()}, {"r": wild})) if "training range" in t
    ]
    assert "on u (5.0 %)" in alone


def test_a_gain_above_what_the_flights_show_is_cautioned() -> None:
    """Slow inputs end below the bandwidth of the model; fast ones do not."""
    rng = np.random.default_rng(3)
    quick = replace(TS, a=0.3, b=0.7, labels=("R1",))
    for hold, warned in ((60, True), (1, False)):
        u = np.repeat(rng.normal(size=6000 // hold), hold)
        u = np.convolve(u, np.ones(hold) / hold, mode="same")[:, None]
        y = quick.simulate(u, np.zeros((1, 1))) + 0.05 * rng.normal(size=u.shape)
        test = Dataset(quick.dt_s, quick.inputs, quick.outputs, (Segment(u, y, flight="f"),), name="roll")
        c = compare({"arx": replace(quick, structure="arx"), "ts": quick}, test)
        told = [t for t in cautions({"roll": c}, {"roll": diagnose(c)}) if "responds " in t.text]
        assert bool(told) is warned
        assert all("of roll" in t.text for t in told)


def test_one_step_error_that_changes_by_less_than_half_is_cautioned() -> None:
    """And only where the free run changes by more than 10 %: else there is nothing to flatter."""

    def is_told(free: float, one: float) -> bool:
        c = compared()
        changes = {"free_run": free, "1": one}
        entries = tuple(
            replace(
                e, pairs={k: replace(p, change_pct=changes.get(e.horizon, free)) for k, p in e.pairs.items()}
            )
            for e in c.entries
        )
        c = replace(c, entries=entries)
        return any("One step ahead" in t.text for t in cautions({"c": c}, {"c": diagnose(c)}))

    assert is_told(-40.0, -19.0)
    assert is_told(40.0, 5.0)
    assert not is_told(-40.0, -21.0)
    assert not is_told(-9.0, -1.0)
