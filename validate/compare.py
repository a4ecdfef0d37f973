"""Fitted models against each other on held-out data: plain numbers, intervals and verdicts.

The rules of fairness: the test part is only read; all models start from the same measured samples
(`flysid.validate.trials`); the free run is the headline; errors are in the output's unit; divergence
is a loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.base import Fitted
from flysid.validate.bootstrap import (
    Interval,
    Units,
    block_length,
    change_interval,
    diebold_mariano,
    holm,
    make_units,
)
from flysid.validate.metrics import Scores, pooled, resolution_of, scores
from flysid.validate.trials import (
    FREE_RUN,
    Trial,
    check_models,
    horizon_name,
    run_trials,
    start_of,
)
from flysid.validate.verdict import Evidence, Verdict, decide

HORIZONS: tuple[str | int, ...] = (FREE_RUN, 10, 1)


@dataclass(frozen=True)
class SegmentScore:
    """One model on one held-out segment: its index, its flight, its scores."""

    segment: int
    flight: str
    scores: Scores
    diverged_s: float | None


@dataclass(frozen=True)
class ModelScore:
    """One model on one output at one horizon: pooled and per segment."""

    scores: Scores
    segments: tuple[SegmentScore, ...]

    @property
    def diverged(self) -> tuple[SegmentScore, ...]:
        return tuple(s for s in self.segments if s.diverged_s is not None)

    @property
    def worst_segment(self) -> SegmentScore:
        return max(self.segments, key=lambda s: s.scores.rmse)


@dataclass(frozen=True)
class Pair:
    """One model against the baseline on one output at one horizon.

    Attributes
    ----------
    change_pct : 100 (RMSE - RMSE of baseline) / RMSE of baseline; below 0 the model is better. None where
        the baseline's error is zero or a model diverged.
    ci95 : its 95 % interval, or None.
    p, p_holm : two-sided bootstrap p-value of no change, before and after Holm's correction.
    p_dm : Diebold-Mariano p-value, a second opinion that no verdict uses.
    units, unit : how many independent units, and what they are ("flights" or "blocks of 1.2 s").
    """

    model: str
    baseline: str
    change_pct: float | None
    ci95: tuple[float, float] | None
    p: float | None
    p_holm: float | None
    p_dm: float | None
    units: int
    unit: str
    evidence: Evidence
    verdict: Verdict
    reason: str


@dataclass(frozen=True)
class Entry:
    """One output at one horizon: every model's scores, every pair."""

    output: Signal
    horizon: str
    models: Mapping[str, ModelScore]
    pairs: Mapping[str, Pair]
    resolution: float


