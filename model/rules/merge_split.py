"""A chosen model found again by way of one rule more, so that a rule in the wrong place may move.

Growth inserts rule after rule and never takes one back: it ends in a local minimum that hangs on the first
places. One rule more, and two merged again, leaves it (split and merge: Ueda, Nakano, Ghahramani and Hinton
2000, for mixtures of densities). The words stay as many.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.model.rules.judging import Candidate
from flysid.model.rules.pruning import refined_edits
from flysid.model.rules.regressor_layout import Antecedent
from flysid.model.rules.search import one_more
from flysid.model.rules.search_context import SearchContext

_LEAST_GAIN = 0.01  # of the validation's mean square, and one standard error


def merge_and_split(
    context: SearchContext, models: Sequence[Candidate], at: int, named: tuple[Antecedent, ...]
) -> Candidate:
    """`models[at]`, or one with as many rules that training and validation both prefer.

    Little data are left alone: every quarter of them was asked for the number of rules already, and one
    more choice by the same quarters gained nothing on plants with known truth.
    """
    chosen, larger = models[at], list(models[at + 1 : at + 2])
    if context.folds or chosen.stage.rules < 2:
        return chosen
    for _ in range(context.settings.search.exchanges):
        found = _again(context, chosen, larger or one_more(context, chosen, named))
        if found is chosen:
            break
        chosen, larger = found, []
    return chosen


def _again(context: SearchContext, chosen: Candidate, larger: Sequence[Candidate]) -> Candidate:
    """The best of the larger models' mergers with as many rules as `chosen`; itself where none is better."""
    known = context.judge(chosen.stage)
    found = [
        context.judge(stage)
        for more in larger
        for _, stage in refined_edits(context, more.stage, fewer_rules=True)
        if stage.cost < chosen.stage.cost
    ]
    better = [kid for kid in found if kid.stable and _is_better(kid, known)]
    return min(better, key=lambda kid: kid.mean, default=chosen)


def _is_better(candidate: Candidate, known: Candidate) -> bool:
    gap = known.errors - candidate.errors
    spread = float(gap.std(ddof=1) / np.sqrt(len(gap))) if len(gap) > 1 else 0.0
    return float(gap.mean()) > max(spread, _LEAST_GAIN * known.mean)
