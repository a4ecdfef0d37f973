"""Difference equations in states: the same run, in any units, and states that are uncorrelated."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.rules.linear_starts import realise, uncorrelated
from tests.model_examples import fitted


@pytest.mark.parametrize("name", ["arx, coupled outputs", "arx, refined", "arx, static"])
def test_states_run_as_the_difference_equation_they_stand_for(name: str) -> None:
    model = fitted(name)
    assert isinstance(model, FittedLinear)
    n_y, n_u = len(model.outputs), len(model.inputs)
    rng = np.random.default_rng(1)
    shift = rng.normal(size=n_y + n_u)
    scale = rng.uniform(0.5, 2.0, n_y + n_u)
    (A,), B, c = realise(model, shift, scale).law
    u = rng.uniform(-0.3, 0.3, (300, n_u)) + model.u_origin
    inputs = (u - shift[n_y:]) / scale[n_y:]
    x = np.zeros((len(u), len(c)))
    for k in range(len(B), len(u)):
        x[k] = A @ x[k - 1] + c + sum(B[lag] @ inputs[k - lag] for lag in range(len(B)))
    run = model.simulate(u)
    low, high = model.output_limits
    assert ((run > low) & (run < high)).all()
    assert shift[:n_y] + scale[:n_y] * x[150:, :n_y] == pytest.approx(run[150:], abs=1e-6)


def test_other_states_are_uncorrelated_with_the_outputs_and_each_other() -> None:
    """A state that the outputs say already is left as small as rounding makes it."""
    rng = np.random.default_rng(2)
    seen = rng.normal(size=(500, 2))
    hidden = np.column_stack(
        [seen @ [1.0, -2.0], 5.0 * rng.normal(size=500) + seen[:, 0], rng.normal(size=500)]
    )
    states = np.column_stack([seen, hidden])
    covariance = states.T @ states / 500
    T = uncorrelated(covariance, 2)
    assert T[:2].tolist() == np.eye(2, 5).tolist()
    spread = T @ covariance @ T.T
    assert np.abs(spread[2:, :2]).max() < 1e-9
    assert np.sort(np.diag(spread)[2:]) == pytest.approx([0.0, 1.0, 1.0], abs=1e-9)
    assert np.abs(spread[2:, 2:] - np.diag(np.diag(spread)[2:])).max() < 1e-9
    assert uncorrelated(np.eye(2), 2).tolist() == np.eye(2).tolist()
