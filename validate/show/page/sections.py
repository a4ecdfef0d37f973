"""One section of the page per channel and output: everything its template needs, ready to print."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.model.base import OperatingPoint, Rule
from flysid.model.capabilities import HasMemberships, HasOperatingPoints, HasRuleOutputs
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.operating_words import sentences
from flysid.model.rules.phrases import places_of
from flysid.model.start import as_modelled
from flysid.showing import number
from flysid.validate.compare.comparison import Comparison
from flysid.validate.diagnose.responses import answers
from flysid.validate.show.page import figures, overlay, rulefigures
from flysid.validate.show.page.channel_data import Source
from flysid.validate.show.page.checktable import CheckRow, check_rows, coefficient_rows, interval_text
from flysid.validate.show.page.modelpanels import (
    Panel,
    drawn_panels,
    dynamics_panels,
    gain_unit,
    panels_of,
    residual_panels,
    rules_of,
    with_unit,
)
from flysid.validate.show.page.narrative import badge

UNSTABLE = "unstable"
UNKNOWN = "not pinned down"
NOWHERE = "–"
SIGN = re.compile(r"(?<![\w)])-(?=[ \d])")


@dataclass(frozen=True)
class RuleRow:
    """One row of the If-Then table."""

    label: str
    css: str
    condition: str
    conclusion: str
    gain: str
    gain_interval: str
    time_constant: str
    time_interval: str
    pole: str
    used: float


@dataclass(frozen=True, eq=False)
class Section:
    """One channel and output."""

    anchor: str
    name: str
    signals: str
    badge: Mapping[str, str] | None
    still: Markup
    buttons: tuple[tuple[str, str], ...]
    left_out: str
    residuals: tuple[Panel, ...]
    dynamics: tuple[Panel, ...]
    rules: tuple[tuple[str, tuple[RuleRow, ...]], ...]
    sets: tuple[Panel, ...]
    wide: tuple[Panel, ...]
    models: tuple[str, ...]
    checks: tuple[CheckRow, ...]
    coefficients: tuple[tuple[str, str, str, str], ...]
    simpler: str
    said: tuple[str, ...]
    gain_unit: str
    key: tuple[tuple[str, str], ...]
    data: Mapping[str, Any]


def sections(source: Source, number_of: int) -> list[Section]:
    """A Section for every output of the channel; `number_of` counts channels, for anchors."""
    outputs = source.comparison.test.outputs
    return [_section(source, j, f"c{number_of}-{j}") for j in range(len(outputs))]


def _section(source: Source, j: int, anchor: str) -> Section:
    c = source.comparison
    signal = source.diagnosis.outputs[j].main_input
    of = source.channel or c.test.outputs[j].name
    pieces = extra(Extra.STRIPS, partial(overlay.strips, source, j, signal), (), of)
    longest = max(range(len(pieces)), key=lambda i: pieces[i].t[-1] - pieces[i].t[0], default=0)
    titles = (
        with_unit(c.test.outputs[j].name, c.test.outputs[j].unit),
        with_unit("error (measured − simulated)", c.test.outputs[j].unit),
        "input " + with_unit(c.test.inputs[signal].name, c.test.inputs[signal].unit),
    )
    labels = [one_line(c.segments[p.index]) for p in pieces]
    shown = list(zip(pieces, labels, strict=True))[longest : longest + 1]
    name = one_line(of)
    return Section(
        anchor=anchor,
        name=name if len(c.test.outputs) == 1 else f"{name}/{one_line(c.test.outputs[j].name)}",
        signals=f"{', '.join(one_line(s.name) for s in c.test.inputs)} → {one_line(c.test.outputs[j].name)}",
        badge=badge(c.verdict[c.test.outputs[j].name]) if c.verdict else None,
        still=extra(Extra.STRIPS, partial(_still, shown, titles), Markup(""), of),
        buttons=overlay.buttons(c, pieces, j),
        left_out=overlay.left_out(len(source.diagnosis.free_runs), len(pieces)),
        residuals=residual_panels(source, j, signal),
        dynamics=dynamics_panels(source, j, signal),
        rules=extra(Extra.RULE_TABLE, partial(_rules, source, j, signal), (), of),
        sets=_sets(source, j, signal),
        wide=tuple(panel for p, label in shown for panel in _wide(source, j, p.index, label)),
        models=tuple(one_line(m).upper() for m, _ in overlay.drawn(c)),
        checks=extra(Extra.CHECK_TABLE, partial(check_rows, c, source.diagnosis, j), (), of),
        coefficients=extra(Extra.COEFFICIENTS, partial(coefficient_rows, c, source.diagnosis, j), (), of),
        simpler=_simpler(source),
        said=_operating_sentences(source, j),
        gain_unit=gain_unit(c, j, signal),
        key=extra(Extra.RULE_KEY, partial(_key, c), (), of),
        data={
            "segments": [overlay.as_json(p, label) for p, label in zip(pieces, labels, strict=True)],
            "shown": longest,
            "titles": list(titles),
            "banded": any(p.bands for p in pieces),
            "models": [f"{one_line(m).upper()} free run" for m, _ in overlay.drawn(c)],
            "others": overlay.extras(source),
            "names": [one_line(m) for m in (*(m for m, _ in overlay.drawn(c)), *overlay.list_pickable(c))],
        },
    )


def _still(shown: Sequence[tuple[overlay.Strip, str]], titles: tuple[str, str, str]) -> Markup:
    """The picture of the segment; nothing where none is drawn."""
    for piece, label in shown:
        return overlay.still(piece, titles, f"Measured and simulated {titles[0]}, {label}")
    return Markup("")


def _rules(source: Source, j: int, signal: int) -> tuple[tuple[str, tuple[RuleRow, ...]], ...]:
    """The If-Then tables of the models drawn, the contender's first."""
    named = reversed(overlay.drawn(source.comparison))
    return _named_rules([(m, _rule_rows(source, m, css, (j, signal))) for m, css in named])


