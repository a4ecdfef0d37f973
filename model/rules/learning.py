"""From settings and data to a chosen model of rules: a pipeline of named steps over one record.

Over lags: linear starts, search, choice, the linear side's choice where one rule is enough, settling. Over
hidden states: linear systems, search, choice, settling. Every step returns a new record with its reason in
words; intervals come with its model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError
from flysid.model.arguments import check_inputs, check_rows
from flysid.model.base import Fitted
from flysid.model.last_gates import shortfall
from flysid.model.linear.settings import check_hint
from flysid.model.rules import candidates
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.fitted import FittedTS, finish
from flysid.model.rules.growth import clustered_stage, split
from flysid.model.rules.judging import INTEGRATES, Candidate, fewest, in_words
from flysid.model.rules.linear_starts import as_linear, as_stage
from flysid.model.rules.operating_points import describe
from flysid.model.rules.refit import STEPS_ON_PARTS, on_all_runs
from flysid.model.rules.regressor_layout import runs_of, scaling
from flysid.model.rules.search import search
from flysid.model.rules.search_context import SearchContext, named_antecedents, order_choices
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage, ordered
from flysid.model.rules.state_systems import ends_in_words, linear_systems, saturation_limits
from flysid.model.selection import FEWEST, LEVEL
from flysid.model.start import START_SHARE
from flysid.showing import counted

SWEEP = "Validation free-run error by number of rules"
"""How the note begins that says what was tried."""
LinearSide = Callable[[RuleSettings, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""
_DEEPEST_DELAY = 40  # samples that the linear side's models may look back, delay included


@dataclass(frozen=True, eq=False)
class Search:
    """What a search knows after each of its steps.

    Attributes
    ----------
    starts : linear models that rules may be grown from; `plain`, the one that is a single rule.
    levels : candidates with 1, 2, 3, ... rules, best first.
    chosen : the model that is to be offered; `stage`, the same on all the data.
    notes, verdict : reasons, in words; those on the number of rules.
    linear : the linear model that one rule is, where it is one.
    """

    context: SearchContext
    train: Dataset
    validation: Dataset | None
    starts: tuple[Candidate, ...]
    plain: Candidate
    levels: tuple[tuple[Candidate, ...], ...]
    chosen: Candidate
    stage: Stage
    notes: tuple[str, ...] = ()
    verdict: tuple[str, ...] = ()
    linear: Fitted | None = None

    @classmethod
    def begun(
        cls,
        context: SearchContext,
        data: tuple[Dataset, Dataset | None],
        starts: Sequence[Candidate],
        notes: Sequence[str],
    ) -> Search:
        """Before anything is grown: the simplest linear model that is not clearly worse than the best.

        One of too low an order makes rules look useful that only replace its lags.
        """
        able = [c for c in starts if c.stable]
        plain = able[fewest(able, context.settings.search.rule_gain)]
        return cls(context, *data, tuple(starts), plain, ((plain,),), plain, plain.stage, tuple(notes))

    @property
    def models(self) -> list[Candidate]:
        """The best model of every number of rules."""
        return [self.plain, *(level[0] for level in self.levels[1:])]

    @property
    def promise(self) -> float:
        """What a second rule changes in the judge's mean square, in logarithms; -inf where none was tried."""
        if len(self.levels) < 2:
            return -np.inf
        one, two = (min(c.score for c in level) for level in self.levels[:2])
        return two - one

    def said(self, *notes: str) -> Search:
        """With notes more."""
        return replace(self, notes=(*self.notes, *notes))

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.context.least if self.stage.layout.hidden else self.stage.layout.depth + FEWEST

    @cached_property
    def bare(self) -> FittedTS:
        """The fitted model, without what it does at operating points."""
        return finish(self.stage, self.train, (*self.notes, *self.verdict))

    @property
    def model(self) -> FittedTS:
        """The fitted model; it says what it does at operating points, and how surely."""
        return describe(self.bare, self.train, settled=True)

    def again(self, data: Dataset) -> FittedTS:
        """The model refined from where it is on a part of the data; itself for all of them."""
        if data is self.train:
            return self.bare
        runs = runs_of(self.stage.layout, data.segments, self.least)
        return finish(on_all_runs(self.stage, runs, STEPS_ON_PARTS), data, ())


def over_lags(
    settings: RuleSettings, train: Dataset, validation: Dataset | None, linear_side: LinearSide | None = None
) -> Search:
    """Rules over lags: linear models of several orders, rules grown from all, by the judged free run.

    Parameters
    ----------
    validation : judges the candidates; None: blocks of the training data do, left out in turn.
    linear_side : whose choice a single rule is; where it is None, a single rule is the search's own.

    Raises
    ------
    UsageError : settings that cannot be; antecedents that are not there.
    DataError : no or too few samples, a signal that never moves.
    FitError : no stable model was found.
    """
    found = lag_starts(settings, train, validation)
    for step in (grow, select, partial(take_linear_side, linear_side), settle):
        found = step(found)
    return found


