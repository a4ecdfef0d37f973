"""Gains of rules: found by inequalities, proved in fractions; a wrong gain is never proved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.design import rule_design
from flysid.design.certificate import proves
from flysid.design.rule_design import RuleAxis, RuleDesign
from flysid.design.rule_gains import certified_gains
from flysid.design.rule_plants import RuleLaw, RulePlant, blend, packed_rules
from flysid.validate.runs import run
from tests.command import call

DT = 0.02


def plant(drag: tuple[float, float] = (0.4, 0.8)) -> RulePlant:
    """Tilt (deg) through a lag of 0.2 s to velocity, whose drag differs by the rule; then a position."""
    a = np.zeros((2, 5, 5))
    b = np.zeros((2, 5))
    for r, d in enumerate(drag):
        p1 = np.exp(-d * DT)
        p2 = np.exp(-DT / 0.2)
        gain = 9.81 * np.pi / 180.0 / d * (1.0 - p1) * (1.0 - p2)
        a[r, 0, :3] = p1 + p2, -p1 * p2, 0.5 * gain
        b[r, 0] = 0.5 * gain
        a[r, 1, 0] = 1.0
        b[r, 2] = 1.0
        a[r, 3] = 0.5 * DT * a[r, 0]
        a[r, 3, 0] += 0.5 * DT
        a[r, 3, 3] = a[r, 4, 4] = 1.0
        b[r, 3] = 0.5 * DT * b[r, 0]
        a[r, 4, 3] = DT
    scheduling = np.zeros((1, 5))
    scheduling[0, 0] = 1.0
    ends = np.array([-4.0]), np.array([4.0])
    return RulePlant(DT, a, b, 2, 1, scheduling, np.array([[-2.0], [2.0]]), np.full((2, 1), 1.5), *ends)


@pytest.fixture(scope="module")
def law() -> RuleLaw:
    found = certified_gains(plant(), 1.0, 0.01, 12.0, 1.0, 1.0)
    assert found is not None
    return found


def test_the_gains_are_proved_and_hold_a_place_at_any_blend(law: RuleLaw) -> None:
    p = law.plant
    assert proves(p.a, p.b, law.gains, law.metric, 1.0)
    assert law.reach_m >= 0.99
    rng = np.random.default_rng(1)
    x = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    size = [float(x @ law.metric @ x)]
    most = 0.0
    for _ in range(2000):
        w = rng.dirichlet([0.5, 0.5])
        u = -float(w @ law.gains @ x)
        most = max(most, abs(u))
        x = np.tensordot(w, p.a, 1) @ x + w @ p.b * u
        size.append(float(x @ law.metric @ x))
    assert np.all(np.diff(size) <= 1e-12 * size[0])
    assert abs(x[3]) < 0.05
    assert most <= 12.0


def test_no_wrong_sign_is_proved_and_rounding_is(law: RuleLaw) -> None:
    p = law.plant
    for r, j in np.ndindex(*law.gains.shape):
        wrong = law.gains.copy()
        wrong[r, j] *= -1.0
        assert not proves(p.a, p.b, wrong, law.metric, 1.0), (r, j)
    assert not proves(p.a, p.b, -law.gains, law.metric, 1.0)
    assert not proves(p.a, p.b, law.gains, -law.metric, 1.0)
    assert not proves(p.a, p.b, law.gains, law.metric, 0.5)
    assert not proves(p.a, p.b, law.gains, law.metric, 1.5)
    assert not proves(p.a, p.b, 0.0 * law.gains, law.metric, 1.0)
    assert proves(p.a, p.b, law.gains.astype(np.float32), law.metric, 1.0)


def test_a_proof_needs_every_corner() -> None:
    """Two rules that contract, and whose blend does not."""
    a = np.array([[[0.5, 3.0], [0.0, 0.5]], [[0.5, 0.0], [3.0, 0.5]]])
    none = np.zeros((2, 2))
    rng = np.random.default_rng(0)
    for _ in range(50):
        root = rng.normal(size=(2, 2))
        assert not proves(a, none, none, root @ root.T, 1.0)
    assert proves(0.5 * np.eye(2)[None], none[:1], none[:1], np.eye(2), 0.6)
    assert not proves(0.6 * np.eye(2)[None], none[:1], none[:1], np.eye(2), 0.6)  # not strictly


def test_a_plant_that_cannot_be_held_in_one_metric_has_no_gains() -> None:
    known = plant()
    turned = replace(known, b=known.b * np.array([[1.0], [-1.0]]), a=known.a.copy())
    turned.a[1, 0, 2] *= -1.0
    turned.a[1, 3, 2] *= -1.0
    assert certified_gains(turned, 1.0, 0.01, 12.0, 1.0, 1.0) is None


def test_compiled_blend_is_the_law(law: RuleLaw) -> None:
    counts, numbers, sets = packed_rules((None, law))
    assert counts.tolist() == [[0, 0], [2, 1]]
    p = law.plant
    for x in np.random.default_rng(2).normal(size=(20, 5)) * 3.0:
        z = np.clip(p.scheduling @ x, p.low, p.high)
        w = np.exp(-0.5 * (((z - p.centre) / p.width) ** 2).sum(axis=1))
        expected = -float(w @ law.gains @ x) / w.sum()
        assert blend(x, numbers[1], sets[1]) == pytest.approx(expected, rel=1e-12)


def write_run(root: Path) -> None:
    """A folder that is taken for a run; whoever opens it replaces `open_run`."""
    (root / "run").mkdir()
    (root / "run" / run.RUN_FILE).touch()


def test_the_printed_numbers_alone_hold_the_proof(
    law: RuleLaw, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    axis = RuleAxis("x", "ts", ("deg", "m/s"), law, ms=1.5, peak=1.1, noise=20.0, tracking=0.9)
    design = RuleDesign("run", (axis,), {"y": ("too little moved", "fly longer")})
    monkeypatch.setattr(rule_design, "design_rules", lambda *_: design)
    monkeypatch.setattr(run, "open_run", lambda _: None)
    write_run(tmp_path)
    done = call("design", "run", "--method", "pdc", "--limit", "12", "--json", cwd=tmp_path)
    assert done.returncode == 3
    assert "y: refused: too little moved. Try: fly longer" in done.stderr
    body = json.loads(done.stdout)
    assert body == json.loads(design.files()[rule_design.FILE])
    told = body["axes"][0]
    assert proves(told["a"], told["b"], told["gains"], told["metric"], told["decay"])
    assert len(told["states"]) == len(told["metric"])
    printed = call("design", "run", "--method", "pdc", "--limit", "12", cwd=tmp_path)
    assert "x: gains for 2 rules of 'ts' over 5 measured states, proved" in printed.stdout
    assert rule_design.PROVED in printed.stderr


def test_what_only_a_pid_knows_is_refused_for_rules(tmp_path: Path) -> None:
    write_run(tmp_path)
    for words in (["--old", "mine.param"], ["--for", "px4"], ["--feed-forward"]):
        done = call("design", "run", "--method", "pdc", "--limit", "12", *words, cwd=tmp_path)
        assert done.returncode == 2
        assert "are for the gains of a PID" in done.stderr
