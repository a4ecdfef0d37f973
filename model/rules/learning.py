"""From settings and data to a chosen TS model: orders, growth, rule count, and the reasons in words."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError, UsageError
from flysid.model.arguments import is_count
from flysid.model.base import Fitted
from flysid.model.linear.settings import check_hint
from flysid.model.rules.edits import merge_and_split, prune
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.judging import INTEGRATES, Candidate, choose, hold_out, is_bounded
from flysid.model.rules.linear_starts import Asked, as_linear, as_stage
from flysid.model.rules.refit import on_all_runs, refit
from flysid.model.rules.regressor_layout import (
    Antecedent,
    Orders,
    check_they_move,
    parse_antecedents,
    runs_of,
    scaling,
)
from flysid.model.rules.search import affords, cross_validated, search
from flysid.model.rules.search_context import SPARE_ROWS, SearchContext, Settings
from flysid.model.rules.stages import ordered
from flysid.model.selection import parts_to_choose_on
from flysid.split import MIN_FLIGHTS

SWEEP = "Validation free-run error by number of rules"
"""How the note begins that says what was tried."""
_HIGHEST_LINEAR = 12  # samples of lags that the linear side may choose on short records,
_DEEPEST_DELAY = 40  # and on long ones, delay included
_SHARE = 20  # a segment must be so many times longer than what the linear side looks back
_LATE = 2  # samples of delay from which a dead time is tried as such
_ON_ALL = "The model was refined once more on the held-out part together with the rest."
_AS_IT_WAS = (
    "The held-out part only chose the model: refined once more on all the data, it was no longer stable."
)


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage and how it was chosen, in words.

    Attributes
    ----------
    neighbour : one with a rule more, or fewer where growth ended.
    linear : the linear model that one rule is, where it is one.
    """

    stage: Stage
    notes: tuple[str, ...]
    neighbour: Stage | None = None
    linear: Fitted | None = None

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.stage.layout.depth + SPARE_ROWS

    def again(self, data: Dataset, iterations: int) -> Stage:
        """The stage refined from where it is on a part of the data."""
        return on_all_runs(self.stage, runs_of(self.stage.layout, data.segments, self.least), iterations)


