"""The bordered step against the dense one; the growth of a TS model keeps what it is asked to keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset
from flysid.model.bordered import Bordered
from flysid.model.rules.free_run_error import Problem, SimulationError, runs_of
from flysid.model.rules.growth import first_basis, insertions, linear_stage
from flysid.model.rules.probe_inputs import beyond, stress_run
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders, scaling

P, SEGMENTS, Q = 4, 3, 2


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
    g, scale = rng.normal(size=len(H)), rng.uniform(0.5, 2.0, size=len(H))
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
    grown = insertions(stage, Antecedent(0, 1))[0]
    limits = np.array([[-4.0], [4.0]])
    stress = 2.0 * stress_run(grown.problem.runs, 1, 100, 3)  # leaves the range
    problem = replace(grown.problem, ridge=0.01, limits=limits, stress=stress)
    body = grown.body
    error = SimulationError(problem, body, np.ones(body.size))
    start = error.start(grown.initial)
    rng = np.random.default_rng(2)
    point = start + 1e-3 * rng.normal(size=len(start))
    cost, H, g = error.normal(point)
    assert abs(cost - error.cost(point)) < 1e-12
    calm = SimulationError(replace(problem, stress=None), body, np.ones(body.size))
    assert cost > calm.cost(point) + 1e-6
    assert len(H.blocks) == 2
    for column in range(len(point)):
        shift = np.zeros(len(point))
        shift[column] = 1e-6
        slope = (error.cost(point + shift) - error.cost(point - shift)) / 2e-6
        assert abs(slope / 2 - g[column]) < 1e-5 * max(1.0, np.abs(g).max()), column


def test_only_what_leaves_the_range_counts() -> None:
    y = np.array([[-3.0], [-1.9], [0.0], [1.9], [2.5]])
    over = beyond(y, np.array([[-3.0], [3.0]]))
    assert np.allclose(over[:, 0], [-1.0, 0.0, 0.0, 0.0, 0.5])
