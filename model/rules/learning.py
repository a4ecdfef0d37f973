"""From settings and data to a chosen model of rules: a pipeline of named steps over one record.

Over lags: split and linear starts, grow, select, merge and split, the linear side's choice where one
rule is enough, refit. Over hidden states: linear systems and split, grow, select, refit. Every step returns
a new record with its reason in words; intervals come with its model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.arguments import check_inputs, check_rows
from flysid.model.base import Fitted
from flysid.model.last_gates import shortfall
from flysid.model.linear.settings import check_hint
from flysid.model.rules import edits
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.fitted import FittedTS, finish
from flysid.model.rules.growth import clustered_stage, split
from flysid.model.rules.judging import (
    INTEGRATES,
    Candidate,
    Family,
    fewest_rules,
    hold_out,
    sweep_in_words,
    tolerant,
)
from flysid.model.rules.linear_starts import PLAIN, StateRealisation, as_linear, as_stage
from flysid.model.rules.operating_points import describe
from flysid.model.rules.refit import STEPS_ON_PARTS, on_all_runs, refit
from flysid.model.rules.regressor_layout import runs_of, scaling
from flysid.model.rules.search import search
from flysid.model.rules.search_context import (
    SearchContext,
    named_antecedents,
    order_choices,
)
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage, on_runs_of, ordered
from flysid.model.rules.state_systems import (
    in_coordinates,
    in_words,
    linear_systems,
    saturation_limits,
    system_stage,
)
from flysid.model.selection import FEWEST, LEVEL, parts_to_choose_on
from flysid.model.start import START_SHARE
from flysid.showing import counted
from flysid.split import MIN_FLIGHTS

SWEEP = "Validation free-run error by number of rules"
"""How the note begins that says what was tried."""
LinearSide = Callable[[RuleSettings, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""
_HIGHEST_LINEAR = 12  # samples of lags that the linear side may choose on short records,
_DEEPEST_DELAY = 40  # and on long ones, delay included
_ON_ALL = "The model was refined once more on the held-out part together with the rest."
_AS_IT_WAS = (
    "The held-out part only chose the model: refined once more on all the data, it was no longer stable."
)


@dataclass(frozen=True, eq=False)
class Search:
    """What a search knows after each of its steps.

    Attributes
    ----------
    own : the judging part was taken from the training data.
    plain : the best single rule, judged over all parts.
    starts : linear models that rules may be grown from.
    best : the best family of models with 1, 2, 3, ... rules.
    chosen : the model that is to be offered, as grown on the first part; `at` + 1 is its number of rules.
    stage : the same on all the data.
    notes, verdict : reasons, in words; those on the number of rules.
    linear : the linear model that one rule is, where it is one.
    fit : change of the training mean square by a second rule, in logarithms.
    """

    context: SearchContext
    train: Dataset
    validation: Dataset | None
    own: bool
    plain: Family
    starts: tuple[Family, ...]
    best: Family
    chosen: Candidate
    stage: Stage
    at: int = 0
    notes: tuple[str, ...] = ()
    verdict: tuple[str, ...] = ()
    linear: Fitted | None = None
    fit: float = -np.inf

    @classmethod
    def begun(
        cls,
        context: SearchContext,
        data: tuple[Dataset, Dataset | None],
        own: bool,
        plain: Family,
        starts: Sequence[Family],
        notes: Sequence[str],
    ) -> Search:
        """Before anything is grown: the best single rule is what is offered."""
        one = plain.linear
        return cls(context, *data, own, plain, tuple(starts), plain, one, one.stage, notes=tuple(notes))

    @property
    def models(self) -> list[Candidate]:
        """Models by number of rules, as grown on the first part."""
        return [self.plain.linear, *self.best.folds[0][1:]]

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
    """Rules over lags: choose orders, then rules, by the validation free run.

    Parameters
    ----------
    linear_side : whose choice a single rule is; where it is None, a single rule is the search's own.

    Raises
    ------
    UsageError : settings that cannot be; antecedents that are not there.
    DataError : no or too few samples, a signal that never moves.
    FitError : no stable model was found.
    """
    found = lag_starts(settings, train, validation)
    steps = (grow, select, merge_and_split, partial(take_linear_side, linear_side), refit_lags)
    for step in steps:
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
    """Rules over hidden states: choose states and coordinates, then rules; raises as `over_lags`."""
    found = state_starts(settings, train, validation)
    for step in (grow, select, refit_states):
        found = step(found)
    return found


def lag_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """The data split, and linear models of several orders."""
    check_inputs(len(train.inputs))
    check_hint(settings.nk_hint, len(train.inputs))
    check_hint(settings.nk_least, len(train.inputs), "nk_least")
    choices = order_choices(settings, len(train.inputs))
    named = named_antecedents(settings, choices, train)
    if settings.na != "auto":
        fewest = choices[0]
        check_rows(train, fewest.depth, len(train.outputs) * fewest.na + sum(fewest.nb) + 1)
    deepest = _deepest(settings, train) if len(choices) > 1 else 0
    least = max(deepest, *(o.depth for o in choices), *(a.depth for a in named), 0) + FEWEST
    long = len(train) >= settings.search.short
    context, own = _context(settings, (train, validation), least, whole=long)
    starts, notes = context.linear(choices)
    if not any(s.linear.stable for s in starts):
        context = replace(context, must_be_bounded=False)
        starts = [tolerant(s, stressed=False) for s in starts]
        notes.append(f"{INTEGRATES} Boundedness was not asked for.")
    if context.folds:
        notes.append("Little data: parts of it were held out in turn to choose the number of rules.")
    plain = context.completed(starts[0])
    return Search.begun(context, (train, validation), own, plain, starts, notes)


def state_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Linear systems, and the data split as they need it."""
    check_inputs(len(train.inputs))
    scaled = scaling(train)
    systems = linear_systems(settings, train, validation, scaled)
    least = max(s.orders.depth for s in systems) + 2 * max(map(len, systems)) + FEWEST
    ends = saturation_limits(train)
    context, own = _context(settings, (train, validation), least, scaled)
    ridges = context.ridges[1:] or context.ridges
    context = replace(context, promise=settings.search.hidden_gain, ridges=ridges)

    def judged(system: StateRealisation) -> Family:
        stages = [system_stage(system, fit, least, scaled, ends) for fit, _ in context.parts]
        checks = [check for _, check in context.parts]
        return Family(
            tuple((context.judge(s, c),) for s, c in zip(stages, checks, strict=True)), system=system
        )

    families = sorted(map(judged, systems), key=lambda f: tolerant(f).rmse[0])
    plain = tolerant(families[0])
    most = 2 * settings.search.highest_order
    starts = [f for f in families if f.linear.stage.layout.n <= most][: settings.search.linear_systems]
    tried = "; ".join(dict.fromkeys(s.title for s in systems))
    notes = [f"Tried, in several coordinates: {tried}."] if len(systems) > 1 else []
    return Search.begun(context, (train, validation), own, plain, starts, [*notes, *in_words(ends, train)])


