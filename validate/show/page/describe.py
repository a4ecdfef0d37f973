"""What the page of a comparison says and shows, finished: text, numbers and pictures, and no model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from markupsafe import Markup

from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.loops.judged import CAUTION
from flysid.validate.compare.comparison import Comparison, ModelInfo, Pair
from flysid.validate.compare.words import change_words, horizon_words, interval_words, physics_words
from flysid.validate.diagnose.caution import Caution
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.diagnose.diagnostics import Diagnosis
from flysid.validate.show.page import narrative
from flysid.validate.show.page.channel_data import Source
from flysid.validate.show.page.figures import interval_bar
from flysid.validate.show.page.gainpanels import LoopPanel, loop_panels
from flysid.validate.show.page.masthead import masthead
from flysid.validate.show.page.most_telling import answer, telling
from flysid.validate.show.page.overlay import MOST_SEGMENTS, list_pickable
from flysid.validate.show.page.sections import Section, sections
from flysid.validate.show.page.svg import BASELINE, CONTENDER
from flysid.validate.show.terminal import standing
from flysid.version import __version__

NUMBERS_ON_PAGE = 90_000
NOTHING = (Markup(""), "")
VERSION = "version of "
LONG = 400  # characters of a fact that are read in passing


@dataclass(frozen=True)
class Page:
    """All that the template prints, in the order of the page.

    `remark`, `masthead`, `title`, `subtitle`, `basis`: what stands above the cards.
    `cards`: one per channel and output: the verdict, its interval, the most telling seconds.
    `drawn`: (CSS class, name) of the curves on the cards.
    `skipped`: (channel, reason) of those that are not on the page.
    `cautions`: what to beware of, worst first.
    `rows`: the headline pair at every horizon. `models`: every model in free run, the best first.
    `sections`: one per channel and output, with its pictures.
    `loops`: what the logged gains mean. `loops_caution`: what they do not mean.
    `command`, `provenance`, `version`: how to make the page again.
    """

    remark: str
    masthead: Sequence[str]
    title: str
    subtitle: str
    basis: str
    cards: Sequence[Mapping[str, Any]]
    drawn: Sequence[tuple[str, str]]
    skipped: Sequence[tuple[str, str]]
    cautions: Sequence[Caution]
    rows: Sequence[Mapping[str, Any]]
    models: Sequence[Mapping[str, Any]]
    sections: Sequence[Section]
    loops: Sequence[LoopPanel]
    loops_caution: str
    command: str
    provenance: Sequence[tuple[str, str, list[str]]]
    version: str


def describe(context: ReportContext) -> Page:
    """The page of what was found; equal contexts give equal pages. What of it breaks is left out."""
    comparisons = context.comparisons
    diagnoses = context.diagnoses
    with context.missing.gathering():
        parts = _sections(context, diagnoses)
        pairs = narrative.heads(comparisons)
        idle = narrative.as_good_as_constant(comparisons)
        rates = sorted({1.0 / c.dt_s for c in comparisons.values()})
        return Page(
            remark=one_line(context.remark),
            masthead=extra(Extra.MASTHEAD, partial(masthead, context.flights, rates), ()),
            title=narrative.title(pairs, idle),
            subtitle=" ".join([*narrative.worse_than_constant(comparisons), narrative.subtitle(pairs, idle)])
            if pairs
            else narrative.alone(comparisons),
            basis=narrative.basis(comparisons, _seconds_of_training(context)),
            skipped=[(one_line(name), one_line(why)) for name, why in context.skipped.items()],
            cards=_cards(comparisons, diagnoses),
            drawn=_drawn(comparisons),
            cautions=cautions(comparisons, diagnoses, context.doubts),
            rows=_rows(comparisons),
            models=_models(context),
            sections=parts,
            loops=extra(Extra.LOOP_PANELS, partial(loop_panels, context.loops), ()),
            loops_caution=CAUTION,
            command=one_line(context.command),
            provenance=_provenance(context),
            version=__version__,
        )


def _sections(context: ReportContext, diagnoses: Mapping[str, Diagnosis]) -> list[Section]:
    drawn = sum(
        min(len(d.free_runs), MOST_SEGMENTS)
        * len(context.comparisons[n].test.outputs)
        * (8 + len(list_pickable(context.comparisons[n])))
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
    low = min([-10.0, *ends])
    high = max([10.0, *ends])
    low = max(low, -100.0)
    high = min(high, 100.0)
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def _drawn(comparisons: Mapping[str, Comparison]) -> list[tuple[str, str]]:
    """(CSS class, name) of the curves on the cards, one where the search for rules took the baseline."""
    first = next(iter(comparisons.values()))
    pairs = narrative.heads(comparisons)
    words = [narrative.base_words(pairs) if pairs else narrative.name_model(first.baseline)]
    if not all(_is_same_model(pair) for _, pair in pairs):
        words.append(narrative.contender_words(pairs))
    return list(zip((BASELINE, CONTENDER), words, strict=False))


def _cards(comparisons: Mapping[str, Comparison], diagnoses: Mapping[str, Diagnosis]) -> list[dict[str, Any]]:
    pairs = [pair for _, pair in narrative.heads(comparisons)]
    reach = _reach(pairs)
    cards = []
    for channel, c in comparisons.items():
        for j, (output, pair) in enumerate(c.verdict.items()):
            name = channel or output
            trials = diagnoses[channel].free_runs
            draw = partial(telling, c, trials, j)
            shown, where = extra(Extra.TELLING, draw, NOTHING, name) if trials else NOTHING
            moved = diagnoses[channel].outputs[j].main_input
            entry = c.entry(output, c.head)
            base, model = (entry.models[m].scores for m in (pair.baseline, pair.model))
            sizes = [c.models[m] for m in (pair.baseline, pair.model)]
            cards.append(
                {
                    "name": one_line(name),
                    "signals": f"{', '.join(one_line(s.name) for s in c.test.inputs)} → "
                    + one_line(f"{output}, {entry.output.unit}" if entry.output.unit else output),
                    "badge": narrative.badge(pair),
                    "same": one_line(pair.model).upper() if _is_same_model(pair) else "",
                    "change": change_words(pair),
                    "horizon": "RMSE in " + horizon_words(entry.horizon, c.dt_s),
                    "telling": shown,
                    "where": where,
                    "nonlinear": _nonlinear(diagnoses[channel], j),
                    "physics": extra(Extra.PHYSICS, partial(_physics, c, output), "", name),
                    "answer": extra(Extra.ANSWER, partial(answer, c, (j, moved)), "", name),
                    "bar": _bar(pair, reach, name, scale=True),
                    "interval": interval_words(pair),
                    "reason": pair.reason,
                    "rmse": (base.rmse, model.rmse),
                    "fit": (base.fit_pct, model.fit_pct),
                    "unit": one_line(entry.output.unit),
                    "size": _size(sizes[0]) if _is_same_model(pair) else " · ".join(map(_size, sizes)),
                }
            )
    return cards


def _bar(pair: Pair, reach: tuple[float, float], of: str, **form: Any) -> Markup:
    """The picture of a change and its interval."""
    return extra(
        Extra.INTERVAL_BAR, partial(interval_bar, pair, reach, narrative.css(pair), **form), Markup(""), of
    )


def _physics(c: Comparison, output: str) -> str:
    return " ".join(physics_words(c, output))


def _nonlinear(diagnosis: Diagnosis, output: int) -> str:
    """How nonlinear the training flights are, whatever model is fitted to them."""
    return one_line(diagnosis.nonlinear[output].words) if diagnosis.nonlinear else ""


def _is_same_model(pair: Pair) -> bool:
    """The search for rules took the baseline, parameter for parameter."""
    return pair.ci95 == (0.0, 0.0)


def _size(info: ModelInfo) -> str:
    many = f"{info.n_rules} rules, " if info.n_rules > 1 else "one rule, " if info.fuzzy else ""
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
                        "bar": _bar(pair, reach, channel or output.name, width=190.0) if pair else "",
                        "change": change_words(pair) if pair else "",
                        "interval": interval_words(pair) if pair else "",
                        "badge": narrative.badge(pair) if pair else None,
                        "same": pair is not None and _is_same_model(pair),
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
                info = c.models[name]
                pair = entry.pairs.get(name)
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
                        "worst_segment": one_line(c.segments[score.worst_segment.segment]),
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
    versions = versions or {f"{VERSION}flysid": __version__}
    known["versions"] = ", ".join(f"{k.removeprefix(VERSION)} {v}" for k, v in versions.items())
    return [(label, *_fold(value)) for label, value in known.items()]


def _fold(value: str) -> tuple[str, list[str]]:
    """The first sentence and the others of what is too long to be read in passing."""
    first, *rest = value.split("; ")
    return (first, rest) if len(value) > LONG and rest else (value, [])
