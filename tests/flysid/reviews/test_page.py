"""The page, the lines and the files of a review say what its facts say, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from flysid.extras import Extra
from flysid.facts.clock import log_clock
from flysid.flight import ClockMap
from flysid.ingest.lake.timeline import Moment, Timeline, Trace
from flysid.reviews.fact import (
    Action,
    Change,
    Fact,
    Finding,
    Grade,
    HeatMap,
    MotorPlan,
    Picture,
    PictureLine,
    Section,
    Table,
    order,
)
from flysid.reviews.lines import markdown, terminal_text
from flysid.reviews.page import render
from flysid.reviews.parameter_file import file_suffix, parameter_text
from flysid.reviews.reviewed import Review

HOSTILE = "<script>alert(1)</script>"


def some_review(name: str = "flight.ulg", *, sections: tuple[Section, ...] | None = None) -> Review:
    """A review with one of everything."""
    x = np.linspace(0.0, 100.0, 50)
    power = Section(
        "power",
        "Power and motors",
        (
            Fact(
                "power.hover",
                "hover throttle",
                0.66,
                "",
                (0.64, 0.68),
                Grade.WATCH,
                "MPC_THR_HOVER is 0.5",
                ("t.x",),
                12.5,
            ),
            Fact("power.sag", "battery sag", missing="no current is logged", remedy="BAT1_A_PER_V"),
        ),
        (
            Finding("Hover takes 0.66 of full thrust", Grade.WATCH, 0.6, "power.hover"),
            Finding("The battery is fine", Grade.GOOD, 0.1, "power.sag"),
        ),
        (
            Action(
                "Set the hover throttle",
                "it hovers at 0.66",
                (Change("MPC_THR_HOVER", 0.5, 0.66),),
                "no drop",
                "none",
            ),
        ),
        (
            Picture(
                "Spectrum",
                "Hz",
                "power",
                (PictureLine("gyro", x, 1.0 + x), PictureLine("raw", x, 2.0 + x, "r1")),
                hidden_from=90.0,
                marks={50.0: "50 Hz"},
            ),
            HeatMap("Over throttle", "throttle", "Hz", x[:5], x[:7], np.arange(35.0).reshape(7, 5)),
            MotorPlan(
                "Motors",
                ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)),
                (0.5, 0.5, 0.7, 0.5),
                ("1", "2", "3", "4"),
            ),
            Table("Events", ("time", "what"), (("12.5 s", HOSTILE),), (12.5,)),
        ),
    )
    trace = Trace("t.x", "", x, x)
    timeline = Timeline(name, ((trace,),), ((0.0, 100.0, HOSTILE),), (Moment(1.0, "message", HOSTILE),))
    clock = log_clock([ClockMap(0, 0, 100_000_000_000)])
    found = (power,) if sections is None else sections
    return Review(name, {"autopilot": "px4", "firmware": "1.16"}, clock, found, timeline=timeline)


def test_the_gravest_finding_is_the_headline() -> None:
    page = render([some_review()])
    assert re.search(
        r'<h1 class="watch"><a href="#f0-power-hover">Hover takes 0.66 of full thrust</a></h1>', page
    )
    assert (
        page.index("Hover takes") < page.index("The battery is fine") < page.index("Set the hover throttle")
    )


def test_every_anchor_of_a_sentence_is_on_the_page() -> None:
    page = render([some_review()])
    wanted = set(re.findall(r'href="#([^"]+)"', page))
    assert wanted
    assert wanted <= set(re.findall(r'id="([^"]+)"', page))


def test_a_figure_leads_to_its_second_in_the_plot() -> None:
    page = render([some_review()])
    assert 'data-field="t.x" data-at="12.500"' in page
    assert '"t.x"' in page


def test_names_from_a_log_are_text() -> None:
    page = render([some_review(HOSTILE)])
    assert HOSTILE not in page
    assert "&lt;script&gt;" in page


def test_what_is_not_determined_names_what_logs_it() -> None:
    page = render([some_review()])
    assert "no current is logged. Next time: BAT1_A_PER_V" in page


def test_a_picture_that_breaks_leaves_the_page(break_extra: None) -> None:  # noqa: ARG001
    page = render([some_review()])
    assert "Hover takes 0.66" in page
    assert "The picture of the section of Power and motors could not be given" in page


@pytest.fixture
def break_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ValueError("injected")

    for name in ("draw_picture", "draw_heat_map", "draw_motors"):
        monkeypatch.setattr(f"flysid.reviews.page.{name}", fail)
    assert Extra.REVIEW_PICTURE


def test_several_logs_stand_below_one_another() -> None:
    page = render([some_review("a.ulg"), some_review("b.ulg")])
    assert page.count('class="log"') == 2
    assert 'id="f1-power-hover"' in page


def test_a_log_without_any_figure_says_so() -> None:
    empty = some_review(sections=())
    assert not empty.is_judged
    assert "Nothing in this log can be judged" in render([empty])


def test_the_terminal_shows_the_answer_within_25_lines() -> None:
    lines = terminal_text(some_review()).splitlines()
    assert len(lines) <= 25
    assert lines[2] == "Hover takes 0.66 of full thrust."
    assert any("MPC_THR_HOVER 0.5 -> 0.66" in line for line in lines)
    assert "1 figure not determined" in "\n".join(lines)


def test_markdown_has_a_row_for_every_fact_and_no_markup_of_the_log() -> None:
    text = markdown(some_review(HOSTILE))
    assert "| hover throttle | 0.66 \\[0.64, 0.68\\] |" in text
    assert "<script>" not in text


@pytest.mark.parametrize(
    ("family", "line"),
    [
        ("ardupilot", "MPC_THR_HOVER,0.66"),
        ("px4", "1\t1\tMPC_THR_HOVER\t0.66\t9"),
        ("betaflight", "set MPC_THR_HOVER = 0.66"),
    ],
)
def test_parameters_are_written_as_their_ground_station_reads_them(family: str, line: str) -> None:
    text = parameter_text(some_review().actions, family)
    assert line in text.splitlines()
    assert "# MPC_THR_HOVER was 0.5" in text.splitlines()
    assert file_suffix(family) in (".params", ".txt")


def test_a_whole_number_of_px4_keeps_its_type() -> None:
    action = Action("Log more", "", (Change("SDLOG_PROFILE", 1, 17),))
    assert "1\t1\tSDLOG_PROFILE\t17\t6" in parameter_text([action], "px4", {"SDLOG_PROFILE"})


def test_no_change_makes_no_file() -> None:
    assert parameter_text([Action("Check motor 1", "")], "px4") == ""


def test_values_are_what_a_condition_compares(tmp_path: Path) -> None:  # noqa: ARG001
    assert some_review().values == {"power": {"hover": 0.66, "sag": None}}


def test_of_one_topic_the_gravest_finding_stands_for_all() -> None:
    loop = Finding("Oscillates in roll", Grade.BAD, 1.0, "a.b", topic="oscillation")
    tone = Finding("Roll shakes", Grade.BAD, 0.8, "a.c", topic="oscillation")
    others = [Finding("Sags", Grade.WATCH, 0.9, "a.d"), Finding("Late", Grade.BAD, 0.9, "a.e")]
    assert order([tone, *others, loop]) == [loop, others[1], others[0]]
    assert order([tone, *others]) == [others[1], tone, others[0]]


def test_a_long_record_is_drawn_with_its_peaks_and_little_markup() -> None:
    x = np.linspace(0.0, 100.0, 100_000)
    y = np.zeros(len(x))
    y[54_321] = 7.0
    section = Section("power", "Power", shown=(Picture("Battery", "s", "V", (PictureLine("V", x, y),)),))
    page = render([some_review(sections=(section,))])
    peaks = re.findall(r'<path d="(M[^"]*)" class="line measured"/>', page)
    (heights,) = [[float(pair.split()[1]) for pair in re.split("[ML]", path)[1:]] for path in peaks]
    assert len(heights) < 1_000
    assert min(heights) < 0.5 * max(heights)
