"""Thresholds keep their promise on flights that they have not seen, and faults are found."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

from flysid.dataset import Segment
from flysid.errors import DataError
from flysid.validate.diagnose.detect import Sums, block_maxima, calibrate, levels, threshold
from tests.fakes import FirstOrder

MODEL = FirstOrder()


def flown(
    seed: int, seconds: float, *, noise: float = 0.05, drift: float = 0.0, offset: float = 0.0
) -> Segment:
    """A flight of the model's plant; `drift` adds slow, coloured disturbances, `offset` a fault for good."""
    rng = np.random.default_rng(seed)
    n = round(seconds / MODEL.dt_s)
    u = np.repeat(rng.standard_normal((n // 20 + 1, 1)), 20, axis=0)[:n]
    slow = 0.0
    y = [0.0]
    chance = rng.standard_normal((n - 1, 2)).tolist()
    for driven, (gust, error) in zip((MODEL.b * u[:-1, 0]).tolist(), chance, strict=True):
        slow = 0.98 * slow + drift * gust
        y.append(MODEL.a * y[-1] + driven + noise * error + slow + offset)
    return Segment(u, np.array(y)[:, None])


def alarms(segment: Segment, limits: object) -> int:
    """How often a statistic rises above its threshold."""
    return sum(int((np.diff(over.astype(int)) == 1).sum()) for over in judged(segment, limits))


def judged(segment: Segment, limits: object) -> list[npt.NDArray[np.bool_]]:
    from flysid.validate.diagnose.detect import Thresholds, one_step

    assert isinstance(limits, Thresholds)
    errors = one_step(MODEL, segment.u, segment.y)[1:, 0] / limits.sigma
    found, _ = Sums(limits.drift, 400).feed(errors)
    level = np.abs(levels(MODEL, segment.u, segment.y).level[:, 0])
    return [np.abs(found[:, 0]) > limits.cusum, found[:, 1] > limits.glr, level > limits.level]


@pytest.mark.parametrize("drift", [0.0, 0.002])
def test_false_alarms_are_those_that_were_asked_for(drift: float) -> None:
    asked = 6.0  # an hour, for each of three detectors
    limits = calibrate(MODEL, [flown(k, 300, drift=drift) for k in range(6)], asked)[0]
    hours = 0.5
    count = sum(alarms(flown(100 + k, 300, drift=drift), limits) for k in range(6))
    assert count <= stats.poisson.ppf(0.999, 3 * asked * hours)


def test_a_step_is_found_by_all_three() -> None:
    limits = calibrate(MODEL, [flown(k, 300) for k in range(4)], 0.1)[0]
    before = flown(50, 60)
    after = flown(51, 60, offset=0.15)
    y = after.y + before.y[-1]
    joined = Segment(np.concatenate([before.u, after.u]), np.concatenate([before.y, y]))
    found = judged(joined, limits)
    assert not any(over[: len(before) - 1].any() for over in found[:2])
    first = [int(np.argmax(over)) for over in found]
    assert len(before) <= first[0] < len(before) + 60
    assert len(before) <= first[1] < len(before) + 60
    assert found[2].any()


def test_pieces_give_what_the_whole_gives() -> None:
    errors = np.random.default_rng(3).standard_normal(1000)
    whole = Sums(0.5, 100).feed(errors)
    parts = Sums(0.5, 100)
    pieces = [parts.feed(errors[a : a + 7]) for a in range(0, 1000, 7)]
    np.testing.assert_allclose(np.concatenate([p[0] for p in pieces]), whole[0], atol=1e-9)
    assert np.array_equal(np.concatenate([p[1] for p in pieces]), whole[1])


def test_the_cusum_is_the_textbooks() -> None:
    errors = np.random.default_rng(4).standard_normal(300) + np.repeat([0.0, 1.0, -1.0], 100)
    up = down = 0.0
    expected = []
    for e in errors:
        up = max(0.0, up + e - 0.5)
        down = max(0.0, down - e - 0.5)
        expected.append(up if up >= down else -down)
    np.testing.assert_allclose(Sums(0.5, 50).feed(errors)[0][:, 0], expected)


def test_the_glr_is_the_largest_of_its_windows() -> None:
    errors = np.random.default_rng(5).standard_normal(200)
    got = Sums(0.5, 65).feed(errors)[0][:, 1]
    for k in (0, 1, 5, 63, 64, 199):
        windows = [w for w in (1, 2, 4, 8, 16, 32, 64) if w <= k + 1]
        expected = max(errors[k + 1 - w : k + 1].sum() ** 2 / (2 * w) for w in windows)
        assert got[k] == pytest.approx(expected)


def test_a_threshold_of_an_exponential_tail() -> None:
    truth = 10.0 + 2.0 * np.log(60.0 / 0.1)  # 60 blocks an hour, one excess in ten hours
    rng = np.random.default_rng(6)
    found = [threshold((rng.exponential(2.0, (400, 1)) + 10.0).tolist(), 60.0, 0.1) for _ in range(200)]
    assert 0.9 < np.mean(np.array(found) > truth) < 1.0  # the upper end of the scale's interval


def test_blocks_of_few_flights_tell_less() -> None:
    tops = np.random.default_rng(7).exponential(2.0, 120)
    few, many = (threshold(tops.reshape(n, -1).tolist(), 60.0, 0.1) for n in (4, 120))
    assert few > 1.3 * many


def test_equal_blocks_have_their_value_as_threshold() -> None:
    assert threshold([[1.0] * 30], 60.0, 0.1) == 1.0
    assert block_maxima(np.arange(10.0), 4) == [3.0, 7.0]


def test_too_little_flight_is_refused() -> None:
    with pytest.raises(DataError, match="too little"):
        calibrate(MODEL, [flown(1, 100)], 0.1)
    with pytest.raises(DataError, match="too little"):
        calibrate(MODEL, [], 0.1)
