"""Intervals and tests on data whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from bench.verdict_coverage import CASES, Case, run
from flysid.dataset import FloatArray
from flysid.validate.bootstrap import (
    Units,
    block_length,
    change_interval,
    correlation_length,
    diebold_mariano,
    holm,
    make_units,
    seen_by_blocks,
)


def ar1(n: int, rho: float, rng: np.random.Generator) -> FloatArray:
    e = np.zeros(n)
    for k in range(1, n):
        e[k] = rho * e[k - 1] + rng.normal()
    return e


def test_correlation_length_of_an_ar1_process() -> None:
    rng = np.random.default_rng(3)
    white = correlation_length([rng.normal(size=20000)])
    assert white == pytest.approx(1.0, abs=0.15)
    red = correlation_length([ar1(10000, 0.9, rng), ar1(10000, 0.9, rng)])
    assert red == pytest.approx(19.0, rel=0.25)  # (1 + rho) / (1 - rho)


def test_five_flights_are_units_and_four_are_not() -> None:
    rng = np.random.default_rng(0)
    errors = [rng.normal(size=300) for _ in range(10)]
    five = make_units(errors, errors, [f"f{i % 5}" for i in range(10)])
    assert (five.kind, len(five.a), five.length) == ("flights", 5, 0)
    four = make_units(errors, errors, [f"f{i % 4}" for i in range(10)])
    assert four.kind == "blocks"
    assert len(four.a) > 8


def test_blocks_hold_all_errors_once() -> None:
    rng = np.random.default_rng(0)
    ea, eb = [rng.normal(size=n) for n in (101, 57, 999)], [rng.normal(size=n) for n in (101, 57, 999)]
    units = make_units(ea, eb, ["one"] * 3)
    ratio = sum(float((e**2).sum()) for e in eb) / sum(float((e**2).sum()) for e in ea)
    assert units.b.sum() / units.a.sum() == pytest.approx(ratio)
    assert block_length(ea, eb) == units.length


def test_interval_holds_the_change_and_is_reproducible() -> None:
    rng = np.random.default_rng(1)
    ea = [ar1(2000, 0.7, rng)]
    eb = [0.8 * ea[0] + 0.1 * rng.normal(size=2000)]
    units = make_units(ea, eb, ["f"])
    one, two = change_interval(units, seed=4), change_interval(units, seed=4)
    assert one is not None
    assert one == two
    assert one.low_pct < one.change_pct < one.high_pct < 0.0
    assert one.p < 0.01
    assert change_interval(units, seed=5) != one


def test_equal_models_and_hopeless_data() -> None:
    rng = np.random.default_rng(1)
    e = [rng.normal(size=2000)]
    same = change_interval(make_units(e, e, ["f"]))
    assert same is not None
    assert (same.low_pct, same.high_pct, same.p) == (0.0, 0.0, 1.0)
    assert change_interval(Units(np.ones(4), np.ones(4), "blocks", 9)) is None
    assert change_interval(Units(np.zeros(9), np.ones(9), "blocks", 9)) is None


def test_share_of_the_variance_that_blocks_show() -> None:
    """Against the variance of block sums of an AR(1) process, by its autocovariance."""
    phi, length = 0.9, 40
    k = np.arange(1, length)
    exact = 1.0 + 2.0 * float(np.sum((1.0 - k / length) * phi**k))
    tau = (1.0 + phi) / (1.0 - phi)
    assert seen_by_blocks(tau, length) == pytest.approx(exact / tau, rel=1e-9)
    assert seen_by_blocks(1.0, 50) == 1.0
    assert seen_by_blocks(1e6, 2) == 0.3


@pytest.mark.parametrize("seed", range(12))
def test_p_is_below_5_percent_where_the_interval_excludes_no_change(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.gamma(2.0, size=9)
    interval = change_interval(Units(a, a * np.exp(rng.normal(-0.2, 0.3, size=9)), "flights", 0))
    assert interval is not None
    assert (interval.p < 0.05) == (not interval.low_pct <= 0.0 <= interval.high_pct)


def test_the_interval_reaches_beyond_the_worst_of_five_flights() -> None:
    """Five flights cannot show how bad a sixth may be; a percentile interval would end at the worst."""
    interval = change_interval(Units(np.ones(5), np.array([0.9, 1.0, 1.1, 1.2, 1.3]), "flights", 0))
    assert interval is not None
    assert interval.low_pct < 0.0 < interval.high_pct
    assert interval.high_pct > 100.0 * (np.sqrt(1.2) - 1.0)


@pytest.mark.parametrize("case", [CASES[0], CASES[4], CASES[5], CASES[6]], ids=lambda c: c.name)
def test_interval_covers_the_truth_about_as_often_as_it_says(case: Case) -> None:
    """120 draws: two and a half standard errors are 5 %. The bench does this at length, for more cases."""
    outcome = run(case, 120)
    assert 90.0 <= outcome.coverage <= 100.0
    assert outcome.better <= 5.0


def test_a_true_advantage_of_a_fifth_is_found() -> None:
    outcome = run(CASES[9], 60)
    assert outcome.better >= 80.0
    assert outcome.coverage >= 86.0


@pytest.mark.parametrize("case", [c for c in CASES if c.rare and c.flights <= 8], ids=lambda c: c.name)
def test_the_end_away_from_no_change_allows_for_flights_not_seen(case: Case) -> None:
    """Advantages that few flights show: Student's t alone leaves 8 and 9 % of the truths beyond that end."""
    outcome = run(case, 400, seed=7)
    assert outcome.truth_below <= 6.5
    assert outcome.coverage >= 92.0


def test_diebold_mariano_minds_correlation() -> None:
    """A naive test on correlated errors cries wolf; with enough lags it does not."""
    rng = np.random.default_rng(11)
    naive = hac = 0
    for _ in range(60):
        ea, eb = ar1(600, 0.95, rng), ar1(600, 0.95, rng)
        p0, p1 = diebold_mariano([ea], [eb], 0), diebold_mariano([ea], [eb], 80)
        assert p0 is not None
        assert p1 is not None
        naive += p0 < 0.05
        hac += p1 < 0.05
    assert naive > 20
    assert hac < 15
    assert diebold_mariano([ea], [ea], 5) is None


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []
    assert holm([0.9, 0.8]) == [1.0, 1.0]
