"""Intervals and tests on data whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.verdict_coverage import Case, run
from bench.verdict_few import POLE, flight_of
from flysid.dataset import FloatArray
from flysid.validate.compare.intervals import (
    Scope,
    across_flights,
    change,
    correlation_length,
    distance,
    flight_sides,
    holm,
)


def ar1(n: int, rho: float, rng: np.random.Generator) -> FloatArray:
    e = np.zeros(n)
    for k in range(1, n):
        e[k] = rho * e[k - 1] + rng.normal()
    return e


def test_correlation_length_of_an_ar1_process() -> None:
    rng = np.random.default_rng(3)
    assert correlation_length(rng.normal(size=20000)) == pytest.approx(1.0, abs=0.15)
    assert correlation_length(ar1(20000, 0.9, rng)) == pytest.approx(19.0, rel=0.25)  # (1 + rho) / (1 - rho)


def test_the_scope_is_another_flight_only_where_several_flights_are_unseen() -> None:
    rng = np.random.default_rng(0)
    ea, eb = ([rng.normal(size=300) for _ in range(4)] for _ in range(2))
    flights = ["f", "f", "g", "h"]
    assert (change(ea, eb, flights).scope, change(ea, eb, flights).units) == (Scope.LIKE, 3)
    seen = change(ea, eb, flights, seen=["g", "x"])
    assert (seen.scope, seen.units, seen.block) == (Scope.THESE, 12, 100)
    assert change(ea, eb, ["f"] * 4).scope is Scope.THIS
    assert change(ea, eb, ["f"] * 4, seen=["f"]).scope is Scope.THIS


def test_one_flight_held_out_of_several_is_not_this_flight() -> None:
    """Three flights fitted, one left out: "this flight" would be said of a log that stands alone."""
    rng = np.random.default_rng(0)
    ea, eb = ([rng.normal(size=300)] for _ in range(2))
    assert change(ea, eb, ["h"], seen=["f", "g"]).scope is Scope.HELD
    assert str(Scope.HELD) == "the held-out flight"


def test_a_typical_flight_is_the_geometric_mean_with_students_t() -> None:
    """By hand: logs of 0.8, 0.9, 1.0, 0.7, 0.85; t of 4 degrees of freedom is 2.776."""
    ratios = np.array([0.8, 0.9, 1.0, 0.7, 0.85])
    e = [np.full(40, 1.0 + i) * np.resize([1.0, -1.0], 40) for i in range(5)]
    found = change(e, [r * x for r, x in zip(ratios, e, strict=True)], list("abcde"))
    logs = np.log(ratios)
    half = 2.7764451 * logs.std(ddof=1) / np.sqrt(5)
    assert found.interval is not None
    assert found.interval.change_pct == pytest.approx(100 * np.expm1(logs.mean()))
    assert found.interval.low_pct == pytest.approx(100 * np.expm1(logs.mean() - half))
    assert found.interval.high_pct == pytest.approx(100 * np.expm1(logs.mean() + half))
    assert found.by_flight["d"] == pytest.approx(-30.0)


def test_a_flight_lies_where_its_truth_stands_between_two_predictions() -> None:
    """By hand: predictions 0.9 x and 1.1 x, truths of 1.1 x, 1 x and 0.8 x, no noise."""
    x = np.random.default_rng(2).normal(size=500)
    gains = [1.1, 1.0, 0.8]
    sides = flight_sides([(g - 0.9) * x for g in gains], [(g - 1.1) * x for g in gains], list("abc"))
    apart = 0.2**2
    for name, g, w in zip("abc", gains, (0.5, 0.0, -1.0), strict=True):
        both = (g - 0.9) ** 2 + (g - 1.1) ** 2
        assert sides[name] == pytest.approx(w * 2.0 * apart / (2.0 * apart + 0.1 * both))


def test_flights_of_one_heap_that_lie_all_over_show_no_change() -> None:
    """Five flights suit the second model by the same factor; where each truth lies says it is chance."""
    logs = [-1.5, -1.6, -1.5, -1.4, -1.5]
    shown = across_flights(logs, [0.5, 0.55, 0.45, 0.5, 0.5])
    chance = across_flights(logs, [0.1, 0.9, 0.05, 1.2, 0.1])
    opposed = across_flights(logs, [-0.5, -0.55, -0.45, -0.5, -0.5])
    assert shown.p < 0.05
    assert shown.high_pct < 0.0
    for found in (chance, opposed):
        assert found.p > 0.05
        assert found.high_pct == 0.0
        assert found.low_pct == shown.low_pct


def test_a_still_flight_does_not_hide_what_the_others_show() -> None:
    """Where both predict next to the same, noise alone says on which side the flight lies."""
    rng = np.random.default_rng(3)
    ea, eb = [], []
    for size in (1.0, 1.2, 0.9, 1.1, 1.0, 0.01):
        noise = 0.2 * rng.normal(size=800)
        x = size * rng.normal(size=800)
        ea.append(noise + x)
        eb.append(noise + rng.normal(0.0, 0.05) * x)
    found = change(ea, eb, list("abcdef")).interval
    assert found is not None
    assert found.p < 0.05


def test_models_that_predict_alike_are_the_same_from_two_flights() -> None:
    rng = np.random.default_rng(2)
    e = [rng.normal(size=500) for _ in range(2)]
    nearly = change(e, [1.01 * x for x in e], ["a", "b"]).interval
    assert nearly is not None
    assert -5.0 < nearly.low_pct <= nearly.high_pct < 5.0


def test_rotation_stretches_the_interval() -> None:
    """By hand: 1.2 times Student's t of 5 degrees of freedom."""
    logs = [-0.5, -0.3, -0.4, -0.2, -0.4, -0.45]
    rotated = across_flights(logs, [0.5, 0.4, 0.5, 0.4, 0.5, 0.5], rotated=True)
    width = np.log1p(rotated.high_pct / 100) - np.log1p(rotated.low_pct / 100)
    assert width == pytest.approx(1.2 * 2.0 * 2.5705818 * np.std(logs, ddof=1) / np.sqrt(6))


