"""A gain is called changed in flight only where that is shown, not where it drifts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import FloatArray
from flysid.loops.term_check import show_change


def told(gain: FloatArray, rng: np.random.Generator) -> str:
    """What is told of a term whose gain moved like that over a minute."""
    time_s = np.arange(len(gain)) / 100.0
    rebuilt = lfilter([1.0], [1.0, -0.95], rng.normal(size=len(gain)))
    recorded = gain * rebuilt + 0.02 * rng.normal(size=len(gain))
    left = recorded - rebuilt * (recorded @ rebuilt / (rebuilt @ rebuilt))
    return show_change(time_s, recorded, rebuilt, float(np.sqrt(left @ left / (recorded @ recorded))))


@pytest.mark.parametrize("seed", range(3))
def test_a_switch_is_named_and_a_battery_that_empties_is_not(seed: int) -> None:
    """Of 150 gains that sank by a fifth to three fifths, 36 were called changed in flight."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 6000)
    loss = rng.uniform(0.3, 0.6)
    switched = np.where(share > rng.uniform(0.2, 0.8), 1.0 - loss, 1.0)
    assert "gains were changed in flight" in told(switched, rng)
    drifts = told(1.0 - loss * share, rng)
    assert "changed" not in drifts
    assert drifts.startswith("recorded over rebuilt drifts from")
