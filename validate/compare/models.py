"""Fitted models against each other on held-out data: plain numbers, intervals and verdicts.

The rules of fairness: the test part is only read; all models start from the same measured samples
(`flysid.validate.compare.trials`); the free run is the headline; errors are in the output's unit; divergence
is a loss.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError, UsageError
from flysid.model.base import Fitted
from flysid.model.linear_choice import FIRST, best_fitted
from flysid.model.structures import OWN, kind_of, leaders, row_of
from flysid.validate.compare.comparison import Comparison, Entry, ModelInfo, ModelScore, Pair, SegmentScore
from flysid.validate.compare.intervals import Interval, change, distance, holm
from flysid.validate.compare.metrics import pool, resolution_of, scores
from flysid.validate.compare.neighbours import flights_began
from flysid.validate.compare.trials import (
    FREE_RUN,
    StructureTrial,
    check_models,
    horizon_name,
    run_trials,
    start_of,
)
from flysid.validate.compare.verdict import Evidence, Verdict, decide

HORIZONS: tuple[str | int, ...] = (FREE_RUN, 10, 1)
C = TypeVar("C", bound=Comparison)


def compare_models(
    models: Sequence[Fitted] | Mapping[str, Fitted],
    test: Dataset,
    *,
    horizons: Sequence[str | int] = HORIZONS,
    baseline: str | None = None,
    contender: str | None = None,
    train: Dataset | None = None,
    seen: Collection[str] = (),
    turns: Sequence[Turn] = (),
) -> Comparison:
    """Compare fitted models on held-out data; see `flysid.compare`."""
    named = dict(models) if isinstance(models, Mapping) else _name(models)
    if train is not None:
        named = with_references(named, train)
        seen = {*seen, *_in_both(train, test), *(set(train.flights) - set(test.flights))}
    check_models(named, test)
    sides = sides_of(named, baseline or _best_linear(named, contender, train), contender, seen)
    names = [horizon_name(h) for h in dict.fromkeys(horizons)]
    if not names:
        raise UsageError("no horizon given", hint="use 'free_run', 10 and 1")
    head = FREE_RUN if FREE_RUN in names else names[0]
    entries: list[Entry] = []
    scored = 0
    start_s = 0.0
    for horizon in names:
        trials = run_trials(named, test, horizon)
        scored = max(scored, len(trials))
        if horizon == FREE_RUN:
            start_s = max(t.first for t in trials) * test.dt_s
        who = sides if horizon == head else replace(sides, rivals=())
        entries += _entries((trials, test), _in_turn(turns, named, horizon), horizon, who)
    comparison = Comparison(
        channel=test.name,
        dt_s=test.dt_s,
        models={name: _info(name, model) for name, model in named.items()},
        baseline=sides.base,
        contender=sides.contender,
        entries=tuple(entries),
        lags=start_of(named),
        start_s=start_s,
        scored_segments=scored,
        unused_segments=len(test.segments) - scored,
        test_hash=test.content_hash(),
        fitted=named,
        test=test,
    )
    return across_channels({"": comparison})[""]


def across_channels(comparisons: Mapping[str, C]) -> dict[str, C]:
    """The same comparisons with p-values corrected (Holm) over channels and outputs, verdicts decided anew.

    A family is one horizon and one pair of models. Doing it again changes nothing. Against rivals a channel
    is better only where all tests say so, which needs no correction over rivals (Berger, 1982).
    """
    families: dict[tuple[str, str, bool], list[Pair]] = {}
    for c in comparisons.values():
        for e in c.entries:
            for pairs, rival in ((e.pairs, False), (e.rivals, True)):
                for name, pair in pairs.items():
                    families.setdefault((e.horizon, name, rival), []).append(pair)
    corrected: dict[int, Pair] = {}
    for family in families.values():
        tested = [pair for pair in family if pair.p is not None]
        for pair, p in zip(tested, holm([t.p for t in tested if t.p is not None]), strict=True):
            evidence = replace(pair.evidence, p=p)
            verdict, reason = decide(evidence)
            corrected[id(pair)] = replace(pair, p_holm=p, evidence=evidence, verdict=verdict, reason=reason)
    return {
        channel: replace(c, entries=tuple(_with_pairs(e, corrected) for e in c.entries))
        for channel, c in comparisons.items()
    }


def _with_pairs(entry: Entry, corrected: Mapping[int, Pair]) -> Entry:
    both = entry.pairs, entry.rivals
    pairs, rivals = ({n: corrected.get(id(p), p) for n, p in old.items()} for old in both)
    lost = tuple(name for name, pair in rivals.items() if pair.verdict is not Verdict.BETTER)
    for model in {pair.model for pair in rivals.values()}:
        pairs[model] = replace(pairs[model], short_of=lost)
    return replace(entry, pairs=pairs, rivals=rivals)


def headline(labels: Collection[str], baseline: str) -> str:
    """The model that a run is about: its fuzzy one, or where there is none its baseline."""
    return next((label for label in leaders() if label in labels), baseline)


def sides_of(
    models: Mapping[str, Fitted],
    baseline: str | None,
    contender: str | None = None,
    seen: Collection[str] = (),
) -> Sides:
    """Who is compared with whom; arguments and errors as `compare`.

    Rivals are there for a fuzzy contender against a linear baseline.
    """
    base = _baseline(models, baseline)
    if contender is not None and (contender not in models or contender == base):
        raise UsageError(f"the contender {contender!r} is not among the models compared with {base!r}")
    contender = contender or _contender(models, base)
    one_rule = _one_rule(models)
    if kind_of(models[base].structure) == "rules" and base not in one_rule:
        return Sides(base, contender, (), frozenset(), frozenset(seen))
    has_rules = contender is not None and kind_of(models[contender].structure) == "rules"
    fuzzy = contender in one_rule or has_rules
    linear = _linear(models)
    rivals = [n for n in models if fuzzy and n in linear and n not in (base, contender)]
    return Sides(base, contender, tuple(rivals), one_rule, frozenset(seen))


def _one_rule(models: Mapping[str, Fitted]) -> frozenset[str]:
    """Fuzzy models that are linear ones: of one rule, or what the search for rules took instead of them."""
    alone = {n: m for n, m in models.items() if len(m.rules()) == 1}
    return frozenset(n for n, m in alone.items() if kind_of(m.structure) == "rules" or n in leaders())


def _linear(models: Mapping[str, Fitted]) -> frozenset[str]:
    return _one_rule(models) | {n for n, m in models.items() if kind_of(m.structure) == "linear"}


def with_references(models: Mapping[str, Fitted], train: Dataset) -> dict[str, Fitted]:
    """The same models, and the references that are not among them, fitted to `train`."""
    there = {m.structure for m in models.values()}
    missing = [row for row in OWN.values() if row.kind == "reference" and row.file_name not in there]
    return {**models, **{row.name: row.settings({}).fit(train) for row in missing}}


def _in_both(train: Dataset, test: Dataset) -> set[str]:
    """Flights of which other parts were trained on; one name at one time stands for two flights."""
    spans: dict[str, list[tuple[int, int]]] = {}
    for s in train.segments:
        spans.setdefault(s.flight, []).append(_span(s, train.dt_s))
    alike = {s.flight for s in test.segments if s.flight in spans}
    return alike - {
        s.flight
        for s in test.segments
        for first, last in spans.get(s.flight, ())
        if first <= _span(s, test.dt_s)[1] and _span(s, test.dt_s)[0] <= last
    }


def _span(s: Segment, dt_s: float) -> tuple[int, int]:
    """Time of the first and the last sample, ns."""
    return s.t0_ns, s.t0_ns + round((len(s) - 1) * dt_s * 1e9)


def _name(models: Sequence[Fitted]) -> dict[str, Fitted]:
    named: dict[str, Fitted] = {}
    for model in models:
        name = model.structure
        alike = sum(m.structure == name for m in named.values())
        named[f"{name}-{alike + 1}" if alike else name] = model
    return named


def _baseline(models: Mapping[str, Fitted], wanted: str | None) -> str:
    if wanted is not None and wanted not in models:
        raise UsageError(f"the baseline {wanted!r} is not among the models: {', '.join(sorted(models))}")
    return wanted or (FIRST if FIRST in models else next(iter(models)))


def _best_linear(models: Mapping[str, Fitted], contender: str | None, train: Dataset | None) -> str | None:
    """The linear model that follows `train` best; None where there is none to tell by."""
    linear = _linear(models) - {contender, *leaders()}
    if train is None or not linear:
        return None
    with suppress(DataError):
        return best_fitted({n: m for n, m in models.items() if n in linear}, train).label
    return None


def _contender(models: Mapping[str, Fitted], base: str) -> str | None:
    others = [n for n, m in models.items() if n != base and kind_of(m.structure) != "reference"]
    # a static one's loss would tell nobody anything
    dynamic = [n for n in others if not row_of(models[n].structure).least]
    first = next(iter([*dynamic, *others]), None)
    return next((label for label in leaders() if label in others), first)


def _info(name: str, model: Fitted) -> ModelInfo:
    return ModelInfo(
        name, model.structure, model.n_parameters, len(model.rules()), model.n_init, tuple(model.notes)
    )


@dataclass(frozen=True)
class _Errors:
    """Of the models that all parts have, on one output, by model and segment; the flight of each segment."""

    of: Mapping[str, list[FloatArray]]
    flights: Sequence[str]


@dataclass(frozen=True)
class _Panel:
    """One output at one horizon: what every pair of models is judged on."""

    errors: _Errors
    models: Mapping[str, ModelScore]
    resolution: float
    dt_s: float
    still: bool
    began: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Turn:
    """Models by label, flights that they have not seen, and those that the compared models have seen, too."""

    models: Mapping[str, Fitted]
    test: Dataset
    both: Dataset


OF_TURN = "turn:"
"""Before the labels of a turn's models, where the compared ones stand beside them."""
Judged = tuple[Sequence[StructureTrial], Dataset]
"""Free runs or predictions, and the data that they are of."""


