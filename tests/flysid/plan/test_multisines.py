"""Multisines: nothing shared between axes, low peaks, quiet ends."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.plan.flightplan import CommandedAxis, make_plan
from flysid.plan.multisines import (
    _norm_and_slope,
    largest_correlation,
    low_peak_phases,
    relative_peak_factor,
    sum_of_lines,
)

AXES = tuple(CommandedAxis(name, peak) for name, peak in (("roll", 0.1), ("pitch", 0.2), ("yaw", 0.3)))


@pytest.mark.parametrize(("band", "seconds"), [((0.3, 12.0), 60.0), ((0.1, 4.0), 30.0)])
def test_axes_share_no_line_do_not_correlate_and_have_low_peaks(
    band: tuple[float, float], seconds: float
) -> None:
    plan = make_plan("multisine", AXES, band, seconds, 5 * band[1])
    every = np.concatenate(plan.lines)
    assert len(set(every)) == len(every)
    assert every.min() / seconds >= band[0] - 1e-9
    assert every.max() / seconds <= band[1] + 1e-9
    assert plan.correlation < 1e-3
    assert max(plan.peak_factors) <= 1.12
    np.testing.assert_allclose(np.abs(plan.u).max(axis=0), [a.peak for a in AXES])


def test_every_axis_has_its_own_lines_alone() -> None:
    plan = make_plan("multisine", AXES, (0.2, 3.0), 20.0, 20.0)
    spectra = np.abs(np.fft.rfft(plan.u, axis=0))
    for j, own in enumerate(plan.lines):
        others = np.delete(spectra[:, j], own)
        assert others.max() < 1e-9 * spectra[own, j].min()


def test_a_period_begins_and_ends_near_zero() -> None:
    lines = np.arange(4, 60, 2)
    x = sum_of_lines(lines, low_peak_phases(lines), 8192)
    assert abs(x[0]) < 0.01 * np.abs(x).max()
    assert abs(x[-1]) < 0.05 * np.abs(x).max()


def test_the_slope_of_the_norm_is_that_of_differences() -> None:
    lines = np.array([3, 5, 8, 9])
    phases = np.array([0.1, 2.0, 3.0, 5.0])
    _, slope = _norm_and_slope(phases, lines, 256, 8)
    step = 1e-6
    for k in range(4):
        moved = phases + step * np.eye(4)[k]
        back = phases - step * np.eye(4)[k]
        there = _norm_and_slope(moved, lines, 256, 8)[0] - _norm_and_slope(back, lines, 256, 8)[0]
        assert slope[k] == pytest.approx(there / (2 * step), abs=1e-7)


def test_a_sine_has_a_relative_peak_factor_of_one() -> None:
    assert relative_peak_factor(np.sin(np.linspace(0, 2 * np.pi, 1000, endpoint=False))) == pytest.approx(
        1.0, abs=1e-4
    )
    assert largest_correlation(np.ones((5, 1))) == 0.0
