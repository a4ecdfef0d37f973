"""The search for rules: several linear starts grow side by side, and the better ones go on.

Growth is a local search whose outcome hangs on its start, and the best linear order says little about the
best order with rules: a linear model uses lags to imitate bends. So every linear model grows a second rule,
and the lanes that free-run best on validation go on, fewer with every rule (successive halving, Jamieson and
Talwalkar 2016). Among equals the lane of fewer parameters stands for a number of rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.errors import DataError
from flysid.model.rules.clustered_start import clustered_stage
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.growth import Training, one_rule_more, thinned
from flysid.model.rules.judging import Candidate, choose
from flysid.model.rules.refit import refit
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders, parse_antecedent, runs_of, scaling
from flysid.model.rules.search_context import SearchContext, Settings
from flysid.model.rules.stages import refine, with_ridge
from flysid.progress import tell

_MOST_ROWS = 12000  # of training data while searching; the chosen model is refined on all
_RIDGES = (1.0, 1e3)  # where freedom made a model unstable; the last one leaves the rules equal
_HOPELESS = 4.0  # times the mean square of the best linear model: such orders are not grown
_ASTRAY = 1.5  # times the training mean square of a fit from elsewhere: the search on a fold has failed
_EQUAL = 0.1  # of the mean square: what fewer parameters may cost among equal numbers of rules
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_ROWS_PER_NUMBER = 4


def search(context: SearchContext, linear: Sequence[Candidate]) -> list[Candidate]:
    """Models with 1, 2, 3, ... rules, simplest first: of every number of rules the one to be offered.

    Ends where growth stalls, where data run out, or at the number of rules that was asked for.
    """
    settings = context.settings
    most = context.most_rules
    kept = context.lanes
    models = [linear[0]]
    lanes = _starts(context, linear)
    tell("1 rule", share=1 / (most + 1), validation=float(np.sqrt(linear[0].mean)))
    if not settings.refine:
        looked_at = variables(settings, linear[0].stage.problem.layout)
        plain = (clustered_stage(linear[0].stage, looked_at[:2], r) for r in range(2, most + 1))
        return [linear[0], *(context.judge(s) for s in plain)]
    while len(models) < most:
        rules = len(models) + 1
        keep = 1 if rules == 2 else kept
        kids = [kid for lane in lanes if affords(lane, rules) for kid in _grown(context, lane, keep)]
        if not kids or (rules == 2 and not _promising(context, lanes, kids)):
            break
        models.append(representative(kids))
        tell(f"{rules} rules", share=rules / (most + 1), validation=float(np.sqrt(models[-1].mean)))
        lanes = _survivors(kids, kept)
        if settings.rules == "auto" and has_stalled(models):
            break
    return models


def _promising(context: SearchContext, lanes: Sequence[Candidate], kids: Sequence[Candidate]) -> bool:
    """Whether two rules lower the training error, at least, by what they must win on held-out parts."""
    if context.fold_rules or context.settings.rules != "auto":
        return True
    least = min(lane.stage.cost for lane in lanes)
    return min(kid.stage.cost for kid in kids) < (1.0 - context.gain) * least


def _starts(context: SearchContext, linear: Sequence[Candidate]) -> list[Candidate]:
    """The linear models to grow from: of each orders the best, the hopeless ones left out."""
    best: dict[Orders, Candidate] = {}
    for candidate in linear:
        orders = candidate.stage.problem.layout.orders
        if orders not in best or _rank(candidate) < _rank(best[orders]):
            best[orders] = candidate
    limit = _HOPELESS * max(min(c.mean for c in linear if c.stable == linear[0].stable), _EXACT)
    kept = [c for c in best.values() if c is linear[0] or c.mean <= limit]
    thin = [replace(c, stage=thinned(c.stage, _MOST_ROWS)) for c in kept]
    if context.must_be_bounded:
        return thin
    return [replace(c, stage=_unstressed(c.stage)) for c in thin]


def _unstressed(stage: Stage) -> Stage:
    return replace(stage, problem=replace(stage.problem, stress=None))


def affords(lane: Candidate, rules: int) -> bool:
    """Whether a model's data could pay for so many rules."""
    stage = lane.stage
    return bool(stage.body.a[0].size * rules * _ROWS_PER_NUMBER < stage.problem.samples)


def _grown(context: SearchContext, lane: Candidate, keep: int) -> list[Candidate]:
    """A lane's models with one rule more; held together by a ridge where freedom made all unstable.

    In the basis of the linear model's Gauss-Newton matrix a ridge of 1 halves what the data say about
    the difference of two rules, so that the ladder is the same for every data set.
    """
    candidates = variables(context.settings, lane.stage.problem.layout)
    iterations = context.settings.iterations
    how = Training(iterations=iterations, tries=0)
    found = one_rule_more(lane.stage, candidates, how, keep)
    kids = [context.judge(grown.stage) for grown in found]
    for ridge in _RIDGES:
        if not found or any(kid.stable for kid in kids):
            break
        kids.append(context.judge(refine(with_ridge(found[0].start, ridge), iterations, 1e-4)))
    return kids


