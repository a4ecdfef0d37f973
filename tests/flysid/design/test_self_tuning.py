"""The self-tuning PD: its rules, its ends, and that it flies as a fixed law where both ends are equal."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.design.law import Gains
from flysid.design.self_tuning import KD_RULES, KP_RULES, SETS, Tuner, tuned_gains
from flysid.design.trialflight import Doubtful, Trial, fly_trial
from flysid.errors import UsageError

TUNER = Tuner((2.0, 6.0), (3.0, 9.0), 1.0, 2.0)


def test_the_rules_do_not_know_left_from_right() -> None:
    for rules in (KP_RULES, KD_RULES):
        assert rules.shape == (SETS, SETS)
        assert np.array_equal(rules, rules[::-1])
        assert np.array_equal(rules, rules[:, ::-1])


@pytest.mark.parametrize(
    ("error", "slope", "big_kp", "big_kd"),
    [
        (0.0, 0.0, True, True),
        (1.0, 0.0, True, False),
        (5.0, 50.0, True, False),
        (0.0, 2.0, False, True),
    ],
)
def test_where_one_rule_speaks_a_gain_is_near_its_end(
    error: float, slope: float, big_kp: bool, big_kd: bool
) -> None:
    kp, kd = tuned_gains(error, slope, TUNER.packed())
    small = np.exp(-4.0)
    assert kp == pytest.approx(2.0 + 4.0 * (1.0 - small if big_kp else small))
    assert kd == pytest.approx(3.0 + 6.0 * (1.0 - small if big_kd else small))


def test_gains_stay_between_their_ends_everywhere() -> None:
    rng = np.random.default_rng(1)
    for error, slope in rng.uniform(-3.0, 3.0, (500, 2)):
        kp, kd = tuned_gains(error, slope, TUNER.packed())
        assert 2.0 <= kp <= 6.0
        assert 3.0 <= kd <= 9.0


def test_equal_ends_fly_as_the_fixed_law() -> None:
    trial = Trial.drawn(Doubtful(), 3, 0)
    law = Gains(1.4, 4.2)
    still = Tuner((1.4 * 4.2,) * 2, (4.2,) * 2, 1.0, 1.0)
    tuned = fly_trial(trial, (Gains(9.0, 9.0), law), Doubtful(), tuners=(still, None))
    fixed = fly_trial(trial, (law, law), Doubtful())
    assert tuned["x"].ise == pytest.approx(fixed["x"].ise, rel=1e-9)
    assert tuned["y"].ise == pytest.approx(fixed["y"].ise, rel=1e-9)


@pytest.mark.parametrize(
    "wrong", [((0.0, 1.0), (1.0, 1.0), 1.0), ((2.0, 1.0), (1.0, 1.0), 1.0), ((1.0, 1.0), (1.0, 1.0), 0.0)]
)
def test_ends_and_spans_that_cannot_be_are_refused(
    wrong: tuple[tuple[float, float], tuple[float, float], float],
) -> None:
    kp, kd, span = wrong
    with pytest.raises(UsageError):
        Tuner(kp, kd, span, 1.0)
