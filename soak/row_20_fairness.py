"""Rows 20 and 21: the verdict on plants whose nature is known, 200 linear and 200 nonlinear ones.

Passes when a fuzzy model is called better on at most 5 % of linear plants, and on at least 80 % of those
where it truly is, judged with the exact 95 % interval of the share.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.verdict_fairness import Outcome as Plant
from bench.verdict_fairness import exact_interval, judged, linear_plant, nonlinear_plant
from flysid.errors import FlysidError
from soak import Budget, Campaign, Outcome

COUNT = 200
CALLED_BETTER = 5.0
FOUND = 80.0


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per kind of plant."""
    for kind, share in zip(("linear", "nonlinear"), budget.shares(2), strict=True):
        outcome = Outcome(f"{kind} plants")
        plants = list[Plant]()
        goes_on = share.clock()
        while outcome.trials < COUNT and goes_on():
            rng = np.random.default_rng(outcome.trials)
            with outcome.trial():
                try:
                    plant = linear_plant(rng) if kind == "linear" else nonlinear_plant(rng)
                    plants.append(judged(plant, rng, outcome.trials))
                except FlysidError:
                    outcome.raised += 1
        _judge(kind, plants, outcome)
        yield outcome


def _judge(kind: str, plants: list[Plant], outcome: Outcome) -> None:
    """Note the shares, and a failure where the interval excludes the bound."""
    better = sum(p.verdict == "better" and (p.rules > 1 or kind == "nonlinear") for p in plants)
    covered = [p.covered for p in plants if p.covered is not None]
    low, high = exact_interval(better, max(len(plants), 1))
    outcome.remark = (
        f"called better {better} of {len(plants)}; interval holds the truth {sum(covered)} of {len(covered)}"
    )
    if kind == "linear" and low > CALLED_BETTER:
        outcome.failures.append(f"called better in {better} of {len(plants)} linear plants")
    if kind == "nonlinear" and high < FOUND:
        outcome.failures.append(f"found in {better} of {len(plants)} nonlinear plants")


CAMPAIGN = Campaign(20, "the verdict against known truth", run)
