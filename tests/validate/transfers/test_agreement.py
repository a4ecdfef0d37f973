"""Two verbs that exclude each other are named; those that meet, or differ by a little, are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.frequency.response import measure_response
from flysid.model.step_figures import StepFigure
from flysid.model.step_response import StepResponse, step_response
from flysid.model.transfer_function import TF
from flysid.validate.transfers.agreement import gain_caution, response_caution
from tests.command import call


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


def test_a_step_and_a_measured_response_of_one_lag_meet(lag: Dataset) -> None:
    assert response_caution(measure_response(lag), 0, step_response(lag)) == ""


def test_a_step_that_a_measured_response_excludes_is_named(lag: Dataset) -> None:
    """Both verbs print it: the same shape, but twice as far."""
    found = step_response(lag)
    twice = replace(found, step=2.0 * found.step)
    said = response_caution(measure_response(lag), 0, twice)
    assert said.startswith("two figures exclude each other: at ")
    assert "('flysid tf')" in said
    assert "('flysid step')" in said


def test_a_step_knows_the_frequency_response_of_its_taps(lag: Dataset) -> None:
    omega = np.geomspace(0.5, 10.0, 20)
    for horizon_s in (2.0, 8.0):  # with and without taps further apart than samples
        g, relative = step_response(lag, horizon_s=horizon_s).frequency_response(omega, lag.dt_s)
        back = np.exp(-1j * omega * lag.dt_s)
        true = 0.2 * back / (1.0 - 0.9 * back)
        assert np.abs(g / true - 1.0).max() < 0.1
        assert (relative > 0.0).all()


def test_a_response_that_changes_with_size_is_cautioned_in_both_verbs(tmp_path: Path) -> None:
    """A saturation cuts what is slow and large, and hardly what is quick: no one response does both."""
    rng = np.random.default_rng(6)
    dt_s = 0.02
    slow = 3.0 * np.repeat(rng.normal(size=12), 500)
    quick = 0.3 * np.repeat(rng.normal(size=600), 10)
    u = slow + quick
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.9 * y[k - 1] + 0.2 * np.clip(u[k - 1], -1.0, 1.0)
    rows = np.column_stack([dt_s * np.arange(len(u)), u, y + 0.01 * rng.normal(size=len(u))])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time_s,u,y", comments="", fmt="%.9g")
    for verb in ("tf", "step"):
        done = call(verb, "log.csv", "--from", "u", "--to", "y", "-q", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "caution: two figures exclude each other: at " in done.stdout
