"""The compiled kernels against a plain Python model, and sensitivities against differences."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import Lags, Parameters, firing, free_run, predict, sweep

LAGS = Lags(  # two outputs, one input; z = (y1(k-1), u(k-1), y2(k-1) - y2(k-2))
    np.array([0, 0, 1, 2, -1]),
    np.array([1, 2, 1, 1, 0]),
    np.array([0, 2, 1]),
    np.array([1, 1, 1]),
    np.array([-1, -1, 2]),
)


def parameters(rules: int = 3) -> Parameters:
    rng = np.random.default_rng(0)
    theta = 0.25 * rng.normal(size=(rules, 2, 5))
    return Parameters(
        theta,
        rng.normal(size=(rules, 3)),
        rng.uniform(0.5, 1.5, size=(rules, 3)),
        np.array([[-5.0] * 3, [5.0] * 3]),
        np.array([[-50.0] * 2, [50.0] * 2]),
    )


def inputs(n: int) -> FloatArray:
    W = np.zeros((n, 3))
    W[:2, :2] = [[0.3, -0.2], [0.1, 0.4]]
    W[:, 2] = np.random.default_rng(1).normal(size=n)
    return W


def plain_step(W: FloatArray, k: int, p: Parameters) -> FloatArray:
    x = np.array([W[k - 1, 0], W[k - 2, 0], W[k - 1, 1], W[k - 1, 2], 1.0])
    z = np.array([W[k - 1, 0], W[k - 1, 2], W[k - 1, 1] - W[k - 2, 1]])
    w = np.exp(-0.5 * (((z - p.centre) / p.width) ** 2).sum(axis=1))
    return np.asarray(np.einsum("r,rim,m->i", w / w.sum(), p.theta, x))


@pytest.mark.parametrize("rules", [1, 3])
def test_free_run_is_the_plain_model(rules: int) -> None:
    W = inputs(60)
    p = parameters(rules)
    expected = W.copy()
    for k in range(2, 60):
        expected[k, :2] = plain_step(expected, k, p)
    free_run(W, 2, LAGS, p)
    assert np.allclose(W, expected, rtol=1e-12, atol=1e-13)


def test_prediction_restarts_from_measurements_and_leaves_them_alone() -> None:
    W = inputs(40)
    p = parameters()
    W[:, :2] = np.random.default_rng(2).normal(size=(40, 2))
    before = W.copy()
    ahead = predict(W, 2, 3, LAGS, p)
    assert np.array_equal(W, before)
    assert np.isnan(ahead[:4]).all()
    short = before[:11].copy()
    free_run(short, 8, LAGS, p)
    assert np.allclose(ahead[10], short[10, :2], rtol=1e-13)


@pytest.mark.parametrize("rules", [1, 3])
def test_sensitivities_are_the_derivatives_of_the_free_run(rules: int) -> None:
    p = parameters(rules)
    n = 50
    depth = 2
    basis = np.random.default_rng(3).normal(size=(5, 5))
    a = p.theta @ np.linalg.inv(basis)
    size = a.size + 2 * p.centre.size

    def run(v: FloatArray) -> FloatArray:
        m = a.size
        c = p.centre.size
        q = Parameters(
            np.ascontiguousarray(v[:m].reshape(a.shape) @ basis),
            np.ascontiguousarray(v[m : m + c].reshape(p.centre.shape)),
            np.ascontiguousarray(np.exp(v[m + c : m + 2 * c]).reshape(p.centre.shape)),
            p.z_range,
            p.limits,
        )
        W = inputs(n)
        W[:depth, :2] = v[size:].reshape(depth, 2)
        free_run(W, depth, LAGS, q)
        return np.asarray(W[:, :2].ravel())

    v = np.concatenate([a.ravel(), p.centre.ravel(), np.log(p.width).ravel(), inputs(n)[:depth, :2].ravel()])
    J = np.zeros((n, 2, len(v)))
    for k in range(depth):
        for i in range(2):
            J[k, i, size + 2 * k + i] = 1.0
    ring = J[:depth].copy()
    W = inputs(n)
    later = J[depth:].copy()
    H = np.zeros((len(v), len(v)))
    g = np.zeros(len(v))
    square = sweep(
        inputs(n), W, (depth, n), LAGS, p, np.ascontiguousarray(basis.T), depth * 2, ring, later, H, g
    )
    J[depth:] = later
    flat = later.reshape(-1, len(v))
    gaps = inputs(n)
    free_run(gaps, depth, LAGS, p)
    error = (gaps - W)[depth:, :2].ravel()
    assert square == pytest.approx(error @ error)
    assert np.allclose(np.tril(H), np.tril(flat.T @ flat), rtol=1e-9, atol=1e-9)
    assert np.allclose(g, flat.T @ error, rtol=1e-9, atol=1e-9)
    step = 1e-6
    for column in range(len(v)):
        shift = np.zeros(len(v))
        shift[column] = step
        difference = (run(v + shift) - run(v - shift)) / (2 * step)
        assert np.allclose(J[:, :, column].ravel(), difference, rtol=2e-6, atol=2e-8), column


@pytest.mark.parametrize("bad", [1e308, -1e308])
def test_absurd_inputs_end_at_the_limits(bad: float) -> None:
    W = inputs(30)
    p = parameters()
    W[5:, 2] = bad
    free_run(W, 2, LAGS, p)
    assert np.isfinite(W).all()
    assert (np.abs(W[:, :2]) <= 50.0).all()


def test_firing_rows_sum_to_one_and_begin_with_the_first_known() -> None:
    phi = firing(inputs(20), 2, LAGS, parameters())
    assert np.allclose(phi.sum(axis=1), 1.0, atol=1e-14)
    assert np.array_equal(phi[0], phi[2])