@dataclass(frozen=True)
class _Turned:
    """A turn's models on what they have not seen; on what both have, they (OF_TURN) and the compared ones."""

    unseen: Judged
    both: Judged


@dataclass(frozen=True)
class Sides:
    """Who is compared with whom: the baseline, the contender and the other linear models, the fuzzy models of
    one rule; flights that they were trained on."""

    base: str
    contender: str | None
    rivals: tuple[str, ...]
    one_rule: frozenset[str]
    seen: frozenset[str]


def _in_turn(turns: Sequence[Turn], models: Mapping[str, Fitted], horizon: str) -> list[_Turned]:
    """What the models of every turn do, as far as its flights are long enough."""
    found: list[_Turned] = []
    for turn in turns:
        with suppress(DataError):
            unseen = run_trials(turn.models, turn.test, horizon), turn.test
            every = {**models, **{OF_TURN + name: model for name, model in turn.models.items()}}
            found.append(_Turned(unseen, (run_trials(every, turn.both, horizon), turn.both)))
    return found


def _entries(here: Judged, turns: Sequence[_Turned], horizon: str, sides: Sides) -> list[Entry]:
    entries = []
    for j, output in enumerate(here[1].outputs):
        panel = _panel([here], j)
        rotation = _rotation(turns, j) if len(turns) > 1 else None
        pairs = {name: _pair(panel, rotation, sides, name) for name in panel.models if name != sides.base}
        rivals = {
            name: _pair(panel, rotation, replace(sides, base=name), sides.contender)
            for name in sides.rivals
            if sides.contender is not None
        }
        entries.append(Entry(output, horizon, panel.models, pairs, panel.resolution, rivals))
    return entries