def _context(
    settings: RuleSettings,
    data: tuple[Dataset, Dataset | None],
    least: int,
    scaled: tuple[FloatArray, FloatArray] | None = None,
    *,
    whole: bool = False,
) -> tuple[SearchContext, bool]:
    """The data split for segments of at least so many rows; whether the judging part is of the training data.

    Parameters
    ----------
    scaled : shift and scale; None: of the fitting part.
    whole : the judging part is whole flights, where there are enough.
    """
    train, validation = data
    longest = max((len(s) for s in train.segments), default=0)
    if longest < least:
        raise DataError(
            f"the longest segment has {counted(longest, 'sample')}; this model needs {least}",
            hint="record longer, allow longer gaps, or ask for lower orders or fewer states",
        )
    s = settings.search
    folds: tuple[tuple[Dataset, Dataset], ...] = ()
    if validation is not None and any(len(part) >= least for part in validation.segments):
        parts, own = (train, validation), False
    else:
        parts, own = (_whole_flights if whole else hold_out)(train, least), True
        if settings.rules == "auto" and settings.refine and len(train) < s.short:
            folds = tuple(hold_out(train, least, fold) for fold in range(1, s.folds))
    shift, scale = scaled or scaling(parts[0])
    ridges = s.ridges if settings.ridge == "auto" else (settings.ridge,)
    context = SearchContext(
        settings, *parts, shift, scale, least, folds=folds, promise=s.rule_gain, ridges=ridges
    )
    return context, own


