"""Predictions through coloured noise step by step, and the rows that stand for a long record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.model.fir import FIR
from flysid.model.in_pieces import in_pieces
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.noise import coloured_gram, k_step_ahead
from flysid.model.simulation_error import OutputError, OutputOrders, Record
from flysid.model.step_response import step_response
from tests.model_examples import EXAMPLES, fitted


@pytest.mark.parametrize("k", [1, 2, 4])
@pytest.mark.parametrize("moving", [True, False])
def test_k_steps_ahead_of_two_coupled_outputs(k: int, moving: bool) -> None:
    """At time t what comes after it is replaced by its prediction, errors that come by zero."""
    rng = np.random.default_rng(k)
    n = 12
    a = np.concatenate([np.eye(2)[None], 0.4 * rng.normal(size=(3, 2, 2))])
    y, drive, e = rng.normal(size=(3, n, 2))
    ma = np.vstack([np.ones(2), rng.normal(size=(2, 2))])
    found = k_step_ahead(a, y, drive, k, ma if moving else None, e if moving else None)
    assert np.isnan(found[: k - 1]).all()
    for t in range(-1, n - k):
        known = {s: y[s] for s in range(t + 1)}
        for s in range(t + 1, t + k + 1):
            known[s] = drive[s] - sum(a[lag] @ known[s - lag] for lag in range(1, 4) if s >= lag)
            if moving:
                known[s] = known[s] + sum(ma[lag] * e[s - lag] for lag in range(1, 3) if 0 <= s - lag <= t)
        assert found[t + k] == pytest.approx(known[t + k])


def test_a_record_in_pieces_is_foreseen_through_a_strong_moving_average() -> None:
    """The innovations of its start are zeros, which stay in mind for many samples."""
    model = fitted("bj")
    assert isinstance(model, FittedLinear)
    model = replace(model, noise=np.array([[1.0], [-0.5], [0.1]]), ma=np.array([[1.0], [0.9], [0.05]]))
    segment = EXAMPLES["bj"][1].segments[0]
    ahead = in_pieces(model)
    pieces = [slice(0, 1), slice(1, 3), *(slice(k, k + 9) for k in range(3, len(segment), 9))]
    found = np.concatenate([ahead.feed(segment.u[p], segment.y[p]) for p in pieces])
    np.testing.assert_allclose(found, model.predict(segment.u, segment.y, 1), atol=1e-9)


def test_a_gram_of_coloured_noise_is_that_of_its_covariance() -> None:
    d = np.array([1.0, -0.8, 0.2])
    jacobian = np.random.default_rng(0).normal(size=(15, 2))
    answer = lfilter([1.0], d, np.eye(15)[0])
    through = np.array([[answer[i - j] if i >= j else 0.0 for j in range(15)] for i in range(15)])
    assert coloured_gram([jacobian], d) == pytest.approx(jacobian.T @ through @ through.T @ jacobian)


def test_what_taps_leave_over_has_the_colour_of_the_noise() -> None:
    rng = np.random.default_rng(6)
    u = rng.normal(size=3000)
    noise = lfilter([1.0], [1.0, -0.8], 0.1 * rng.normal(size=3000))
    data = Dataset.from_arrays(u, 5.0 + lfilter([0.0, 1.0, 0.5], [1.0], u) + noise, 0.02)
    model = FIR(taps=4, nk=0).fit(data)
    assert model.noise is not None
    assert model.noise[1, 0] == pytest.approx(-0.8, abs=0.06)  # four standard errors
    assert np.abs(model.noise[2:]).max(initial=0.0) < 0.08


def ramp(n: int) -> Record:
    return Record(np.arange(float(n))[:, None], np.arange(float(n)))


def test_a_long_record_is_thinned_to_pieces_from_all_over() -> None:
    problem = OutputError((ramp(3000), ramp(1000), ramp(4)), OutputOrders(2, (2,), (1,)))
    assert problem.thinned(1000) is problem  # 4,000 rows count, of 4 nothing can be told
    found = problem.thinned(400)
    assert [r.y[0] for r in found.records] == [450.0, 1450.0, 2450.0, 450.0]  # the middle of a thousand
    assert {len(r.y) for r in found.records} == {100}
    assert all((r.u[:, 0] == r.y).all() for r in found.records)
    fewer = problem.thinned(400, pieces=2)
    assert [r.y[0] for r in fewer.records] == [675.0, 2175.0, 450.0]
    assert [len(r.y) for r in fewer.records] == [150, 150, 100]
    assert problem.thinned(999) is not problem
    assert problem.thinned(24) is problem  # pieces of 6 rows tell no more than their own start


def test_a_step_cut_short_is_no_surer_than_what_a_longer_one_says_otherwise() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.normal(size=40), 25)
    y = lfilter([0.0, 0.02], [1.0, -0.98], u) + 0.01 * rng.normal(size=len(u))
    data = Dataset.from_arrays(u, y, 0.02)
    short, long = (step_response(data, horizon_s=seconds) for seconds in (0.5, 1.0))
    off: FloatArray = np.abs(np.interp(short.time_s, long.time_s, long.step) - short.step)
    assert (short.error[1:] >= 0.999 * off[1:]).all()
    assert off.max() > 0.0
