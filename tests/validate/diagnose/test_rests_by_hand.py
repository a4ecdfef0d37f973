"""Measured equilibria: which stretches count, at their bounds."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.validate.diagnose.responses import measured_rests

DT = 0.1


def record(*pieces: FloatArray) -> Dataset:
    """A flight whose middle 90 % reach from 0 to 1 in both signals, and these stretches as flights."""
    wide = np.concatenate([np.zeros(500), np.ones(500)])[:, None]
    us = [wide, *(p[:, :1] for p in pieces)]
    ys = [wide, *(p[:, 1:] for p in pieces)]
    return Dataset.from_arrays(us, ys, DT)


def rests_of(piece: FloatArray) -> list[list[float]]:
    """Of one stretch, without those of the flight that gives the range."""
    found = measured_rests(record(piece), 0.9, 0, 0)
    return [row for row in found.tolist() if row not in ([0.0, 0.0], [1.0, 1.0])]


@pytest.mark.parametrize(("drift", "rests"), [(0.099, True), (0.101, False)])
def test_a_mean_may_drift_by_a_tenth_of_the_range(drift: float, rests: bool) -> None:
    """From the first third to the last, of the input or of the output."""
    thirds = np.repeat([0.4, 0.4 + 0.5 * drift, 0.4 + drift], 3)
    still = np.full(9, 0.3)
    for piece in (np.column_stack([thirds, still]), np.column_stack([still, thirds])):
        assert rests_of(piece) == ([pytest.approx(piece.mean(axis=0).tolist())] if rests else [])


@pytest.mark.parametrize(("swing", "rests"), [(0.199, True), (0.201, False)])
def test_an_input_may_swing_by_two_tenths_an_output_as_it_likes(swing: float, rests: bool) -> None:
    around = 0.5 + swing * np.array([0, 0, 0, 1, 1, 1, 0, 0, 0])
    still = np.full(9, 0.3)
    assert len(rests_of(np.column_stack([around, still]))) == rests
    assert len(rests_of(np.column_stack([still, around]))) == 1


def test_stretches_overlap_by_half_and_have_six_samples_at_least() -> None:
    level = np.linspace(0.30, 0.34, 21)
    (flight,) = [np.column_stack([level, level])]
    found = [row[0] for row in rests_of(flight)]
    assert found == pytest.approx([level[a : a + 9].mean() for a in (0, 4, 8, 12)])
    short = measured_rests(record(flight[:6]), 0.1, 0, 0)
    assert [level[:6].mean()] * 2 in [pytest.approx(row) for row in short.tolist()]
    assert not len(measured_rests(Dataset.from_arrays(level[:5], level[:5], DT), 0.1, 0, 0))