def _whole_flights(train: Dataset, least: int) -> tuple[Dataset, Dataset]:
    """The parts that the baseline is chosen on, where flights are enough: its rivals share their fits."""
    if len(train.flights) >= MIN_FLIGHTS:
        with suppress(DataError):
            parts = parts_to_choose_on(train)
            if all(any(len(s) >= least for s in part.segments) for part in parts):
                return parts
    return hold_out(train, least)


def _deepest(settings: RuleSettings, train: Dataset) -> int:
    """Samples that the linear side's models may look back."""
    longest = max((len(s) for s in train.segments), default=0)
    return min(
        _DEEPEST_DELAY if len(train) > settings.search.short else _HIGHEST_LINEAR, int(START_SHARE * longest)
    )


def grow(found: Search) -> Search:
    """Rules, one after the other, from the starts that promise most."""
    context = found.context
    asked = context.settings.rules
    if asked != "auto" and not any(context.room(s.linear.stage, asked - 1) for s in found.starts):
        raise _too_many(asked, found.plain.linear.stage)  # before an hour of growing
    if not context.settings.refine:
        linear = found.plain.linear
        looked_at = context.antecedents(linear.stage.layout)[:2]
        stages = [clustered_stage(linear.stage, looked_at, r) for r in range(2, context.most_rules + 1)]
        return replace(found, best=Family(((linear, *(context.judge(s) for s in stages)),)))
    best, fit = search(context, found.plain, found.starts)
    if asked != "auto" and best.stages < asked:
        raise _too_many(asked, found.plain.linear.stage)
    return replace(found, best=best, fit=fit)


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
    at = (
        fewest_rules(found.best, found.plain, context.settings.search.rule_gain)
        if context.settings.rules == "auto"
        else context.settings.rules - 1
    )
    model = models[at]
    notes: tuple[str, ...] = ()
    if not model.stable and not model.stage.layout.hidden:  # those may come back with fewer rules
        model, note = _split_instead(found, at)
        notes = (note,)
    chosen = replace(found, at=at, chosen=model, stage=ordered(model.stage)).said(*notes)
    away = ", ".join(str(m.stage.rules) for m in models if not m.stable and m.stage.rules != at + 1)
    if away:
        noun = "rule" if away == "1" else "rules"
        chosen = chosen.said(
            f"Left out, because their output left its limits under bounded random inputs: {away} {noun}."
        )
    orders = model.stage.layout.orders
    if not chosen.stage.layout.hidden and orders != models[0].stage.layout.orders:
        chosen = chosen.said(f"With rules, orders {orders} did better and were taken.")
    return replace(chosen, verdict=_verdict(chosen))


def _split_instead(found: Search, at: int) -> tuple[Candidate, str]:
    """As many rules as were asked for where refining them leaves the limits, and a note on it.

    On a plant that fewer rules describe to rounding, more numbers follow nothing but rounding, anywhere. The
    most rules that are bounded are split instead, which leaves what they do as it is.

    Raises
    ------
    FitError : no model with fewer rules is bounded.
    """
    context = found.context
    for known in reversed(found.models[:at]):
        if not known.stable:
            continue
        stage = split(known.stage, context.antecedents(known.stage.layout), at + 1)
        if stage is None:
            continue
        model = context.judge(stage)
        if model.stable:
            count = "one rule" if known.stage.rules == 1 else f"{known.stage.rules} rules"
            return model, (
                f"{at + 1} rules refined separately left their limits under bounded random inputs: {count} "
                "split, without another conclusion."
            )
    raise FitError(
        "no stable model was found: under bounded random inputs every candidate left its limits",
        hint="give more data, lower orders, or fewer rules",
    )


def _verdict(found: Search) -> tuple[str, ...]:
    """The rule count in words."""
    if found.context.settings.rules != "auto":
        asked = found.context.settings.rules
        return (f"{asked} rules, as asked." if asked != 1 else "One rule, as asked.",)
    tried = sweep_in_words(found.best, found.plain)
    said = f"{SWEEP}, in standard deviations of the output: {tried}."
    if "+-" in tried:
        said += " +- is one standard error of the distance to the best."
    if found.best.stages == 1:
        return (said, "One rule is enough: two hardly lower the error even of what they were fitted to.")
    if found.at == 0:
        return (said, "One rule is enough: more rules do not lower the validation error beyond its spread.")
    return (said, f"{found.at + 1} rules: the fewest that are not clearly worse than the best.")


