"""Data, settings and judgement that all stages of a fit of rules share; orders of lags, linear models."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.freerun import far
from flysid.model.polynomials import VANISHING
from flysid.model.rules.boundedness import FAR, probe_run
from flysid.model.rules.free_run_error import Problem, range_of, widen
from flysid.model.rules.growth import (
    embedded_start,
    first_basis,
    linear_stage,
    looks_integrating,
    rebase,
    skip_refining,
    with_integrator,
)
from flysid.model.rules.judging import Candidate, Family, judged
from flysid.model.rules.linear_starts import LinearStart, arx_start, as_stage, linear_models
from flysid.model.rules.refit import STEPS_ON_PARTS, refit
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
from flysid.model.selection import FEWEST, simplest
from flysid.model.shared import digest, once
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
    folds : further parts of little data, held out in turn.
    promise : in logarithms of the mean square, what two rules must lower fit and validation by on average.
    ridges : weights on the difference of rules, see `Training`; the first for every start.
    """

    settings: RuleSettings
    fit_part: Dataset
    check_part: Dataset
    shift: FloatArray
    scale: FloatArray
    least: int
    must_be_bounded: bool = True
    folds: tuple[tuple[Dataset, Dataset], ...] = ()
    promise: float = 0.0
    ridges: tuple[float, ...] = NORMAL.ridges

    def key(self, choices: Hashable) -> Hashable:
        """What linear models of these choices hang on; one rule, as a rival, and rules ask for the same."""
        s = self.settings
        asked = (s.na == "auto", s.refine, s.iterations, tuple(s.nk_hint), tuple(s.nk_least))
        parts = digest(self.fit_part), digest(self.check_part)
        return choices, asked, parts, self.least, self.must_be_bounded

    @property
    def parts(self) -> tuple[tuple[Dataset, Dataset], ...]:
        """Fitting and judging parts; places for rules are searched for on the first."""
        return ((self.fit_part, self.check_part), *self.folds)

    @property
    def auto(self) -> bool:
        """The number of rules is chosen."""
        return self.settings.rules == "auto"

    @property
    def asks_nothing(self) -> bool:
        """The number of rules, their antecedents and all orders are chosen."""
        s = self.settings
        return all(asked == "auto" for asked in (s.rules, s.antecedents, s.na, s.nb, s.nk))

    @property
    def most_rules(self) -> int:
        """Where growth stops."""
        return self.settings.most_rules if self.settings.rules == "auto" else self.settings.rules

    def error(self, family: Family) -> float:
        """What families are ranked by: the validation error of the asked, or the best number of rules."""
        return float(family.rmse.min() if self.auto else family.rmse[-1])

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

    def problem(self, orders: Orders) -> Problem:
        """The problem of a linear model of these orders.

        Its output limits are loose: where a simulation is held at a limit no gradient shows the way back,
        and a linear model's start can always be found by least squares.
        """
        layout = Layout(self.fit_part.outputs, self.fit_part.inputs, orders, (), self.shift, self.scale)
        runs = runs_of(layout, self.fit_part.segments, self.least)
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

    def judge(self, stage: Stage, check: Dataset | None = None) -> Candidate:
        """The stage on a judging part, the first one where none is given."""
        data = self.check_part if check is None else check
        runs = runs_of(stage.layout, data.segments, self.least)
        return judged(stage, runs, self.least - FEWEST, must_be_bounded=self.must_be_bounded)

    def linear(self, choices: Sequence[Orders]) -> tuple[list[Family], list[str]]:
        """Linear models, each refined from the one before, up to the best orders."""
        candidates = list(self._of_orders(tuple(choices)))
        notes: list[str] = []
        needless = self._needless(candidates) if len(choices) > 1 else ()
        if needless:
            candidates += self._of_orders(
                tuple(dict.fromkeys(_without(orders, needless) for orders in choices))
            )
            names = ", ".join(self.fit_part.inputs[j].name for j in needless)
            notes = [f"A linear model simulates held-out parts as well without past values of {names}."]
        candidates += self._linear_side(len(choices))
        candidates.sort(key=lambda c: c.stage.body.size)
        at = self._simplest(candidates)
        orders = candidates[at].stage.problem.layout.orders
        most = 100.0 * self.settings.search.rule_gain
        near = f"the simplest within one standard error of the best, and {most:g} %"
        how = "as given" if len(choices) == 1 else near
        notes = [f"Orders {orders}: {how} (validation free run of the linear model).", *notes]
        others = [i for i, c in enumerate(candidates) if i != at and c.stable == candidates[at].stable]
        return [Family(((candidates[i],),)) for i in (at, *others)], notes

    def _simplest(self, candidates: Sequence[Candidate]) -> int:
        """Index of the simplest stable linear model that runs as near as the best stable one, or nearly.

        A linear model of too low an order makes rules look useful that only replace its lags, so that
        simplicity may cost no more than a rule must win.
        """
        stable = [i for i, c in enumerate(candidates) if c.stable] or [0]
        errors = [np.maximum(candidates[i].errors, VANISHING) for i in stable]
        return stable[simplest(errors, self.settings.search.rule_gain)]

    @once(key)
    def _of_orders(self, choices: tuple[Orders, ...]) -> tuple[Candidate, ...]:
        """One linear model of each, or two where one holds an integrator; each starts from those before."""
        candidates: list[Candidate] = []
        loose: list[Stage] = []
        for orders in choices:
            problem = self.problem(orders)
            if self.settings.refine:
                nested = (embedded_start(known, problem) for known in reversed(loose))
                start = next(filter(None, nested), ())
                if self.settings.na != "auto":  # else the linear side's model of its own orders comes in
                    start += arx_start(problem, self.fit_part)
                stage = linear_stage(problem, self.settings.iterations, start)
            else:
                stage = skip_refining(problem)
            variants = self._settle(stage, loose)
            candidates += [self.judge(self.ready(s)) for s in variants]
            loose += variants
        return tuple(candidates)

    def _needless(self, candidates: Sequence[Candidate]) -> tuple[int, ...]:
        """Inputs whose past values a linear model of the best of these orders does as well without.

        Left out one after the other, the least missed one first, while the loss stays within what simpler
        orders may cost. Every rule would weigh their lags anew, and few rules could be afforded.
        """
        if not self.settings.refine or self.settings.nb != "auto" or len(self.fit_part.inputs) < 2:
            return ()
        best = min(candidates, key=lambda c: (not c.stable, c.mean))
        orders = best.stage.problem.layout.orders
        whole = self._on_every_part(best)
        alone = {j: self._left_out(orders, (j,)) for j, lags in enumerate(orders.nb) if lags}
        needless: tuple[int, ...] = ()
        for j in sorted(alone, key=lambda j: alone[j].mean):
            tried = (*needless, j)
            if len(tried) == len(alone):
                break
            rest = alone[j] if len(tried) == 1 else self._left_out(orders, tried)
            if self._simplest([rest, whole]):
                break
            needless = tried
        return tuple(sorted(needless))

    def _left_out(self, orders: Orders, inputs: Sequence[int]) -> Candidate:
        return self._on_every_part(self._of_orders((_without(orders, inputs),))[0])

    @once(key)
    def _linear_side(self, choices: int) -> Sequence[Candidate]:
        """What the linear side chooses by itself, with its delays, as it is and refined."""
        if not self.settings.refine or choices == 1:
            return []
        found = linear_models(self.fit_part, self.check_part, self.settings.nk_hint)
        return [c for model in found if self._may_start(model.orders) for c in self._both(model)]

    def _may_start(self, orders: Orders) -> bool:
        """The data hold these lags, and none is shorter than the dead time that the log shows."""
        least = tuple(self.settings.nk_least) or (0,) * len(orders.nk)
        late = all(k >= floor or not b for k, floor, b in zip(orders.nk, least, orders.nb, strict=True))
        return late and self.holds(orders)

    def holds(self, orders: Orders) -> bool:
        """The segments of every part are long enough for these lags."""
        return orders.depth + FEWEST <= self.least

    def completed(self, start: Family) -> Family:
        """A linear start beside itself on the parts that other folds hold out, refitted without them.

        One quarter of little data says too little to choose the number of rules by.
        """
        if len(start.folds) == len(self.parts):
            return start
        models = [start.linear, *(self._refit(start.linear, *parts) for parts in self.folds)]
        return replace(start, folds=tuple((model,) for model in models))

    def _refit(self, known: Candidate, fit_part: Dataset, check_part: Dataset) -> Candidate:
        layout = known.stage.layout
        again = refit(known, fit_part, runs_of(layout, fit_part.segments, self.least), STEPS_ON_PARTS)
        runs = runs_of(layout, check_part.segments, self.least)
        one = judged(again, runs, self.least - FEWEST, must_be_bounded=False)
        return replace(one, stable=known.stable)

    def _on_every_part(self, known: Candidate) -> Candidate:
        """The candidate with its errors on every part."""
        folds = self.completed(Family(((known,),))).folds
        return replace(known, errors=np.concatenate([m.errors for (m,) in folds]))

    def _both(self, model: LinearStart) -> list[Candidate]:
        plain = as_stage(model, self.problem(model.orders))
        settled = self._settle(rebase(plain).refined(self.settings.iterations, 1e-6))
        kept = [] if any(s.problem.integrates for s in settled) else [self.judge(self.ready(rebase(plain)))]
        return [
            *(replace(c, linear=model, moved=False) for c in kept if np.isfinite(c.stage.cost)),
            *(replace(self.judge(self.ready(s)), linear=model) for s in settled),
        ]

    def _settle(self, stage: Stage, known: Sequence[Stage] = ()) -> tuple[Stage, ...]:
        """The linear stage, its integrator kept where it has one."""
        if not (self.settings.refine and looks_integrating(stage)):
            return (stage,)
        return with_integrator(stage, self.settings.iterations, known)


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


def _without(orders: Orders, inputs: Sequence[int]) -> Orders:
    """The orders with no past values of these inputs."""
    return replace(orders, nb=tuple(0 if j in inputs else lags for j, lags in enumerate(orders.nb)))
