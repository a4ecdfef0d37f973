"""Rules on what physics leaves: a law that physics lacks is found and worded, none where there is none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.dataset import Dataset, FloatArray
from flysid.sixdof import judging, rotations
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import KINDS, drive
from flysid.sixdof.judging import ALONE, AXES, BLIND, BOX, HELD, HORIZONS_S, LOOP, RULED, Judgement
from flysid.sixdof.records import Scale, flights_of
from flysid.sixdof.rest import find_rules
from flysid.sixdof.rules import LEFT, LIFT, PITCH, SPEED, UP, HingeRule
from flysid.sixdof.vehicle import _Work
from tests.flysid.sixdof.hidden_quad import write_table

V, P, Q = slice(10, 13), slice(13, 16), slice(6, 10)


Law = Callable[[int, FloatArray], FloatArray]


def bent(data: Dataset, law: Law) -> Dataset:
    """Flights that a force in body axes moves, by sample and air speed, which no number of a vehicle is."""
    segments = []
    for segment in data.segments:
        y = segment.y.copy()
        turn = rotations.matrices(rotations.unit(y[:, Q]))
        added = np.zeros(3)
        for i in range(len(y)):
            y[i, V] += added
            added += data.dt_s * turn[i] @ law(i, turn[i].T @ y[i, V])
        y[:, P] += data.dt_s * np.cumsum(y[:, V] - segment.y[:, V], axis=0)
        segments.append(replace(segment, y=y))
    return data.with_segments(segments)


def brake(_: int, air: FloatArray) -> FloatArray:
    """Drag to either side that grows with the square beyond 1 m/s."""
    return np.array([0.0, -0.5 * air[1] * max(abs(air[1]) - 1.0, 0.0), 0.0])


def test_what_physics_has_needs_no_rule(gusty: Dataset, gusty_regressed: FittedVehicle) -> None:
    assert find_rules(flights_of(gusty, Scale(0.0, 1.0)).records, gusty_regressed) == ()


def test_a_brake_beyond_a_speed_is_found(gusty: Dataset, gusty_regressed: FittedVehicle) -> None:
    (rule,) = find_rules(flights_of(bent(gusty, brake), Scale(0.0, 1.0)).records, gusty_regressed)
    assert (rule.axis, rule.base, rule.quantity) == (LEFT, SPEED, "aside")
    found = (rule.plain + rule.slope * (rule.reach - rule.above)) * rule.reach
    assert found == pytest.approx(-0.5 * (rule.reach - 1.0) * rule.reach, rel=0.25)


def test_a_lift_that_sinking_adds_is_found(gusty: Dataset, gusty_regressed: FittedVehicle) -> None:
    alone = gusty.with_segments(gusty.segments[:1])
    (record,) = flights_of(alone, Scale(0.0, 1.0)).records
    lift = [*drive(record, gusty_regressed).lift, 0.0]
    lifted = bent(alone, lambda i, air: np.array([0.0, 0.0, 0.1 * lift[i] * max(-air[2], 0.0)]))
    (rule,) = find_rules(flights_of(lifted, Scale(0.0, 1.0)).records, gusty_regressed)
    assert (rule.axis, rule.base, rule.quantity) == (UP, LIFT, "sink")
    assert "in descents" in str(rule)
    assert "thrust grows" in str(rule)


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (HingeRule(UP, LIFT, "sink", 1.0, 0.0, -0.05, 3.0), "faster than 1 m/s thrust falls: -10 % at 3 m/s"),
        (
            HingeRule(UP, LIFT, "low", -0.5, 0.0, 0.5, -0.1),
            "below 0.5 m from the lowest place thrust grows: +20",
        ),
        (
            HingeRule(LEFT, SPEED, "aside", 0.0, 0.0, -0.2, 5.0),
            "drag grows with the square: +5 m/s^2 at 5 m/s",
        ),
        (HingeRule(LEFT, SPEED, "aside", 6.0, 0.0, -0.2, 9.0), "above 6 m/s to either side drag grows"),
        (HingeRule(PITCH, SPEED, "forward", 2.0, 0.0, 0.5, 4.0), "turns it in pitch: +4 rad/s^2 at 4 m/s"),
    ],
)
def test_rules_are_sentences(rule: HingeRule, words: str) -> None:
    assert words in str(rule)


@pytest.mark.parametrize(
    ("alone", "ruled", "answer", "words"),
    [
        (0.5, None, "physics", "no rule on what physics leaves holds"),
        (0.5, 0.6, "physics", "are not kept"),
        (
            0.5,
            0.4,
            "physics with rules",
            "take up to 20 % off errors of position, at 0.1 s. Kept: in descents",
        ),
        (2.0, 0.5, "physics with rules", "physics with rules predicts best up to 5 s"),
        (2.0, 1.9, "rules alone", "the black box predicts better"),
    ],
)
def test_the_answer_follows_the_table(alone: float, ruled: float | None, answer: str, words: str) -> None:
    one = np.ones((len(HORIZONS_S), len(KINDS)))
    table = {
        HELD: 3.0 * one,
        BLIND: 1.5 * one,
        AXES: 1.2 * one,
        BOX: one,
        ALONE: alone * one,
        LOOP: 0.9 * one,
    }
    rules = () if ruled is None else (HingeRule(UP, LIFT, "sink", 1.0, 0.0, -0.05, 3.0),)
    if ruled is not None:
        table[RULED] = ruled * one
    judged = Judgement(table, (1, 1, 1, 1), "1 flight", rules)
    assert judged.answer == answer
    assert any(words in line for line in judged.words()), judged.words()
    assert len(judged.to_dict()["rules"]) == (ruled is not None and ruled < alone)


def test_the_verb_names_the_rule(gusty: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Work, "shoot", lambda _: None)
    monkeypatch.setattr(judging, "EVERY_S", 0.25)
    flights = bent(gusty, brake)
    tables = [
        str(write_table(tmp_path / f"{i}.csv", flights.with_segments([segment])))
        for i, segment in enumerate(flights.segments)
    ]
    done = CliRunner().invoke(root, ["vehicle", *tables, "--pool", "--calm", "--json", "-q"])
    assert done.exit_code == 0, done.output
    judged = json.loads(done.stdout)["judged"]
    assert RULED in judged["errors"]
    assert judged["answer"] == "physics with rules"
    assert any("to either side drag grows with the square" in rule["words"] for rule in judged["rules"])