def split_from_one(
    settings: RuleSettings, train: Dataset, validation: Dataset | None, linear_side: LinearSide | None = None
) -> Search:
    """As many rules over lags as are asked for, all of which say what one says; raises as `over_lags`."""
    rules = int(settings.rules)
    found = over_lags(replace(settings, rules=1), train, validation, linear_side)
    stage = split(found.stage, found.context.antecedents(found.stage.layout), rules)
    if stage is None:
        raise _too_many(rules, found.stage)
    note = f"{rules} rules refined separately followed the training data less closely: one rule split."
    return replace(found, stage=ordered(stage), linear=None).said(note)


def over_states(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Rules over hidden states: linear systems, rules grown from all; raises as `over_lags`."""
    found = state_starts(settings, train, validation)
    for step in (grow, select, settle):
        found = step(found)
    return found.said(INTEGRATES) if not found.context.must_be_bounded else found


def lag_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Linear models of several orders, judged."""
    check_inputs(len(train.inputs))
    check_hint(settings.nk_hint, len(train.inputs))
    check_hint(settings.nk_least, len(train.inputs), "nk_least")
    choices = order_choices(settings, len(train.inputs))
    named = named_antecedents(settings, choices, train)
    if settings.na != "auto":
        simplest = choices[0]
        check_rows(train, simplest.depth, len(train.outputs) * simplest.na + sum(simplest.nb) + 1)
    deepest = _deepest(train) if len(choices) > 1 else 0
    depth = max(deepest, *(o.depth for o in choices), *(a.depth for a in named), 0)
    context = _context(settings, (train, validation), depth)
    starts, notes = candidates.over_lags(context, choices)
    if not any(c.stable for c in starts):
        context = replace(context, must_be_bounded=False)
        starts = [replace(c, stage=c.stage.under(stress=None), stable=True) for c in starts]
        notes.append(f"{INTEGRATES} Boundedness was not asked for.")
    found = Search.begun(context, (train, validation), starts, notes)
    near = f"the simplest within one standard error of the best, and {100 * settings.search.rule_gain:g} %"
    how = "as given" if len(choices) == 1 else near
    return found.said(f"Orders {found.plain.stage.layout.orders}: {how} (free run of the linear model).")


def state_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Linear systems in several coordinates, judged."""
    check_inputs(len(train.inputs))
    systems = linear_systems(settings, train, validation, scaling(train))
    depth = max(s.orders.depth for s in systems) + 2 * max(map(len, systems))
    ends = saturation_limits(train)
    context = _context(settings, (train, validation), depth)
    context = replace(context, ridges=context.ridges[1:] or context.ridges)
    starts = candidates.over_states(context, systems, ends)
    if not any(c.stable for c in starts):
        context = replace(context, must_be_bounded=False)
        starts = [replace(c, stable=True) for c in starts]
    tried = "; ".join(dict.fromkeys(s.title for s in systems))
    notes = [f"Tried, in several coordinates: {tried}."] if len(systems) > 1 else []
    return Search.begun(context, (train, validation), starts, [*notes, *ends_in_words(ends, train)])


def _context(settings: RuleSettings, data: tuple[Dataset, Dataset | None], depth: int) -> SearchContext:
    """Settings, data and scaling; of a validation part that holds no segment long enough, nothing.

    Parameters
    ----------
    depth : samples that the deepest model looks back.
    """
    train, validation = data
    least = depth + FEWEST
    longest = max((len(s) for s in train.segments), default=0)
    if longest < least:
        raise DataError(
            f"the longest segment has {counted(longest, 'sample')}; this model needs {least}",
            hint="record longer, allow longer gaps, or ask for lower orders or fewer states",
        )
    usable = validation is not None and any(len(part) >= least for part in validation.segments)
    ridges = settings.search.ridges if settings.ridge == "auto" else (settings.ridge,)
    check = validation if usable else None
    return SearchContext(settings, train, check, *scaling(train), least, ridges=ridges)


def _deepest(train: Dataset) -> int:
    """Samples that the linear side's models may look back."""
    longest = max((len(s) for s in train.segments), default=0)
    return min(_DEEPEST_DELAY, int(START_SHARE * longest))


def grow(found: Search) -> Search:
    """Rules, one after the other, from all that may be grown from."""
    context = found.context
    asked = context.settings.rules
    able = [c for c in found.starts if c.stable and c.may_grow]
    if asked != "auto" and not any(context.room(c.stage, asked - 1) for c in able):
        raise _too_many(asked, found.plain.stage)  # before an hour of growing
    if context.most_rules == 1:
        return found
    if not context.settings.refine:
        linear = found.plain
        looked_at = context.antecedents(linear.stage.layout)[:2]
        stages = (clustered_stage(linear.stage, looked_at, r) for r in range(2, context.most_rules + 1))
        return replace(found, levels=((linear,), *((context.judge(s),) for s in stages)))
    return replace(found, levels=tuple(tuple(level) for level in search(context, able or found.starts)))


def _too_many(rules: int, stage: Stage) -> DataError:
    return DataError(
        f"{rules} rules of {stage.body.a[0].size} numbers need more than the "
        f"{stage.problem.samples} samples there are",
        hint="ask for fewer rules, lower orders or fewer states, or record longer",
    )


def select(found: Search) -> Search:
    """How many of the rules are worth it, and why."""
    context = found.context
    models = found.models
    asked = context.settings.rules
    if asked == "auto":
        chosen = models[fewest(models, context.settings.search.rule_gain)]
    elif len(models) >= asked and models[asked - 1].stable:
        chosen = models[asked - 1]
    else:
        chosen, note = _split_instead(found, asked)
        found = found.said(note)
    found = replace(found, chosen=chosen, stage=ordered(chosen.stage))
    if chosen.origin:
        found = replace(found, notes=(chosen.origin, *found.notes))
    orders = chosen.stage.layout.orders
    if not chosen.stage.layout.hidden and orders != found.plain.stage.layout.orders:
        found = found.said(f"With rules, orders {orders} did better and were taken.")
    return replace(found, verdict=_verdict(found))


def _split_instead(found: Search, rules: int) -> tuple[Candidate, str]:
    """As many rules as were asked for where refining them leaves the limits, and a note on it.

    On a plant that fewer rules describe to rounding, more numbers follow nothing but rounding, anywhere. The
    most rules that are bounded are split instead, which leaves what they do as it is.

    Raises
    ------
    FitError : no model with fewer rules is bounded.
    """
    context = found.context
    for known in reversed(found.models[: rules - 1]):
        if not known.stable:
            continue
        stage = split(known.stage, context.antecedents(known.stage.layout), rules)
        if stage is None:
            continue
        model = context.judge(stage, origin=known.origin)
        if model.stable:
            count = "one rule" if known.stage.rules == 1 else f"{known.stage.rules} rules"
            return model, (
                f"{rules} rules refined separately left their limits under bounded random inputs: {count} "
                "split, without another conclusion."
            )
    raise FitError(
        "no stable model was found: under bounded random inputs every candidate left its limits",
        hint="give more data, lower orders, or fewer rules",
    )


def _verdict(found: Search) -> tuple[str, ...]:
    """The rule count in words."""
    asked = found.context.settings.rules
    if asked != "auto":
        return (f"{asked} rules, as asked." if asked != 1 else "One rule, as asked.",)
    said = f"{SWEEP}, in standard deviations of the output: {in_words(found.models)}."
    if "+-" in said:
        said += " +- is one standard error of the distance to the best."
    if len(found.models) == 1:
        return (said, "One rule is enough: no model of two stayed bounded, or the data are too few for one.")
    if found.chosen.stage.rules == 1:
        return (said, "One rule is enough: more rules do not lower the validation error beyond its spread.")
    return (said, f"{found.chosen.stage.rules} rules: the fewest that are not clearly worse than the best.")


def take_linear_side(linear_side: LinearSide | None, found: Search) -> Search:
    """One rule is the linear side's choice, parameter for parameter.

    As it was where there is more than one rule, where the choice is no equation over lags that runs free, or
    where the rule holds an integrator, to the last digit, and follows the training data as closely.
    """
    context = found.context
    chosen = found.chosen.stage
    if linear_side is None or chosen.rules > 1 or not context.settings.refine:
        return found
    choice = linear_side(context.settings, found.train, found.validation)
    model = None if choice is None else as_linear(choice[1])
    if choice is None or model is None:
        return found
    if chosen.problem.integrates and not shortfall(
        settle(found).bare, {choice[0]: choice[1]}, found.train, LEVEL
    ):
        return found
    least = max(context.least, model.orders.depth + FEWEST)
    if not any(len(s) >= least for s in found.train.segments):
        return found
    whole = replace(context, least=least)
    stage = whole.ready(as_stage(model, whole.problem(model.orders)))
    asked = context.must_be_bounded and not chosen.problem.integrates  # no model of such a process comes back
    if not np.isfinite(stage.cost) or (asked and not is_bounded(stage)):
        return found
    said = f"One rule is the linear side's choice, parameter for parameter: {choice[0].upper()}."
    return replace(found, stage=stage, linear=choice[1], notes=(said, *choice[1].notes))


def settle(found: Search) -> Search:
    """The chosen model refined until it settles, on all the data, if it stays bounded."""
    context = found.context
    if found.linear is not None:
        return found
    if not context.settings.refine:
        method = "Consequents are one-step least squares; the simulation error was not refined."
        return replace(found, verdict=(*found.verdict, method))
    runs = runs_of(found.stage.layout, found.train.segments, context.least)
    stage = on_all_runs(found.stage, runs, context.settings.iterations, bounded=context.must_be_bounded)
    method = (
        "Consequents and memberships were refined on the simulation error with exact sensitivities; only "
        "models that stayed bounded under random inputs were considered."
    )
    found = replace(found, stage=stage, verdict=(*found.verdict, method))
    return found.said(INTEGRATES) if stage.problem.integrates and context.must_be_bounded else found