def _simpler(source: Source) -> str:
    """What simpler rules would cost, in one sentence; "" where there is nothing to leave out."""
    checks = source.diagnosis.checks.get(source.comparison.contender or "")
    if checks is None or not checks.simpler:
        return ""
    edits = "; ".join(map(str, checks.simpler))
    return (
        f"Simpler rules, and what each adds to the free-run RMSE on the training flights: {one_line(edits)}."
    )


def _operating_sentences(source: Source, j: int) -> tuple[str, ...]:
    """What the contender's rules do from the slow to the fast end of what was flown."""
    c = source.comparison
    model = c.fitted[c.contender] if c.contender else None
    if not isinstance(model, HasOperatingPoints):
        return ()
    points = [p for p in model.operating_points if p.output == j]
    return tuple(_typeset(text) for text in sentences(points, (model.outputs, model.inputs)))


def _key(c: Comparison) -> tuple[tuple[str, str], ...]:
    """(CSS class, "R1 forward") of every rule; the words where one antecedent tells all rules apart."""
    rules = rules_of(c)
    words = [re.findall(r" is A\d+ '([^']*)'", rule.condition) for rule in rules]
    alone = all(len(said) == 1 for said in words) and len({said[0] for said in words}) == len(rules)
    names = [f"{r.label} {said[0]}" if alone else r.label for r, said in zip(rules, words, strict=True)]
    return tuple((f"r{i % 8 + 1}", one_line(name)) for i, name in enumerate(names))


def _named_rules(
    tables: Sequence[tuple[str, tuple[RuleRow, ...]]],
) -> tuple[tuple[str, tuple[RuleRow, ...]], ...]:
    """The rules of every model: a single one is called by its model, "R1" by model and rule where several
    models have rules."""
    several = sum(len(rows) > 1 for _, rows in tables) > 1
    found = []
    for model, rows in tables:
        name = one_line(model).upper()
        labels = [f"{name} {r.label}" if several else r.label for r in rows] if len(rows) > 1 else [name]
        found.append((model, tuple(replace(r, label=label) for r, label in zip(rows, labels, strict=True))))
    return tuple(found)


def _rule_rows(source: Source, name: str, css: str, place: tuple[int, int]) -> tuple[RuleRow, ...]:
    """Rows of the If-Then table; a model of one rule keeps its own colour. `place` is (output, input)."""
    rules = source.comparison.fitted[name].rules()
    colours = [css] if len(rules) == 1 else [f"r{i % 8 + 1}" for i in range(len(rules))]
    checks = source.diagnosis.checks.get(name)
    known = [bool(places_of(at, rules)) for at in range(len(rules))]
    alone = next((p for p in answers(source.comparison.fitted[name]) if p.output == place[0]), None)
    rows = [
        _rule_row(r, colour, place, alone, known=told)
        for r, colour, told in zip(rules, colours, known, strict=True)
    ]
    if checks is None or checks.intervals is None:
        return tuple(rows)
    sure = checks.intervals
    (j, signal) = place
    slow = sure.reached_s
    return tuple(
        replace(
            row,
            gain_interval=interval_text(sure.gain[:, r, j, signal])
            or (UNKNOWN if row.gain[-1:].isdigit() else ""),
            time_interval="" if slow is None else interval_text(slow[:, r, j, signal], " s"),
        )
        for r, row in enumerate(rows)
    )


