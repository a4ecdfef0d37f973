import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.align import resample
from flysid.ingest.align.resample import RecordedSignal

MS = 1_000_000


def at(times_ms: object, values: object) -> RecordedSignal:
    return RecordedSignal(
        np.round(np.asarray(times_ms) * MS).astype(np.int64), np.asarray(values, dtype=float)
    )


def test_tidy_sorts_drops_and_counts() -> None:
    t = np.array([30, 10, 20, 20, 40], dtype=np.int64)
    series = resample.tidy(t, np.array([3.0, 1.0, 2.0, 2.5, np.nan]))
    np.testing.assert_array_equal(series.t_ns, [10, 20, 30])
    np.testing.assert_array_equal(series.x, [1.0, 2.5, 3.0])
    assert (series.non_finite, series.duplicates) == (1, 1)


def test_jumps_that_no_vehicle_can_make_are_dropped_and_steps_of_a_signal_are_not() -> None:
    t = np.arange(200, dtype=np.int64) * 10 * MS
    x = np.sin(t * 1e-9 * 5.0)
    x[50] += 3.0
    x[120:122] -= 3.0
    series = resample.tidy(t, x, max_rate=20.0)
    assert series.spikes == 3
    np.testing.assert_array_equal(np.setdiff1d(t, series.t_ns) // (10 * MS), [50, 120, 121])
    step = np.where(np.arange(200) < 100, 0.0, 3.0)
    assert resample.tidy(t, step, max_rate=100.0).spikes == 0


def test_the_period_ignores_pauses_and_bursts() -> None:
    t = np.concatenate([np.arange(100), 1000 + np.arange(100)]) * 20 * MS
    assert resample.period_ns(t) == 20 * MS
    bursts = np.sort(np.concatenate([np.arange(0, 1000, 100), np.arange(0, 1000, 100) + 1])) * MS
    assert resample.period_ns(bursts) == pytest.approx(50 * MS, rel=0.1)
    assert resample.period_ns(np.array([5])) == float("inf")
    assert resample.period_ns(np.array([5, 5, 5])) == float("inf")
    assert resample.period_ns(np.array([5, 5, 5, 9])) == pytest.approx(4 / 3)  # two senders, one clock


@pytest.mark.parametrize(
    ("period", "nice"),
    [(20.02e6, 20e6), (5.052e6, 1e9 / 198), (33.3e6, 1e9 / 30), (249.9e6, 250e6), (66.6e6, 1e9 / 15)],
)
def test_sample_times_are_those_people_write(period: float, nice: float) -> None:
    assert resample.nice_period_ns(period) == round(nice)


def test_spans_end_at_gaps() -> None:
    t = np.array([0, 20, 40, 200, 220], dtype=np.int64)
    assert resample.spans_between_gaps(t, 50) == [(0, 41), (200, 221)]
    assert resample.spans_between_gaps(t, 50, after_ns=20) == [(0, 60), (200, 240)]


spans = st.lists(st.integers(0, 200), min_size=2, max_size=12, unique=True).map(
    lambda v: list(zip(sorted(v)[: len(v) // 2 * 2 : 2], sorted(v)[1::2], strict=False))
)


@settings(max_examples=100, deadline=None)
@given(spans, spans)
def test_intersection_holds_exactly_the_common_points(
    first: list[tuple[int, int]], second: list[tuple[int, int]]
) -> None:
    def inside(point: int, of: list[tuple[int, int]]) -> bool:
        return any(a <= point < b for a, b in of)

    both = resample.intersect(first, second)
    assert all(inside(p, both) == (inside(p, first) and inside(p, second)) for p in range(201))


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 50), st.integers(0, 10**9), st.integers(10, 60))
def test_equal_stamps_come_through_unchanged(period_ms: int, start_ns: int, count: int) -> None:
    t = start_ns + np.arange(count, dtype=np.int64) * period_ms * MS
    x = np.random.default_rng(1).normal(size=count)
    series = RecordedSignal(t, x)
    phase = resample.phase_ns(t, period_ms * MS)
    grid = resample.grid_in((int(t[0]), int(t[-1]) + 1), period_ms * MS, phase)
    np.testing.assert_array_equal(grid, t)
    np.testing.assert_array_equal(resample.linear(series, grid), x)
    np.testing.assert_array_equal(resample.hold(series, grid, resample.hold_tolerance_ns(series, grid)), x)


def test_jitter_does_not_smear_commands_stamped_with_the_output() -> None:
    rng = np.random.default_rng(3)
    grid = np.arange(200, dtype=np.int64) * 20 * MS
    command = RecordedSignal(grid + rng.integers(-MS, MS, size=200), np.arange(200.0))
    held = resample.hold(command, grid, resample.hold_tolerance_ns(command, grid))
    np.testing.assert_array_equal(held, np.arange(200.0))


def test_hold_keeps_the_last_command_and_knows_nothing_before_the_first() -> None:
    series = at([10, 50], [1.0, 2.0])
    held = resample.hold(series, np.array([0, 10, 49, 50, 90]) * MS)
    np.testing.assert_array_equal(held, [np.nan, 1.0, 1.0, 2.0, 2.0])


@pytest.mark.parametrize("ratio", [2, 5, 16])
def test_the_low_pass_keeps_slow_and_removes_fast_parts(ratio: int) -> None:
    n = np.arange(400 * ratio) / ratio  # in grid samples
    slow = np.sin(2 * np.pi * 0.1 * n)
    fast = np.sin(2 * np.pi * 0.8 * n)
    kept = resample.decimate(slow, ratio)
    inner = slow[5 * ratio : -5 * ratio : ratio][: len(kept)]
    np.testing.assert_allclose(kept, inner, atol=5e-3)
    if ratio > 2:
        assert np.abs(resample.decimate(fast, ratio)).max() < 5e-3
    assert (
        len(kept) == len(slow[::ratio]) - 10 + (1 if (len(slow) - 1) % ratio == 0 else 0) or len(kept) > 380
    )


def test_a_constant_passes_the_low_pass_exactly_and_short_pieces_give_nothing() -> None:
    np.testing.assert_allclose(resample.decimate(np.full(300, 2.5), 4), 2.5, rtol=1e-12)
    assert len(resample.decimate(np.ones(40), 4)) == 0
