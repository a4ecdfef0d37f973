"""The last step of a search: words that the validation free run does not miss are left out.

A rule that growth needed on its way may be idle in the end, and so may a condition. What goes is what costs
next to nothing on validation; often that free run gets better, as there is less to be fitted to noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from flysid.model.rules.edits import edits, staged
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.growth import rule_support
from flysid.model.rules.judging import Candidate
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import ordered, refine, with_ridge

_TRIED = 3  # edits that are refined, of all ranked by their cost in training
_RIDGE = 0.01  # of the mean square error, as in growth


def prune(context: SearchContext, chosen: Candidate) -> tuple[Candidate, list[str]]:
    """The chosen model without what validation does not miss, and a sentence about every edit."""
    # `chosen` may have been judged on other parts too, harder or easier ones; the edits are not
    limit, said = context.judge(chosen.stage).mean, list[str]()
    while context.settings.search.prune and chosen.stage.rules > 1:
        offers = [(what, context.judge(stage)) for what, stage in refined_edits(context, chosen.stage)]
        good = [(what, c) for what, c in offers if c.stable and c.mean <= limit]
        if not good:
            break
        what, chosen = min(good, key=lambda offer: offer[1].mean)
        said.append(f"Simplified: {what}.")
    return chosen, said


def refined_edits(
    context: SearchContext, stage: Stage, *, fewer_rules: bool = False
) -> Iterator[tuple[str, Stage]]:
    """The most promising edits, or only those that leave fewer rules, refined on the training part."""
    stage = ordered(stage)
    problem = stage.problem
    tried = [
        (what, replace(s, problem=replace(s.problem, stress=problem.stress)))
        for what, layout, p in edits(problem.layout, problem.parameters(stage.body), rule_support(stage))
        if len(p.theta) < stage.rules or not fewer_rules
        for s in staged(layout, p, problem.runs)
    ]
    tried.sort(key=lambda edit: edit[1].cost)
    for what, s in tried[:_TRIED]:
        yield what, refine(with_ridge(s, _RIDGE * s.cost), context.settings.iterations // 2, 1e-5)
