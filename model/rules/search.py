"""One search for rules, over lags and over hidden states: candidates, a trainer, a judge, halving.

A candidate is a model with a place for another rule. All splits of all linear starts are ranked by what one
Gauss-Newton step promises, the most promising ones refined by a few steps on few rows, the best of these
fully, and judged; they are split again (successive halving, Jamieson and Talwalkar 2016, in a beam). Nothing
is decided beforehand on orders, delays or variables: linear starts of every kind stay as long as rules do
well on them. Children begin as what their parent says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.model.polynomials import VANISHING
from flysid.model.rules.growth import splits, thin
from flysid.model.rules.judging import Candidate
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage, expected_cost, on_runs_of
from flysid.progress import tell

TRIES = 3
"""Splits of a model that are refined a little, the most promising ones."""
_TRIAL_STEPS = 6
_FEW = 2000  # rows for ranking splits and for trying the best ones
_STEPS = 20  # of a candidate that is judged
_KIN = 2  # candidates of the same lags, of every number of rules
_ALIKE = 0.01  # of the training error: two candidates over the same variables are one

Split = tuple[float, Stage, Candidate]
"""What the error will be, the split, whose it is."""


def search(context: SearchContext, starts: Sequence[Candidate]) -> list[list[Candidate]]:
    """Candidates with 1, 2, 3, ... rules, best first; as far as rules help, or as many as are asked for."""
    levels = [sorted(starts, key=lambda c: c.score)]
    tell(f"1 rule, {counted_left(levels[0])}", share=0.0, validation=levels[0][0].rmse)
    parents = [c for c in levels[0] if c.may_grow]
    while levels[-1][0].stage.rules < context.most_rules:
        grown: list[Candidate] = []
        for ridge in context.ridges:
            grown = grown or _next_level(context, parents[: 2 * context.settings.search.width], ridge)
        if not grown:
            break
        levels.append(grown)
        rules = grown[0].stage.rules
        share = (rules - 1) / context.most_rules
        tell(f"{rules} rules, {counted_left(grown)}", share=share, validation=grown[0].rmse)
        known = min(level[0].score for level in levels[:-1])
        idle = grown[0].score > known - context.settings.search.rule_gain
        if context.auto and (idle or grown[0].stage.mean_square() < VANISHING):
            break
        parents = grown[: context.settings.search.width]
    return levels


def counted_left(candidates: Sequence[Candidate]) -> str:
    """ "4 candidates left"."""
    return f"{len(candidates)} candidate{'s' if len(candidates) != 1 else ''} left"


def _next_level(context: SearchContext, parents: Sequence[Candidate], ridge: float) -> list[Candidate]:
    """The best candidates with one rule more, refined fully and judged; bounded ones only."""
    tried = [t for parent in parents if context.room(parent.stage) for t in _trials(context, parent, ridge)]
    width = context.settings.search.width
    first = bool(parents) and parents[0].stage.rules == 1
    found = []
    for _, stage, parent in _varied(sorted(tried, key=lambda t: t[0]), 2 * width if first else width):
        whole = on_runs_of(stage, parent.stage)
        whole = whole.under(ridge=ridge * whole.mean_square()).refined(_STEPS, 1e-5)
        if np.isfinite(whole.cost):
            found.append(context.judge(whole, origin=parent.origin))
    return sorted((c for c in found if c.stable), key=lambda c: c.score)


def _trials(context: SearchContext, parent: Candidate, ridge: float) -> list[Split]:
    """The most promising splits of a model, a little refined."""
    few = thin(parent.stage, _FEW)
    few = few.under(ridge=ridge * few.mean_square())
    options = splits(few, context.antecedents(few.layout))
    promised = np.array([expected_cost(s) for s in options])
    order = [i for i in np.argsort(promised, kind="stable") if np.isfinite(promised[i])][:TRIES]
    tried = [options[i].refined(_TRIAL_STEPS, 1e-4) for i in order]
    return [(_foreseen(s), s, parent) for s in tried if np.isfinite(s.cost)]


def _foreseen(stage: Stage) -> float:
    """The error on other data, to first order: Akaike's final prediction error."""
    samples = stage.problem.samples
    numbers = min(stage.body.free.size, samples // 2)
    return stage.cost * (samples + numbers) / (samples - numbers)


def _varied(tried: Sequence[Split], most: int) -> list[Split]:
    """The best splits, no two that came to the same over the same variables, and two at most of any lags.

    Those of other lags come first where the places do not suffice: low orders are soon where they can get,
    high ones need more steps.
    """
    kept: list[tuple[int, Split]] = []
    for foreseen, stage, parent in tried:
        layout = stage.layout
        kin = [(f, s.layout) for _, (f, s, _) in kept if s.layout.regressors == layout.regressors]
        alike = [f for f, k in kin if set(k.antecedents) == set(layout.antecedents)]
        if len(kin) < _KIN and all(foreseen > (1.0 + _ALIKE) * f for f in alike):
            kept.append((len(kin), (foreseen, stage, parent)))
    return [split for _, split in sorted(kept, key=lambda k: (k[0], k[1][0]))][:most]
