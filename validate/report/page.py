"""The page as a string: template, styles, script and data in one file that loads nothing.

Safety: names come from logs. The template escapes everything; the data block is JSON with <, > and & written
as \\u escapes; the Content-Security-Policy allows this page's own script and styles by hash and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

import flysid
from flysid.errors import StoreError
from flysid.files import write_atomically
from flysid.validate.cautions import cautions
from flysid.validate.compare import FUZZY
from flysid.validate.comparison import Comparison, ModelInfo, Pair
from flysid.validate.diagnostics import Diagnosis
from flysid.validate.report import narrative
from flysid.validate.report.context import ReportContext
from flysid.validate.report.figures import interval_bar
from flysid.validate.report.overlay import MOST_SEGMENTS
from flysid.validate.report.sections import Section, sections
from flysid.validate.report.source import Source
from flysid.validate.terminal import standing
from flysid.validate.words import (
    change_words,
    horizon_words,
    interval_words,
    number,
    one_line,
    percentage,
)

NUMBERS_ON_PAGE = 90_000
VERSION = "version of "
LONG = 400  # characters of a fact that are read in passing


@cache
def _asset(name: str) -> str:
    return (resources.files("flysid.validate.report") / "assets" / name).read_text("utf-8")


def write_report(path: str | Path, context: ReportContext) -> Path:
    """Write the page whole or not at all; returns its path.

    Raises
    ------
    StoreError : the file cannot be written.
    """
    path = Path(path)
    text = render(context)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    except OSError as error:
        raise StoreError(
            f"the report cannot be written: {error.strerror}",
            path=path,
            hint="choose another folder, or free some space",
        ) from error
    return path


def render(context: ReportContext) -> str:
    """The page; equal contexts give equal pages."""
    comparisons = context.comparisons
    diagnoses = context.diagnoses
    parts = _sections(context, diagnoses)
    pairs, idle = narrative.heads(comparisons), narrative.as_good_as_constant(comparisons)
    styles = _asset("uPlot.min.css") + "\n" + _asset("page.css")
    scripts = [_asset("uPlot.iife.min.js"), _asset("page.js")]
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            csp=_policy(scripts, styles),
            styles=Markup(styles),
            scripts=[Markup(s) for s in scripts],
            data=Markup(_json([s.data for s in parts])),
            remark=one_line(context.remark),
            title=narrative.title(pairs, idle),
            subtitle=narrative.subtitle(pairs, idle) if pairs else narrative.alone(comparisons),
            basis=narrative.basis(comparisons, _seconds_of_training(context)),
            skipped=[(one_line(name), one_line(why)) for name, why in context.skipped.items()],
            cards=_cards(comparisons),
            cautions=cautions(comparisons, diagnoses, context.doubts),
            rows=_rows(comparisons),
            models=_models(context),
            sections=parts,
            command=one_line(context.command),
            provenance=_provenance(context),
            version=flysid.__version__,
        )
    )


@cache
def _environment() -> Environment:
    from jinja2 import FunctionLoader

    environment = Environment(
        loader=FunctionLoader(_asset),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    environment.filters["percentage"] = percentage
    return environment


def _policy(scripts: Sequence[str], styles: str) -> str:
    allowed = " ".join(_hash(s) for s in scripts)
    return (
        f"default-src 'none'; script-src {allowed}; style-src {_hash(styles)}; "
        "img-src 'none'; base-uri 'none'; form-action 'none'"
    )


def _hash(content: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(content.encode()).digest()).decode() + "'"


def _json(value: Any) -> str:
    """JSON that cannot end its <script> block nor start a comment in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _sections(context: ReportContext, diagnoses: Mapping[str, Diagnosis]) -> list[Section]:
    drawn = sum(
        min(len(d.free_runs), MOST_SEGMENTS) * len(context.comparisons[n].test.outputs) * 8
        for n, d in diagnoses.items()
    )
    points = max(60, min(800, NUMBERS_ON_PAGE // max(1, drawn)))
    parts: list[Section] = []
    for i, (name, comparison) in enumerate(context.comparisons.items()):
        source = Source(
            name, comparison, diagnoses[name], context.train.get(name), context.sweeps.get(name), points
        )
        parts += sections(source, i)
    return parts


def _seconds_of_training(context: ReportContext) -> float | None:
    seconds = [sum(len(s) for s in d.segments) * d.dt_s for d in context.train.values()]
    return max(seconds, default=None)


def _reach(pairs: Sequence[Pair]) -> tuple[float, float]:
    """Common axis of all interval bars: holds every interval up to -100 and +100 percent, and zero."""
    ends = [v for p in pairs for v in (*(p.ci95 or ()), p.change_pct) if v is not None]
    low, high = min([-10.0, *ends]), max([10.0, *ends])
    low, high = max(low, -100.0), min(high, 100.0)
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def _cards(comparisons: Mapping[str, Comparison]) -> list[dict[str, Any]]:
    pairs = [pair for _, pair in narrative.heads(comparisons)]
    reach = _reach(pairs)
    cards = []
    for channel, c in comparisons.items():
        for output, pair in c.verdict.items():
            entry = c.entry(output, c.head)
            base, model = (entry.models[m].scores for m in (pair.baseline, pair.model))
            sizes = [c.models[m] for m in (pair.baseline, pair.model)]
            cards.append(
                {
                    "name": one_line(channel or output),
                    "signals": f"{', '.join(one_line(s.name) for s in c.test.inputs)} → {one_line(output)}",
                    "badge": narrative.badge(pair),
                    "change": change_words(pair),
                    "horizon": "RMSE in " + horizon_words(entry.horizon, c.dt_s),
                    "bar": interval_bar(pair, reach, narrative.css(pair)),
                    "interval": interval_words(pair),
                    "reason": pair.reason,
                    "rmse": (base.rmse, model.rmse),
                    "fit": (base.fit_pct, model.fit_pct),
                    "unit": one_line(entry.output.unit),
                    "size": " · ".join(map(_size, sizes)),
                }
            )
    return cards


def _size(info: ModelInfo) -> str:
    many = f"{info.n_rules} rules, " if info.n_rules > 1 else "one rule, " if info.structure in FUZZY else ""
    return f"{one_line(info.name).upper()} {many}{info.n_parameters} parameters"


def _rows(comparisons: Mapping[str, Comparison]) -> list[dict[str, Any]]:
    """The headline pair at every horizon, one row each."""
    every = [c.entry(e.output.name, e.horizon).pairs[c.contender] for c in comparisons.values()
             for e in c.entries if c.contender]  # fmt: skip
    reach = _reach(every)
    rows = []
    for channel, c in comparisons.items():
        for output in c.test.outputs:
            entries = [e for e in c.entries if e.output.name == output.name]
            for i, entry in enumerate(entries):
                pair = entry.pairs.get(c.contender or "")
                base = entry.models[c.baseline].scores
                other = entry.models[c.contender].scores if c.contender else None
                rows.append(
                    {
                        "first": i == 0,
                        "span": len(entries),
                        "name": one_line(channel or output.name),
                        "signals": one_line(f"{output.name}, {output.unit}" if output.unit else output.name),
                        "horizon": horizon_words(entry.horizon, c.dt_s),
                        "headline": entry.horizon == c.head,
                        "base": base,
                        "other": other,
                        "bar": interval_bar(pair, reach, narrative.css(pair), 190.0) if pair else "",
                        "change": change_words(pair) if pair else "",
                        "interval": interval_words(pair) if pair else "",
                        "badge": narrative.badge(pair) if pair else None,
                    }
                )
    return rows


def _models(context: ReportContext) -> list[dict[str, Any]]:
    """Every model of every channel in free run, the best first, with its size, notes and verdict."""
    rows = []
    for channel, c in context.comparisons.items():
        seconds = context.fit_seconds.get(channel, {})
        for output in c.test.outputs:
            entry = c.entry(output.name, c.head)
            ranked = sorted(entry.models.items(), key=lambda item: item[1].scores.rmse)
            for i, (name, score) in enumerate(ranked):
                info, pair = c.models[name], entry.pairs.get(name)
                words = standing(name, entry, c)
                first = min((s.diverged_s for s in score.diverged if s.diverged_s is not None), default=None)
                rows.append(
                    {
                        "first": i == 0,
                        "span": len(ranked),
                        "channel": one_line(channel or output.name),
                        "unit": one_line(output.unit),
                        "name": one_line(name),
                        "score": score.scores,
                        "worst_segment": f"H{score.worst_segment.segment + 1}",
                        "worst_rmse": score.worst_segment.scores.rmse,
                        "rules": "" if info.reference else info.n_rules,
                        "parameters": info.n_parameters,
                        "notes": [one_line(n).removesuffix(".") for n in info.notes],
                        "seconds": seconds.get(name),
                        "change": change_words(pair) if pair else "",
                        "interval": interval_words(pair) if pair else "",
                        "words": words,
                        "badge": narrative.badge(pair) if pair and words != "reference" else None,
                        "diverged": len(score.diverged),
                        "diverged_s": first,
                    }
                )
    return rows


def _provenance(context: ReportContext) -> list[tuple[str, str, list[str]]]:
    """(label, value, what is folded away): given labels first, then what the comparisons themselves know."""
    known = {one_line(k): one_line(str(v)) for k, v in context.provenance.items()}
    versions = {k: v for k, v in known.items() if k.startswith(VERSION)}
    known = {k: v for k, v in known.items() if k not in versions}
    for name, c in context.comparisons.items():
        if c.test_hash not in known.values():
            label = f"held-out data of {one_line(name)}" if name else "held-out data"
            known.setdefault(label, f"sha256 {c.test_hash}")
    versions = versions or {f"{VERSION}flysid": flysid.__version__}
    known["versions"] = ", ".join(f"{k.removeprefix(VERSION)} {v}" for k, v in versions.items())
    return [(label, *_folded(value)) for label, value in known.items()]


def _folded(value: str) -> tuple[str, list[str]]:
    """The first sentence and the others of what is too long to be read in passing."""
    first, *rest = value.split("; ")
    return (first, rest) if len(value) > LONG and rest else (value, [])
