"""Intervals and trusted bands of responses that are written down: by hand and by table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.frequency.response import MeasuredResponse
from tests.fakes import flat_response


def measured(coherence: FloatArray, averages: float = 60.0) -> MeasuredResponse:
    """Two inputs, F points an octave apart; the first input coheres as told, the second nowhere."""
    count = len(coherence)
    return replace(
        flat_response(count),
        coherence=np.column_stack([coherence, np.zeros(count)]),
        error=np.full((count, 2), 0.1) * [1.0, 2.0],
        averages=np.full((count, 2), averages),
        freedom=np.full(count, 10.0),
    )


def test_intervals_are_student_s_and_phases_hold_the_stamps() -> None:
    """Quantiles of the tables: t with 10 degrees of freedom 2.228 and 1.812, normal 1.960 and 1.645."""
    found = replace(measured(np.ones(3)), late_s=0.05)
    assert found.half_width() == pytest.approx(np.outer(np.ones(3), [0.2228, 0.4456]), rel=1e-3)
    assert found.half_width(0.9) == pytest.approx(np.outer(np.ones(3), [0.1812, 0.3625]), rel=1e-3)
    late = 0.05 * np.array([1.0, 2.0, 4.0])
    for level, t, z in ((0.95, 2.228, 1.960), (0.9, 1.812, 1.645)):
        expected = np.hypot(np.outer(np.ones(3), [0.1 * t, 0.2 * t]), (z * late)[:, None])
        assert found.phase_half_width(level) == pytest.approx(expected, rel=1e-3)


def test_gain_and_phase_are_decibels_and_degrees_without_jumps() -> None:
    turned = np.exp(-1j * np.radians([10.0, 120.0, 200.0, 350.0]))
    found = replace(measured(np.ones(4)), response=np.column_stack([turned, 10.0 * turned**-1]))
    assert found.gain_db == pytest.approx(np.outer(np.ones(4), [0.0, 20.0]))
    assert found.phase_deg[:, 0] == pytest.approx([-10.0, -120.0, -200.0, -350.0])
    assert found.phase_deg[:, 1] == pytest.approx([10.0, 120.0, 200.0, 350.0])


@pytest.mark.parametrize(
    ("coherence", "averages", "band"),
    [
        ([0.61] * 5, 60.0, (1.0, 16.0)),
        ([0.59] * 5, 60.0, None),
        ([0.9, 0.9, 0.9, 0.1, 0.1, 0.9, 0.9, 0.9, 0.9], 60.0, (32.0, 256.0)),  # the widest run
        ([0.9, 0.9, 0.9, 0.9, 0.1, 0.1, 0.9, 0.9, 0.9], 60.0, (1.0, 8.0)),
        ([0.1, 0.1, 0.9, 0.9, 0.9, 0.1, 0.1], 60.0, (4.0, 16.0)),  # no edge on a neighbour's word
        ([0.9, 0.9, 0.3, 0.9, 0.9], 60.0, (1.0, 16.0)),  # one point alone may be chance
        ([0.1, 0.1, 0.9, 0.1, 0.1], 60.0, None),
        ([0.57, 0.97, 0.57, 0.57, 0.57], 60.0, (2.0, 2.0)),
        ([0.78] * 5, 3.0, (1.0, 16.0)),  # chance alone: 1 - 0.05^(1 / 2) = 0.776
        ([0.77] * 5, 3.0, None),
        ([0.99] * 5, 1.0, None),
    ],
    ids=str,
)
def test_a_band_is_where_the_coherence_counts(
    coherence: list[float], averages: float, band: tuple[float, float] | None
) -> None:
    found = measured(np.array(coherence), averages)
    assert found.band() == band
    assert found.band(1) is None
    inside = np.zeros(len(coherence)) if band is None else (found.omega >= band[0]) & (found.omega <= band[1])
    assert found.trusted().tolist() == inside.astype(float).tolist()


def test_a_band_among_some_points_alone() -> None:
    found = measured(np.full(7, 0.9))
    among = np.array([True, True, False, True, True, True, False])
    assert found.band(0, among) == (8.0, 32.0)
    assert found.trusted(0, among).tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0]
