"""A single stable rule is a linear model: its output limits cut off what it says, and never hold its lags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.recursion import drop_held, pole_radius
from flysid.model.start import estimate_start
from flysid.model.ts import TS, over_lags

DT_S = 0.02
POLES = np.exp(DT_S * np.array([-0.4, -0.7 + 4.4j, -0.7 - 4.4j, -4.8 + 2.7j, -4.8 - 2.7j]))
NOISE = 0.02


def response(u: FloatArray) -> FloatArray:
    """A stable plant of order five, at a rate at which its five lags are nearly equal."""
    a = np.real(np.poly(POLES))
    return np.asarray(lfilter([0.0, 0.6 * a.sum()], a, u))


def steps(rng: np.random.Generator) -> FloatArray:
    return np.repeat(rng.uniform(-0.7, 0.7, 40), 50)


@pytest.fixture(scope="module")
def fitted() -> FittedTS:
    rng = np.random.default_rng(0)
    u = [steps(rng) for _ in range(4)]
    y = [response(v) + NOISE * rng.normal(size=len(v)) for v in u]
    train = Dataset.from_arrays(u, y, DT_S, inputs=["u"], outputs=["y"])
    return over_lags(TS(rules=1, na=5, nb=2, nk=0), train)


@pytest.fixture(scope="module")
def flight() -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(9)
    u = steps(rng)
    y = response(u)
    return u[:, None], y[:, None], (y + NOISE * rng.normal(size=len(y)))[:, None]


@pytest.mark.parametrize("shove", [0.0, 0.3, -0.3])
def test_a_stable_rule_comes_back_from_any_start(
    fitted: FittedTS, flight: tuple[FloatArray, FloatArray, FloatArray], shove: float
) -> None:
    """Raw noisy lags, shoved sample by sample: metres per second off, and forgotten all the same."""
    u, truth, measured = flight
    zigzag = shove * (-1.0) ** np.arange(fitted.n_init)[:, None]
    run = fitted.simulate(u, measured[: fitted.n_init] + zigzag)
    low, high = fitted.output_limits
    assert ((run[fitted.n_init :] >= low) & (run[fitted.n_init :] <= high)).all()
    assert np.sqrt(np.mean((run - truth)[-500:] ** 2)) < NOISE


def test_a_start_is_found_where_the_first_guess_leaves_the_limits(
    fitted: FittedTS, flight: tuple[FloatArray, FloatArray, FloatArray]
) -> None:
    u, truth, measured = flight
    start = estimate_start(fitted, u[:60], measured[:60])
    assert np.sqrt(np.mean((fitted.simulate(u, start) - truth)[60:] ** 2)) < NOISE


def test_rules_and_what_does_not_come_back_are_held(fitted: FittedTS) -> None:
    lags = fitted.layout.lags
    par = fitted.parameters
    assert np.ptp(drop_held(lags, par).limits) > 50 * np.ptp(par.limits)
    two = par._replace(
        theta=np.repeat(par.theta, 2, axis=0),
        centre=np.repeat(par.centre, 2, axis=0),
        width=np.repeat(par.width, 2, axis=0),
    )
    assert drop_held(lags, two) is two
    grows = par.theta.copy()
    grows[0, 0, 0] += 0.1
    assert drop_held(lags, par._replace(theta=grows)).limits is par.limits
    still_held = replace(fitted, parameters=par._replace(theta=grows))
    assert np.isfinite(still_held.simulate(np.ones((3000, 1)))).all()


def test_models_without_limits_say_the_same_inside_them(
    fitted: FittedTS, flight: tuple[FloatArray, FloatArray, FloatArray]
) -> None:
    u, _, measured = flight
    linear = ARX(na=2, nb=2, nk=1).fit(
        Dataset.from_arrays(u, measured, DT_S, inputs=["u"], outputs=["y"]), None
    )
    for model in (fitted, linear):
        calm = np.repeat(measured[:1], model.n_init, axis=0)
        inside = model.simulate(u, calm)
        np.testing.assert_array_equal(model.unlimited().simulate(u, calm), inside)
    assert pole_radius(fitted.local_polynomials()[0][0]) < 1.0
