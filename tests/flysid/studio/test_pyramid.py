"""What a pixel shows is what its samples hold, at every zoom."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.studio.pyramid import Pyramid, TimeAxis, extremes_between, hold, look


def held(tmp_path: Path, time_s: object, values: object) -> tuple[TimeAxis, Pyramid]:
    return hold([(np.asarray(time_s, dtype=float), np.asarray(values, dtype=float))], tmp_path)


@given(
    count=st.integers(1, 30_000),
    missing=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_extremes_of_any_ranges(
    tmp_path_factory: pytest.TempPathFactory, count: int, missing: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=count)
    values[rng.random(count) < missing**4] = np.nan
    _, pyramid = held(tmp_path_factory.mktemp("p"), np.arange(count), values)
    ends = np.sort(rng.integers(0, count + 1, size=(20, 2)), axis=1)
    lows, highs = extremes_between(pyramid, ends[:, 0], ends[:, 1])
    for (start, stop), low, high in zip(ends, lows, highs, strict=True):
        part = values[start:stop]
        finite = part[np.isfinite(part)]
        expected = (finite.min(), finite.max()) if len(finite) else (np.nan, np.nan)
        assert np.array_equal((low, high), expected, equal_nan=True)


@pytest.mark.parametrize("pixels", [16, 333, 1200])
@pytest.mark.parametrize("window", [(0.0, 1000.0), (400.0, 700.0), (499.5, 500.5)])
def test_a_spike_of_one_sample_is_seen(tmp_path: Path, pixels: int, window: tuple[float, float]) -> None:
    values = np.sin(np.arange(1_000_000) * 1e-3)
    values[500_000] = 50.0
    axis, pyramid = held(tmp_path, np.arange(1_000_000) * 1e-3, values)
    view = look(axis, pyramid, *window, pixels)
    assert np.nanmax(view.values) == 50.0
    assert len(view.values) <= 2 * pixels + 2
    at = view.time_s[np.nanargmax(view.values)]
    assert abs(at - 500.0) <= (window[1] - window[0]) / pixels


def test_a_pixel_holds_its_own_samples_alone(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time_s = np.cumsum(rng.uniform(0.001, 0.003, 100_000))
    values = rng.normal(size=len(time_s))
    axis, pyramid = held(tmp_path, time_s, values)
    view = look(axis, pyramid, 20.0, 150.0, 400)
    edges = np.linspace(20.0, 150.0, 401)
    for k in range(400):
        inside = values[(time_s >= edges[k]) & (time_s < edges[k + 1])]
        drawn = view.values[(view.time_s >= edges[k]) & (view.time_s < edges[k + 1])]
        assert (drawn.min(), drawn.max()) == (inside.min(), inside.max())


@pytest.mark.parametrize("pixels", [100, 20_000])
def test_pauses_break_the_line_and_slow_pixels_do_not(tmp_path: Path, pixels: int) -> None:
    time_s = np.concatenate([np.arange(0, 100, 0.01), np.arange(200, 300, 0.01)])
    axis, pyramid = held(tmp_path, time_s, np.ones(len(time_s)))
    view = look(axis, pyramid, 0.0, 300.0, pixels)
    gaps = view.time_s[np.isnan(view.values)]
    assert len(gaps)
    assert ((gaps > 99.9) & (gaps < 200.1)).all()
    drawn = view.time_s[np.isfinite(view.values)]
    assert not ((drawn > 100.0 + 3.0) & (drawn < 200.0 - 3.0)).any()


def test_missing_values_are_gaps_at_either_end_and_inside(tmp_path: Path) -> None:
    values = np.ones(10_000)
    for part in (slice(0, 1000), slice(4000, 5000), slice(9000, 10_000)):
        values[part] = np.nan
    axis, pyramid = held(tmp_path, np.arange(10_000) * 0.01, values)
    for pixels in (50, 20_000):
        view = look(axis, pyramid, 0.0, 100.0, pixels)
        missing = view.time_s[np.isnan(view.values)]
        for low, high in ((0.0, 10.0), (40.0, 50.0), (90.0, 100.0)):
            assert ((missing >= low) & (missing < high)).any()
        drawn = view.time_s[np.isfinite(view.values)]
        assert drawn.min() >= 9.9
        assert drawn.max() <= 91.9


def test_empty_and_single_samples(tmp_path: Path) -> None:
    for count in (0, 1, 2, 64, 65, 64 * 64 + 1):
        axis, pyramid = held(tmp_path, np.arange(count), np.arange(count))
        view = look(axis, pyramid, -1.0, count + 1.0, 16)
        assert np.nanmax(view.values, initial=0.0) == max(0, count - 1)
