"""Time as damaged logs have it: order is kept or the segment cut, counts are exact, nothing crosses a gap.

Row 18 of the reliability catalogue: 400 cases. Steps back of 1 us to 1 h, repeated stamps, a reboot, a 32-bit
wrap, drift and jumps of a clock, gaps of 0.1 to 60 s.
"""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.flight import Flight
from flysid.ingest.align.align import Aligned, align
from tests.ingest.align.test_align import MS, flight_of, recipe, table

IntArray = npt.NDArray[np.int64]
# 30 s at 50 Hz
N = 1500
PERIOD = 20 * MS
T = np.arange(N, dtype=np.int64) * PERIOD + 5_000_000_000
RECIPE = recipe(rate_hz=50.0)
BRIDGED = 2.5 * PERIOD  # a pause up to here is one lost sample


def truth(t_ns: IntArray) -> npt.NDArray[np.float64]:
    """What is flown: a function of time that no two samples share."""
    s = t_ns * 1e-9
    return np.asarray(np.sin(1.7 * s) + 0.3 * np.sin(9.1 * s) + 0.01 * s)


def log(t_ns: IntArray, y: npt.NDArray[np.float64], boot: object = 0) -> Flight:
    command = table(T, u=np.repeat(np.random.default_rng(0).normal(size=N // 25), 25))
    return flight_of(CMD=command, STATE=table(t_ns, boot=boot, y=y))


def aligned(t_ns: IntArray, y: npt.NDArray[np.float64]) -> Aligned:
    return align([log(t_ns, y)], RECIPE, "c")


def check(data: Dataset, stamps: IntArray) -> None:
    """Every sample lies on the truth and between two stamps that are no gap apart; segments keep order."""
    known = np.unique(stamps)
    for segment in data.segments:
        at = segment.t0_ns + np.arange(len(segment), dtype=np.int64) * PERIOD
        after = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
        assert at[0] >= known[0]
        assert at[-1] <= known[-1]
        assert (np.where(np.isin(at, known), 0, known[after] - known[after - 1]) <= BRIDGED).all()
        np.testing.assert_allclose(segment.y[:, 0], truth(at), atol=0.02)
    ends = [(s.t0_ns, s.t0_ns + (len(s) - 1) * PERIOD) for s in data.segments]
    assert all(a[1] < b[0] for a, b in pairwise(ends))


@pytest.mark.parametrize("gap_s", np.geomspace(0.1, 20.0, 5))
def test_gaps_cut_wherever_they_lie(gap_s: float) -> None:
    for seed in range(20):
        start = int(np.random.default_rng(seed).integers(100, N - 200))
        keep = (np.arange(N) < start) | (T[start] + round(gap_s * 1e9) <= T)
        found = aligned(T[keep], truth(T[keep]))
        check(found.dataset, T[keep])
        lengths = [start, int(keep.sum()) - start]
        assert [len(s) for s in found.dataset.segments] == [n for n in lengths if n >= 20]
        assert found.report.flights[0].gaps == (1 if lengths[1] else 0)


def test_a_gap_of_a_minute() -> None:
    t = np.concatenate([T, T + 60_000_000_000 + N * PERIOD])
    command = table(t, u=np.repeat(np.random.default_rng(0).normal(size=2 * N // 25), 25))
    found = align([flight_of(CMD=command, STATE=table(t, y=truth(t)))], RECIPE, "c")
    check(found.dataset, t)
    assert [len(s) for s in found.dataset.segments] == [N, N]


@pytest.mark.parametrize(
    "back_ns", [1_000, 1 * MS, 50 * MS, 1_000_000_000, 60_000_000_000, 3_600_000_000_000]
)
def test_single_stamps_that_step_back_harm_nothing_else(back_ns: int) -> None:
    """What alignment gets is ordered by time; a stamp far off its place stands alone and is no segment."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = T.copy()
        bad = rng.choice(np.arange(50, N - 50), size=3, replace=False)
        t[bad] -= back_ns
        y = truth(T)
        y[bad] = truth(t[bad])  # sampled when its stamp says: only the order is wrong
        found = aligned(t, y)
        check(found.dataset, t)
        assert len(found.dataset) >= N - 60


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_repeated_stamps_are_counted_exactly_and_the_last_value_holds(share: float) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        twice = np.flatnonzero(rng.random(N) < share)
        t = np.concatenate([T[twice], T])
        y = np.concatenate([np.full(len(twice), 99.0), truth(T)])
        order = np.argsort(t, kind="stable")
        found = aligned(t[order], y[order])
        np.testing.assert_array_equal(np.concatenate([s.y[:, 0] for s in found.dataset.segments]), truth(T))
        assert found.report.flights[0].signals[1].duplicates == len(twice)


def test_a_shuffled_stream_comes_back_in_order() -> None:
    for seed in range(20):
        order = np.random.default_rng(seed).permutation(N)
        found = aligned(T[order], truth(T)[order])
        np.testing.assert_array_equal(found.dataset.segments[0].y[:, 0], truth(T))


def test_a_reboot_in_the_file_is_never_crossed() -> None:
    """The clock starts again: both boots hold the same times, apart in two flights."""
    for seed in range(20):
        at = int(np.random.default_rng(seed).integers(100, N - 100))
        boot = (np.arange(N) >= at).astype(int)
        t = np.where(boot == 1, T - T[at] + T[0], T)
        command = table(t, boot=boot, u=np.repeat(np.random.default_rng(0).normal(size=N // 25), 25))
        data = align([flight_of(CMD=command, STATE=table(t, boot=boot, y=truth(t)))], RECIPE, "c").dataset
        assert [(s.flight, len(s)) for s in data.segments] == [("f.tlog#0", at), ("f.tlog#1", N - at)]
        for segment in data.segments:
            check(data.with_segments([segment]), t)


@pytest.mark.parametrize("drift_ppm", [-500.0, -50.0, 50.0, 500.0])
def test_a_clock_that_drifts_costs_no_sample(drift_ppm: float) -> None:
    for seed in range(10):
        jitter = np.random.default_rng(seed).integers(-MS, MS, size=N)
        t = T + np.round((T - T[0]) * drift_ppm * 1e-6).astype(np.int64) + jitter
        found = aligned(t, truth(t))
        check(found.dataset, t)
        assert len(found.dataset.segments) == 1
        assert len(found.dataset) >= N - 3


@pytest.mark.parametrize("jump_s", [-10.0, -0.5, 0.5, 10.0])
def test_a_clock_that_jumps_is_a_gap_or_ends_the_flight(jump_s: float) -> None:
    """As a GPS clock does at its fix. Forwards: a pause. Backwards: two times are told twice, one is kept."""
    for seed in range(10):
        at = int(np.random.default_rng(seed).integers(600, N - 600))
        t = T + np.where(np.arange(N) >= at, round(jump_s * 1e9), 0)
        try:
            found = aligned(t, truth(t))
        except DataError:
            continue
        check(found.dataset, t)
        assert found.report.flights[0].signals[1].duplicates == N - len(np.unique(t))


@pytest.mark.parametrize("bits", [32])
def test_a_counter_of_microseconds_that_wraps_is_unrolled_by_the_reader(bits: int) -> None:
    from flysid.ingest.formats.common.clock import wrap_points

    period = (1 << bits) * 1000
    for seed in range(20):
        start = period - int(np.random.default_rng(seed).integers(1, N)) * PERIOD
        counter = (start + np.arange(N, dtype=np.int64) * PERIOD) % period
        points = wrap_points(counter, period)
        unrolled = counter + period * np.searchsorted(points, np.arange(N), side="right")
        assert (np.diff(unrolled) == PERIOD).all()
