"""The page's first screen: whose flights, a picture beside every verdict, segments named by flight."""

from __future__ import annotations

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from flysid.catalogue import FlightFacts
from flysid.dataset import Dataset, Segment
from flysid.manifest import Stamp
from flysid.validate.compare.comparison import BEGIN, segment_names
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.show.page.masthead import dates, masthead
from flysid.validate.show.page.most_telling import answer, most_telling
from flysid.validate.show.page.page import render
from tests.fakes import FirstOrder, flown

ARX = FirstOrder(a=0.9, b=0.07)
TS = FirstOrder(a=0.9, b=0.1, structure="ts")
DAY_NS = 86_400 * 10**9


def facts(number: int, **info: str) -> FlightFacts:
    return FlightFacts(
        id=f"log-{number}-0123abcd",
        log=f"log-{number}.bin",
        format="dataflash",
        size_bytes=1,
        sha256="0" * 64,
        flysid="0.1.0",
        duration_s=90.0,
        rows=1,
        lossy=False,
        start_utc_ns=number * DAY_NS,
        info=info,
        streams={},
        layout="",
        stamp=msgspec.convert((1, 1), Stamp),
    )


def test_the_masthead_says_what_the_logs_say() -> None:
    logs = [facts(i, vehicle="copter", firmware=f"4.{i % 2}") for i in range(5)]
    assert masthead(logs, [50.0]) == [
        "5 logs: log-0.bin, log-1.bin, log-2.bin and 2 more",
        "copter",
        "4.0, 4.1",
        "1 Jan 1970 to 5 Jan 1970",
        "8 min in total",
        "50 Hz",
    ]
    alone = replace_info(facts(0))
    assert masthead([alone], [25.0]) == ["1 log: log-0.bin", "90 s in total", "25 Hz"]
    assert masthead([], [25.0]) == []
    assert dates([3 * DAY_NS, 3 * DAY_NS + 5]) == "4 Jan 1970"


def replace_info(flight: FlightFacts) -> FlightFacts:
    return msgspec.structs.replace(flight, start_utc_ns=None)


def parts(*places: tuple[str, float, float]) -> Dataset:
    """Segments of (flight, time of the first sample in s, time of the flight's beginning in s)."""
    segments = [
        Segment(np.zeros((9, 1)), np.zeros((9, 1)), round(at * 1e9), flight, {BEGIN: begin})
        for flight, at, begin in places
    ]
    data = Dataset.from_arrays(np.zeros(9), np.zeros(9), 0.1)
    return data.with_segments(segments)


def test_segments_are_named_by_flight_and_by_time_where_it_has_several() -> None:
    data = parts(
        ("hover-0123abcd", 130.0, 100.0), ("hover-0123abcd", 225.4, 100.0), ("climb-89abcdef", 7.0, 0.0)
    )
    assert segment_names(data) == ("hover 0:30", "hover 2:05", "climb")


def test_without_a_beginning_times_count_from_the_first_segment_of_the_flight() -> None:
    data = parts(
        ("hover-0123abcd", 130.0, 100.0), ("hover-0123abcd", 225.4, 100.0), ("climb-89abcdef", 7.0, 0.0)
    )
    bare = data.with_segments([replace(s, marks={}) for s in data.segments])
    assert segment_names(bare) == ("hover 0:00", "hover 1:35", "climb")


def test_a_hash_stays_where_the_rest_names_two_flights() -> None:
    assert segment_names(parts(("a-0123abcd", 0.0, 0.0), ("a-89abcdef", 0.0, 0.0))) == (
        "a-0123abcd",
        "a-89abcdef",
    )


@pytest.mark.parametrize("at", [40, 250])
def test_the_picture_shows_where_the_models_differ_most(at: int) -> None:
    test = flown(TS, [500, 500], noise=0.001)
    lively = [replace(s, u=0.01 * s.u) for s in test.segments]
    u = lively[1].u.copy()
    u[at : at + 50] = 5.0
    lively[1] = replace(lively[1], u=u)
    c = compare([ARX, TS], test.with_segments(lively))
    found = most_telling(c, ReportContext.of({"x": c}).diagnoses["x"].free_runs, 0)
    rows = round(10.0 / c.dt_s)
    assert found.trial.segment == 1
    assert found.last - found.first == min(rows, len(found.trial.y))
    assert found.trial.first + found.first <= at + 50
    assert found.trial.first + found.last >= at


def test_every_card_has_its_picture_and_a_numbered_scale() -> None:
    c = compare([ARX, TS], flown(TS, [400] * 12, noise=0.02))
    page = render(replace(ReportContext.of({"x": c}), flights=[facts(1, vehicle="copter")]))
    first_screen = page.partition("Before you rely on this")[0]
    assert first_screen.count('class="telling"') == 1
    assert "1 log: log-1.bin" in first_screen
    assert " %</text>" in first_screen
    assert "linear model, free run" in first_screen


def test_the_card_says_how_the_output_answers_a_small_step() -> None:
    """Of a first-order lag: its gain, and its time constant of 0.47 s, between two samples."""
    c = compare([FirstOrder(a=0.9, b=0.1), FirstOrder(a=0.9, b=0.05)], flown(TS, [300] * 2, noise=0.02))
    assert answer(c, (0, 0)) == "One more deg of u adds 1 m/s to y; 63 % of that after 0.48 s."
    integrating = FirstOrder(a=1.0, b=0.1)
    assert answer(compare([integrating], flown(TS, [300] * 2, noise=0.02)), (0, 0)) == ""


def curves(card: str) -> int:
    return len(set(re.findall(r'<path [^>]*class="(measured|arx|ts)"', card)))


def test_a_search_for_rules_that_ends_with_the_linear_model_is_one_model_on_the_card() -> None:
    c = compare([ARX, replace(ARX, structure="ts")], flown(ARX, [600] * 6, noise=0.02))
    page = render(ReportContext({"roll": c}))
    card = page.partition('<article class="card')[2].partition("</article>")[0]
    assert "TS is the same model." in card
    assert "[0.0, 0.0]" not in card + page.partition('id="numbers"')[2].partition("<details")[0]
    assert curves(card) == 2  # measured, and one free run in the colour that the legend names
    other = render(ReportContext({"roll": compare([ARX, TS], flown(TS, [600] * 6, noise=0.02))}))
    assert curves(other.partition('<article class="card')[2].partition("</article>")[0]) == 3