LinearSide = Callable[[Asked, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""


class _Linear(NamedTuple):
    """A linear model, the same as a stage of one rule, and how it was found."""

    model: Fitted
    stage: Stage
    notes: tuple[str, ...]


def learn(
    settings: Settings, train: Dataset, validation: Dataset | None, linear_side: LinearSide | None = None
) -> Learned:
    """Choose orders, then rules, by the validation free run; see the module's parts for the methods.

    Parameters
    ----------
    linear_side : whose choice a single rule is; where it is None, a single rule is the search's own.

    Raises
    ------
    UsageError : settings that cannot be; antecedents that are not there.
    DataError : no or too few samples, a signal that never moves.
    FitError : no stable model was found.
    """
    check(settings)
    settings.search.check()
    check_hint(settings.nk_hint, len(train.inputs))
    check_hint(settings.nk_least, len(train.inputs), "nk_least")
    choices = order_choices(settings, len(train.inputs))
    named = _named(settings, choices, train)
    deepest = _deepest(settings, train) if len(choices) > 1 else 0
    depths = [deepest, *(o.depth for o in choices), *(max(a.lag, a.minus) for a in named)]
    least = max(depths) + SPARE_ROWS
    long = len(train) >= settings.search.short
    fit_part, check_part, own = _parts(train, validation, least, long=long)
    shift, scale = scaling(fit_part)
    small = own and settings.rules == "auto" and settings.refine and not long
    folds = tuple(hold_out(train, least, fold) for fold in range(1, settings.search.folds)) if small else ()
    gain = settings.search.short_rule_gain if small else settings.search.rule_gain
    context = SearchContext(settings, fit_part, check_part, shift, scale, least, folds=folds, gain=gain)
    candidates, notes = context.linear(choices)
    context = replace(context, must_be_bounded=any(c.stable for c in candidates))
    if not context.must_be_bounded:
        candidates = [replace(c, stable=True) for c in candidates]
        notes.append(f"{INTEGRATES} Boundedness was not asked for.")
    if folds:
        notes.append("Little data: parts of it were held out in turn to choose the number of rules.")
    models, at = _chosen(context, candidates)
    chosen = models[at]
    if not chosen.stable:
        raise FitError(
            "no stable model was found: none came back from bounded random inputs",
            hint="give more data, lower orders, or fewer rules",
        )
    notes += _changed_orders(models, at) + _unstable(models)
    if settings.refine and settings.rules == "auto" and settings.antecedents == "auto":
        chosen, simpler = prune(context, merge_and_split(context, models, at))
        notes += simpler
    stage = known = ordered(chosen.stage)
    near = [*models[at + 1 :], *models[at - 1 : at]]
    neighbour = next((m.stage for m in near if m.stable), None)
    linear = None if linear_side is None else _linear(linear_side, context, chosen.stage, train, validation)
    if linear is not None:
        words = (*linear.notes, *rule_verdict(settings, models, at))
        return Learned(linear.stage, words, neighbour, linear.model)
    if settings.refine:
        runs = runs_of(stage.problem.layout, (train if own else fit_part).segments, least)
        stage = refit(replace(chosen, stage=stage), train if own else fit_part, runs, settings.iterations)
    if own and settings.refine:
        notes.append(_AS_IT_WAS if stage is known else _ON_ALL)
    if stage.problem.integrates and context.must_be_bounded:
        notes.append(INTEGRATES)
    return Learned(stage, (*notes, *rule_verdict(settings, models, at), _method(settings)), neighbour)


def _linear(
    linear_side: LinearSide, context: SearchContext, chosen: Stage, train: Dataset, validation: Dataset | None
) -> _Linear | None:
    """One rule is the linear side's choice, parameter for parameter.

    None where there is more than one rule, where the process integrates, which one rule can say exactly, or
    where the choice is no equation over lags that runs free.
    """
    settings = context.settings
    if chosen.rules > 1 or chosen.problem.integrates or not settings.refine:
        return None
    found = linear_side(settings, train, validation)
    model = None if found is None else as_linear(found[1])
    if found is None or model is None:
        return None
    least = max(context.least, model.orders.depth + SPARE_ROWS)
    if not any(len(s) >= least for s in train.segments):
        return None
    whole = replace(context, fit_part=train, least=least)
    stage = whole.ready(as_stage(model, whole.problem(model.orders)))
    if not np.isfinite(stage.cost) or (context.must_be_bounded and not is_bounded(stage)):
        return None
    said = f"One rule is the linear side's choice, parameter for parameter: {found[0].upper()}."
    return _Linear(found[1], stage, (said, *found[1].notes))


def _deepest(settings: Settings, train: Dataset) -> int:
    """Samples that the linear side's models may look back."""
    longest = max((len(s) for s in train.segments), default=0)
    return min(_DEEPEST_DELAY if len(train) > settings.search.short else _HIGHEST_LINEAR, longest // _SHARE)


def _chosen(context: SearchContext, linear: Sequence[Candidate]) -> tuple[list[Candidate], int]:
    """Models by number of rules, and which of them is offered."""
    settings = context.settings
    if settings.rules != "auto" and not any(affords(c, settings.rules) for c in linear):
        raise _too_many(settings.rules, linear)  # before an hour of growing
    models = search(context, linear)
    if settings.rules != "auto":
        if len(models) < settings.rules:
            raise _too_many(settings.rules, models)
        return models, len(models) - 1
    if context.folds and len(models) > 1:
        models = cross_validated(context, models, max(1, choose(models, least_gain=context.gain)))
    return models, choose(models, least_gain=context.gain)


def _too_many(rules: int, models: Sequence[Candidate]) -> DataError:
    stage = models[0].stage
    return DataError(
        f"{rules} rules of {stage.body.a[0].size} numbers need more than the "
        f"{stage.problem.samples} samples there are",
        hint="ask for fewer rules or lower orders, or record longer",
    )


def _changed_orders(models: Sequence[Candidate], at: int) -> list[str]:
    """That the orders with rules are others than without, in words."""
    orders = models[at].stage.problem.layout.orders
    if orders == models[0].stage.problem.layout.orders:
        return []
    return [f"With rules, orders {orders} did better and were taken."]


def _unstable(models: Sequence[Candidate]) -> list[str]:
    """Which models may not be offered, in words."""
    counts = ", ".join(str(len(m.stage.body.a)) for m in models if not m.stable)
    if not counts:
        return []
    return [f"Did not come back from bounded random inputs, and were not offered: {counts} rules."]


def check(settings: Settings) -> None:
    """Raise UsageError for settings that cannot be."""
    for name in ("rules", "na"):
        value = getattr(settings, name)
        low = 1 if name == "rules" else 0
        if value != "auto" and not is_count(value, low):
            raise UsageError(f"{name}={value!r}", hint=f'give "auto" or a whole number from {low} on')
    for name in ("nb", "nk"):
        value = getattr(settings, name)
        numbers = list(value) if isinstance(value, Sequence | np.ndarray) else [value]
        if value != "auto" and not all(is_count(v, 0) for v in numbers):
            raise UsageError(f"{name}={value!r}", hint='give "auto", a whole number, or one per input')
    for name in ("most_rules", "iterations"):
        if not is_count(getattr(settings, name), 1):
            raise UsageError(f"{name}={getattr(settings, name)!r}", hint="give a whole number, at least 1")
    if not isinstance(settings.refine, bool):
        raise UsageError(f"refine={settings.refine!r}", hint="give True or False")


def _per_input(value: int | Sequence[int], inputs: int, name: str) -> tuple[int, ...]:
    numbers = (int(value),) * inputs if isinstance(value, int | np.integer) else tuple(map(int, value))
    if len(numbers) != inputs:
        raise UsageError(f"{name} has {len(numbers)} numbers for {inputs} inputs")
    return numbers


def order_choices(settings: Settings, inputs: int) -> list[Orders]:
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
    return sorted([*choices, *_delayed(settings, choices)], key=lambda o: (o.na, sum(o.nb)))


def _delayed(settings: Settings, choices: Sequence[Orders]) -> list[Orders]:
    """The choices behind the dead times that the log shows, where no choice bridges those by itself."""
    hint = tuple(settings.nk_hint)
    if settings.nk != "auto" or max(hint, default=0) < _LATE:
        return []
    own = choices[0].nk
    hint = tuple(map(max, hint, own))
    fewer = [
        1 if settings.nb == "auto" and k == 0 else 0 for k in own
    ]  # the present input's coefficient goes
    behind = [
        Orders(o.na, tuple(max(1, b - f) for b, f in zip(o.nb, fewer, strict=True)), hint) for o in choices
    ]
    return [orders for orders in behind if orders not in choices]


def _named(settings: Settings, choices: Sequence[Orders], train: Dataset) -> tuple[Antecedent, ...]:
    """The antecedents asked for, at the lags that they have with any of these orders."""
    if settings.antecedents == "auto":
        return ()
    if isinstance(settings.antecedents, str) or not settings.antecedents:
        raise UsageError(f"antecedents={settings.antecedents!r}", hint='give "auto" or a list of names')
    found = (
        parse_antecedents(settings.antecedents, train.outputs, train.inputs, orders.nk) for orders in choices
    )
    named = tuple(dict.fromkeys(itertools.chain.from_iterable(found)))
    check_they_move(named, train)
    return named


def _parts(
    train: Dataset, validation: Dataset | None, least: int, *, long: bool
) -> tuple[Dataset, Dataset, bool]:
    longest = max((len(s) for s in train.segments), default=0)
    if longest < least:
        raise DataError(
            f"the longest segment has {longest} samples; these orders need {least}",
            hint="record longer, allow longer gaps, or ask for lower orders",
        )
    if validation is not None and any(len(s) >= least for s in validation.segments):
        return train, validation, False
    kept, held = _whole_flights(train, least) if long else hold_out(train, least)
    return kept, held, True


def _whole_flights(train: Dataset, least: int) -> tuple[Dataset, Dataset]:
    """The parts that the baseline is chosen on, where flights are enough: its rivals share their fits."""
    if len(train.flights) >= MIN_FLIGHTS:
        with suppress(DataError):
            parts = parts_to_choose_on(train)
            if all(any(len(s) >= least for s in part.segments) for part in parts):
                return parts
    return hold_out(train, least)


def rule_verdict(settings: Settings, models: Sequence[Candidate], at: int) -> list[str]:
    """The rule count in words."""
    if settings.rules != "auto":
        return [f"{settings.rules} rules, as asked."]
    tried = ", ".join(f"{len(m.stage.body.a)}: {with_spread(m, models)}" for m in models)
    sweep = f"{SWEEP}, in standard deviations of the output: {tried}."
    if "+-" in tried:
        sweep += " +- is one standard error of the distance to the best."
    if len(models) == 1:
        return [sweep, "One rule is enough: two hardly lower the error even of what they were fitted to."]
    if at == 0:
        return [sweep, "One rule is enough: more rules do not lower the validation error beyond its spread."]
    return [sweep, f"{at + 1} rules: the fewest within one standard error of the best."]


def with_spread(model: Candidate, models: Sequence[Candidate]) -> str:
    """ "0.134 +- 0.012": the error, and one standard error of its distance to the best stable model's."""
    best = min((m for m in models if m.stable), key=lambda m: m.mean, default=model)
    error = float(np.sqrt(model.mean))
    gap = model.errors - best.errors
    if model is best or len(gap) < 2 or not error > 0.0:
        return f"{error:.3g}"
    # of the root of the mean square, to first order
    return f"{error:.3g} +- {float(gap.std(ddof=1) / np.sqrt(len(gap))) / (2.0 * error):.2g}"


def _method(settings: Settings) -> str:
    if not settings.refine:
        return "Consequents are one-step least squares; the simulation error was not refined."
    return (
        "Consequents and memberships were refined on the simulation error with exact sensitivities; models "
        "were offered only if they came back from bounded random inputs."
    )
