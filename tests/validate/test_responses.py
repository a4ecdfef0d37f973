"""Frequency responses and steady states of models whose transfer function is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.capabilities import HasDifferenceEquation
from flysid.validate.responses import impulse_response, responses, steady_outputs
from tests.fakes import FirstOrder

HZ = np.geomspace(0.01, 9.9, 50)
LINEAR = FirstOrder(a=0.9, b=0.1)


@dataclass(frozen=True, eq=False)
class WithPolynomials(FirstOrder):
    """The same model, saying what it is."""

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        A = np.array([[[self.a]]])
        B = np.array([[[0.0]], [[self.b]]])
        return tuple((A, (r + 1) * B, np.zeros(1)) for r in range(len(self.labels)))


def test_polynomials_and_simulation_agree_with_the_transfer_function() -> None:
    z = np.exp(2j * np.pi * HZ * LINEAR.dt_s)
    truth = 0.1 / (z - 0.9)
    by_simulation = responses(LINEAR, HZ, 0, 0)
    by_rule = responses(WithPolynomials(a=0.9, b=0.1, labels=("R1", "R2")), HZ, 0, 0)
    np.testing.assert_allclose(by_simulation[0], truth, rtol=1e-9)
    np.testing.assert_allclose(by_rule[0], truth, rtol=1e-9)
    np.testing.assert_allclose(by_rule[1], 2 * truth, rtol=1e-9)
    assert responses(replace(LINEAR, labels=("R1", "R2")), HZ, 0, 0) == []


def test_a_linear_model_answers_by_its_difference_equation() -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(2000, 1))
    y = LINEAR.simulate(u) + 0.001 * rng.normal(size=(2000, 1))
    fitted = ARX(na=1, nb=1, nk=1).fit(Dataset.from_arrays(u, y, LINEAR.dt_s))
    assert isinstance(fitted, HasDifferenceEquation)
    z = np.exp(2j * np.pi * HZ * LINEAR.dt_s)
    (response,) = responses(fitted, HZ, 0, 0)
    np.testing.assert_allclose(response, 0.1 / (z - 0.9), rtol=0.02)


def test_an_integrator_has_no_gain_at_zero_frequency() -> None:
    (response,) = responses(WithPolynomials(a=1.0, b=0.1), np.array([0.0, 1.0]), 0, 0)
    assert np.isnan(response[0])
    assert np.isfinite(response[1])


def test_impulse_and_steady_state() -> None:
    np.testing.assert_allclose(impulse_response(LINEAR, 0, 0, 5), [0, 0.1, 0.09, 0.081, 0.0729], rtol=1e-9)
    levels = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_allclose(
        steady_outputs(LINEAR, levels, np.zeros(1), 0, 0), levels, rtol=1e-2, atol=1e-12
    )
    runaway = steady_outputs(replace(LINEAR, a=1.0), levels, np.zeros(1), 0, 0)
    assert np.isnan(runaway[[0, 2]]).all()
