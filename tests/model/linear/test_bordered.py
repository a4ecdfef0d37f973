"""The bordered step against the dense one; the growth of a TS model keeps what it is asked to keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.bordered import Bordered
from flysid.model.rules.boundedness import probe_run
from flysid.model.rules.free_run_error import Body, Problem
from flysid.model.rules.growth import first_basis, insertions, linear_stage
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders, runs_of, scaling
from flysid.model.rules.stages import Stage

P = 4
SEGMENTS = 3
Q = 2


def test_the_step_is_the_dense_one() -> None:
    rng = np.random.default_rng(0)
    jacobian = np.zeros((60, P + SEGMENTS * Q))
    for s in range(SEGMENTS):
        rows = slice(20 * s, 20 * (s + 1))
        jacobian[rows, :P] = rng.normal(size=(20, P))
        jacobian[rows, P + s * Q : P + (s + 1) * Q] = rng.normal(size=(20, Q))
    H = jacobian.T @ jacobian
    own = [slice(P + s * Q, P + (s + 1) * Q) for s in range(SEGMENTS)]
    found = Bordered(H[:P, :P], np.stack([H[:P, o] for o in own]), np.stack([H[o, o] for o in own]))
    g = rng.normal(size=len(H))
    scale = rng.uniform(0.5, 2.0, size=len(H))
    expected = -np.linalg.solve(H + 0.1 * np.diag(scale**2), g)
    step = found.damped_step(scale, 0.1, g)
    assert step is not None
    assert np.allclose(step, expected, rtol=1e-12)
    assert np.array_equal(found.diagonal(), np.diagonal(H))
    assert not replace(found, corner=np.full((P, P), np.nan)).is_finite()
    assert replace(found, corner=-found.corner).damped_step(scale, 0.1, g) is None


def _problem() -> Problem:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, 60), 10)
    y = np.zeros(600)
    for k in range(2, 600):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + 0.1 * u[k - 1] - 0.1 * y[k - 1] ** 3
    data = Dataset.from_arrays([u[:300], u[300:]], [y[:300], y[300:]], 0.05)
    layout = Layout(data.outputs, data.inputs, Orders(2, (2,), (1,)), (), *scaling(data))
    runs = runs_of(layout, data.segments, 20)
    basis = first_basis(layout, runs)
    wide = np.array([[-50.0], [50.0]])
    return Problem(layout, runs, basis, np.zeros((1, len(basis))), np.zeros((2, 0)), wide)


def test_gradient_and_matrix_hold_ridge_first_outputs_and_stress() -> None:
    stage = linear_stage(_problem(), 5)
    _, grown = insertions(stage, [Antecedent(0, 1)])[0]
    limits = np.array([[-4.0], [4.0]])
    stress = 2.0 * probe_run(grown.problem.runs, 1, 100, 3)  # leaves the range
    problem = replace(grown.problem, ridge=0.01, limits=limits, stress=stress)
    stage = replace(grown, problem=problem)
    rng = np.random.default_rng(2)
    point = stage.unknowns + 1e-3 * rng.normal(size=len(stage.unknowns))
    cost, found, g = stage.cost_of().normal(point)
    assert abs(cost - stage.cost_of().at(point)) < 1e-12
    calm = replace(stage, problem=replace(problem, stress=None))
    assert cost > calm.cost_of().at(point) + 1e-6
    assert len(found.blocks) == 2
    at = stage.cost_of().at
    for column in range(len(point)):
        shift = np.zeros(len(point))
        shift[column] = 1e-6
        slope = (at(point + shift) - at(point - shift)) / 2e-6
        assert abs(slope / 2 - g[column]) < 1e-5 * max(1.0, np.abs(g).max()), column


def test_only_what_leaves_the_range_counts() -> None:
    """Half of the margin between the training range and the limits is free."""
    layout = replace(_problem().layout, orders=Orders(0, (1,), (0,)), shift=np.zeros(2), scale=np.ones(2))
    stress = np.array([[0.0, u] for u in (-3.0, -1.9, 0.0, 1.9, 2.5)])
    own = replace(_problem(), layout=layout, runs=(np.zeros((3, 2)),), basis=np.eye(2))
    limits = np.array([[-3.0], [3.0]])
    problem = replace(own, offset=np.zeros((1, 2)), limits=limits, stress=stress)
    same = Body(np.array([[[1.0, 0.0]]]), np.zeros((1, 0)), np.zeros((1, 0)))  # y(k) = u(k)
    cost = Stage(problem, same, np.zeros((1, 0, 1))).priced().cost
    # row 0 is before the first simulated one
    assert cost == pytest.approx(0.5**2 / 5)


def test_a_rule_that_looks_back_further_than_the_lags_starts_from_what_it_sees() -> None:
    stage = linear_stage(_problem(), 5)
    _, grown = insertions(stage, [Antecedent(0, 5)])[0]
    assert grown.layout.depth == grown.layout.moving == grown.initial.shape[1] == 5
    before = stage.simulated()[0][3:5, :1]
    assert np.allclose(grown.initial[0, 3:], before)
