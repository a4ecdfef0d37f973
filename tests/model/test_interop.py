"""python-control objects and back: the same numbers, digit by digit."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.model.interop import from_control
from tests import model_examples

control = pytest.importorskip("control")


def forced(system: object, u: FloatArray) -> FloatArray:
    return np.atleast_2d(control.forced_response(system, inputs=u.T).outputs).T


@pytest.mark.parametrize(("n_u", "n_y"), [(1, 1), (2, 1), (2, 2)])
def test_to_control_simulates_alike(n_u: int, n_y: int) -> None:
    data = model_examples.data(n_u, n_y)
    model = ARX(na=2, nb=2, nk=(1, 0)[:n_u], offset=False, refine=False).fit(data)
    u = data.segments[0].u
    y = forced(model.to_control(), u)
    assert y == pytest.approx(model.simulate(u), abs=1e-9)


def test_there_and_back_keeps_every_digit() -> None:
    model = ARX(na=3, nb=2, nk=2, offset=False, refine=False).fit(model_examples.data())
    again = from_control(model.to_control())
    assert again.dt_s == model.dt_s
    assert np.array_equal(np.trim_zeros(again.system.a[:, 0, 0], "b"), model.system.a[:, 0, 0])
    assert np.array_equal(np.trim_zeros(again.system.b[:, 0, 0], "b"), model.system.b[:, 0, 0])
    assert again.inputs[0].name == "u"


def test_a_continuous_system_is_sampled_behind_a_hold() -> None:
    plant = control.tf([0.7995], [1.0, 4.1881, 7.1429])
    u = np.repeat(np.random.default_rng(0).standard_normal(20), 5)
    model = from_control(plant, 0.02, inputs=["theta"], outputs=["v_x"])
    expected = forced(control.sample_system(plant, 0.02, "zoh"), u[:, None])
    assert model.simulate(u) == pytest.approx(expected, abs=1e-12)
    with pytest.raises(UsageError, match="no sample time"):
        from_control(plant)


def test_several_denominators_are_brought_to_one() -> None:
    fast = control.tf([1.0], [1.0, -0.5], 0.1)
    slow = control.tf([0.2, 0.1], [1.0, -0.9, 0.1], 0.1)
    both = control.tf([[fast.num[0][0], slow.num[0][0]]], [[fast.den[0][0], slow.den[0][0]]], 0.1)
    u = np.random.default_rng(1).standard_normal((50, 2))
    assert from_control(both).simulate(u) == pytest.approx(
        forced(fast, u[:, :1]) + forced(slow, u[:, 1:]), abs=1e-9
    )
