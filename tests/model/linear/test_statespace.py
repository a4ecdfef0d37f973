"""State space: known systems found again by every method, gaps respected, choices explained, errors named."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.linear.data import Scaling
from flysid.model.statespace import StateSpace
from flysid.model.subspace.kalman import gains_of
from flysid.model.subspace.triangle import (
    METHODS,
    Columns,
    Method,
    Realisation,
    kalman_gain,
    project,
    subspace,
    triangle_for,
    window,
)

A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.85, 0.1], [0.0, 0.0, 0.7]])
B = np.array([[0.1, 0.0], [0.0, 0.2], [0.3, 0.1]])
C = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]])
D = np.array([[0.0, 0.05], [0.1, 0.0]])
K = np.array([[0.3, 0.05], [0.0, 0.4], [0.1, 0.1]])


def fly(
    rows: int, seed: int, *, noise: float = 0.0, level: float = 0.0, feedback: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """The system above from a random state under random steps, with innovations and maybe feedback."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (rows // 3 + 1, 2)), 3, axis=0)[:rows]
    e = noise * rng.standard_normal((rows, 2))
    x = rng.standard_normal(3)
    y = np.zeros((rows, 2))
    delayed = np.zeros(2)
    for k in range(rows):
        u[k] -= feedback * delayed
        y[k] = C @ x + D @ u[k] + e[k]
        x = A @ x + B @ u[k] + K @ e[k]
        delayed = y[k]
    return u, y + level


def markov(a: FloatArray, b: FloatArray, c: FloatArray, steps: int = 8) -> FloatArray:
    return np.stack([c @ np.linalg.matrix_power(a, i) @ b for i in range(steps)])


def off(found: Realisation) -> float:
    """Largest error of the impulse response."""
    gap = markov(found.a, found.b, found.c) - markov(A, B, C)
    return float(max(np.abs(gap).max(), np.abs(found.d - D).max()))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_a_system_without_noise_from_segments_with_gaps(method: Method) -> None:
    flights = [fly(n, seed, level=3.0) for seed, n in enumerate((150, 90, 5, 200))]
    found = subspace([u for u, _ in flights], [y for _, y in flights], 3, method=method)
    assert off(found) < 1e-8
    assert found.innovation.diagonal().max() < 1e-18


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_noise_too(method: Method) -> None:
    u, y = fly(40_000, 1, noise=0.1)
    found = subspace([u], [y], 3, method=method, past=15)
    assert off(found) < 0.02
    assert markov(found.a, found.k, found.c) == pytest.approx(markov(A, K, C), abs=0.03)
    assert found.innovation == pytest.approx(0.01 * np.eye(2), abs=5e-4)


def test_feedback_biases_the_oblique_projection_and_not_the_predictor() -> None:
    u, y = fly(40_000, 2, noise=0.5, feedback=0.5)
    errors = {m: off(subspace([u], [y], 3, method=m, past=20)) for m in METHODS}
    assert errors["pbsid"] < 0.04
    assert min(errors["moesp"], errors["n4sid"]) > 2 * errors["pbsid"]


def test_no_feedthrough_is_estimated_where_it_was_ruled_out() -> None:
    u, y = fly(500, 3)
    for method in METHODS:
        found = subspace([u], [y - u @ D.T], 3, method=method, feedthrough=False)
        assert not found.d.any()
        assert markov(found.a, found.b, found.c) == pytest.approx(markov(A, B, C), abs=1e-8)


def test_the_kalman_gain_solves_the_filter_equation() -> None:
    q = np.diag([0.1, 0.2, 0.3])
    r = np.diag([0.5, 1.0])
    gain = kalman_gain(A, C, q, np.zeros((3, 2)), r)
    p = np.eye(3)
    for _ in range(500):
        p = A @ p @ A.T + q - A @ p @ C.T @ np.linalg.solve(C @ p @ C.T + r, C @ p @ A.T)
    assert gain == pytest.approx(A @ p @ C.T @ np.linalg.inv(C @ p @ C.T + r), abs=1e-7)


def test_gains_of_the_first_samples_are_those_of_the_covariance_form() -> None:
    """Whose recursion squares what the roots keep; with little noise it would lose its digits."""
    r = np.array([[0.5, 0.1], [0.1, 1.0]])
    p = np.diag([2.0, 1.0, 0.5])
    still = np.zeros(3)
    system = Realisation(A, B, C, D, K, still, still[:2], r, p)
    gains = gains_of(system, 40)
    for gain in gains:
        cross = A @ p @ C.T + K @ r
        seen = C @ p @ C.T + r
        assert gain == pytest.approx(cross @ np.linalg.inv(seen), abs=1e-7)
        p = A @ p @ A.T + K @ r @ K.T - gain @ cross.T
    assert gains[-1] == pytest.approx(K, abs=1e-3)


def data(rows: int = 2000, noise: float = 0.02, level: float = 2.0) -> Dataset:
    flights = [fly(rows, seed, noise=noise, level=level) for seed in (4, 5)]
    return Dataset.from_arrays([u for u, _ in flights], [y for _, y in flights], 0.02)


def test_the_order_is_chosen_and_explained() -> None:
    model = StateSpace(refine=False).fit(data(700))
    assert model.order == 3
    assert "simplest within one standard error" in model.notes[0]
    assert np.sort(np.abs(model.poles)) == pytest.approx(np.sort(np.abs(np.linalg.eigvals(A))), abs=0.02)
    u, y = fly(500, 9, level=2.0)
    n = model.n_init
    assert np.abs(model.simulate(u, y[:n]) - y)[n:].max() < 0.1
    static = D + C @ np.linalg.solve(np.eye(3) - A, B)
    assert model.dc_gain == pytest.approx(static, rel=0.05, abs=0.03)
    assert "State space of order 3" in str(model)
    assert model.singular_values[0] >= model.singular_values[-1]


