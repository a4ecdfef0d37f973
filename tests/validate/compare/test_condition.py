"""--fail-if: a small grammar, nothing else is evaluated."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.errors import UsageError
from flysid.validate.compare.condition import check_condition, matching_channels


def entry(change: float | None, verdict: str, rmse: float = 0.3) -> dict[str, Any]:
    return {
        "models": {"arx": {"rmse": 0.4, "fit_pct": 72.0}, "ts": {"rmse": rmse, "fit_pct": None}},
        "change_pct": change,
        "ci95": [-38.0, -24.0],
        "verdict": verdict,
        "pairs": {"ts": {"change_pct": change, "verdict": verdict, "p": None}},
    }


DOCUMENT = {
    "channels": {
        "roll": {"free_run": entry(-30.0, "better"), "10": entry(7.0, "worse"), "1": entry(0.0, "same")},
        "v z/odd": {
            "free_run": entry(None, "worse"),
            "10": entry(None, "not enough data"),
            "1": entry(1, "same"),
        },
    },
    "skipped": {"skipped": "no excitation"},
}


@pytest.mark.parametrize(
    ("expression", "channels"),
    [
        ("free_run.change_pct > 5", ("v z/odd",)),  # diverged counts as infinitely worse
        ("free_run.change_pct < -20", ("roll",)),
        ("roll.free_run.change_pct < -20", ("roll", "v z/odd")),
        ("10.change_pct > 5", ("roll", "v z/odd")),  # what cannot be judged fails
        ("1.change_pct == 0", ("roll",)),
        ("free_run.verdict == worse", ("v z/odd",)),
        ("10.verdict == 'not enough data'", ("v z/odd",)),
        ("free_run.ci95.high < 0 and not free_run.verdict == worse", ("roll",)),
        ("free_run.ts.rmse > 0.29 and free_run.models.arx.rmse >= 0.4", ("roll", "v z/odd")),
        ("(free_run.change_pct > 5 or 10.change_pct > 5) and 1.verdict == same", ("roll", "v z/odd")),
        ('"v z/odd".1.change_pct >= 1e0 and free_run.verdict != worse', ("roll",)),
        ("free_run.ts.fit_pct < 50", ("roll", "v z/odd")),  # null
        ("free_run.pairs.ts.change_pct > 1000", ("v z/odd",)),
    ],
)
def test_conditions(expression: str, channels: tuple[str, ...]) -> None:
    assert tuple(matching_channels(expression, DOCUMENT)) == channels


def test_a_guard_that_cannot_judge_fails_and_says_why() -> None:
    both = {**entry(None, "same"), "reason": "both diverged in free run: neither is usable"}
    document = {"channels": {"roll": {"free_run": both}}}
    for expression in ("free_run.change_pct > 5", "not free_run.change_pct > 5", "free_run.pairs.ts.p < 0.1"):
        (why,) = matching_channels(expression, document).values()
        assert "does not exist (both diverged in free run: neither is usable)" in why
    assert matching_channels("free_run.ts.rmse > 1", document) == {}


def test_better_without_more_words_is_said_of_another_flight() -> None:
    here = {"channels": {"roll": {"free_run": {**entry(-30.0, "better"), "scope": "this flight"}}}}
    assert matching_channels("free_run.verdict == better", here) == {}
    assert matching_channels("free_run.verdict == 'better on this flight'", here) == {"roll": ""}
    assert matching_channels('free_run.scope == "this flight"', here) == {"roll": ""}
    bad = {"channels": {"roll": {"free_run": {**entry(30.0, "worse"), "scope": "this flight"}}}}
    assert matching_channels("free_run.verdict == worse", bad) == {"roll": ""}


def test_models_of_two_runs_need_no_quotes() -> None:
    two = {**entry(-30.0, "better"), "models": {"a:ts": {"rmse": 0.4}, "b:ts": {"rmse": 0.3}}}
    document = {"channels": {"roll": {"free_run": two}}}
    both = "free_run.b:ts.rmse < 0.35 and free_run.models.a:ts.rmse > 0.35"
    assert matching_channels(both, document) == {"roll": ""}
    assert matching_channels('free_run."b:ts".rmse < 0.2', document) == {}


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("", "not understood"),
        ("free_run.change_pct", "needs a comparison"),
        ("free_run.change_pct > 5 5", "not understood"),
        ("free_run.change_pct 5 >", "not understood"),
        ("(free_run.change_pct > 5", "not understood"),
        ("free_run.chang_pct > 5", "'free_run.chang_pct' is not a field"),
        ("yaw.free_run.change_pct > 5", "'yaw.free_run.change_pct' is not a field"),
        ("roll.free_run > 5", "not a single value"),
        ("free_run.models > 5", "not a single value"),
        ("free_run.change_pct.low > 5", "not a field"),
        ("free_run.change_pct > 'a'", "compares 'free_run.change_pct', a number, with \"'a'\", a word"),
        ("worse == free_run.change_pct", "compares 'free_run.change_pct', a number, with 'worse', a word"),
        ("free_run.verdict > worse", "only be compared with =="),
        ("__import__('os').system('x') > 1", "not understood"),
        ("(" * 300 + "1 > 0" + ")" * 300, "not understood"),
        ("not " * 300 + "1 > 0", "neither is a field"),
        ("free_run.change_pct ; 5", "not understood"),
        ("free_run.verdict == wrse", "no verdict 'wrse'"),
        ("'enough' != roll.free_run.verdict", "no verdict 'enough'"),
        ("verdict == worse", "neither is a field"),
        ("1 > 2 or free_run.change_pct > 5", "neither is a field"),
        (
            "yaw.free_run.change_pct > 5 and skipped.free_run.change_pct > 5",
            "'yaw.free_run.change_pct' is not",
        ),
        ("skipped.free_run.change_pct > 5", "channel 'skipped' was skipped: no excitation"),
    ],
)
def test_what_is_not_understood_is_named(expression: str, message: str) -> None:
    with pytest.raises(UsageError, match=message.replace("(", r"\(")):
        matching_channels(expression, DOCUMENT)


@pytest.mark.parametrize(
    ("expression", "hint"),
    [
        ("free_run.chnage_pct > 5", "did you mean 'free_run.change_pct'"),
        ("free_run.p > 5", "did you mean 'free_run.pairs.ts.p'"),
        ("rol.free_run.change_pct > 5", "did you mean 'roll.free_run.change_pct'"),
        ("freerun.change_pct > 5", "did you mean 'free_run.change_pct'"),
        ("free_run.txs.rmse > 5", "did you mean 'free_run.models.ts.rmse'"),
        (
            "free_run.ts.fitpct < 5",
            "did you mean 'free_run.models.ts.fit_pct'",
        ),
        ("free_run.rmse > 5", "did you mean 'free_run.models.ts.rmse'"),
        ("verdict == worse", "did you mean 'free_run.verdict'?"),
        ("free_run.verdict == wrose", "did you mean 'worse'?"),
        ("roll.5.change_pct > 5", "did you mean 'roll.1.change_pct'"),
    ],
)
def test_what_is_near_is_named(expression: str, hint: str) -> None:
    with pytest.raises(UsageError) as caught:
        check_condition(expression, DOCUMENT)
    assert str(caught.value.hint).startswith(hint)


def test_a_condition_that_is_understood_passes_the_check_whether_it_holds_or_not() -> None:
    check_condition("free_run.change_pct > 5", DOCUMENT)
    check_condition("free_run.change_pct > 1e9", DOCUMENT)


@settings(deadline=None, max_examples=200)
@given(st.text(max_size=60))
def test_any_text_names_channels_or_is_a_usage_error(text: str) -> None:
    with contextlib.suppress(UsageError):
        assert set(matching_channels(text, DOCUMENT)) <= {"roll", "v z/odd"}
