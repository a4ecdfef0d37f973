"""The equations of a rotor axis: motors and torques in small steps, against the exact integrals."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.rotorcraft.rotor_axis import forgets, free_run, predictions, steps_ahead, wandering_trim

DT = 0.02
FINE = 400
"""Steps a row; a delay is a whole number of them."""
LAG, CURVE, DAMPING, TRIM = 0.05, 0.6, 1.2, 0.3
TORQUES = np.array([3.0, -2.0])


def parameters(delay: float, hold: float = 0.0, drift: float = 0.0) -> FloatArray:
    return np.array([LAG, delay, CURVE, DAMPING, TRIM, hold, drift, *TORQUES])


def torques(x: FloatArray, delay: float, resting: bool = False) -> FloatArray:
    """((N - 1) FINE + 1,) g(t), from row to row held commands; motors lag."""
    late = round(delay / DT * FINE)
    before = np.zeros(2) if resting else x[0]
    h = DT / FINE
    n = before.copy()
    found = []
    for k in range((len(x) - 1) * FINE + 1):
        found.append(float(TORQUES @ ((1.0 - CURVE) * n + CURVE * n**2)))
        x_now = x[(k - late) // FINE] if k >= late else before
        n = x_now + (n - x_now) * np.exp(-h / LAG)
    return np.array(found)


def moved(rate: float, g: FloatArray, trim: float) -> float:
    """The rate a row later: dy/dt = push - damping y under the row's mean torque, which is held."""
    push = float(np.mean(0.5 * (g[1:] + g[:-1]))) + trim
    rest = push / DAMPING
    return rest + (rate - rest) * float(np.exp(-DAMPING * DT))


@pytest.fixture(scope="module")
def commands() -> FloatArray:
    return np.random.default_rng(2).uniform(0.2, 1.0, (7, 2))


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.02, 0.047])
@pytest.mark.parametrize("resting", [False, True])
def test_a_free_run_is_the_integral_of_the_equations(
    commands: FloatArray, delay: float, resting: bool
) -> None:
    g = torques(commands, delay, resting)
    rates = [0.7]
    for k in range(len(commands) - 1):
        rates.append(moved(rates[-1], g[k * FINE : (k + 1) * FINE + 1], TRIM))
    theta = parameters(delay, hold=0.4, drift=0.1)  # a free run has neither
    assert free_run(commands, 0.7, theta, DT, True, resting) == pytest.approx(rates, abs=1e-6)
    assert free_run(commands, 0.7, theta, DT, False, resting) == pytest.approx(g[::FINE] + TRIM, abs=1e-9)


@pytest.mark.parametrize("hold", [0.0, 0.4])
def test_what_is_seen_corrects_the_rate_and_the_trim(commands: FloatArray, hold: float) -> None:
    """The rate by `hold` e, the trim by `drift` e a sample, where it is a torque: a rate in a sample."""
    drift = 0.1
    theta = parameters(0.013, hold, drift)
    y = np.random.default_rng(3).normal(size=len(commands))
    g = torques(commands, 0.013)
    rates, trims = [float(y[0])], [TRIM]
    for k in range(len(commands) - 1):
        e = y[k] - rates[-1]
        trims.append(trims[-1] + drift * e / DT)
        rates.append(moved(rates[-1] + hold * e, g[k * FINE : (k + 1) * FINE + 1], trims[-1]))
    assert predictions(commands, y, theta, DT, True)[0] == pytest.approx(rates, abs=1e-6)
    assert wandering_trim(commands, y, theta, DT, True) == pytest.approx(trims)
    ahead = steps_ahead(commands, y, theta, DT, True, 3)
    for k in range(3, len(commands)):  # known to row k - 3, whose correction is in the row after
        rate = rates[k - 2]
        for row in (k - 2, k - 1):
            rate = moved(rate, g[row * FINE : (row + 1) * FINE + 1], trims[k - 2])
        assert ahead[k] == pytest.approx(rate, abs=1e-6)


def test_an_acceleration_is_corrected_by_its_trim_alone(commands: FloatArray) -> None:
    theta = parameters(0.013, 0.4, 0.1)
    y = np.random.default_rng(3).normal(size=len(commands))
    g = torques(commands, 0.013)[::FINE]
    found, trims = [], [TRIM]
    for k in range(len(commands)):
        found.append(g[k] + trims[-1])
        trims.append(trims[-1] + 0.4 * (y[k] - found[-1]))
    assert predictions(commands, y, theta, DT, False)[0] == pytest.approx(found)
    assert wandering_trim(commands, y, theta, DT, False) == pytest.approx(trims[:-1])
    ahead = steps_ahead(commands, y, theta, DT, False, 3)
    assert ahead[3:] == pytest.approx([g[k] + trims[k - 2] for k in range(3, len(commands))])


@pytest.mark.parametrize(
    ("hold", "drift", "integrates", "does"),
    [
        (0.0, 0.0, True, True),  # damped by itself
        (0.4, 0.1, True, True),
        (2.05, 0.0, True, False),  # overcorrects: |fade (1 - hold)| = 1.025
        (2.0, 0.0, True, True),
        (0.0, -0.1, True, False),  # the trim runs after the error's wrong side
        (2.0, 0.0, False, True),
        (2.01, 0.0, False, False),
        (0.0, 0.0, False, True),
        (-0.01, 0.0, False, False),
    ],
)
def test_a_start_is_forgotten_where_the_correction_is_stable(
    hold: float, drift: float, integrates: bool, does: bool
) -> None:
    assert forgets(parameters(0.0, hold, drift), DT, integrates) is does
