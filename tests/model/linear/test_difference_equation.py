"""What a difference equation hands to python-control: the same answers, the same digits."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.model.arx import ARX
from tests import model_examples

control = pytest.importorskip("control")


@pytest.mark.parametrize(("n_u", "n_y"), [(1, 1), (2, 1), (2, 2)])
def test_to_control_simulates_alike(n_u: int, n_y: int) -> None:
    data = model_examples.data(n_u, n_y)
    model = ARX(na=2, nb=2, nk=(1, 0)[:n_u], offset=False, refine=False).fit(data)
    u = data.segments[0].u
    y = np.atleast_2d(control.forced_response(model.to_control(), inputs=u.T).outputs).T
    assert y == pytest.approx(model.simulate(u), abs=1e-9)


def test_to_control_keeps_every_digit() -> None:
    model = ARX(na=3, nb=2, nk=2, offset=False, refine=False).fit(model_examples.data())
    system = model.to_control()
    assert system.dt == model.dt_s
    assert np.array_equal(system.den[0][0], np.trim_zeros(model.system.a[:, 0, 0], "b"))
    assert np.array_equal(np.trim_zeros(system.num[0][0]), np.trim_zeros(model.system.b[:, 0, 0]))
