"""ARMAX and Box-Jenkins: exact gradients, no bias, the spread the Cramer-Rao bound promises."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.bj import BJ
from flysid.model.linear.pem import Kind, PredictionError, innovations_start
from flysid.model.simulation_error import OutputOrders, Record, Transfer, from_transfer

A = [1.0, -1.5, 0.7]
B = [0.0, 1.0, 0.5]
C = [1.0, -0.6, 0.2]
D = [1.0, -0.9]
TRUTH = np.array([-1.5, 0.7, 1.0, 0.5])


def experiment(kind: Kind, seed: int, samples: int = 600) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    e = 0.3 * rng.standard_normal(samples)
    noise = lfilter(C, A if kind == "armax" else D, e)
    return u, np.asarray(lfilter(B, A, u) + noise)


@pytest.mark.parametrize("kind", ["armax", "bj"])
def test_sensitivities_equal_differences(kind: Kind) -> None:
    orders = OutputOrders(2, (2,), (1,))
    records = tuple(Record(u[:, None], y) for u, y in (experiment(kind, s, 80) for s in (1, 2)))
    problem = PredictionError(kind, records, orders, 2, 0 if kind == "armax" else 1)
    dynamics = from_transfer(Transfer(np.array(A), (np.array(B),), 0.1), orders)
    theta = np.concatenate([dynamics, [-0.5, 0.1], [] if kind == "armax" else [-0.7]])
    residual, jacobian = problem.residuals_and_jacobian(theta)
    gradient = 2 * jacobian.T @ residual
    for i in range(len(theta)):
        step = 1e-6 * np.eye(len(theta))[i]
        slope = (problem.cost(theta + step) - problem.cost(theta - step)) / 2e-6
        assert gradient[i] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize("kind", ["armax", "bj"])
def test_unbiased_and_as_sure_as_promised(kind: Kind) -> None:
    settings = (
        ARMAX(na=2, nb=2, nk=1, nc=2, offset=False)
        if kind == "armax"
        else BJ(na=2, nb=2, nk=1, nc=2, nd=1, offset=False)
    )
    estimates = []
    promised = []
    for seed in range(25):
        u, y = experiment(kind, seed)
        data = Dataset.from_arrays(u, y, 0.1)
        model = settings.fit(data, data)
        estimates.append(model.flat[list(model.free)])
        promised.append(model.standard_errors[list(model.free)])
    spread = np.std(estimates, axis=0)
    mean = np.mean(estimates, axis=0)
    assert np.abs(mean - TRUTH).max() < 3 * (spread / np.sqrt(25)).max()
    assert spread == pytest.approx(np.mean(promised, axis=0), rel=0.4)
    inside = np.abs(np.array(estimates) - TRUTH) < 1.96 * np.array(promised)
    assert 0.88 < inside.mean() <= 1.0


def test_one_step_errors_are_the_innovations() -> None:
    for kind, settings in (("armax", ARMAX(na=2, nb=2, nk=1)), ("bj", BJ(na=2, nb=2, nk=1))):
        u, y = experiment(kind, 5, 3000)  # type: ignore[arg-type]
        model = settings.fit(Dataset.from_arrays(u, y + 1.0, 0.1))
        miss = (model.predict(u, y[:, None] + 1.0, 1)[50:, 0] - y[50:] - 1.0).std()
        assert miss < 1.02 * 0.3
        steps = [np.nanstd(model.predict(u, y + 1.0, k)[50:, 0] - y[50:]) for k in (1, 2, 3, 10)]
        assert steps == sorted(steps)


def test_a_feedback_loop_does_not_bias_armax() -> None:
    rng = np.random.default_rng(6)
    e = 0.5 * rng.standard_normal(6000)
    r = rng.standard_normal(6000)
    y = np.zeros(6000)
    u = np.zeros(6000)
    for k in range(2, 6000):
        y[k] = 0.9 * y[k - 1] + 0.5 * u[k - 1] + e[k] + 0.8 * e[k - 1]
        u[k] = r[k] - 0.5 * y[k]
    data = Dataset.from_arrays(u, y, 0.1)
    model = ARMAX(na=1, nb=1, nk=1, nc=1).fit(data)
    miss = np.abs(model.flat[list(model.free)][:2] - [-0.9, 0.5])
    assert (miss < 4 * model.standard_errors[list(model.free)][:2]).all()
    plain = ARX(na=1, nb=1, nk=1, refine=False).fit(data)
    assert np.abs(plain.flat[list(plain.free)][0] + 0.9) > 0.03


def test_short_pieces_that_begin_in_mid_flight_do_not_bend_armax() -> None:
    """The first three outputs of a piece have not all their lags; the state of C takes up one error alone."""
    b, a, c = [0.0, 0.2], np.poly([0.9, 0.9, 0.5]), [1.0, -0.5]
    rng = np.random.default_rng(9)
    u = np.repeat(rng.choice([-1.0, 1.0], 120), 10)
    y = lfilter(b, a, u) + lfilter(c, a, 0.02 * rng.standard_normal(len(u)))
    whole = Dataset.from_arrays(u, y, 0.1)
    pieces = [whole.segments[0].slice(at, at + 20, 0.1) for at in range(0, len(u), 20)]
    model = ARMAX(na=3, nb=1, nk=1, nc=1, offset=False).fit(whole.with_segments(pieces))
    free = list(model.free)
    miss = np.abs(model.flat[free][:4] - [*a[1:], 0.2])
    assert (miss < 4.0 * model.standard_errors[free][:4]).all()
    assert (miss < 0.05).all()


def test_the_noise_start_is_close() -> None:
    rng = np.random.default_rng(7)
    v = np.asarray(lfilter(C, D, rng.standard_normal(4000)))
    c, d = innovations_start([v], 2, 1)
    assert c == pytest.approx(np.array(C), abs=0.1)
    assert d == pytest.approx(np.array(D), abs=0.1)


def test_noise_orders_that_cannot_be() -> None:
    u, y = experiment("bj", 0)
    with pytest.raises(UsageError, match="both"):
        BJ(nc=1).fit(Dataset.from_arrays(u, y, 0.1))
    with pytest.raises(UsageError, match="ARMAX: nc is a whole number from 0 on"):
        ARMAX(nc=-1).fit(Dataset.from_arrays(u, y, 0.1))
