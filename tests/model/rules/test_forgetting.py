"""Models that end in two places, depending on where they were started."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray, Signal
from flysid.model.rules.boundedness import is_contracting
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders

SEEN = np.array([[-1.0], [1.0]])


def two_rules(left: tuple[float, float], right: tuple[float, float]) -> tuple[Layout, Parameters]:
    """y(k) = a y(k-1) + 0.01 u(k-1) + c with (a, c) near y = -1 and near y = 1."""
    layout = Layout(
        (Signal("y"),), (Signal("u"),), Orders(1, (1,), (1,)), (Antecedent(0, 1),), np.zeros(2), np.ones(2)
    )
    theta = np.array([[[a, 0.01, c]] for a, c in (left, right)])
    assert [column for column, _ in layout.regressors] == [0, 1, -1]
    far = np.array([[-3.0], [3.0]])
    return layout, Parameters(theta, np.array([[-1.0], [1.0]]), np.full((2, 1), 0.5), far, far)


def runs(samples: int = 500) -> tuple[FloatArray]:
    rng = np.random.default_rng(0)
    return (np.column_stack([np.zeros(samples), rng.uniform(-1.0, 1.0, samples)]),)


@pytest.mark.parametrize(
    ("left", "right", "forgets"),
    [
        ((0.8, -0.2), (0.8, 0.2), False),  # rests at -1 and at 1: inside every limit, and in two places
        ((0.8, 0.0), (0.8, 0.0), True),
        ((0.8, 0.2), (0.8, -0.2), True),  # either rule sends it to the other: one place, in the middle
        ((1.0, 0.0), (1.0, 0.0), False),  # an integrator keeps its start for ever
        ((0.9995, 0.0), (0.9995, 0.0), True),  # slow, but it forgets
    ],
)
def test_two_rests_are_told_from_one(
    left: tuple[float, float], right: tuple[float, float], forgets: bool
) -> None:
    layout, parameters = two_rules(left, right)
    assert is_contracting(runs(), SEEN, layout.depth, layout.lags, parameters) is forgets


def test_a_slow_plant_is_given_the_length_of_its_record() -> None:
    """Time constant 5,000 samples: told from an integrator only by a run as long as the data."""
    layout, parameters = two_rules((0.9998, 0.0), (0.9998, 0.0))
    assert not is_contracting(runs(500), SEEN, layout.depth, layout.lags, parameters)
    assert is_contracting(runs(12_000), SEEN, layout.depth, layout.lags, parameters)


def test_an_oscillation_that_does_not_decay_remembers_its_start() -> None:
    """Poles on the unit circle, but for rounding: inside all limits, and never where the plant is."""
    layout = Layout((Signal("y"),), (Signal("u"),), Orders(2, (1,), (1,)), (), np.zeros(2), np.ones(2))
    far = np.array([[-3.0], [3.0]])
    for radius, forgets in ((0.9999999, False), (0.99, True)):
        theta = np.array([[[2.0 * radius * np.cos(0.3), -(radius**2), 0.01, 0.0]]])
        none = np.zeros((1, 0))
        parameters = Parameters(theta, none, none, np.zeros((2, 0)), far)
        assert is_contracting(runs(), SEEN, layout.depth, layout.lags, parameters) is forgets


@pytest.mark.parametrize(("gone_at", "forgets"), [(2100, True), (2300, False)])
def test_the_last_quarter_of_the_run_decides(gone_at: int, forgets: bool) -> None:
    """Runs of 3,000 samples, of starts that are a quarter of what was seen apart at one of them."""
    pole = 0.5 ** (1.0 / gone_at)
    layout, parameters = two_rules((pole, 0.0), (pole, 0.0))
    assert is_contracting(runs(), SEEN, layout.depth, layout.lags, parameters) is forgets
