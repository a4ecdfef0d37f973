"""Data and settings that all candidates of one search share; the orders that are tried."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.freerun import far
from flysid.model.linear.data import SEARCH_ROWS
from flysid.model.rules.boundedness import FAR, is_bounded, probe_run
from flysid.model.rules.free_run_error import Problem, range_of, widen
from flysid.model.rules.growth import first_basis, thinned
from flysid.model.rules.judging import Candidate, followed, left_out
from flysid.model.rules.regressor_layout import (
    Antecedent,
    Layout,
    Orders,
    check_they_move,
    parse_antecedent,
    parse_antecedents,
    runs_of,
)
from flysid.model.rules.search_settings import NORMAL, RuleSettings
from flysid.model.rules.stages import Stage
from flysid.model.selection import FEWEST
from flysid.model.shared import digest
from flysid.model.subspace.order_search import ROWS_PER_UNKNOWN
from flysid.showing import counted

_STRESS = 1000  # steps of each kind of stress


def order_choices(settings: RuleSettings, inputs: int) -> list[Orders]:
    """Orders to try, simplest first: n outputs and n + 1 inputs from the present one on.

    n goes from 1 to `search.highest_order`; behind a dead time that the log shows there is no present one.

    Raises
    ------
    UsageError : orders that leave nothing to learn, or another number of them than of inputs.
    """
    choices: list[Orders] = []
    own = tuple(settings.nk_least) or (0,) * inputs
    for n in range(1, settings.search.highest_order + 1):
        na = n if settings.na == "auto" else int(settings.na)
        nk = own if settings.nk == "auto" else _per_input(settings.nk, inputs, "nk")
        more = [1 if settings.nk == "auto" and k == 0 else 0 for k in nk]
        lags = n if settings.na == "auto" else na
        nb = [lags + one for one in more] if settings.nb == "auto" else settings.nb
        orders = Orders(na, _per_input(nb, inputs, "nb"), nk)
        if orders not in choices:
            choices.append(orders)
    if all(b == 0 for b in choices[0].nb) and choices[0].na == 0:
        raise UsageError("na = 0 and nb = 0 leave nothing to learn")
    return sorted([*choices, *_delay(settings, choices)], key=lambda o: (o.na, sum(o.nb)))


def without_present(settings: RuleSettings, choices: Sequence[Orders]) -> list[Orders]:
    """The choices without the present inputs, where lags and delays are open."""
    if settings.nk != "auto" or settings.nb != "auto" or len(choices) == 1:
        return []
    found: list[Orders] = []
    for o in choices:
        fewer = tuple(max(b - 1, 1) if k == 0 else b for b, k in zip(o.nb, o.nk, strict=True))
        late = Orders(o.na, fewer, tuple(max(k, 1) for k in o.nk))
        found += [late] if late not in (*choices, *found) else []
    return found


def _per_input(value: int | Sequence[int], inputs: int, name: str) -> tuple[int, ...]:
    numbers = (int(value),) * inputs if isinstance(value, int | np.integer) else tuple(map(int, value))
    if len(numbers) != inputs:
        raise UsageError(f"{name} has {counted(len(numbers), 'number')} for {counted(inputs, 'input')}")
    return numbers


def _delay(settings: RuleSettings, choices: Sequence[Orders]) -> list[Orders]:
    """The choices behind the dead times that the log shows, where no choice bridges those by itself."""
    hint = tuple(settings.nk_hint)
    if settings.nk != "auto" or max(hint, default=0) <= 1:  # as late as any plant behind a hold
        return []
    own = choices[0].nk
    hint = tuple(map(max, hint, own))
    # the coefficient of the present input goes
    fewer = [1 if settings.nb == "auto" and k == 0 else 0 for k in own]
    behind = [
        Orders(o.na, tuple(max(1, b - f) for b, f in zip(o.nb, fewer, strict=True)), hint) for o in choices
    ]
    return [orders for orders in behind if orders not in choices]


def named_antecedents(
    settings: RuleSettings, choices: Sequence[Orders], train: Dataset
) -> tuple[Antecedent, ...]:
    """The antecedents asked for, at the lags that they have with any of these orders."""
    if settings.antecedents == "auto":
        return ()
    found = (
        parse_antecedents(settings.antecedents, train.outputs, train.inputs, orders.nk) for orders in choices
    )
    named = tuple(dict.fromkeys(itertools.chain.from_iterable(found)))
    check_they_move(named, train)
    return named


@dataclass(frozen=True, eq=False)
class SearchContext:
    """Data and settings that all stages of one fit share.

    Attributes
    ----------
    check : judges the candidates; None: blocks of the training data do, left out in turn.
    least : rows that a segment must have.
    ridges : weights on the difference of rules, rising; those after the first where rules run away.
    """

    settings: RuleSettings
    train: Dataset
    check: Dataset | None
    shift: FloatArray
    scale: FloatArray
    least: int
    must_be_bounded: bool = True
    ridges: tuple[float, ...] = NORMAL.ridges

    def key(self, choices: Hashable) -> Hashable:
        """What linear models of these choices hang on; one rule, as a rival, and rules ask for the same."""
        s = self.settings
        asked = (s.na == "auto", s.refine, s.iterations, tuple(s.nk_hint), tuple(s.nk_least))
        parts = digest(self.train), None if self.check is None else digest(self.check)
        return choices, asked, parts, self.least, self.must_be_bounded

    @property
    def auto(self) -> bool:
        """The number of rules is chosen."""
        return self.settings.rules == "auto"

    @property
    def most_rules(self) -> int:
        """Where growth stops."""
        return self.settings.most_rules if self.settings.rules == "auto" else self.settings.rules

    def room(self, stage: Stage, more: int = 1) -> bool:
        """Whether there are samples enough for so many rules more."""
        numbers = stage.body.a[0].size * (stage.rules + more)
        return bool(numbers * ROWS_PER_UNKNOWN < stage.problem.samples)

    def antecedents(self, layout: Layout) -> tuple[Antecedent, ...]:
        """Variables to split along: those asked for, or all that may tell rules apart.

        An input named without a lag is meant at the first lag that acts with these orders.
        """
        asked = self.settings.antecedents
        if asked == "auto":
            return found_antecedents(layout)
        known = layout.signals[: layout.n]
        terms = (parse_antecedent(name, known, layout.inputs, layout.orders.nk) for name in asked)
        return tuple(dict.fromkeys(terms))

    def runs(self, layout: Layout) -> tuple[FloatArray, ...]:
        """The runs that are learned from while candidates are many: pieces of a long record."""
        return thinned(runs_of(layout, self.train.segments, self.least), self.least - FEWEST, SEARCH_ROWS)

    def problem(self, orders: Orders) -> Problem:
        """The problem of a linear model of these orders.

        Its output limits are loose: where a simulation is held at a limit no gradient shows the way back,
        and a linear model's start can always be found by least squares.
        """
        layout = Layout(self.train.outputs, self.train.inputs, orders, (), self.shift, self.scale)
        runs = self.runs(layout)
        limits = far(range_of([W[:, : layout.n_y] for W in runs]))
        basis = first_basis(layout, runs)
        return Problem(layout, runs, basis, np.zeros((layout.n_y, len(basis))), np.zeros((2, 0)), limits)

    def ready(self, stage: Stage) -> Stage:
        """A linear stage to grow from: with its output limits and with stress."""
        problem = stage.problem
        n_y = stage.problem.layout.n_y
        seen = range_of([W[:, :n_y] for W in problem.runs])
        limits = widen(seen, FAR if problem.integrates else 1.0)
        steps = min(_STRESS, max(200, sum(map(len, problem.runs)) // 2))
        stress = (
            probe_run(problem.runs, n_y, steps, seed=1)  # models are asked with others in the end
            if self.must_be_bounded and not problem.integrates
            else None
        )
        return stage.under(limits=limits, stress=stress)

    def judge(self, stage: Stage, **about: Any) -> Candidate:
        """The stage as a candidate; `about` as `Candidate` has it."""
        if self.check is None:
            errors = left_out(stage)
        else:
            runs = runs_of(stage.layout, self.check.segments, self.least)
            errors = followed(stage, runs, self.least - FEWEST)
        return Candidate(stage, errors, not self.must_be_bounded or is_bounded(stage), **about)


def found_antecedents(layout: Layout) -> tuple[Antecedent, ...]:
    """The newest outputs and hidden states, the newest two of every input, the change of every output."""
    orders = layout.orders
    newest = [Antecedent(i, 1) for i in range(layout.n)] if orders.na else []
    inputs = [
        Antecedent(layout.n + j, lag)
        for j, (nb, nk) in enumerate(zip(orders.nb, orders.nk, strict=True))
        for lag in range(nk, nk + min(max(nb, 1), 2))
    ]
    change = [Antecedent(i, 1, 2) for i in range(layout.n_y)] if orders.na >= 2 else []
    return (*newest, *inputs, *change)
