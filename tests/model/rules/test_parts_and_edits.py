"""Small steps of the search for rules: parts that are held out, rules that are merged, states made plain."""

from __future__ import annotations

import numpy as np
import pytest

from bench.ts_intervals import known_model
from flysid.dataset import Dataset
from flysid.model.rules.edits import edits
from flysid.model.rules.judging import hold_out
from flysid.model.rules.linear_starts import uncorrelated


@pytest.mark.parametrize("fold", range(4))
def test_every_fold_of_one_segment_holds_out_another_quarter(fold: int) -> None:
    rows = np.arange(100.0)
    data = Dataset.from_arrays(rows, rows, 0.1)
    kept, held = hold_out(data, 10, fold)
    (quarter,) = held.segments
    begin = 75 - 25 * fold
    np.testing.assert_array_equal(quarter.y[:, 0], rows[begin : begin + 25])
    others = np.concatenate([s.y[:, 0] for s in kept.segments])
    np.testing.assert_array_equal(others, np.delete(rows, np.arange(begin, begin + 25)))


@pytest.mark.parametrize(("fold", "turn"), [(0, (2, 6)), (1, (3, 7)), (2, (0, 4)), (3, (1, 5))])
def test_every_fold_of_many_segments_holds_out_every_fourth(fold: int, turn: tuple[int, ...]) -> None:
    """The ninth is too short to count."""
    levels = [np.full(20 if k < 8 else 9, float(k)) for k in range(9)]
    kept, held = hold_out(Dataset.from_arrays(levels, levels, 0.1), 10, fold)
    assert tuple(s.y[0, 0] for s in held.segments) == turn
    assert [s.y[0, 0] for s in kept.segments] == [k for k in range(8) if k not in turn]


def test_two_equal_rules_merge_into_the_same_rule() -> None:
    """The set of a merged rule is as wide as theirs; apart, it covers what lies between them."""
    model = known_model()
    p = model.parameters
    for apart in (0.0, 3.0):
        twins = p._replace(
            theta=p.theta[[0, 0]].copy(),
            centre=p.centre[[0, 0]] + np.array([[-apart], [apart]]),
            width=0.5 * np.ones_like(p.width[[0, 0]]),
        )
        (merged,) = [q for what, _, q in edits(model.layout, twins, np.array([0.5, 0.5])) if "merged" in what]
        np.testing.assert_allclose(merged.theta, p.theta[:1])
        np.testing.assert_allclose(merged.centre, p.centre[:1])
        np.testing.assert_allclose(merged.width, np.sqrt(0.25 + apart**2))


def test_a_state_that_the_outputs_say_already_is_left_at_its_size() -> None:
    """The others become uncorrelated with them and of spread one."""
    rng = np.random.default_rng(2)
    y, w = rng.normal(size=(2, 5000))
    states = np.stack([y, 3.0 * w + y, 2.0 * y])
    T = uncorrelated(np.cov(states), 1)
    np.testing.assert_array_equal(T[0], [1.0, 0.0, 0.0])
    assert np.abs(T).max() < 10.0
    spread = np.cov(T @ states)
    np.testing.assert_allclose(spread[0, 1:], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sort(np.diag(spread)[1:]), [0.0, 1.0], atol=1e-9)