def test_one_step_predictions_leave_the_innovations() -> None:
    model = StateSpace(order=3, refine=False).fit(data())
    u, y = fly(3000, 10, noise=0.02, level=2.0)
    spread = [np.nanstd(y - model.predict(u, y, k), axis=0) for k in (1, 2, 5)]
    assert spread[0] == pytest.approx([0.02, 0.02], rel=0.06)
    assert all((later > earlier).all() for earlier, later in pairwise(spread))
    assert model.states(u, y).shape == (3000, 3)


def test_rest_is_rest_with_inputs_and_outputs_at_zero() -> None:
    model = StateSpace(order=3, past=10, method="pbsid").fit(data(noise=0.0, level=0.0))
    u = fly(200, 11)[0]
    x = np.zeros(3)
    y = np.zeros((200, 2))
    for k in range(200):
        y[k], x = C @ x + D @ u[k], A @ x + B @ u[k]
    assert model.simulate(u) == pytest.approx(y, abs=1e-6)


def test_a_ramp_is_an_integrator_with_drift() -> None:
    rng = np.random.default_rng(6)
    u = rng.standard_normal((400, 1))
    y = np.cumsum(np.vstack([[[0.0]], 0.1 * u[:-1] + 0.02]), axis=0)
    model = StateSpace(order=1, feedthrough=False).fit(Dataset.from_arrays(u, y, 0.1))
    assert model.poles == pytest.approx([1.0], abs=1e-6)
    n = model.n_init
    assert np.abs(model.simulate(u, y[:n]) - y).max() < 1e-3


def test_python_control_gets_the_same_matrices() -> None:
    model = StateSpace(order=3, method="cva", past=10).fit(data())
    system = model.to_control()
    for name in "abcd":
        assert np.array_equal(getattr(system, name.upper()), getattr(model.realisation, name))
    assert system.dt == model.dt_s
    assert list(system.output_labels) == [s.name for s in model.outputs]


def late_plant(rows: int = 1500, late: int = 14) -> tuple[FloatArray, FloatArray]:
    """First order behind a dead time far longer than the horizons tried."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.standard_normal((rows // 3, 1)), 3, axis=0)
    y = np.zeros((rows, 1))
    for k in range(late + 1, rows):
        y[k] = 0.9 * y[k - 1] + 0.5 * u[k - 1 - late]
    return u, y + 0.02 * rng.standard_normal((rows, 1))


def test_a_dead_time_is_kept_out_of_the_states() -> None:
    u, y = late_plant()
    data = Dataset.from_arrays(u, y, 0.02)
    model = StateSpace(method="pbsid", past=5).fit(data)
    assert 10 <= model.delays[0] <= 14
    assert model.order <= 5
    assert "enter late, in samples: u 1" in model.notes[-1]
    n = model.n_init
    assert n >= model.delays[0]
    assert np.std((model.simulate(u, y[:n]) - y)[n:]) < 0.04
    system = model.to_control()
    assert system.nstates == model.order + model.delays[0]
    rest = replace(
        model, u_origin=np.zeros(1), y_origin=np.zeros(1), realisation=_without_offsets(model.realisation)
    )
    import control

    _, expected = control.forced_response(system, U=u[:100, 0])
    assert rest.simulate(u[:100])[:, 0] == pytest.approx(expected, abs=1e-9)
    given = StateSpace(order=1, method="pbsid", past=5, nk=15, refine=False).fit(data)
    assert given.delays == (14,)


def _without_offsets(system: Realisation) -> Realisation:
    return replace(system, drift=np.zeros_like(system.drift), level=np.zeros_like(system.level))


def test_what_cannot_be_fitted_is_said() -> None:
    u, y = fly(300, 7)
    short = Dataset.from_arrays([u[:12], u[20:30]], [y[:12], y[20:30]], 0.02)
    with pytest.raises(DataError, match=r"too few|no segment is longer"):
        StateSpace(order=3, past=10, method="pbsid").fit(short)
    with pytest.raises(FitError, match=r"order 9 was asked for.*show 3 at most.*smaller order"):
        StateSpace(order=9, past=10, method="pbsid").fit(Dataset.from_arrays(u, y, 0.02))
    with pytest.raises(UsageError, match=r"method is .*, not 'magic'"):
        StateSpace(method="magic").fit(short)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"nk=\(1, 2, 3\)"):
        StateSpace(nk=(1, 2, 3)).fit(short)
    with pytest.raises(DataError, match="longer than the delay of 39 samples"):
        StateSpace(nk=40).fit(short)
    with pytest.raises(UsageError, match="order is at least 1, not 0"):
        StateSpace(order=0).fit(short)
    with pytest.raises(DataError, match="never changes"):
        StateSpace().fit(Dataset.from_arrays(u, np.ones_like(y), 0.02))


def test_the_highest_order_leaves_one_row_of_the_future_to_each_output() -> None:
    """Noise alone shows every order; the shift of the observability matrix needs the last row."""
    rng = np.random.default_rng(0)
    noise = Dataset.from_arrays(rng.normal(size=(300, 1)), rng.normal(size=(300, 1)), 1.0)
    triangle = triangle_for(noise, Scaling.of(noise), window(3, "n4sid"))
    projection = project(Columns.of(triangle, (1, 1), 3, "n4sid", feedthrough=False), "n4sid")
    assert projection.most == len(projection.left) - 1 < np.count_nonzero(projection.singular_values > 0.0)
