"""Two verbs that exclude each other are named; those that meet, or differ by a little, are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.step_figures import StepFigure
from flysid.model.step_response import StepResponse, step_response
from flysid.model.transfer_function import TF
from flysid.validate.transfers.agreement import gain_caution


class _Ends:
    """A step response of which only the end is known."""

    def __init__(self, low: float, high: float) -> None:
        self.figures = (StepFigure("final value", "", 0.5 * (low + high), low, high),)


@pytest.fixture(scope="module")
def lag() -> Dataset:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.normal(size=150), 20)
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.9 * y[k - 1] + 0.2 * u[k - 1]
    return Dataset.from_arrays(u, y + 0.05 * rng.normal(size=len(u)), 0.02, inputs=["u"], outputs=["y"])


def test_what_two_verbs_say_of_one_lag_meets(lag: Dataset) -> None:
    transfer = TF(poles=1, zeros=0).fit(lag).transfer()
    assert gain_caution(transfer, step_response(lag)) == ""


@pytest.mark.parametrize(
    ("low", "high", "excluded"), [(1.9, 2.1, False), (2.05, 2.2, False), (2.6, 2.7, True)]
)
def test_exclusion_is_said_with_both_figures(low: float, high: float, excluded: bool, lag: Dataset) -> None:
    transfer = TF(poles=1, zeros=0).fit(lag).transfer()
    ends: StepResponse = _Ends(low, high)  # type: ignore[assignment]
    said = gain_caution(transfer, ends)
    assert bool(said) is excluded
    if excluded:
        assert f"a step ends at {low:g} to {high:g} ('flysid step')" in said
        assert "the steady gain above is" in said


def test_a_step_without_an_end_contradicts_nothing(lag: Dataset) -> None:
    found = step_response(lag)
    assert gain_caution(TF(poles=1, zeros=0).fit(lag).transfer(), replace(found, confirmed=False)) == ""
