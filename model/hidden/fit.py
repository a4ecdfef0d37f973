"""From settings and data to a chosen TS state-space model: states, coordinates, rules, and the reasons."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.fuzzy.choice import hold_out
from flysid.model.fuzzy.layout import Antecedent, parse_antecedent, scaling
from flysid.model.hidden.choice import Family, Start, chosen
from flysid.model.hidden.grow import (
    StateStage,
    Training,
    linear_stage,
    on_runs_of,
    one_rule_more,
    ordered,
    refine,
    with_ridge,
)
from flysid.model.hidden.judge import ends_of_travel, is_bounded, judged
from flysid.model.hidden.layout import StateLayout, runs_of
from flysid.model.hidden.start import coordinates, realised
from flysid.model.linear.model import FittedLinear
from flysid.model.oe import OE

_LOW = 3  # orders up to this are tried with one more: rules may use a state that a linear model does not
_RIDGES = (0.01, 0.1)
_LARGE = 10_000  # samples from which on one start and one ridge must do
_SAMPLES = 2  # that there must be per consequent
_SCREEN_ROWS = 3000  # of every part, in pieces of
_PIECE = 1000
_KEPT = 3  # starts that are grown over all folds,
_SCREEN_RULES = 3  # the best with this many rules, strongly held together
_SMALL = 4000  # samples below which every quarter is held out in turn
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_SPARE_ROWS = 12  # a segment must be longer than its start by this to say anything


class Settings(Protocol):
    """What `learn` needs to know; `TSStateSpace` is one."""

    @property
    def states(self) -> int | Literal["auto"]: ...
    @property
    def rules(self) -> int | Literal["auto"]: ...
    @property
    def antecedents(self) -> Sequence[str] | Literal["auto"]: ...
    @property
    def nk(self) -> int | Sequence[int] | Literal["auto"]: ...
    @property
    def most_rules(self) -> int: ...
    @property
    def iterations(self) -> int: ...
    @property
    def ridge(self) -> float | Literal["auto"]: ...


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage on all training runs, and how it was chosen.

    Attributes
    ----------
    folds : the block errors of models of these settings on every judging part, before they saw it, in
        variances of the outputs.
    """

    stage: StateStage
    notes: tuple[str, ...]
    folds: tuple[FloatArray, ...]


def check(settings: Settings) -> None:
    """Raise UsageError for settings that cannot be."""
    for name in ("states", "rules"):
        value = getattr(settings, name)
        if value != "auto" and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
            raise UsageError(f"{name}={value!r}", hint='give "auto" or a whole number from 1 on')
    if settings.most_rules < 1 or settings.iterations < 1:
        raise UsageError("most_rules and iterations must be at least 1")
    if settings.ridge != "auto" and not settings.ridge >= 0:
        raise UsageError(f"ridge={settings.ridge!r}", hint='give "auto", or 0 or more; 0.01 is usual')
    if settings.antecedents != "auto" and (isinstance(settings.antecedents, str) or not settings.antecedents):
        raise UsageError(f"antecedents={settings.antecedents!r}", hint='give "auto" or a list of names')


def learn(settings: Settings, train: Dataset, validation: Dataset | None) -> Learned:
    """Choose states and coordinates, then rules, by the validation free run; then learn from all data."""
    check(settings)
    scaled = scaling(train)
    starts = linear_starts(settings, train, scaled)
    depth = max(lag for s in starts for own in s.real.input_lags for lag in own)
    least = depth + 2 * max(len(s.real.A) for s in starts) + _SPARE_ROWS
    longest = max(len(s) for s in train.segments)
    if longest < least:
        raise DataError(
            f"the longest segment has {longest} samples; these states and delays need {least}",
            hint="record longer, allow longer gaps, or ask for fewer states",
        )
    bench = Bench(settings, least, ends_of_travel(train), scaled)
    parts = _parts(train, validation, least)
    many = len(train) > _LARGE
    few = _RIDGES[:1] if many else _RIDGES
    ridges = few if settings.ridge == "auto" else (settings.ridge,)
    kept = bench.screened(starts, parts, max(ridges))[: 1 if many else _KEPT]
    families = [bench.family(s, parts, ridge) for s in kept for ridge in ridges]
    best, at = chosen(families, settings.rules)
    _check_count(settings, best)
    final = ordered(bench.on_everything(best, at, train))
    notes = [_why(best, starts), *_ends(bench.ends, train), *_rule_notes(settings, best, final.rules)]
    return Learned(final, tuple(notes), tuple(fold[at].errors for fold in best.folds))


