"""The change on one flight, and the tables behind intervals, recomputed from their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from flysid.dataset import FloatArray
from flysid.validate.compare.intervals import EVENLY, Interval, Scope, across_days, across_flights, change


def slow(n: int, rho: float, seed: int) -> FloatArray:
    return np.asarray(lfilter([1.0], [1.0, -rho], np.random.default_rng(seed).normal(size=n)))


def rho_of(x: FloatArray) -> FloatArray:
    """(N,) correlations at all lags, sum by sum."""
    return np.array([x[k:] @ x[: len(x) - k] for k in range(len(x))]) / (x @ x)


def length(e: FloatArray) -> float:
    """The longer of Geyer's (1992), of the square, and of what the errors' own correlation makes of it."""
    rho = rho_of(e**2 - (e**2).mean())
    pairs = [rho[k] + rho[k + 1] for k in range(0, len(rho) - 1, 2)]
    first = next((k for k, pair in enumerate(pairs) if pair <= 0.0), len(pairs))
    own = rho_of(e)
    end = next((k for k, value in enumerate(own) if value <= 0.0), len(own))
    return max(1.0, 2.0 * float(sum(pairs[:first])) - 1.0, 2.0 * float((own[:end] ** 2).sum()) - 1.0)


@pytest.mark.parametrize(
    ("n", "rho", "blocks", "short"),
    [
        (3000, 0.3, 12, False),
        (1200, 0.85, None, False),
        (450, 0.85, 4, False),  # 41 lengths, enough for blocks alone
        (150, 0.95, 4, True),
        (60, 0.97, 4, True),
    ],
    ids=str,
)
@pytest.mark.parametrize("size", [1.05, 1.5])
def test_a_change_on_one_flight(n: int, rho: float, blocks: int | None, short: bool, size: float) -> None:
    """Student's t of blocks' log ratios, joined with an F ratio of so many lengths where these are few."""
    ea = slow(n, rho, 1)
    eb = size * (0.8 * ea + 0.6 * slow(n, rho, 2))
    found = change([ea], [eb], ["f"])
    taus = length(ea), length(eb)
    longest = max(taus)
    count = int(np.clip(n / (15.0 * longest), 4, 12))
    assert count == (blocks or count)
    assert 4 < count < 12 or blocks
    assert (found.scope, found.units, found.block) == (Scope.THIS, count, n // count)
    assert found.slow is bool(n < 10.0 * longest)
    theta = float(0.5 * np.log((eb @ eb) / (ea @ ea)))
    logs = [
        0.5 * np.log(np.mean(y**2) / np.mean(x**2))
        for x, y in zip(np.array_split(ea, count), np.array_split(eb, count), strict=True)
    ]
    error = np.std(logs, ddof=1) / np.sqrt(count)
    centres = sorted([float(np.mean(logs)), theta])
    half = stats.t(count - 1).ppf(0.975) * error
    low, high = centres[0] - half, centres[1] + half
    nearest = min(np.abs(centres)) if centres[0] * centres[1] > 0.0 else 0.0
    p = 2.0 * stats.t(count - 1).sf(nearest / error)
    assert bool(n < 25.0 * longest) is short
    if short:
        x, y = ea**2 / np.mean(ea**2), eb**2 / np.mean(eb**2)
        scale = min(1.0, np.sqrt(np.var(y - x) * longest / (np.var(x) * taus[0] + np.var(y) * taus[1])))
        ratio = stats.f(max(1.0, n / taus[1] - 2.0), max(1.0, n / taus[0] - 2.0))
        low = min(low, theta - 0.5 * scale * np.log(ratio.ppf(0.975)))
        high = max(high, theta - 0.5 * scale * np.log(ratio.ppf(0.025)))
        beyond = ratio.cdf(np.exp(2.0 * theta / scale))
        p = max(p, 2.0 * min(beyond, 1.0 - beyond))
    ends = 100.0 * np.expm1([theta, low, high])
    assert found.interval is not None
    assert [found.interval.change_pct, found.interval.low_pct, found.interval.high_pct] == pytest.approx(ends)
    assert found.interval.p == pytest.approx(min(p, 1.0))


def test_how_often_even_numbers_look_alike() -> None:
    """Of two the ratio is (x + y) / |x - y|, beyond c with 1 / (1 + c): 5 % are beyond 19."""
    assert EVENLY[2] == pytest.approx(19.0 / stats.t(1).ppf(0.975), abs=5e-4)
    assert sorted(EVENLY) == list(range(2, 13))
    rng = np.random.default_rng(0)
    for n in range(3, 13):
        x = rng.uniform(-1.0, 1.0, (100_000, n))
        t = np.abs(x.mean(axis=1)) / (x.std(axis=1, ddof=1) / np.sqrt(n))
        assert np.quantile(t, 0.95) / stats.t(n - 1).ppf(0.975) == pytest.approx(EVENLY[n], abs=0.03)


def test_few_flights_are_judged_by_both_of_their_numbers() -> None:
    """Student's t of the logarithms; the sides' p with the table's stretch, or that of rotation."""
    logs = [-0.30, -0.20, -0.26, -0.18]
    sides = [0.40, 0.20, 0.55, 0.30]
    for rotated, of_logs, of_sides in ((False, 1.0, 1.210), (True, 1.2, 1.210)):
        found = across_flights(logs, sides, rotated=rotated)
        half = stats.t(3).ppf(0.975) * of_logs * np.std(logs, ddof=1) / 2.0
        mean = float(np.mean(logs))
        p = [
            2.0 * stats.t(3).sf(abs(np.mean(v)) / (stretch * np.std(v, ddof=1) / 2.0))
            for v, stretch in ((logs, of_logs), (sides, of_sides))
        ]
        assert [found.change_pct, found.low_pct, found.high_pct] == pytest.approx(
            100.0 * np.expm1([mean, mean - half, mean + half])
        )
        assert found.p == pytest.approx(max(p))
        opposed = across_flights(logs, [-s for s in sides], rotated=rotated)
        assert (opposed.p, opposed.high_pct) == (1.0, 0.0)
        assert across_flights([-v for v in logs], sides).low_pct == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("odd", "shown"), [(0.8, True), (1.5, False)])
def test_odd_flights_that_may_outweigh_the_others_leave_no_change_shown(
    odd: float, shown: bool, side: float
) -> None:
    """Two odd of twenty may be 32 % (Clopper and Pearson): 0.68 x -0.5 + 0.32 x 0.8 is below zero."""
    logs = [side * (odd if k in (5, 12) else -0.5 + 0.01 * (-1) ** k) for k in range(20)]
    sides = [0.5 + 0.01 * (-1) ** k for k in range(20)]
    change_pct = -20.0 * side
    near = Interval(change_pct, change_pct, change_pct, 0.001)
    found = across_days(logs, sides, near)
    share = stats.beta(3, 18).ppf(0.975)
    end = found.high_pct if side > 0.0 else found.low_pct
    assert end == pytest.approx(100.0 * np.expm1(side * ((1.0 - share) * -0.5 + share * odd)), abs=1.5)
    assert (found.p < 0.05) is shown
    assert found.p == 1.0 or shown
    assert found.change_pct == near.change_pct
