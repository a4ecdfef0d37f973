"""From settings and data to a chosen model of rules: a pipeline of named steps over one record.

Over lags: split and linear starts, grow, select, merge and split, the linear side's choice where one
rule is enough, refit. Over hidden states: linear systems and split, grow, select, refit. Every step returns
a new record with its reason in words; intervals come with its model.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError
from flysid.model.rules import edits
from flysid.model.rules.clustered_start import clustered_stage
from flysid.model.rules.families import Family, fewest_rules, sweep_in_words
from flysid.model.rules.first_steps import lag_starts, state_starts
from flysid.model.rules.last_steps import refit_lags, refit_states, take_linear_side
from flysid.model.rules.search import search
from flysid.model.rules.search_record import LinearSide, Search
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage, ordered

SWEEP = "Validation free-run error by number of rules"
"""How the note begins that says what was tried."""


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


def over_states(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Rules over hidden states: choose states and coordinates, then rules; raises as `over_lags`."""
    found = state_starts(settings, train, validation)
    for step in (grow, select, refit_states):
        found = step(found)
    return found


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
    if not models[at].stable and not models[at].stage.layout.hidden:  # those may come back with fewer rules
        raise FitError(
            "no stable model was found: under bounded random inputs every candidate left its limits",
            hint="give more data, lower orders, or fewer rules",
        )
    chosen = replace(found, at=at, chosen=models[at], stage=ordered(models[at].stage))
    away = ", ".join(str(m.stage.rules) for m in models if not m.stable)
    if away:
        chosen = chosen.said(
            f"Left out, because their output left its limits under bounded random inputs: {away} rules."
        )
    orders = models[at].stage.layout.orders
    if not chosen.stage.layout.hidden and orders != models[0].stage.layout.orders:
        chosen = chosen.said(f"With rules, orders {orders} did better and were taken.")
    return replace(chosen, verdict=_verdict(chosen))


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

    Rules that were asked for stay as they are.
    """
    s = found.context.settings
    if not (s.refine and s.rules == "auto" and s.antecedents == "auto"):
        return found
    chosen = edits.merge_and_split(found.context, found.models, found.at)
    return replace(found, chosen=chosen, stage=ordered(chosen.stage))