def test_models_that_ended_in_another_minimum_are_taken_off() -> None:
    """The compared model errs 0.6 times the baseline; the ones that judged two of six flights 1.2 times."""
    rng = np.random.default_rng(4)
    flights = list("abcdef")
    ea = [rng.normal(size=400) * (1.0 + 0.1 * i) for i in range(6)]
    judged_by = dict(zip(flights, (0.6, 1.2, 0.6, 0.6, 1.2, 0.6), strict=True))
    eb = [judged_by[f] * e for f, e in zip(flights, ea, strict=True)]
    compared = [0.6 * e for e in ea]
    apart = {f: distance((ea, [g * e for e in ea]), (ea, compared), flights) for f, g in judged_by.items()}
    assert apart["b"][0] == pytest.approx(np.log(2.0))
    assert apart["a"] == (0.0, 0.0)
    found = change(ea, eb, flights, apart=apart)
    assert found.rotated
    assert found.apart["b"] == pytest.approx(100.0)
    assert found.interval is not None
    assert found.interval.low_pct == pytest.approx(-40.0)
    assert found.interval.high_pct == pytest.approx(-40.0)
    plain = change(ea, eb, flights).interval
    assert plain is not None
    assert plain.high_pct >= 0.0


@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_two_equal_models_are_seldom_told_apart(count: int) -> None:
    """Log ratios in two heaps: three flights are of one heap in a quarter of the trials."""
    rng = np.random.default_rng((1, count))
    wrong = 0
    for _ in range(400):
        ea, eb = [], []
        for _ in range(count):
            u, y = flight_of(1.0 + 0.1 * rng.normal(), 2000, rng)
            run = lfilter([0.0, 1.0 - POLE], [1.0, -POLE], u[:, 0])
            ea.append(y[:, 0] - 0.9 * run)
            eb.append(y[:, 0] - 1.1 * run)
        found = change(ea, eb, [str(i) for i in range(count)]).interval
        assert found is not None
        wrong += found.p < 0.05
    assert wrong <= 0.075 * 400  # 5 %, and two standard errors


