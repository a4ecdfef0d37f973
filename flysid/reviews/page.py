"""The page of a review: the answer first, what to do next, pictures, and every figure with its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FunctionLoader
from markupsafe import Markup

from flysid.escaping import one_line
from flysid.extras import Extra, Missing, extra
from flysid.ingest.lake.timeline import Timeline
from flysid.reviews.drawing import draw_heat_map, draw_motors, draw_picture, draw_top_view
from flysid.reviews.fact import Action, Drawn, Finding, Grade, HeatMap, MotorPlan, Section, Table, TopView
from flysid.reviews.lines import capital, head
from flysid.reviews.reviewed import Review
from flysid.validate.show.page.flight_page import timeline_document
from flysid.validate.show.page.html import environment, load_asset, script_json, security_policy, write_page
from flysid.version import __version__

FEW = 6
"""Figures of a section that all stand open; of more, those without a limit are folded away."""
MOST_SAMPLES = 120_000
"""In the lines of the flight over time; where there are more, extremes are kept."""


def write_review(
    path: str | Path,
    reviews: Sequence[Review],
    command: str = "",
    series: Sequence[Table] = (),
    absent: Sequence[str] = (),
) -> Path:
    """Write the page whole or not at all; returns its path. The rest is as in `render`.

    Raises StoreError: the file cannot be written.
    """
    return write_page(path, render(reviews, command, series, absent))


def render(
    reviews: Sequence[Review],
    command: str = "",
    series: Sequence[Table] = (),
    absent: Sequence[str] = (),
) -> str:
    """The page of one log, or of several below one another.

    `command`: that made it, for its foot.
    `series`: tables over all of them, which come first.
    `absent`: sentences for what of the series could not be given.
    """
    missing = Missing()
    with missing.gathering():
        timelines = [review.timeline for review in reviews]
        most = MOST_SAMPLES // len(reviews)
        shown = [_filled(review, i) for i, review in enumerate(reviews)]
        data = [_timeline(each, most) for each in timelines]
    title = reviews[0].findings[0].text if len(reviews) == 1 else f"{len(reviews)} flights"
    return fill_page(title, shown, data, command, series, (*absent, *missing.sentences))


def fill_page(
    title: str,
    shown: Sequence[Mapping[str, Any]],
    data: Sequence[Mapping[str, Any]] = (),
    command: str = "",
    series: Sequence[Table] = (),
    absent: Sequence[str] = (),
) -> str:
    """The page of what `fill_answer` made, one below another.

    `data`: a timeline each, for plots; () where nothing is plotted: then the page runs no script.
    `command`, `series`, `absent`: as in `render`.
    """
    styles = "\n".join(load_asset(name) for name in ("uPlot.min.css", "page.css", "plot.css"))
    styles += _asset("review.css")
    scripts = [load_asset("uPlot.iife.min.js"), load_asset("plot.js")] if data else []
    return (
        _environment()
        .get_template("review.html.j2")
        .render(
            capital=capital,
            csp=security_policy(scripts, styles),
            styles=Markup(styles),
            scripts=[Markup(script) for script in scripts],
            data=Markup(script_json(list(data))),
            title=title,
            reviews=shown,
            series=series,
            command=command,
            version=__version__,
            missing=absent,
        )
    )


@cache
def _asset(name: str) -> str:
    return (files("flysid.reviews") / "assets" / name).read_text("utf-8")


@cache
def _environment() -> Environment:
    """As the report's pages, with this page's template; no text of a log breaks a line."""
    return environment().overlay(loader=FunctionLoader(_asset), finalize=_printable)


def _printable(shown: object) -> object:
    """Names and messages come from logs; markup was made here."""
    return one_line(shown) if isinstance(shown, str) and not isinstance(shown, Markup) else shown


def _filled(review: Review, index: int) -> dict[str, Any]:
    aside = "from what this log shows; nothing was tried on the vehicle"
    answer = fill_answer(head(review), review.findings, review.actions, review.sections, aside, index)
    return answer | {
        "broken": review.broken,
        "clock": review.clock.words,
        "has_panels": bool(review.timeline.panels),
    }


def fill_answer(
    whose: str,
    findings: Sequence[Finding],
    actions: Sequence[Action],
    sections: Sequence[Section],
    aside: str,
    index: int = 0,
) -> dict[str, Any]:
    """What the template shows of one log or vehicle.

    `whose`: the line above the headline.
    `findings`: the first one is the headline.
    `aside`: what the actions rest on.
    `index`: of it on its page.
    """
    keys = {fact.key for section in sections for fact in section.facts}
    return {
        "index": index,
        "head": whose,
        "findings": findings,
        "actions": actions,
        "aside": aside,
        "sections": [_section(section, index) for section in sections],
        "anchor": partial(_anchor, index),
        "link": lambda key: _anchor(index, key) if key in keys else "",
        "broken": (),
        "has_panels": False,
    }


def _section(section: Section, index: int) -> dict[str, Any]:
    known = [fact for fact in section.facts if fact.value is not None]
    judged = [fact for fact in known if fact.grade is not Grade.PLAIN]
    first = known if len(known) <= FEW else judged
    drawn = [shown for shown in section.shown if not isinstance(shown, Table)]
    empty = Markup("")
    return {
        "key": _anchor(index, section.key),
        "title": section.title,
        "facts": first,
        "more": [fact for fact in known if fact not in first],
        "unknown": [fact for fact in section.facts if fact.value is None],
        "pictures": [
            (shown, extra(Extra.REVIEW_PICTURE, partial(_draw, shown), empty, of=section.title))
            for shown in drawn
        ],
        "tables": [shown for shown in section.shown if isinstance(shown, Table)],
    }


def _draw(shown: Drawn) -> Markup:
    if isinstance(shown, TopView):
        return draw_top_view(shown)
    if isinstance(shown, HeatMap):
        return draw_heat_map(shown)
    if isinstance(shown, MotorPlan):
        return draw_motors(shown)
    return draw_picture(shown)


def _anchor(index: int, key: str) -> str:
    return f"f{index}-{key.replace('.', '-')}"


def _timeline(timeline: Timeline, most: int) -> Mapping[str, Any]:
    count = sum(len(trace.values) for panel in timeline.panels for trace in panel)
    size = max(1, -(-2 * count // most)) if count > most else 1
    return timeline_document(timeline, size)