@dataclass(frozen=True)
class _Rotation:
    """One output at one horizon: every flight by models that have not seen it; and the turns one by one.

    `turns`: of every turn the flights left out, and the errors on those that both have seen.
    """

    panel: _Panel
    turns: Sequence[tuple[Sequence[str], _Errors]]

    def apart(self, base: str, name: str) -> dict[str, tuple[float, float]]:
        """How far the models that judge a flight are from those compared (`intervals.distance`)."""
        found = {}
        for left_out, both in self.turns:
            own, compared = ((both.of[who + base], both.of[who + name]) for who in (OF_TURN, ""))
            found.update(dict.fromkeys(left_out, distance(own, compared, both.flights)))
        return found


def _rotation(turns: Sequence[_Turned], j: int) -> _Rotation:
    whole = _panel([turn.unseen for turn in turns], j)
    return _Rotation(whole, [(_errors([t.unseen], j).flights, _errors([t.both], j)) for t in turns])


def _errors(parts: Sequence[Judged], j: int) -> _Errors:
    trials = [t for some, _ in parts for t in some]
    names = [name for name in trials[0].yh if all(name in t.yh for t in trials)]
    flights = [test.segments[t.segment].flight for some, test in parts for t in some]
    return _Errors({name: [t.y[:, j] - t.yh[name][:, j] for t in trials] for name in names}, flights)