@dataclass(frozen=True)
class ModelInfo:
    """What a reader needs to know of a model."""

    name: str
    structure: str
    n_parameters: int
    n_rules: int
    n_init: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """Models compared on the held-out segments of one channel.

    Attributes
    ----------
    channel : name of the dataset.
    models : by name, in the order given.
    baseline, contender : the pair the headline speaks of; contender is None for a single model.
    entries : one per output and horizon.
    lags : measured samples that every model needs at least.
    start_s : the longest window at a segment's start that gave the starting state of a free run; not scored.
    unused_segments : held-out segments too short to score in free run.
    test_hash : content hash of the test part.
    fitted, test : what was compared, for drawing; not part of equality.
    """

    channel: str
    dt_s: float
    models: Mapping[str, ModelInfo]
    baseline: str
    contender: str | None
    entries: tuple[Entry, ...]
    lags: int
    start_s: float
    scored_segments: int
    unused_segments: int
    test_hash: str
    fitted: Mapping[str, Fitted] = field(repr=False, compare=False)
    test: Dataset = field(repr=False, compare=False)

    @property
    def horizons(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(e.horizon for e in self.entries))

    @property
    def verdict(self) -> dict[str, Pair]:
        """The headline pair in free run (or the first horizon), by output name."""
        if self.contender is None:
            return {}
        head = self.horizons[0] if FREE_RUN not in self.horizons else FREE_RUN
        return {e.output.name: e.pairs[self.contender] for e in self.entries if e.horizon == head}

    def entry(self, output: str | None = None, horizon: str | int = FREE_RUN) -> Entry:
        """The entry of an output (the first when None) at a horizon.

        Raises
        ------
        UsageError : there is no such entry.
        """
        name = horizon_name(horizon)
        for e in self.entries:
            if e.horizon == name and output in (None, e.output.name):
                return e
        raise UsageError(f"no output {output!r} at horizon {name!r} in this comparison")

    def to_json(self) -> dict[str, Any]:
        """The JSON document of this comparison alone."""
        from flysid.validate.document import to_json

        return to_json({self.channel or "channel": self})

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of this comparison alone; returns the path."""
        from flysid.validate.report import ReportContext, write_report

        return write_report(path, ReportContext.of({self.channel or "channel": self}))

    def _repr_html_(self) -> str:
        from flysid.validate.tables import to_html

        return str(to_html({self.channel or "channel": self}))

    def __str__(self) -> str:
        from flysid.validate.terminal import table

        return table({self.channel or "channel": self})


def compare(
    models: Sequence[Fitted] | Mapping[str, Fitted],
    test: Dataset,
    *,
    horizons: Sequence[str | int] = HORIZONS,
    baseline: str | None = "arx",
    contender: str | None = None,
    seed: int = 0,
) -> Comparison:
    """Compare fitted models on held-out data.

    Parameters
    ----------
    models : by name, or a list (named by structure: "arx", "ts", "ts-2", ...).
    test : the held-out part; nothing is fitted to it.
    horizons : "free_run" and numbers of steps.
    baseline : the model the others are compared with; the first one where there is no "arx" or it is None.
    contender : the model the headline speaks of; "ts" where there is one, else the first, when None.
    seed : of the bootstrap.

    Raises
    ------
    UsageError : a model does not belong to the data, or the baseline is not among the models.
    DataError : no segment is long enough to score.
    """
    named = dict(models) if isinstance(models, Mapping) else _named(models)
    check_models(named, test)
    base = _baseline(named, baseline)
    if contender is not None and (contender not in named or contender == base):
        raise UsageError(f"the contender {contender!r} is not among the models compared with {base!r}")
    names = [horizon_name(h) for h in dict.fromkeys(horizons)]
    if not names:
        raise UsageError("no horizon given", hint="use 'free_run', 10 and 1")
    entries: list[Entry] = []
    scored, start_s = 0, 0.0
    for horizon in names:
        trials = run_trials(named, test, horizon)
        scored = max(scored, len(trials))
        if horizon == FREE_RUN:
            start_s = max(t.first for t in trials) * test.dt_s
        entries += _entries(trials, test, horizon, base, seed)
    comparison = Comparison(
        channel=test.name,
        dt_s=test.dt_s,
        models={name: _info(name, model) for name, model in named.items()},
        baseline=base,
        contender=contender or _contender(named, base),
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


def across_channels(comparisons: Mapping[str, Comparison]) -> dict[str, Comparison]:
    """The same comparisons with p-values corrected (Holm) over channels and outputs, verdicts decided anew.

    A family is one horizon and one pair of models. Doing it again changes nothing.
    """
    families: dict[tuple[str, str], list[Pair]] = {}
    for c in comparisons.values():
        for e in c.entries:
            for name, pair in e.pairs.items():
                families.setdefault((e.horizon, name), []).append(pair)
    corrected: dict[int, Pair] = {}
    for pairs in families.values():
        tested = [pair for pair in pairs if pair.p is not None]
        for pair, p in zip(tested, holm([t.p for t in tested if t.p is not None]), strict=True):
            evidence = replace(pair.evidence, p=p)
            verdict, reason = decide(evidence)
            corrected[id(pair)] = replace(pair, p_holm=p, evidence=evidence, verdict=verdict, reason=reason)
    return {
        channel: replace(c, entries=tuple(_with_pairs(e, corrected) for e in c.entries))
        for channel, c in comparisons.items()
    }


def _with_pairs(entry: Entry, corrected: Mapping[int, Pair]) -> Entry:
    return replace(entry, pairs={n: corrected.get(id(p), p) for n, p in entry.pairs.items()})


def _named(models: Sequence[Fitted]) -> dict[str, Fitted]:
    named: dict[str, Fitted] = {}
    for model in models:
        name, count = model.structure, 2
        while name in named:
            name, count = f"{model.structure}-{count}", count + 1
        named[name] = model
    return named


def _baseline(models: Mapping[str, Fitted], wanted: str | None) -> str:
    if wanted in models:
        return str(wanted)
    if wanted not in (None, "arx"):
        raise UsageError(f"the baseline {wanted!r} is not among the models {sorted(models)}")
    return next(iter(models))


def _contender(models: Mapping[str, Fitted], base: str) -> str | None:
    others = [name for name in models if name != base]
    return "ts" if "ts" in others else next(iter(others), None)


def _info(name: str, model: Fitted) -> ModelInfo:
    return ModelInfo(
        name, model.structure, model.n_parameters, len(model.rules()), model.n_init, tuple(model.notes)
    )


@dataclass(frozen=True)
class _Panel:
    """One output at one horizon: what every pair of models is judged on."""

    errors: Mapping[str, list[FloatArray]]
    models: Mapping[str, ModelScore]
    flights: Sequence[str]
    resolution: float
    dt_s: float


def _entries(trials: Sequence[Trial], test: Dataset, horizon: str, base: str, seed: int) -> list[Entry]:
    entries = []
    for j, output in enumerate(test.outputs):
        panel = _panel(trials, test, j)
        pairs = {name: _pair(panel, base, name, seed) for name in panel.models if name != base}
        entries.append(Entry(output, horizon, panel.models, pairs, panel.resolution))
    return entries


def _panel(trials: Sequence[Trial], test: Dataset, j: int) -> _Panel:
    flights = [test.segments[t.segment].flight for t in trials]
    names = list(trials[0].yh)
    return _Panel(
        errors={name: [t.y[:, j] - t.yh[name][:, j] for t in trials] for name in names},
        models={name: _model_score(trials, flights, name, j) for name in names},
        flights=flights,
        resolution=resolution_of([t.y[:, j] for t in trials], test.outputs[j].resolution),
        dt_s=test.dt_s,
    )


def _model_score(trials: Sequence[Trial], flights: Sequence[str], name: str, j: int) -> ModelScore:
    segments = tuple(
        SegmentScore(t.segment, flight, scores(t.y[:, j], t.yh[name][:, j]), t.diverged_s.get(name))
        for t, flight in zip(trials, flights, strict=True)
    )
    return ModelScore(pooled([t.y[:, j] for t in trials], [t.yh[name][:, j] for t in trials]), segments)


def _pair(panel: _Panel, base: str, name: str, seed: int) -> Pair:
    a, b = panel.models[base], panel.models[name]
    ea, eb = panel.errors[base], panel.errors[name]
    lost = bool(a.diverged or b.diverged)
    units = make_units(ea, eb, panel.flights)
    interval = None if lost else change_interval(units, seed)
    evidence = _evidence(a, b, panel.resolution, interval)
    verdict, reason = decide(evidence)
    change = None
    if a.scores.rmse > 0.0 and not lost:
        change = 100.0 * float(np.minimum(b.scores.rmse / a.scores.rmse, 1e300) - 1.0)
    lags = units.length or block_length(ea, eb)
    return Pair(
        model=name,
        baseline=base,
        change_pct=change,
        ci95=(interval.low_pct, interval.high_pct) if interval else None,
        p=interval.p if interval else None,
        p_holm=interval.p if interval else None,
        p_dm=None if lost else diebold_mariano(ea, eb, lags),
        units=len(units.a),
        unit=_unit_words(units, panel.dt_s),
        evidence=evidence,
        verdict=verdict,
        reason=reason,
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


def _unit_words(units: Units, dt_s: float) -> str:
    return "flights" if units.kind == "flights" else f"blocks of {units.length * dt_s:.3g} s"