def merge_and_split(found: Search) -> Search:
    """The same number of rules by way of one more, where training and validation both prefer it.

    Requested rules stay as they are.
    """
    s = found.context.settings
    if not (s.refine and s.rules == "auto" and s.antecedents == "auto"):
        return found
    chosen = edits.merge_and_split(found.context, found.models, found.at)
    return replace(found, chosen=chosen, stage=ordered(chosen.stage))


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
        refit_lags(found).bare, {choice[0]: choice[1]}, found.train, LEVEL
    ):
        return found
    least = max(context.least, model.orders.depth + FEWEST)
    if not any(len(s) >= least for s in found.train.segments):
        return found
    whole = replace(context, fit_part=found.train, least=least)
    stage = whole.ready(as_stage(model, whole.problem(model.orders)))
    asked = context.must_be_bounded and not chosen.problem.integrates  # no model of such a process comes back
    if not np.isfinite(stage.cost) or (asked and not is_bounded(stage)):
        return found
    said = f"One rule is the linear side's choice, parameter for parameter: {choice[0].upper()}."
    return replace(found, stage=stage, linear=choice[1], notes=(said, *choice[1].notes))


def refit_lags(found: Search) -> Search:
    """The chosen model refined on all the data, if it stays stable."""
    context = found.context
    settings = context.settings
    if found.linear is not None:
        return found
    if not settings.refine:
        method = "Consequents are one-step least squares; the simulation error was not refined."
        return replace(found, verdict=(*found.verdict, method))
    data = found.train if found.own else context.fit_part
    runs = runs_of(found.stage.layout, data.segments, context.least)
    stage = refit(replace(found.chosen, stage=found.stage), data, runs, settings.iterations)
    notes = [_AS_IT_WAS if stage is found.stage else _ON_ALL] if found.own else []
    if stage.problem.integrates and context.must_be_bounded:
        notes.append(INTEGRATES)
    method = (
        "Consequents and memberships were refined on the simulation error with exact sensitivities; only "
        "models that stayed bounded under random inputs were considered."
    )
    return replace(found, stage=stage, verdict=(*found.verdict, method)).said(*notes)


def refit_states(found: Search) -> Search:
    """The chosen model on all the data: one rule in the most readable coordinates, more grown again."""
    context = found.context
    family = found.plain if found.at == 0 else found.best
    system = family.system
    assert system is not None
    ends = saturation_limits(found.train)

    start = system_stage(system, found.train, context.least, (context.shift, context.scale), ends)
    if found.at == 0:
        readable = len(system) <= context.settings.search.highest_order  # of more, rates and modes say little
        stage, words = in_coordinates(start, "" if readable else PLAIN)
        drifts = not is_bounded(stage)
    else:
        words = family.words
        start, _ = in_coordinates(start, family.coordinates)
        drifts = not is_bounded(start)
        stage = ordered(_on_everything(found, start, family.ridge, drifts=drifts))
    hidden = f" Hidden states: {words}, in units of their spread in training." if stage.layout.hidden else ""
    notes = [f"From {system.title}.{hidden}", *found.notes]
    if drifts:
        notes.append(INTEGRATES)
    if stage.rules <= found.at:
        count = f"{stage.rules} rules" if stage.rules > 1 else "One rule"
        notes.append(f"{count} stayed bounded under random inputs.")
    return replace(found, stage=stage, notes=tuple(notes))


def _on_everything(found: Search, start: Stage, ridge: float, *, drifts: bool) -> Stage:
    """The chosen model refined on all the data from the first part's.

    Fewer rules where the model does not come back from bounded random inputs, though one rule does
    (`drifts` is False).
    """
    for model in found.models[found.at : 0 : -1]:
        stage = on_runs_of(model.stage, start)
        stage = stage.under(ridge=ridge * stage.mean_square()).refined(
            found.context.settings.iterations, 1e-6
        )
        if np.isfinite(stage.cost) and (drifts or is_bounded(stage)):
            return stage
    return start
