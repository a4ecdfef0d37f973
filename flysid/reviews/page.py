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
from flysid.reviews.fact import (
    Action,
    Drawn,
    Fact,
    Finding,
    Grade,
    HeatMap,
    MotorPlan,
    Section,
    Table,
    TopView,
)
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

    Raises
    ------
    StoreError : the file cannot be written.
    """
    return write_page(path, render(reviews, command, series, absent))


def render(
    reviews: Sequence[Review],
    command: str = "",
    series: Sequence[Table] = (),
    absent: Sequence[str] = (),
) -> str:
    """The page of one log, or of several below one another.

    Parameters
    ----------
    command : that made it, for its foot.
    series : tables over all of them, which come first.
    absent : sentences for what of the series could not be given.
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

    Parameters
    ----------
    data : a timeline each, for plots; () where nothing is plotted: then the page runs no script.
    command, series, absent : as in `render`.
    """
    styles = "\n".join(load_asset(name) for name in ("uPlot.min.css", "page.css", "plot.css"))
    styles += _asset("review.css")
    scripts = [load_asset("uPlot.iife.min.js"), load_asset("plot.js")] if data else []
    return (
        _environment()
        .get_template("review.html.j2")
        .render(
            csp=security_policy(scripts, styles),
            styles=Markup(styles),
            scripts=[Markup(script) for script in scripts],
            data=Markup(script_json(list(data))),
            title=one_line(title),
            reviews=shown,
            series=[_table(table) for table in series],
            command=one_line(command),
            version=__version__,
            missing=[one_line(words) for words in absent],
        )
    )


@cache
def _asset(name: str) -> str:
    return (files("flysid.reviews") / "assets" / name).read_text("utf-8")


@cache
def _environment() -> Environment:
    """As the report's pages, with this page's template."""
    return environment().overlay(loader=FunctionLoader(_asset))


def _filled(review: Review, index: int) -> dict[str, Any]:
    aside = "from what this log shows; nothing was tried on the vehicle"
    answer = fill_answer(head(review), review.findings, review.actions, review.sections, aside, index)
    return answer | {
        "broken": [one_line(sentence) for sentence in review.broken],
        "clock": one_line(review.clock.words),
        "moments": [(m.time_s, one_line(m.kind), one_line(m.text)) for m in review.timeline.moments],
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

    Parameters
    ----------
    whose : the line above the headline.
    findings : the first one is the headline.
    aside : what the actions rest on.
    index : of it on its page.
    """
    first, *rest = findings
    keys = {fact.key: _anchor(index, fact.key) for section in sections for fact in section.facts}
    return {
        "index": index,
        "head": one_line(whose),
        "headline": one_line(first.text),
        "headline_more": one_line(first.more),
        "headline_to": keys.get(first.fact, ""),
        "headline_grade": first.grade.value,
        "findings": [
            {
                "text": one_line(finding.text),
                "more": one_line(finding.more),
                "grade": finding.grade.value,
                "to": keys.get(finding.fact, ""),
            }
            for finding in rest
        ],
        "aside": one_line(aside),
        "actions": [
            {
                "title": one_line(action.title),
                "reason": one_line(capital(action.reason)),
                "changes": [one_line(change.words) for change in action.changes],
                "predicted": one_line(action.predicted),
                "risk": one_line(action.risk),
                "to": keys.get(action.fact, ""),
            }
            for action in actions
        ],
        "sections": [_section(section, index) for section in sections],
        "broken": [],
        "has_panels": False,
    }


def _section(section: Section, index: int) -> dict[str, Any]:
    known = [fact for fact in section.facts if fact.value is not None]
    judged = [fact for fact in known if fact.grade is not Grade.PLAIN]
    first = known if len(known) <= FEW else judged
    return {
        "key": _anchor(index, section.key),
        "title": one_line(section.title),
        "facts": [_fact(fact, index) for fact in first],
        "more": [_fact(fact, index) for fact in known if fact not in first],
        "unknown": [_fact(fact, index) for fact in section.facts if fact.value is None],
        "pictures": [
            {
                "title": one_line(shown.title),
                "aside": one_line(shown.aside),
                "svg": extra(Extra.REVIEW_PICTURE, partial(_draw, shown), Markup(""), of=section.title),
            }
            for shown in section.shown
            if not isinstance(shown, Table)
        ],
        "tables": [_table(shown) for shown in section.shown if isinstance(shown, Table)],
    }


def _draw(shown: Drawn) -> Markup:
    if isinstance(shown, TopView):
        return draw_top_view(shown)
    if isinstance(shown, HeatMap):
        return draw_heat_map(shown)
    if isinstance(shown, MotorPlan):
        return draw_motors(shown)
    return draw_picture(shown)


def _table(table: Table) -> dict[str, Any]:
    times = table.times or (None,) * len(table.rows)
    return {
        "title": one_line(table.title),
        "headings": [one_line(heading) for heading in table.headings],
        "rows": [
            {"cells": [one_line(cell) for cell in row], "at": at}
            for row, at in zip(table.rows, times, strict=True)
        ],
    }


def _fact(fact: Fact, index: int) -> dict[str, Any]:
    return {
        "key": _anchor(index, fact.key),
        "label": one_line(fact.label),
        "words": one_line(fact.words),
        "grade": fact.grade.value,
        "note": one_line(fact.note),
        "missing": one_line(fact.missing),
        "remedy": one_line(fact.remedy),
        "fields": [one_line(field) for field in fact.fields],
        "at": fact.at_s,
    }


def _anchor(index: int, key: str) -> str:
    return f"f{index}-{key.replace('.', '-')}"


def _timeline(timeline: Timeline, most: int) -> Mapping[str, Any]:
    count = sum(len(trace.values) for panel in timeline.panels for trace in panel)
    size = max(1, -(-2 * count // most)) if count > most else 1
    return timeline_document(timeline, size)
