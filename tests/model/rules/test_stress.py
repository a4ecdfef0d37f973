"""Stress inputs, and what models must stand before they are offered."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import FloatArray
from flysid.model.rules.boundedness import probe_run

STEPS = 1000


def runs(samples: int, n_u: int = 1) -> tuple[FloatArray, ...]:
    """A slow lag under inputs like noise."""
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (samples, n_u))
    return (np.column_stack([lfilter([0.0, 0.02], [1.0, -0.98], u[:, 0]), u]),)


@pytest.mark.parametrize("samples", [3, 40, 600])
@pytest.mark.parametrize("steps", [2, 7, 200])
def test_every_row_is_an_input_in_the_training_range(samples: int, steps: int) -> None:
    known = runs(samples, 2)
    W = probe_run(known, 1, steps, 3)
    assert W.shape == (2 * steps, 3)
    assert (W[:, 0] == 0.0).all()
    assert (W[:, 1:] >= known[0][:, 1:].min(axis=0)).all()
    assert (W[:, 1:] <= known[0][:, 1:].max(axis=0)).all()
    np.testing.assert_array_equal(W, probe_run(known, 1, steps, 3))
