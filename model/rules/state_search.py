"""Growing rules from many linear starts without growing them all: most are given up early.

Every linear system is judged with one rule over all held-out parts. From the promising ones, in every choice
of coordinates, two rules are grown on a single part; the few best of those are grown further over all parts,
as long as rules help. Where a rule goes is found on the first part; the others place theirs likewise, and
search for themselves only where that helps them less.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.growth import Insertion, Training, one_rule_more, same_insertion, thinned
from flysid.model.rules.judging import Candidate
from flysid.model.rules.realisation import PLAIN, Realisation, coordinates
from flysid.model.rules.state_choice import Family, Start
from flysid.model.rules.state_context import LARGE, StateContext
from flysid.model.rules.state_systems import System

_SCREEN_ROWS = 3000  # of the first fitting part, and of the first judging part
_SEARCH_ROWS = 20_000  # of a fitting part, where data are longer: a plant that integrates needs its whole
_PIECES = 4  # that a long part is cut into at least, each of
_PIECE = 1000  # rows at least
_KEPT = 2  # starts that are grown over all parts
_MOST_STATES = 8  # of a system that rules are grown from
_LEVEL = 1.02  # times the least error: as good, if it has fewer states
_RAN_AWAY = 1e2  # error of a single rule, in standard deviations of the output
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_FEWER_TRIES = 1  # insertions less that are tried out on long records, whose promises can be trusted
_SCREEN = Training(ridge=0.1, tries=2, iterations=12, tolerance=1e-3)
_AS_MUCH = 0.7  # of the first part's gain in logarithms, that another part must see from the same place
_PROMISE = 0.3  # in logarithms of the mean square, that two rules must lower fit and validation by
_IDLE = 2  # rules in a row that may bring nothing,
_HARM = 1.05  # or one, if the validation error is so many times the least


Parts = Sequence[tuple[Dataset, Dataset]]
"""Fitting and judging parts."""


@dataclass(frozen=True, eq=False)
class Found:
    """The best family of rules, and the best single rule, each judged over all parts."""

    best: Family
    plain: Family


@dataclass(frozen=True, eq=False)
class _Linear:
    """A system with one rule: its stage on every fitting part, and how it is judged."""

    system: System
    stages: tuple[Stage, ...]
    family: Family

    @classmethod
    def of(cls, context: StateContext, system: System, parts: Parts) -> _Linear:
        stages = tuple(context.linear(system, fit) for fit, _ in parts)
        found = tuple((context.judge(s, c),) for s, (_, c) in zip(stages, parts, strict=True))
        return cls(system, stages, Family(Start(system, PLAIN), 0.0, found))

    @property
    def error(self) -> float:
        return float(tolerant(self.family).rmse[0])


def searched(context: StateContext, systems: Sequence[System], parts: Parts) -> Found:
    """The best family over all starts; see the module's docstring."""
    many = len(parts[0][0]) > LARGE
    if many:
        parts = [(_sampled(fit, _SEARCH_ROWS), check) for fit, check in parts]
    linear = sorted((_Linear.of(context, s, parts) for s in systems), key=lambda x: x.error)
    near = [x for x in linear if x.error <= _LEVEL * linear[0].error]
    plain = tolerant(min(near, key=lambda x: len(x.system.real.A)).family)
    able = [x for x in linear if len(x.system.real.A) <= _MOST_STATES and context.room(x.stages[0])]
    able = [x for x in able if x.error < _RAN_AWAY] or able[:1]
    if context.most == 1 or not able:
        return Found(plain, plain)
    screened = _screened(context, able[: context.settings.search.linear_systems], parts)
    if context.settings.rules == "auto" and min(change for _, _, change in screened) > -_PROMISE:
        return Found(plain, plain)
    kept = [(start, x) for start, x, _ in screened[: 1 if many else _KEPT]]
    ridges = context.settings.search.ridges if context.settings.ridge == "auto" else (context.settings.ridge,)
    families = [(grown(context, start, x.stages, parts, ridges[0]), x) for start, x in kept]
    families.sort(key=lambda f: _error(context, f[0]))
    again = families[: _again(context, families, linear[0].error)] if not many else []
    found = [grown(context, f.start, x.stages, parts, r) for r in ridges[1:] for f, x in again]
    best = min([*(f for f, _ in families), *found], key=lambda f: _error(context, f))
    return Found(best, plain)


def _again(context: StateContext, families: Sequence[tuple[Family, _Linear]], plain: float) -> int:
    """How many of the families another ridge is tried on: all where one ran away, the best where it helps."""
    if any(not m.stable for family, _ in families for fold in family.folds for m in fold):
        return len(families)
    helps = context.settings.rules != "auto" or _error(context, families[0][0]) < 0.99 * plain
    return 1 if helps else 0


def _error(context: StateContext, family: Family) -> float:
    return float(family.rmse[-1] if context.settings.rules != "auto" else family.rmse.min())


def tolerant(family: Family) -> Family:
    """The family as if all were bounded: a process that integrates has linear models that drift, too."""
    return replace(family, folds=tuple(tuple(_tolerant(m) for m in fold) for fold in family.folds))