def _panel(parts: Sequence[Judged], j: int) -> _Panel:
    trials = [t for some, _ in parts for t in some]
    inputs = [test.segments[t.segment].u for some, test in parts for t in some]
    output = parts[0][1].outputs[j]
    errors = _errors(parts, j)
    return _Panel(
        errors=errors,
        models={name: _model_score(trials, errors.flights, name, j) for name in errors.of},
        resolution=resolution_of([t.y[:, j] for t in trials], output.resolution),
        dt_s=parts[0][1].dt_s,
        still=not np.ptp(np.concatenate(inputs), axis=0).any(),
        began=flights_began([test.segments[t.segment] for some, test in parts for t in some]),
    )


def _model_score(trials: Sequence[StructureTrial], flights: Sequence[str], name: str, j: int) -> ModelScore:
    segments = tuple(
        SegmentScore(t.segment, flight, scores(t.y[:, j], t.yh[name][:, j]), t.diverged_s.get(name))
        for t, flight in zip(trials, flights, strict=True)
    )
    return ModelScore(pool([t.y[:, j] for t in trials], [t.yh[name][:, j] for t in trials]), segments)


def _pair(panel: _Panel, rotation: _Rotation | None, sides: Sides, name: str) -> Pair:
    """The pair, judged in turn where every turn has both models."""
    base = sides.base
    apart = None
    if rotation is not None and {name, base} <= rotation.panel.models.keys():
        panel = rotation.panel
        apart = rotation.apart(base, name)
    a = panel.models[base]
    b = panel.models[name]
    lost = bool(a.diverged or b.diverged)
    errors = panel.errors
    seen = () if apart is not None else sides.seen
    found = change(errors.of[base], errors.of[name], errors.flights, seen, apart=apart, began=panel.began)
    interval = None if lost else found.interval
    evidence = replace(_evidence(a, b, panel.resolution, interval), still=panel.still)
    verdict, reason = decide(evidence)
    change_pct = interval.change_pct if interval else None
    if interval is None and a.scores.rmse > 0.0 and not lost:
        change_pct = 100.0 * float(np.minimum(b.scores.rmse / a.scores.rmse, 1e300) - 1.0)
    return Pair(
        model=name,
        baseline=base,
        change_pct=change_pct,
        ci95=(interval.low_pct, interval.high_pct) if interval else None,
        p=interval.p if interval else None,
        p_holm=interval.p if interval else None,
        unit="flights" if not found.block else f"blocks of {found.block * panel.dt_s:.3g} s",
        basis=found,
        evidence=evidence,
        verdict=verdict,
        reason=reason,
        one_rule=name in sides.one_rule,
    )


def _evidence(a: ModelScore, b: ModelScore, resolution: float, interval: Interval | None) -> Evidence:
    return Evidence(
        rmse_baseline=a.scores.rmse,
        rmse_model=b.scores.rmse,
        resolution=resolution,
        diverged_baseline=bool(a.diverged),
        diverged_model=bool(b.diverged),
        low_pct=interval.low_pct if interval else None,
        high_pct=interval.high_pct if interval else None,
        p=interval.p if interval else None,
        constant=a.scores.fit_pct is None,
    )
