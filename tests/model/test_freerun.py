"""The free run equals the recursion written out, from any state, coupled or not; overflow saturates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference, saturate


def random_system(rng: np.random.Generator, n_y: int, n_u: int, *, diagonal: bool) -> Difference:
    a = np.concatenate([np.eye(n_y)[None], 0.2 * rng.standard_normal((rng.integers(0, 3), n_y, n_y))])
    if diagonal:
        a = a * np.eye(n_y)
    return Difference(a, rng.standard_normal((rng.integers(1, 4), n_y, n_u)), rng.standard_normal(n_y))


def written_out(system: Difference, u: FloatArray, y: FloatArray, start: int) -> FloatArray:
    y = y.copy()
    for k in range(start, len(u)):
        y[k] = system.c
        for lag in range(len(system.b)):
            y[k] += system.b[lag] @ u[k - lag]
        for lag in range(1, len(system.a)):
            y[k] -= system.a[lag] @ y[k - lag]
    return y


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**31), n_y=st.integers(1, 3), n_u=st.integers(1, 2), diagonal=st.booleans())
def test_the_recursion(seed: int, n_y: int, n_u: int, diagonal: bool) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, n_y, n_u, diagonal=diagonal)
    u = rng.standard_normal((40, n_u))
    y = rng.standard_normal((40, n_y))
    start = max(system.depth, 1)
    run = system.run(u[start:], system.state(u[:start], y[:start]))
    expected = written_out(system, u, y, start)
    assert run == pytest.approx(expected[start:], rel=1e-9, abs=1e-9)


def test_states_along_a_record_continue_it() -> None:
    rng = np.random.default_rng(5)
    system = random_system(rng, 2, 1, diagonal=False)
    u = rng.standard_normal((30, 1))
    zero = np.zeros((system.depth, 2))
    run = system.run(u, zero)
    states = system.state_history(u, run)
    for k in (0, 1, 2, 17):
        assert system.run(u[k:], states[k]) == pytest.approx(run[k:], abs=1e-9)


def test_overflow_ends_at_the_limit_last_touched() -> None:
    system = Difference(np.array([[[1.0]], [[-3.0]]]), np.ones((2, 1, 1)), np.zeros(1))
    run = system.run(-np.ones((2000, 1)), np.zeros((1, 1)))
    assert not np.isfinite(run).all()
    kept = saturate(run, np.array([[-5.0], [5.0]]))
    assert (kept[10:] == -5.0).all()