def test_one_flight_always_has_an_interval() -> None:
    rng = np.random.default_rng(1)
    found = change([ar1(300, 0.995, rng)], [0.5 * ar1(300, 0.995, rng)], ["f"])
    assert found.interval is not None
    assert found.interval.low_pct < found.interval.change_pct < found.interval.high_pct
    assert found.slow


def test_the_interval_is_the_same_whichever_model_is_the_baseline() -> None:
    rng = np.random.default_rng(6)
    ea, eb = ([rng.normal(size=300) for _ in range(3)] for _ in range(2))
    for flights in (list("abc"), ["a"] * 3):
        one = change(ea, eb, flights).interval
        other = change(eb, ea, flights).interval
        assert one is not None
        assert other is not None
        assert np.log1p(one.low_pct / 100) == pytest.approx(-np.log1p(other.high_pct / 100))


def test_equal_models_and_hopeless_data() -> None:
    rng = np.random.default_rng(1)
    e = [rng.normal(size=2000)]
    for flights in (["f"], ["f", "g"], list("abcdef")):
        same = change(e * len(flights), e * len(flights), flights).interval
        assert same is not None
        assert (same.low_pct, same.high_pct, same.p) == (0.0, 0.0, 1.0)
    assert change([np.zeros(2000)], e, ["f"]).interval is None
    assert change(e, [np.zeros(2000)], ["f"]).interval is None


@pytest.mark.parametrize("unit", [1e-200, 1e200])
def test_units_do_not_matter(unit: float) -> None:
    rng = np.random.default_rng(4)
    ea, eb = ([rng.normal(size=200) for _ in range(3)] for _ in range(2))
    one = change(ea, eb, list("abc")).interval
    other = change([unit * e for e in ea], [unit * e for e in eb], list("abc")).interval
    assert one is not None
    assert other is not None
    assert other.high_pct == pytest.approx(one.high_pct)


@pytest.mark.parametrize("flights", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", range(6))
def test_p_is_below_5_percent_where_the_interval_excludes_no_change(seed: int, flights: int) -> None:
    rng = np.random.default_rng(seed)
    ea = [ar1(400, 0.9, rng) for _ in range(flights)]
    eb = [np.exp(rng.normal(-0.3, 0.2)) * ar1(400, 0.9, rng) for _ in range(flights)]
    found = change(ea, eb, [str(i) for i in range(flights)]).interval
    assert found is not None
    assert (found.p < 0.05) == (not found.low_pct <= 0.0 <= found.high_pct)


@pytest.mark.parametrize(
    "case",
    [Case(n, luck=luck) for n in (2, 4, 6) for luck in (0.0, 0.15)]
    + [Case(3, luck=0.3), Case(8, luck=0.15, kind="drift"), Case(5, kind="regimes", luck=0.15)]
    + [Case(1, 500, 0.9), Case(1, 500, 0.98), Case(1, 500, 0.9, 0.98), Case(1, 2000, 0.9, 0.999)],
    ids=str,
)
def test_interval_covers_the_truth_about_as_often_as_it_says(case: Case) -> None:
    """200 draws: two and a half standard errors are 4 %. The bench does this at length, for more cases."""
    outcome = run(case, 200)
    assert outcome.coverage >= 91.0
    assert outcome.false <= 9.0


def test_true_advantages_are_found() -> None:
    assert run(Case(8, change_pct=-20.0), 100).better >= 90.0
    assert run(Case(4, change_pct=-50.0, luck=0.15), 100).better >= 75.0
    assert run(Case(1, 500, 0.9, 0.98, change_pct=-90.0), 100).better >= 90.0


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []
    assert holm([0.9, 0.8]) == [1.0, 1.0]