def _rule_row(
    rule: Rule, css: str, place: tuple[int, int], alone: OperatingPoint | None, *, known: bool
) -> RuleRow:
    """A row; with what the model does where the rule is the strongest, where that is `known`, or everywhere.

    `alone`: what it does everywhere, of a model of one rule.
    """
    j, signal = place
    gain = float(np.asarray(rule.dc_gain)[j, signal])
    tau, sample_s = rule.time_constant_s, 0.0
    without = UNSTABLE if rule.pole_radius >= 1.0 + ROUNDING else ""
    here = next((p for p in rule.here if p.output == j), alone)
    if here is not None:
        gain, tau, sample_s = float(here.gain[signal]), float(here.reached_s[signal]), here.sample_s
    elif known:
        gain, tau, without = np.nan, np.nan, NOWHERE
    return RuleRow(
        label=one_line(rule.label),
        css=css,
        condition=_typeset(rule.condition),
        conclusion=_typeset(rule.conclusion),
        gain=without or (number(gain) if np.isfinite(gain) else "integrates"),
        gain_interval="",
        time_interval="",
        time_constant=without or _duration(tau, sample_s),
        pole=f"{rule.pole_radius:.4f}",
        used=float(np.clip(rule.support, 0.0, 1.0)),
    )


def _duration(seconds: float, sample_s: float) -> str:
    """What no sample resolves is a bound."""
    if not np.isfinite(seconds):
        return "integrates"
    return f"< {number(sample_s)} s" if seconds < sample_s else f"{number(seconds)} s"


def _typeset(words: str) -> str:
    """Rule text with true plus-minus and minus signs; those of "y(k-1)-y(k-2)" stay."""
    return SIGN.sub("−", one_line(words).replace("+-", "±"))


def _sets(source: Source, j: int, signal: int) -> tuple[Panel, ...]:
    """Membership functions and data coverage."""
    c = source.comparison
    return panels_of(
        "data",
        {
            "membership functions": partial(_memberships, source),
            "input coverage": partial(_coverage, source, "u", signal, c.test.inputs[signal]),
            "output coverage": partial(_coverage, source, "y", j, c.test.outputs[j]),
        },
        source,
        j,
        signal,
    )


def _memberships(source: Source) -> list[Panel]:
    c = source.comparison
    model = c.fitted[c.contender] if c.contender else None
    if not isinstance(model, HasMemberships):
        return []
    units = {s.name: s.unit for s in (*c.test.inputs, *c.test.outputs)}
    drawn = rulefigures.membership_figures(model, source.train or c.test, units)
    return [Panel("Membership functions", "grade of every rule's set", figure) for figure in drawn]


def _coverage(source: Source, side: str, i: int, signal: Signal) -> list[Panel]:
    train = None if source.train is None else _column(source.train, side, i)
    words = (with_unit(signal.name, signal.unit), f"Histogram of {signal.name}")
    return [
        Panel(
            f"{'Input' if side == 'u' else 'Output'} coverage",
            "grey: training; line: held out; red: outside training"
            if train is not None
            else "line: held out",
            figures.coverage(train, _column(source.comparison.test, side, i), words),
        )
    ]


def _column(data: Dataset, side: str, i: int) -> FloatArray:
    return np.concatenate([getattr(s, side)[:, i] for s in data.segments])


def _wide(source: Source, j: int, index: int, label: str) -> tuple[Panel, ...]:
    """Degree of fulfilment and rule outputs along one segment, for a model of several rules."""
    return drawn_panels(
        source,
        {
            "degree of fulfilment": partial(_fulfilment, source, index, label),
            "output of individual rules": partial(_rule_outputs, source, j, index, label),
        },
    )


def _fulfilment(source: Source, index: int, label: str) -> list[Panel]:
    c = source.comparison
    segment = c.test.segments[index]
    strengths = rulefigures.firing_along(c.fitted[c.contender], segment) if c.contender else None
    if strengths is None:
        return []
    t = c.dt_s * np.arange(len(segment), dtype=np.float64)
    return [
        Panel(
            "Degree of fulfilment",
            f"normalised weight of every rule, stacked, segment {label}",
            rulefigures.fulfilment(strengths, t, f"Degree of fulfilment in {label}"),
        )
    ]


def _rule_outputs(source: Source, j: int, index: int, label: str) -> list[Panel]:
    c = source.comparison
    segment = c.test.segments[index]
    model = c.fitted[c.contender] if c.contender else None
    strengths = None if model is None else rulefigures.firing_along(model, segment)
    if strengths is None or not isinstance(model, HasRuleOutputs):
        return []
    t = c.dt_s * np.arange(len(segment), dtype=np.float64)
    out = np.asarray(model.rule_outputs(segment.u, as_modelled(model, segment).y))[:, :, j]
    output = c.test.outputs[j]
    words = (with_unit(output.name, output.unit), f"Output of every rule in {label}")
    return [
        Panel(
            "Output of individual rules",
            "one step ahead, where the weight is at least 0.25; grey: measured",
            rulefigures.rule_output_figure(out, strengths, segment.y[:, j], t, words),
        )
    ]
