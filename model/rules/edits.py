"""Edits of the rules: two as one, one dropped, a condition left out; merge and split; what each costs.

Growth inserts rule after rule and never takes one back: it ends in a local minimum that hangs on the first
places. One rule more, and two merged again, leaves it (split and merge: Ueda, Nakano, Ghahramani and Hinton
2000, for mixtures of densities). The words stay as many.

Of a fitted model every edit is refined on the simulation error before it is priced, so that the price is what
the words are worth, not what a careless edit breaks (rule base simplification: Setnes, Babuska, Kaymak and
van Nauta Lemke, 1998, merge by similarity of sets; here the free run decides).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.consequents import refuse_few, refuse_other_data
from flysid.model.rules.growth import Training, best_started, one_rule_more, rule_support
from flysid.model.rules.judging import Candidate
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.operating_points import describe
from flysid.model.rules.phrases import from_to
from flysid.model.rules.refit import as_problem, at_stage, free_run_rmse
from flysid.model.rules.regressor_layout import Layout, runs_of
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage, ordered
from flysid.model.selection import clearly_better
from flysid.model.threads import on_one_thread


def edits(layout: Layout, p: Parameters, support: FloatArray) -> Iterator[tuple[str, Layout, Parameters]]:
    """Every pair of rules merged, every rule dropped, every antecedent left out."""
    share = np.maximum(support, 1e-3)
    rules, n_z = p.centre.shape
    if rules == 1:
        return
    for i, j in combinations(range(rules), 2):
        yield f"R{i + 1} and R{j + 1} merged", layout, _merge(p, i, j, share)
    if rules > 2:
        for r in range(rules):
            yield f"R{r + 1} dropped", layout, _kept(p, np.delete(np.arange(rules), r))
    for z in range(n_z if n_z > 1 else 0):
        rest = np.delete(np.arange(n_z), z)
        antecedents = tuple(layout.antecedents[k] for k in rest)
        fewer = p._replace(
            centre=p.centre[:, rest], width=p.width[:, rest], z_range=np.ascontiguousarray(p.z_range[:, rest])
        )
        yield (
            f"conditions on {layout.antecedents[z].name(layout.signals)} left out",
            replace(layout, antecedents=antecedents),
            _kept(fewer, np.arange(rules)),
        )


def _merge(p: Parameters, i: int, j: int, share: FloatArray) -> Parameters:
    """Rules i and j as one: means weighted by support; the set covers both."""
    w = np.array([share[i], share[j]]) / (share[i] + share[j])
    centre = w @ p.centre[[i, j]]
    spread = w @ (p.width[[i, j]] ** 2 + (p.centre[[i, j]] - centre) ** 2)
    kept = _kept(p, np.delete(np.arange(len(p.theta)), j))
    at = i if i < j else i - 1
    kept.theta[at] = np.tensordot(w, p.theta[[i, j]], axes=1)
    kept.centre[at] = centre
    kept.width[at] = np.sqrt(spread)
    return kept


def _kept(p: Parameters, rules: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Parameters:
    """A copy with some of the rules."""
    return p._replace(theta=p.theta[rules].copy(), centre=p.centre[rules].copy(), width=p.width[rules].copy())


def staged(layout: Layout, p: Parameters, runs: tuple[FloatArray, ...]) -> Stage:
    """The edited model as a stage of refinement.

    A single rule says the same everywhere: its set is written as one that covers everything.
    """
    problem, body = as_problem(layout, p, runs)
    if len(body.a) == 1:
        body = replace(body, centre=np.zeros_like(body.centre), width=np.ones_like(body.width))
    return best_started(problem, body)


def _refined_mergers(context: SearchContext, stage: Stage) -> Iterator[Stage]:
    """The most promising edits that leave fewer rules, refined on the training part."""
    stage = ordered(stage)
    problem = stage.problem
    tried = [
        staged(layout, p, problem.runs).under(stress=problem.stress)
        for _, layout, p in edits(problem.layout, problem.parameters(stage.body), rule_support(stage))
        if len(p.theta) < stage.rules
    ]
    for s in sorted(tried, key=lambda s: s.cost)[: Training.tries]:
        yield s.under(ridge=Training().ridge * s.cost).refined(context.settings.iterations // 2, 1e-5)


def merge_and_split(context: SearchContext, models: Sequence[Candidate], at: int) -> Candidate:
    """`models[at]`, or one with as many rules that training and validation both prefer.

    Little data are left alone: every quarter of them was asked for the number of rules already, and one
    more choice by the same quarters gained nothing on plants with known truth.
    """
    chosen = models[at]
    larger = list(models[at + 1 : at + 2])
    if context.folds or chosen.stage.rules < 2:
        return chosen
    for _ in range(context.settings.search.exchanges):
        found = _again(context, chosen, larger or _one_more(context, chosen.stage))
        if found is chosen:
            break
        chosen = found
        larger = []
    return chosen


def _one_more(context: SearchContext, stage: Stage) -> list[Candidate]:
    """A model with one rule more than the known one, as far as data and growth go."""
    if not context.room(stage):
        return []
    how = Training(iterations=context.settings.iterations)
    grown = one_rule_more(stage, context.antecedents(stage.layout), how)
    return [context.judge(grown.stage)] if grown else []


def _again(context: SearchContext, chosen: Candidate, larger: Sequence[Candidate]) -> Candidate:
    """The best of the larger models' mergers with as many rules as `chosen`; itself where none is better."""
    known = context.judge(chosen.stage)
    found = [
        context.judge(stage)
        for more in larger
        for stage in _refined_mergers(context, more.stage)
        if stage.cost < chosen.stage.cost
    ]
    better = [kid for kid in found if kid.stable and clearly_better(kid.errors, known.errors)]
    return min(better, key=lambda kid: kid.mean, default=chosen)


