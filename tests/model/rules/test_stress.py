"""Stress inputs, and what models must stand before they are offered."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import FloatArray, Signal
from flysid.model.rules.boundedness import is_bounded, probe_run
from flysid.model.rules.growth import unrefined
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.refit import as_problem
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders

STEPS = 1000


def runs(samples: int, n_u: int = 1) -> tuple[FloatArray, ...]:
    """A slow lag under inputs like noise."""
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (samples, n_u))
    return (np.column_stack([lfilter([0.0, 0.02], [1.0, -0.98], u[:, 0]), u]),)


@pytest.mark.parametrize(("beyond", "bounded"), [((0.98, 0.0), True), ((1.05, -0.02), False)])
def test_rules_that_run_away_where_only_long_pushes_lead_are_refused(
    beyond: tuple[float, float], bounded: bool
) -> None:
    """A second rule above y = 0.6, where inputs as short as those of the record never lead."""
    layout = Layout(
        (Signal("y"),), (Signal("u"),), Orders(1, (1,), (1,)), (Antecedent(0, 1),), np.zeros(2), np.ones(2)
    )
    theta = np.array([[[0.98, 0.02, 0.0]], [[beyond[0], 0.02, beyond[1]]]])
    centre = np.array([[-1.0], [1.0]])
    width = np.full((2, 1), 0.4)
    far = np.array([[-3.0], [3.0]])
    parameters = Parameters(theta, centre, width, far, far)
    stage = unrefined(*as_problem(layout, parameters, runs(500)))
    assert is_bounded(stage) is bounded


@pytest.mark.parametrize("samples", [120, 600, 5000, 50_000])
def test_long_pushes_drive_a_slow_plant_to_where_it_goes(samples: int) -> None:
    wild = probe_run(runs(samples), 1, STEPS, 0, 100)[:STEPS, 1]
    y = np.asarray(lfilter([0.04], [1.0, -0.96], wild))
    assert y.min() < -0.5 < 0.5 < y.max()
    assert np.count_nonzero(np.diff(wild)) > 10  # and fast ones are pushed too


@pytest.mark.parametrize("samples", [3, 40, 600])
@pytest.mark.parametrize("steps", [2, 7, 200])
@pytest.mark.parametrize("longest", [None, 100])
def test_every_row_is_an_input_in_the_training_range(samples: int, steps: int, longest: int | None) -> None:
    known = runs(samples, 2)
    W = probe_run(known, 1, steps, 3, longest)
    assert W.shape == (2 * steps, 3)
    assert (W[:, 0] == 0.0).all()
    assert (W[:, 1:] >= known[0][:, 1:].min(axis=0)).all()
    assert (W[:, 1:] <= known[0][:, 1:].max(axis=0)).all()
    np.testing.assert_array_equal(W, probe_run(known, 1, steps, 3, longest))
