"""The search for rules: many linear starts, of which most are given up early.

Growth is a local search whose outcome hangs on its start, and the best linear model says little about the
best start for rules: a linear model uses lags, or states, to imitate bends. So from every linear model,
hidden states in every choice of coordinates, two rules are grown on one part; the few best are grown
further over all parts, as long as rules help (successive halving, Jamieson and Talwalkar 2016). Where a rule
goes is found on the first part; the others place theirs likewise, and search for themselves only where that
helps less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.model.linear.data import SEARCH_ROWS
from flysid.model.polynomials import VANISHING
from flysid.model.rules.friction import rubbing
from flysid.model.rules.growth import Insertion, Training, one_rule_more, same_insertion, thin
from flysid.model.rules.judging import Family, tolerant
from flysid.model.rules.regressor_layout import Orders
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.search_settings import QUARTERS
from flysid.model.rules.stages import Stage
from flysid.model.rules.state_systems import coordinate_names, in_coordinates
from flysid.progress import tell

_SCREEN = Training(ridge=0.1, tries=2, iterations=12, tolerance=1e-3)
_AS_MUCH = 0.7  # of the first part's gain in logarithms, that another part must see from the same place


@dataclass(frozen=True, eq=False)
class Screened:
    """A linear start in one choice of coordinates, and what two rules do from it on the first part.

    Attributes
    ----------
    change : of the mean square in logarithms: of the fit to the start's own, and of the validation to the
        best start's, on average.
    fits : mean squares in training, of the start and of the two rules.
    """

    family: Family
    runs_away: bool
    score: float
    change: float
    fits: tuple[float, float]


def search(context: SearchContext, plain: Family, starts: Sequence[Family]) -> tuple[Family, float]:
    """The best family over all starts; `plain`, the best single rule, where none is worth growing.

    With it the change of the least training mean square by a second rule, on the first part, in logarithms.
    """
    able = different([s for s in starts if context.room(s.linear.stage)])
    tell("1 rule", share=0.0, validation=float(plain.rmse[0]))
    if context.most_rules == 1 or not able:
        return plain, -np.inf
    screened = _screen(context, able)
    fit = _change(*(min(s.fits[rules] for s in screened) for rules in (1, 0)))
    tried = rubbing(context, starts)
    if context.auto and min(s.change for s in screened) > -context.promise:
        return min([plain, *tried], key=context.error), fit
    kept = [context.completed(s.family) for s in screened[: context.settings.search.lanes]]
    for ridge in context.ridges:
        tried += [grown(context, s, ridge, at / len(kept)) for at, s in enumerate(kept)]
        best = min(tried, key=context.error)
        ran_away = any(not m.stable for fold in best.folds for m in fold)
        if not ran_away or context.error(best) < plain.rmse[0]:
            break
    return best, fit


def different(starts: Sequence[Family]) -> list[Family]:
    """The starts without those that another one is, too, as far as screening can tell.

    One linear model is found from several sides, and would be grown from as often.
    """
    kept: list[tuple[Family, float]] = []
    for start in starts:
        square = start.linear.stage.mean_square()
        alike = (abs(_change(square, s)) < _SCREEN.tolerance for k, s in kept if _lags(k) == _lags(start))
        if not any(alike):
            kept.append((start, square))
    return [start for start, _ in kept]


def _lags(start: Family) -> tuple[Orders, int]:
    layout = start.linear.stage.layout
    return layout.orders, layout.n


def _screen(context: SearchContext, starts: Sequence[Family]) -> list[Screened]:
    """Starts by what two rules do on the first part, best first."""
    known = min(s.linear.mean for s in starts)
    tried = []
    for start in starts:
        first = thin(start.linear.stage, SEARCH_ROWS // QUARTERS)
        for name in coordinate_names(first):
            stage, words = in_coordinates(first, name)
            better = one_rule_more(stage, context.antecedents(stage.layout), _SCREEN)
            found = better.stage if better else stage
            judged = context.judge(found)
            tried.append(
                Screened(
                    replace(start, coordinates=name, words=words),
                    start.linear.stable and not judged.stable,
                    float(np.log(np.maximum((judged.mean, found.mean_square()), VANISHING)).sum()),
                    0.5 * (_change(judged.mean, known) + _change(found.mean_square(), first.mean_square())),
                    (first.mean_square(), found.mean_square()),
                )
            )
    return sorted(tried, key=lambda s: (s.runs_away, s.score))


def grown(context: SearchContext, start: Family, ridge: float, done: float = 0.0) -> Family:
    """Models with 1, 2, 3, ... rules grown on the fitting part of every fold, judged on the other part.

    `done`: share of the search that is done, for the progress.
    """
    checks = [check for _, check in context.parts]
    stages = [in_coordinates(fold[0].stage, start.coordinates)[0] for fold in start.folds]
    folds = tuple((f[0],) for f in start.folds)
    if start.system is not None:
        folds = tuple((context.judge(s, c),) for s, c in zip(stages, checks, strict=True))
    stages = [thin(s, SEARCH_ROWS) for s in stages]
    family = replace(start, folds=folds, ridge=ridge)
    drifts = not all(f[0].stable for f in family.folds)  # the process integrates: linear models of it drift
    family = tolerant(family) if drifts else family
    how = Training(ridge=ridge, iterations=context.settings.iterations)
    while (
        family.stages < context.most_rules and context.room(stages[0]) and not _idle(context, family, stages)
    ):
        better = one_rule_more(stages[0], context.antecedents(stages[0].layout), how)
        if better is None:
            break
        gain = _gain(stages[0], better.stage)
        rest = (_likewise(context, stage, better.where, how, gain) for stage in stages[1:])
        stages = [better.stage, *rest]
        new = [context.judge(s, c) for s, c in zip(stages, checks, strict=True)]
        new = [replace(m, stable=True) if drifts else m for m in new]
        family = replace(family, folds=tuple((*f, m) for f, m in zip(family.folds, new, strict=True)))
        share = done + (1.0 - done) * (family.stages - 1) / context.most_rules
        bounded = all(m.stable for m in new)
        said = f"{family.stages} rules" if bounded else f"{family.stages} rules, not bounded"
        tell(said, share=share, validation=float(family.rmse[-1]) if bounded else None)
    return family


def _likewise(context: SearchContext, stage: Stage, where: Insertion, how: Training, gain: float) -> Stage:
    """A rule at the same place, or at the stage's own best place where that one helps it less."""
    found = same_insertion(stage, where, how)
    if found is not None and _gain(stage, found) >= _AS_MUCH * gain:
        return found
    own = one_rule_more(stage, context.antecedents(stage.layout), how)
    options = [*([own.stage] if own else []), *([found] if found else [])]
    return min(options, key=lambda s: s.cost, default=stage)


def _gain(before: Stage, after: Stage) -> float:
    """By how much the training error fell, in logarithms of the mean square."""
    return -_change(after.mean_square(), before.mean_square())


def _change(after: float, before: float) -> float:
    """From one mean square to another, in logarithms."""
    return float(np.log(max(after, VANISHING)) - np.log(max(before, VANISHING)))


def _idle(context: SearchContext, family: Family, stages: Sequence[Stage]) -> bool:
    """Whether more rules are not worth growing: the last one did not help, or nothing is left."""
    if not context.auto:
        return False
    errors = family.rmse
    return bool(errors[-1] > errors.min()) or stages[0].mean_square() < VANISHING