def one_more(context: SearchContext, known: Candidate) -> list[Candidate]:
    """A model with one rule more than the known one, as far as data and growth go."""
    return _grown(context, known, 1) if affords(known, known.stage.rules + 1) else []


def _rank(candidate: Candidate) -> tuple[bool, float]:
    return not candidate.stable, candidate.mean


def _survivors(kids: Sequence[Candidate], most: int) -> list[Candidate]:
    """The best on validation, and the best in training if it is another: a lucky validation is not all."""
    lanes = sorted(kids, key=_rank)[:most]
    stable = [kid for kid in kids if kid.stable] or list(kids)
    trained = min(stable, key=lambda kid: kid.stage.cost)
    return lanes if trained in lanes else [*lanes, trained]


def representative(kids: Sequence[Candidate]) -> Candidate:
    """Of models with as many rules, the one of fewest parameters that is about as good as the best."""
    simplest = sorted(kids, key=lambda kid: kid.stage.body.size)
    return simplest[choose(simplest, most_loss=_EQUAL)]


def cross_validated(context: SearchContext, models: Sequence[Candidate], at: int) -> list[Candidate]:
    """The models with the validation errors of all further folds, as far as every fold reached.

    On the folds only the orders of the chosen model, `models[at]`, are grown, in one lane and up to as many
    rules as there are models.
    """
    errors = [[m.errors] for m in models]
    orders = models[at].stage.problem.layout.orders
    for fit_part, check_part in context.folds:
        try:
            shift, scale = scaling(fit_part)
        except DataError:  # a quarter without which nothing moves says nothing
            continue
        other = replace(
            context,
            fit_part=fit_part,
            check_part=check_part,
            shift=shift,
            scale=scale,
            folds=(),
            fold_rules=len(models),
            integrates=models[at].stage.problem.integrates,
            known=models[0].linear,
        )
        linear, _ = other.linear([orders])
        if linear[0].mean > _HOPELESS * max(models[0].mean, _EXACT):
            continue  # the linear refit went astray: rules that mend it would look useful
        for known, model in zip(errors, not_astray(other, models, search(other, linear)), strict=False):
            known.append(model.errors)
    return [
        replace(m, errors=np.concatenate(e))
        for m, e in zip(models, errors, strict=True)
        if len(e) == len(errors[0])
    ]


def not_astray(
    fold: SearchContext, models: Sequence[Candidate], grown: Sequence[Candidate]
) -> list[Candidate]:
    """What was grown on a fold; or all `models` refitted to it, where growth ended in a far worse minimum.

    Only the fit to the fold's own training part decides. A search that fails on one part says nothing about
    rules, and its errors on the held-out part would outweigh those of all others. A refit starts from
    numbers that have seen the held-out part, so one rule must be allowed the same.
    """
    pairs = list(zip(models, grown, strict=False))
    poor = [(model, found) for model, found in pairs if found.stage.cost > _ASTRAY * model.stage.cost]
    if any(_ASTRAY * _refitted(fold, model).stage.cost < found.stage.cost for model, found in poor):
        return [_refitted(fold, model) for model, _ in pairs]
    return list(grown)


def _refitted(fold: SearchContext, model: Candidate) -> Candidate:
    runs = runs_of(model.stage.problem.layout, fold.fit_part.segments, fold.least)
    return fold.judge(refit(model, fold.fit_part, runs, fold.settings.iterations))


def variables(settings: Settings, layout: Layout) -> tuple[Antecedent, ...]:
    """Variables to split along: those asked for, or all that may tell rules apart.

    An input named without a lag is meant at the first lag that acts with these orders.
    """
    if settings.antecedents == "auto":
        return found_antecedents(layout)
    asked = (
        parse_antecedent(name, layout.outputs, layout.inputs, layout.orders.nk)
        for name in settings.antecedents
    )
    return tuple(dict.fromkeys(asked))


def found_antecedents(layout: Layout) -> tuple[Antecedent, ...]:
    """Variables to split along: the newest output, the newest two inputs, and the change of every output."""
    n_y = layout.n_y
    orders = layout.orders
    newest = [Antecedent(i, 1) for i in range(n_y)] if orders.na else []
    inputs = [
        Antecedent(n_y + j, lag)
        for j, (nb, nk) in enumerate(zip(orders.nb, orders.nk, strict=True))
        for lag in range(nk, nk + min(max(nb, 1), 2))
    ]
    change = [Antecedent(i, 1, 2) for i in range(n_y)] if orders.na >= 2 else []
    return (*newest, *inputs, *change)


def has_stalled(models: Sequence[Candidate]) -> bool:
    """Two rules more have not helped on validation, or the data are explained exactly."""
    means = [m.mean for m in models]
    return means[-1] < _EXACT or (len(means) > 2 and min(means[-2:]) > 0.98 * min(means[:-2]))
