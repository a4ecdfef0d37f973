"""Boots, outliers, lines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.formats.common.clock import (
    MAX_KNOTS,
    SECOND_NS,
    Extent,
    Fall,
    UtcFit,
    back_steps,
    fit_line,
    interpolate,
    is_outlier,
    leaps,
    split_points,
    wrap_points,
)

MS = 1_000_000


@given(st.lists(st.integers(0, 10**13), min_size=1, max_size=60))
@settings(deadline=None)
def test_rising_times_inside_the_record_are_never_outliers(steps: list[int]) -> None:
    times = np.cumsum(np.array(steps, dtype=np.int64))
    assert not is_outlier(times)[3:-3].any()


@pytest.mark.parametrize("at", [0, 1, 5, 50, 98, 99])
@pytest.mark.parametrize("value", [10**15, -(10**13)])
def test_a_single_absurd_time_is_found_anywhere(at: int, value: int) -> None:
    times = np.arange(100, dtype=np.int64) * 20 * MS
    times[at] = value
    assert np.flatnonzero(is_outlier(times)).tolist() == [at]


def test_a_reboot_is_no_outlier() -> None:
    times = np.concatenate([np.arange(50), np.arange(50)]) * SECOND_NS
    assert not is_outlier(times).any()
    assert back_steps(times).tolist() == [50]


def test_steps_of_one_stream_alone_do_not_split() -> None:
    four = [Extent(0, 99, 1)] * 4
    falls = [Fall(10, 12, 9), Fall(9, 15, 9), Fall(8, 13, 9), Fall(40, 41, 9)]
    assert split_points(falls[:1], four) == []
    assert split_points(falls, four) == [12]
    assert split_points([falls[0], falls[3]], four[:1]) == [12, 41]


def test_streams_that_cannot_have_seen_a_reboot_have_no_say() -> None:
    over = Extent(50, 99, 1)
    slow = Extent(0, 99, 10)
    assert split_points([Fall(10, 12, 9)], [Extent(0, 99, 1), over, over, slow, slow]) == [12]


def test_a_clock_that_begins_anew_within_a_second_is_told_from_late_messages() -> None:
    steps = np.arange(10, dtype=np.int64) * 100 * MS
    assert back_steps(np.concatenate([steps, steps])).tolist() == [10]
    late = np.array([0, 1, 2, 1, 3, 4, 3, 4, 6, 7], dtype=np.int64) * 100 * MS
    assert back_steps(late).tolist() == []
    slow = np.array([800, 100, 1100, 2100, 3100], dtype=np.int64) * MS
    assert back_steps(slow).tolist() == [1]


def test_a_leap_is_what_the_arrivals_do_not_explain() -> None:
    vehicle = np.arange(100, dtype=np.int64) * SECOND_NS
    gap = vehicle + (vehicle > 50 * SECOND_NS) * 600 * SECOND_NS
    leap = vehicle.copy()
    leap[60:] += 7200 * SECOND_NS
    assert leaps(gap, gap // 27, 10 * SECOND_NS).tolist() == []
    assert leaps(leap, vehicle // 27, 10 * SECOND_NS).tolist() == [60]


def test_a_wrap_is_told_from_an_outlier() -> None:
    period = (1 << 32) * MS
    rising = (np.arange(10, dtype=np.int64) * MS + period - 5 * MS) % period
    assert wrap_points(rising, period).tolist() == [5]
    single = np.arange(10, dtype=np.int64) * MS
    single[4] = period - MS
    assert wrap_points(single, period).tolist() == []


def test_interpolation_keeps_nanoseconds() -> None:
    knots = np.array([0, 10, 20])
    values = np.array([0, 100, 300]) + 1_700_000_000_000_000_001
    got = interpolate(np.array([-5, 0, 5, 15, 20, 25]), knots, values, slope=2.0) - values[0]
    assert got.tolist() == [-10, 0, 50, 200, 300, 310]


@pytest.mark.parametrize("slope", [0.92, 1.0, 27.1])
def test_the_fit_survives_jitter_and_a_third_of_wrong_stamps(slope: float) -> None:
    rng = np.random.default_rng(3)
    vehicle = np.arange(3000, dtype=np.int64) * 100 * MS + 5 * SECOND_NS
    utc = (vehicle / slope).astype(np.int64) + 1_700_000_000 * SECOND_NS
    late = utc + rng.exponential(0.05e9, 3000).astype(np.int64)
    late[rng.random(3000) < 0.3] += 3600 * SECOND_NS
    offset, fitted, residual = fit_line(vehicle, late)
    assert fitted == pytest.approx(1 / slope, rel=0.02)
    assert abs(offset + fitted * vehicle[1500] - utc[1500]) < 0.5e9
    assert residual < 1e9


def test_boots_are_fitted_apart() -> None:
    fit = UtcFit()
    times = np.arange(100, dtype=np.int64) * SECOND_NS
    fit.add(0, times, times + 1000 * SECOND_NS)
    fit.add(1, times, times + 5000 * SECOND_NS)
    fit.add(2, times)
    first, second, third = fit.clocks()
    assert (first.utc_offset_ns, second.utc_offset_ns, third.utc_offset_ns) == (
        1000 * SECOND_NS,
        5000 * SECOND_NS,
        None,
    )
    assert (first.first_ns, first.last_ns, first.slope) == (0, 99 * SECOND_NS, 1.0)


def test_a_fit_keeps_no_batch_alive_and_only_so_many_pairs() -> None:
    import weakref

    fit = UtcFit()
    for k in range(200):
        vehicle = np.arange(k * 50_000, (k + 1) * 50_000, dtype=np.int64) * 10**6
        fit.add(0, vehicle, vehicle + 10**18)
        alive = weakref.ref(vehicle)
        del vehicle
        assert alive() is None
    assert fit._held[0] <= MAX_KNOTS
    (clock,) = fit.clocks()
    assert (clock.utc_offset_ns, clock.slope) == (10**18, 1.0)