@dataclass(frozen=True, eq=False)
class PricedEdit:
    """One edit of a model and its price.

    Attributes
    ----------
    what : in words, with the labels of the model that was edited.
    model : the edited model, refined.
    before, after : (n_y,) RMSE of the free run, physical units.
    """

    what: str
    model: RuleModel
    before: FloatArray
    after: FloatArray

    @property
    def loss_pct(self) -> float:
        """How much the free run's RMSE grows, the worst output; below zero where the edit helps."""
        floor = 1e-9 * np.ptp(self.model.output_limits, axis=0)
        return float(100.0 * ((self.after + floor) / (self.before + floor) - 1.0).max())

    def __str__(self) -> str:
        """ "R2 and R3 merged: free run 0.036 -> 0.037 m/s (+2.1 %)"."""
        steps = from_to(self.before, self.after, self.model.outputs)
        return f"{self.what}: free run {steps} ({self.loss_pct:+.1f} %)"


@on_one_thread
def simplifications(
    model: RuleModel,
    train: Dataset,
    validation: Dataset | None = None,
    *,
    iterations: int = 15,
    ridge: float = 1e-3,
) -> list[PricedEdit]:
    """What could be said more simply, cheapest first; an unstable edit is not offered.

    Parameters
    ----------
    train : data on which an edited model is refined.
    validation : data on which it is priced; `train` where None, which makes edits look dear.
    iterations : Levenberg-Marquardt steps after an edit.
    ridge : of the cost: refinement must not wander off along overlapping rules.

    Raises
    ------
    UsageError : not a model of rules over lags, or data with other signals.
    DataError : no segment is long enough to simulate; no more samples than the model has numbers.
    """
    refuse_other_data(model, train)
    judge = train if validation is None else validation
    before = free_run_rmse(model, judge)
    runs = runs_of(model.layout, train.segments, model.n_init + 2)
    refuse_few(sum(len(W) - model.n_init for W in runs), model.parameters.theta[:, 0].size)
    tried = [
        (what, staged(layout, p, runs))
        for what, layout, p in edits(model.layout, model.parameters, model.support)
    ]
    tried.sort(key=lambda edit: edit[1].cost)
    found = []
    for what, stage in tried[: Training.tries]:
        refined = stage.under(ridge=ridge * stage.cost).refined(iterations, 1e-5)
        if np.isfinite(refined.cost) and is_bounded(refined):
            told = replace(model, notes=(*model.notes, f"Simplified by hand: {what}."))
            edited = describe(at_stage(told, ordered(refined), train), train)
            found.append(PricedEdit(what, edited, before, free_run_rmse(edited, judge)))
    return sorted(found, key=lambda s: s.loss_pct)
