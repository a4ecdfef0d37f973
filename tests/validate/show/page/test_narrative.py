"""The first screen in sentences: which model, by how much, how sure, on what data."""

from __future__ import annotations

from dataclasses import replace

from flysid.showing import number
from flysid.validate.compare_models import compare
from flysid.validate.show.page import ReportContext, narrative, render
from tests.fakes import flown
from tests.validate.show.page.test_report import ARX, TS, Page, compared


def test_the_first_screen_of_one_model_says_its_error_and_no_interval() -> None:
    c = compare([ARX], flown(TS, [300] * 2, noise=0.02))
    page = Page(render(ReportContext.of({"roll": c}))).words
    rmse = number(c.entry().models["arx"].scores.rmse)
    assert f"One model, nothing to compare it with. RMSE in free run: roll {rmse} m/s (fit " in page
    assert "intervals come from blocks" not in page


def test_models_that_a_constant_equals_are_not_called_better() -> None:
    test = flown(TS, [300] * 6, noise=0.02)
    train = flown(TS, [300], noise=0.02, seed=5)
    away = replace(ARX, c=0.9)
    far = replace(TS, c=0.5)
    lost = compare([away, far], test, train=train)
    assert lost.verdict["y"].verdict == "better"
    page = Page(render(ReportContext.of({"roll": lost}))).words
    assert "Neither the fuzzy model nor the linear model is better than a constant on roll." in page
    assert "A constant does as well in free run as either model" in page
    assert "smaller on roll" not in page
    both = {"roll": lost, "yaw": compare([ARX, TS], test, train=train)}
    page = Page(render(ReportContext.of(both))).words
    assert "On roll a constant does as well in free run as either model: see the cautions." in page
    assert "smaller on yaw" in page
    assert "The fuzzy model is better on another flight like these on 1 of 2 channels." in page
    assert narrative.as_good_as_constant({"": both["yaw"]}) == []


def test_units_of_all_channels_are_told() -> None:
    (pair,) = compared().verdict.values()
    blocks = [
        replace(pair, basis=replace(pair.basis, units=n), unit=f"blocks of {s} s")
        for n, s in ((4, 8.5), (12, 5.9))
    ]
    for pairs, words in (
        ([pair], "6 flights"),
        (blocks[:1], "4 blocks of 8.5 s"),
        (blocks, "4 to 12 blocks of time"),
        ([pair, pair, *blocks], "6 flights or 4 to 12 blocks of time"),
    ):
        assert narrative._units([("x", p) for p in pairs]) == words


def test_a_baseline_worse_than_the_mean_is_said_first() -> None:
    test = flown(TS, [300] * 6, noise=0.02)
    train = flown(TS, [300], noise=0.02, seed=5)
    c = compare([replace(ARX, c=0.9), TS], test, train=train)
    (words,) = narrative.worse_than_constant({"roll": c})
    rmse = {name: score.scores.rmse for name, score in c.entry().models.items()}
    assert rmse["ts"] < rmse["mean"] < rmse["arx"]
    assert words.startswith("On roll the linear model is worse than the ")
    assert f"to {number(rmse['ts'])}." in words
    assert words in Page(render(ReportContext.of({"roll": c}))).words
    assert narrative.worse_than_constant({"roll": compare([ARX, TS], test, train=train)}) == []


def test_gains_of_four_channels_are_listed_and_of_more_left_to_the_table() -> None:
    c = compare([ARX, TS], flown(TS, [300] * 6, noise=0.02), train=flown(TS, [300], noise=0.02, seed=5))
    first_screens = [
        Page(render(ReportContext.of({f"axis{k}": c for k in range(count)}))).words for count in (4, 5)
    ]
    assert [words.count("% smaller on axis") for words in first_screens] == [4, 0]
