"""Row 39: what is said of another flight, and printed figures, on seeds that nobody has seen.

Two equally good models may be told apart on another flight in 6 of 60 trials at most, where flights drift and
where one in six is odd, and a true difference must be found in most. Then drawn records of every kind of
plant, noise, logging and excitation: no figure's interval may miss the truth in more than a fifth.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator

import numpy as np
from scipy.special import bdtr

from bench.truth.records import draw_record
from bench.truth.verbs import scores
from bench.verdict_few import IN_ORDER, claim, draw_gains
from flysid.validate.compare.intervals import Scope
from soak import Budget, Campaign, Outcome

FLIGHTS = (2, 3, 4, 6, 10, 20)
TRIALS = 60
MOST_FALSE = 6
ROWS = 600
RECORDS = 300
LEAST = 0.8
CHANCE = 1e-4


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per way in which flights differ, and one for the figures."""
    first = budget.seed if budget.seed is not None else secrets.randbelow(2**40)
    shares = budget.shares(len(IN_ORDER) + 1)
    for kind, share in zip(IN_ORDER, shares, strict=False):
        yield _judge_flights(kind, first, share)
    yield _judge_figures(first, shares[-1])


def _judge_flights(kind: str, first: int, budget: Budget) -> Outcome:
    outcome = Outcome(f"flights: {kind}")
    goes_on = budget.clock()
    found = []
    for count in FLIGHTS:
        rng = np.random.default_rng((first, count))
        claims: list[Scope | None] = []
        while len(claims) < TRIALS and goes_on():
            with outcome.trial():
                claims.append(claim(draw_gains(kind, count, rng), ROWS, rng))
        wide = claims.count(Scope.ANOTHER)
        found.append(f"{wide} + {len(claims) - wide - claims.count(None)} of {len(claims)} with {count}")
        if kind != IN_ORDER[-1] and wide > MOST_FALSE:
            outcome.failures.append(f"{count} flights, seed {first}: {wide} of {len(claims)} false")
        if kind == IN_ORDER[-1] and count == FLIGHTS[-1] and len(claims) > wide + TRIALS // 3:
            outcome.failures.append(f"{count} flights, seed {first}: {wide} of {len(claims)} found")
    outcome.remark = f"of another flight + of one like these: {', '.join(found)}"
    return outcome


def _judge_figures(first: int, budget: Budget) -> Outcome:
    outcome = Outcome("figures of drawn records")
    goes_on = budget.clock()
    held: dict[str, list[bool]] = {}
    while outcome.trials < RECORDS and goes_on():
        seed = first + outcome.trials
        with outcome.trial():
            printed = {s.figure: s for s in scores(draw_record(seed)) if s.true is not None}
        for name, score in printed.items():
            if score.low is not None:
                held.setdefault(name, []).append(score.held)
    for name, each in held.items():
        if bdtr(sum(each), len(each), LEAST) < CHANCE:
            outcome.failures.append(f"{name}, seeds from {first}: {sum(each)} of {len(each)} hold the truth")
    outcome.remark = (
        f"{sum(map(sum, held.values()))} of {sum(map(len, held.values()))} intervals hold the truth"
    )
    return outcome


CAMPAIGN = Campaign(39, "sentences that stay true", run)
