"""Row 40: what the search finds hangs on the plant, not on which samples begin the record.

Drawn plants of fresh seeds, as they are, with seven samples dropped and with 98 % of them: linear ones stay
linear, nonlinear ones get rules, and what means nothing does not flip the choice.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping

from scipy.special import bdtr

from bench.drawn_plants import KINDS, kind_of
from bench.lottery import AS_IT_IS, CHANGES, Change, Row, fitted, is_linear, moves, of_plant
from soak import Budget, Campaign, Outcome

LINEAR = ("late third order", "integrator")
PLANTS = 20
"""Of each kind."""
GRANTED = 0.05
"""Share of linear plants with rules, and of changes that flip the choice."""
WORST = 0.4
"""Move of the error, where the choice stays."""
CHANCE = 1e-4
TRIED: Mapping[str, Change] = {
    AS_IT_IS: lambda data: data,
    **{title: CHANGES[title] for title in ("first 7 dropped", "98 %")},
}


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per kind of plant."""
    first = budget.seed if budget.seed is not None else secrets.randbelow(2**40)
    first -= first % len(KINDS)
    names = budget.chosen([kind_of(first + at) for at in range(len(KINDS))])
    for name, share in zip(names, budget.shares(len(names)), strict=True):
        at = next(at for at in range(len(KINDS)) if kind_of(first + at) == name)
        yield _judge_kind(name, first + at, share)


def _judge_kind(name: str, first: int, budget: Budget) -> Outcome:
    outcome = Outcome(name)
    goes_on = budget.clock()
    rows: list[Row] = []
    while outcome.trials < PLANTS and goes_on():
        number = first + outcome.trials * len(KINDS)
        with outcome.trial():
            record = of_plant(number)
            rows += [
                {"record": number, "change": title, **fitted(record, change)}
                for title, change in TRIED.items()
            ]
    moved, flips, _ = moves(rows)
    scored = [row for row in rows if "error" in row]
    wrong = sum(is_linear(row) != (name in LINEAR) for row in scored)
    if scored and bdtr(len(scored) - wrong, len(scored), 1.0 - GRANTED) < CHANCE:
        outcome.failures.append(f"seeds from {first}: {wrong} of {len(scored)} of the other kind")
    if len(moved) and bdtr(len(moved) - len(flips), len(moved), 1.0 - GRANTED) < CHANCE:
        outcome.failures.append(f"seeds from {first}: the choice flips in {len(flips)} of {len(moved)}")
    far = int((moved > WORST).sum())
    outcome.remark = (
        f"{wrong} of {len(scored)} of the other kind, {len(flips)} flips, {far} moves beyond 40 %"
    )
    return outcome


CAMPAIGN = Campaign(40, "the choice does not hang on a few samples", run)
