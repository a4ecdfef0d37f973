"""Filters of flight firmwares: the sections that step them, and their responses."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.loops.stages import filters_of, response, sections

STEP_S = 1.0 / 32_000.0


def stepped(rows: FloatArray, f: FloatArray) -> FloatArray:
    """(F,) response of sections by their coefficients."""
    back = np.exp(-2j * np.pi * f * STEP_S)
    parts = [
        (b0 + b1 * back + b2 * back**2) / (1.0 + a1 * back + a2 * back**2) for b0, b1, b2, a1, a2 in rows
    ]
    return np.asarray(np.prod(parts, axis=0))


@pytest.mark.parametrize("kind", ["pt1", "pt2", "pt3", "biquad"])
def test_a_low_pass_is_at_3_db_where_it_says(kind: str) -> None:
    f = np.array([100.0])
    filters = filters_of(kind, 100.0)
    assert np.abs(response(filters, f)) == pytest.approx(np.sqrt(0.5))
    assert np.abs(stepped(sections(filters, (0.0, 0.0), STEP_S), f)) == pytest.approx(np.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize("kind", ["pt1", "pt2", "pt3", "biquad"])
def test_steps_and_response_agree_far_below_the_rate_of_samples(kind: str) -> None:
    f = np.linspace(1.0, 60.0, 50)
    filters = filters_of(kind, 90.0)
    away = stepped(sections(filters, (260.0, 160.0), STEP_S), f) / response(filters, f, (260.0, 160.0))
    assert np.abs(away - 1.0).max() < 0.05


def test_a_notch_takes_its_centre_out() -> None:
    f = np.array([260.0])
    assert np.abs(stepped(sections((), (260.0, 160.0), STEP_S), f)) == pytest.approx(0.0, abs=1e-12)
    assert np.abs(response((), f, (260.0, 160.0))) == pytest.approx(0.0, abs=1e-12)