def _tolerant(found: Candidate) -> Candidate:
    return replace(found, stable=True)


def _screened(
    context: StateContext, linear: Sequence[_Linear], parts: Parts
) -> list[tuple[Start, _Linear, float]]:
    """Starts by what two rules do on the first part, best first.

    With the change of the mean square in logarithms: of the fit to its own linear system's, and of the
    validation to the best linear system's, on average.
    """
    check = _sampled(parts[0][1], _SCREEN_ROWS)
    how = _searching(_SCREEN, parts)
    known = min(x.family.folds[0][0].mean for x in linear)
    tried: list[tuple[bool, float, Start, _Linear, float]] = []
    for x in linear:
        first = thinned(x.stages[0], _SCREEN_ROWS)
        for name in coordinates(Realisation.of(first.layout, first.body.a[0]), len(check.outputs)):
            stage, _ = context.in_coordinates(first, name)
            grown = one_rule_more(stage, context.candidates(stage.layout), how)
            found = grown[0].stage if grown else stage
            judged = context.judge(found, check)
            score = float(np.log(np.maximum((judged.mean, found.mean_square()), _EXACT)).sum())
            runs_away = x.family.folds[0][0].stable and not judged.stable
            fit = _change(found.mean_square(), first.mean_square())
            change = 0.5 * (_change(judged.mean, known) + fit)
            tried.append((runs_away, score, Start(x.system, name), x, change))
    tried.sort(key=lambda t: t[:2])
    return [(start, x, change) for _, _, start, x, change in tried]


def _searching(how: Training, parts: Parts) -> Training:
    """How places are searched for: on long records fewer of them are tried out."""
    return replace(how, tries=how.tries - _FEWER_TRIES) if len(parts[0][0]) > LARGE else how


def grown(context: StateContext, start: Start, linear: Sequence[Stage], parts: Parts, ridge: float) -> Family:
    """Models with 1, 2, 3, ... rules grown on the fitting part of every fold, judged on the other part."""
    moved = [context.in_coordinates(stage, start.coordinates) for stage in linear]
    stages = [stage for stage, _ in moved]
    family = Family(
        start,
        ridge,
        tuple((context.judge(s, c),) for s, (_, c) in zip(stages, parts, strict=True)),
        moved[0][1],
    )
    drifts = not all(f[0].stable for f in family.folds)  # the process integrates: linear models of it drift
    family = tolerant(family) if drifts else family
    how = _searching(Training(ridge=ridge, iterations=context.settings.iterations), parts)
    while len(family.rmse) < context.most and context.room(stages[0]) and not _idle(context, family, stages):
        better = one_rule_more(stages[0], context.candidates(stages[0].layout), how)
        if not better:
            break
        gain = _gain(stages[0], better[0].stage)
        rest = (_likewise(context, stage, better[0].where, how, gain) for stage in stages[1:])
        stages = [better[0].stage, *rest]
        new = [context.judge(s, c) for s, (_, c) in zip(stages, parts, strict=True)]
        new = [_tolerant(m) if drifts else m for m in new]
        family = replace(family, folds=tuple((*f, m) for f, m in zip(family.folds, new, strict=True)))
    return family


def _likewise(context: StateContext, stage: Stage, where: Insertion, how: Training, gain: float) -> Stage:
    """A rule at the same place, or at the stage's own best place where that one helps it less."""
    found = same_insertion(stage, where, how)
    if found is not None and _gain(stage, found) >= _AS_MUCH * gain:
        return found
    own = one_rule_more(stage, context.candidates(stage.layout), how)
    options = [*(g.stage for g in own), *([found] if found else [])]
    return min(options, key=lambda s: s.cost, default=stage)


def _gain(before: Stage, after: Stage) -> float:
    """By how much the training error fell, in logarithms of the mean square."""
    return -_change(after.mean_square(), before.mean_square())


def _change(after: float, before: float) -> float:
    """From one mean square to another, in logarithms."""
    return float(np.log(max(after, _EXACT)) - np.log(max(before, _EXACT)))


def _idle(context: StateContext, family: Family, stages: Sequence[Stage]) -> bool:
    """Whether more rules are not worth growing."""
    if context.settings.rules != "auto":
        return False
    errors = family.rmse
    idle = len(errors) - 1 - int(errors.argmin())
    harms = len(errors) > 2 and errors[-1] > _HARM * errors.min()  # a second rule may wait for the third
    return idle >= _IDLE or bool(harms) or stages[0].mean_square() < _EXACT


def _sampled(data: Dataset, rows: int) -> Dataset:
    """About `rows` rows of a dataset in evenly spaced pieces."""
    if len(data) <= rows:
        return data
    pieces = []
    size = max(_PIECE, min(len(data), 3 * rows) // _PIECES)
    for segment in data.segments:
        count = max(1, round(len(segment) / size))
        edges = np.linspace(0, len(segment), count + 1).astype(int)
        pieces += [segment.slice(int(a), int(b), data.dt_s) for a, b in itertools.pairwise(edges)]
    every = max(1, round(len(data) / rows))
    return data.with_segments(pieces[every // 2 :: every] or pieces[:1])