def _check_count(settings: Settings, family: Family) -> None:
    stage = family.folds[0][-1].stage
    if settings.rules != "auto" and stage.rules < settings.rules:
        raise DataError(
            f"{settings.rules} rules of {stage.body.a[0].size} numbers need more than the "
            f"{stage.problem.samples} samples there are",
            hint="ask for fewer rules or states, or record longer",
        )


def _parts(train: Dataset, validation: Dataset | None, least: int) -> list[tuple[Dataset, Dataset]]:
    """Fitting and judging parts: the given validation, else one held-out quarter, or every one in turn."""
    if validation is not None and any(len(s) >= least for s in validation.segments):
        return [(train, validation)]
    folds = range(4 if len(train) < _SMALL else 1)
    return [hold_out(train, least, fold) for fold in folds]


def linear_starts(settings: Settings, train: Dataset, scaled: tuple[FloatArray, FloatArray]) -> list[Start]:
    """Output-error models of neighbouring orders and delays, in every choice of coordinates.

    A linear model imitates a hidden state, or a bend, by a longer delay: a delay of one sample, that of any
    plant behind a zero-order hold, is always tried besides the one found.

    Raises
    ------
    FitError : no stable linear model was found.
    """
    n_y, n_u = len(train.outputs), len(train.inputs)
    first = _linear(train, OE(nk=settings.nk))
    order = len(first.system.a) - 1 if first else 2
    orders = sorted({2, order, order + 1} if order <= _LOW else {2, order})
    if settings.states != "auto":
        orders = [max(1, -(-settings.states // n_y))]
    delays = {_delays(first)} if first else set()
    delays |= {(1,) * n_u} if settings.nk == "auto" else {_given(settings.nk, n_u)}
    found = []
    for n, nk in ((n, nk) for n in orders for nk in sorted(delays)):
        fitted = _linear(train, OE(na=n, nb=[n + (k == 0) for k in nk], nk=nk))
        if fitted:
            found += [Start(g, n) for g in coordinates(realised(fitted, *scaled), n_y)]
    if not found:
        raise FitError("no stable linear model was found to start from", hint="check the data for gaps")
    return found


def _linear(train: Dataset, estimator: OE) -> FittedLinear | None:
    try:
        return estimator.fit(train)
    except FitError:
        return None


def _given(nk: int | Sequence[int], n_u: int) -> tuple[int, ...]:
    return (nk,) * n_u if isinstance(nk, int) else tuple(nk)


def _delays(fitted: FittedLinear) -> tuple[int, ...]:
    """The smallest lag of every input over all outputs."""
    taps = np.abs(fitted.system.b).max(axis=1)
    return tuple(int(np.flatnonzero(t)[0]) if t.any() else 1 for t in taps.T)


@dataclass(frozen=True, eq=False)
class Bench:
    """What all stages of one fit share."""

    settings: Settings
    least: int
    ends: FloatArray
    scaled: tuple[FloatArray, FloatArray]

    def stage(self, start: Start, data: Dataset) -> StateStage:
        """The refined linear model from this start."""
        shift, scale = self.scaled
        n_y, hidden = len(data.outputs), len(start.real.A) - len(data.outputs)
        layout = StateLayout(
            data.outputs,
            data.inputs,
            hidden,
            start.real.input_lags,
            (),
            np.concatenate([shift[:n_y], np.zeros(hidden), shift[n_y:]]),
            np.concatenate([scale[:n_y], np.ones(hidden), scale[n_y:]]),
        )
        ends = (self.ends - shift[:n_y]) / scale[:n_y]
        return linear_stage(layout, runs_of(layout, data.segments, self.least), start.real, ends, 20)

    def grown(self, stage: StateStage, most: int, ridge: float) -> list[StateStage]:
        """Models with 1 to `most` rules; fewer where samples are few, or nothing is left to explain."""
        how = Training(ridge=ridge, iterations=self.settings.iterations)
        candidates, stages = self.candidates(stage.layout), [stage]
        while len(stages) < most and stage.body.a.size * (len(stages) + 1) * _SAMPLES < stage.problem.samples:
            if self.settings.rules == "auto" and stages[-1].mean_square() < _EXACT:
                break
            stages.append(one_rule_more(stages[-1], candidates, how))
        return stages

    def candidates(self, layout: StateLayout) -> tuple[Antecedent, ...]:
        """Variables that rules may look at: those asked for, or all."""
        if self.settings.antecedents == "auto":
            return layout.candidates()
        states = layout.signals[: layout.n]
        return tuple(parse_antecedent(a, states, layout.inputs) for a in self.settings.antecedents)

    @property
    def most(self) -> int:
        """Where growth stops."""
        return self.settings.most_rules if self.settings.rules == "auto" else self.settings.rules

    def screened(
        self, starts: Sequence[Start], parts: Sequence[tuple[Dataset, Dataset]], ridge: float
    ) -> list[Start]:
        """The few starts from which few rules do best."""
        if len(starts) <= _KEPT:
            return list(starts)
        few = min(self.most, _SCREEN_RULES)
        short = [(_sampled(a, _SCREEN_ROWS), _sampled(b, _SCREEN_ROWS)) for a, b in parts]
        tried = [self.family(s, short, ridge, few) for s in starts]
        tried.sort(key=lambda f: float(f.rmse.min()))
        return [f.start for f in tried[:_KEPT]]

    def family(
        self,
        start: Start,
        parts: Sequence[tuple[Dataset, Dataset]],
        ridge: float,
        most: int | None = None,
    ) -> Family:
        """Models grown from one start on the fitting part of every fold, judged on the other part."""
        folds = []
        for fit_part, check_part in parts:
            stages = self.grown(self.stage(start, fit_part), most or self.most, ridge)
            runs = runs_of(stages[0].layout, check_part.segments, self.least)
            found = [judged(s, runs, self.least - _SPARE_ROWS) for s in stages]
            if not found[0].bounded:  # the process integrates: linear models of it drift, too
                found = [replace(m, bounded=True) for m in found]
            folds.append(tuple(found))
        return Family(start, ridge, tuple(folds))

    def on_everything(self, family: Family, at: int, train: Dataset) -> StateStage:
        """The chosen model on all training data: grown again, or refined from the first fold's.

        Fewer rules where it does not come back from bounded random inputs.
        """
        start = self.stage(family.start, train)
        stages = self.grown(start, at + 1, family.ridge)
        kept = on_runs_of(family.folds[0][at].stage, start)
        kept = with_ridge(kept, family.ridge * kept.mean_square())
        kept = refine(kept, self.settings.iterations, 1e-6)
        options = [stages[-1], kept] if np.isfinite(kept.cost) else [stages[-1]]
        options = sorted(options, key=lambda s: s.mean_square()) + stages[-2::-1]
        if not is_bounded(start):
            return options[0]
        return next((s for s in options if is_bounded(s)), start)


def _sampled(data: Dataset, rows: int) -> Dataset:
    """About `rows` rows of a dataset in evenly spaced pieces."""
    if len(data) <= rows:
        return data
    pieces = []
    for segment in data.segments:
        count = max(1, round(len(segment) / _PIECE))
        edges = np.linspace(0, len(segment), count + 1).astype(int)
        pieces += [segment.slice(int(a), int(b), data.dt_s) for a, b in itertools.pairwise(edges)]
    every = max(1, round(len(data) / rows))
    return data.with_segments(pieces[every // 2 :: every] or pieces[:1])


def _why(best: Family, starts: Sequence[Start]) -> str:
    tried = "; ".join(dict.fromkeys(str(s) for s in starts))
    many = f" (tried, in several coordinates: {tried})" if len(starts) > 1 else ""
    hidden = len(best.start.real.A) > len(best.folds[0][0].stage.layout.outputs)
    words = (
        f" Hidden states: {best.start.real.words}, in units of their spread in training." if hidden else ""
    )
    return f"{str(best.start)[0].upper()}{str(best.start)[1:]}{many}.{words}"


def _ends(ends: FloatArray, train: Dataset) -> list[str]:
    return [
        f"{signal.name} {word} {ends[side, i]:.4g} {signal.unit}".rstrip()
        + ", where it came to a stop repeatedly: taken as an end of its travel."
        for side, word in enumerate(("never falls below", "never exceeds"))
        for i, signal in enumerate(train.outputs)
        if np.isfinite(ends[side, i])
    ]


def _rule_notes(settings: Settings, family: Family, rules: int) -> list[str]:
    tried = ", ".join(f"{i + 1}: {e:.3g}" for i, e in enumerate(family.rmse))
    sweep = f"Validation free-run error by number of rules, in standard deviations of the output: {tried}."
    if settings.rules != "auto":
        return [
            sweep,
            f"{rules} rules, as asked." if rules == settings.rules else f"{rules} rules came back.",
        ]
    if rules == 1:
        return [sweep, "One rule is enough: more rules do not lower the validation error beyond its spread."]
    return [sweep, f"{rules} rules: the fewest within one standard error of the best."]
