"""Figures of a review, one row each in `figures.toml`: label, unit, limit, finding and action."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files

import numpy as np

from flysid.errors import UsageError
from flysid.reviews.fact import Action, Fact, Finding, Grade, Section
from flysid.showing import one_of, significant

PHASE_MARGIN = "tracking.{axis}_phase_margin"


@dataclass(frozen=True)
class Row:
    """A figure's label, unit and limit, and the finding and action of a value beyond the limit.

    Where `bad` lies below `watch`, less is worse; NaN where the figure has no limit. `least_s` are the
    seconds in the air that the figure needs.
    """

    label: str = ""
    unit: str = ""
    watch: float = np.nan
    bad: float = np.nan
    source: str = ""
    least_s: float = 0.0
    like: str = ""
    finding: str = ""
    more: str = ""
    weight: float | list[float] = 0.5
    action: Mapping[str, str | float] = field(default_factory=dict)

    def grade(self, value: float) -> Grade:
        """Of a value.

        >>> limit("vibration.ardupilot_vibe").grade(41.0).value, limit("estimator.satellites").grade(4).value
        ('watch', 'bad')
        """
        if np.isnan(self.watch):
            return Grade.PLAIN
        sign = 1.0 if self.bad >= self.watch else -1.0
        if sign * value >= sign * self.bad:
            return Grade.BAD
        return Grade.WATCH if sign * value >= sign * self.watch else Grade.GOOD


@cache
def _rows() -> dict[str, Row]:
    sections = tomllib.loads(files(__package__).joinpath("figures.toml").read_text("utf-8"))
    least_s = sections.pop("least_s")
    return {
        f"{name}.{key}": Row(**{"least_s": least_s.get(name, 0.0), **row})
        for name, rows in sections.items()
        for key, row in rows.items()
    }


_OWN: ContextVar[Mapping[str, Row]] = ContextVar("_OWN", default={})  # noqa: B039 - never written to


def limit(key: str) -> Row:
    """The row whose limit a figure has; KeyError where there is none."""
    row = _OWN.get().get(key) or _rows()[key]
    return limit(row.like) if row.like else row


@contextmanager
def own_limits(limits: Mapping[str, tuple[float, float]]) -> Iterator[None]:
    """Judge by other limits within this block.

    `limits`: figure -> from which value on it is to be watched, and bad, in the unit of the figure.
    Raises UsageError: no figure of that name has a limit.

    >>> with own_limits({"power.motor_spread": (20.0, 60.0)}):
    ...     limit("power.motor_spread").grade(15.0).value
    'good'
    """
    keys = {re.sub(r"{\w+}_", "", key): key for key, row in _rows().items() if not np.isnan(row.watch)}
    own = dict(_OWN.get())
    for name, (watch, bad) in limits.items():
        if name not in keys:
            raise UsageError(f"no figure {name!r} has a limit", hint=one_of(list(keys), name))
        words = f"your limits: {significant(watch)} and {significant(bad)}"
        own[keys[name]] = replace(_rows()[keys[name]], watch=watch, bad=bad, source=words)
    before = _OWN.set(own)
    try:
        yield
    finally:
        _OWN.reset(before)


def parse_limits(words: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Limits as a person writes them: "power.motor_spread=15,40".

    Raises UsageError: it is written otherwise.
    """
    found = {}
    for text in words:
        name, _, numbers = text.partition("=")
        try:
            watch, bad = (float(part) for part in numbers.split(","))
        except ValueError:
            hint = "FIGURE=WATCH,BAD, such as power.motor_spread=15,40"
            raise UsageError(f"{text!r} is no limit", hint=hint) from None
        found[name.strip()] = (watch, bad)
    return found


def rate_lag_limit(axis: str) -> Row:
    """Of how late a body rate follows, ms."""
    return limit("tracking.yaw_rate_lag" if axis == "yaw" else "tracking.rate_lag")


def fact_of(
    key: str,
    value: float | str | None,
    fields: tuple[str, ...] = (),
    *,
    at_s: float | None = None,
    interval: tuple[float, float] | None = None,
    note: str = "",
    grade: Grade | None = None,
    missing: str = "",
    **names: str | float,
) -> Fact:
    """A figure as its row calls it, graded by its limit, whose source ends its note.

    `key`: of the row; braces in it and in its label are filled with `names`.
    `grade`: where the row's limit is not that of the value itself.

    >>> fact_of("estimator.cpu_load", 97.0).grade.value
    'bad'
    """
    row, bound = _rows()[key], limit(key)
    if grade is None:
        grade = bound.grade(value) if isinstance(value, (int, float)) else Grade.PLAIN
    return Fact(
        key.format(**names),
        row.label.format(**names),
        value,
        "" if isinstance(value, str) else row.unit,
        interval,
        grade,
        "; ".join(filter(None, (note, bound.source))),
        fields,
        at_s,
        missing,
        least_s=row.least_s,
    )


def absent(
    key: str, missing: str, remedy: str = "", fields: tuple[str, ...] = (), **names: str | float
) -> Fact:
    """A figure that the log does not determine, with the reason and the setting that logs it."""
    label = _rows()[key].label.format(**names)
    return Fact(key.format(**names), label, missing=missing, remedy=remedy, fields=fields)


def withhold(section: Section, flown_s: float) -> Section:
    """A section without figures for which so many seconds of flight are too short, and what rests on them."""
    short = {fact.key for fact in section.facts if fact.value is not None and fact.least_s > flown_s}
    if not short:
        return section
    flown = significant(flown_s)
    return replace(
        section,
        facts=tuple(
            replace(
                fact,
                value=None,
                interval=None,
                grade=Grade.PLAIN,
                note="",
                at_s=None,
                missing=f"{flown} s of flight are too short, {fact.least_s:g} s are needed",
            )
            if fact.key in short
            else fact
            for fact in section.facts
        ),
        findings=tuple(finding for finding in section.findings if finding.fact not in short),
        actions=tuple(action for action in section.actions if action.fact not in short),
        shown=(),
    )


def exceeded(facts: Iterable[Fact]) -> dict[str, Fact]:
    """Key -> fact of those that passed their limits."""
    return {
        fact.key: fact for fact in facts if fact.grade.rank >= Grade.WATCH.rank and fact.value is not None
    }


def findings_of(facts: Iterable[Fact]) -> Iterator[Finding]:
    """The sentences that rows have for facts beyond their limits."""
    for key, fact in exceeded(facts).items():
        row = _rows().get(key, Row())
        if row.finding:
            weights = row.weight if isinstance(row.weight, list) else [row.weight]
            weight = weights[-1] if fact.grade is Grade.BAD else weights[0]
            yield Finding(_filled(row.finding, fact), fact.grade, weight, key, _filled(row.more, fact))


def actions_of(facts: Iterable[Fact]) -> Iterator[Action]:
    """The actions that rows have for facts beyond their limits."""
    for key, fact in exceeded(facts).items():
        action = _rows().get(key, Row()).action
        if action:
            title, reason, outcome = (_filled(str(action[n]), fact) for n in ("title", "reason", "predicted"))
            yield Action(title, reason, predicted=outcome, weight=float(action["weight"]), fact=key)


def _filled(text: str, fact: Fact) -> str:
    """A text of a row with what the fact holds."""
    what = str(fact.value).partition(" at ")[0]
    return text.format(
        value=fact.value,
        words=fact.words,
        what=what,
        What=what.capitalize(),
        at_s=fact.at_s,
        note=fact.note,
        source=limit(fact.key).source,
    )
