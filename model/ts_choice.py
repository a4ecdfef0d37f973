"""Rules over lagged outputs, over hidden states, or no rules at all: which of these the data ask for.

`rules.contest` finds the rules. Where one rule is enough, it is the linear side's choice, and that model is
what comes out.
"""

from __future__ import annotations

from dataclasses import replace

from flysid.dataset import Dataset
from flysid.model.last_gates import LINEAR_ENOUGH, shortfall
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.one_rule import linear_choice, linear_rivals, same_orders
from flysid.model.rules.contest import Contest, advantage, block_errors, parts_to_compare_on, unproven
from flysid.model.rules.contest import contest as contest_of_rules
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.learning import SWEEP
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.shared import sharing
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.threads import on_one_thread

Linear = FittedLinear | FittedStateSpace | FittedTS
"""What the linear side may choose; of rules, a single one."""


@on_one_thread
def contest(settings: RuleSettings, train: Dataset, validation: Dataset | None = None) -> Contest:
    """Both kinds, the second where the first hints at it; the linear model where neither pays.

    >>> from flysid.model.ts_choice import contest
    >>> contest(flysid.TS(), train).winner.structure  # train: see `flysid.Dataset`; its plant is linear
    'arx'
    """
    with sharing():
        found = contest_of_rules(settings, train, validation, linear_choice)
        return replace(found, linear=_linear_enough(settings, found, train, validation))


def _linear_enough(
    settings: RuleSettings, found: Contest, train: Dataset, validation: Dataset | None
) -> Linear | None:
    """The linear side's choice where one rule is enough, or where the rules do not clearly run nearer.

    None where rules are kept.
    """
    rules = found.of_rules
    count = len(rules.parameters.theta)
    if settings.rules not in ("auto", 1):
        return None
    delays = tuple(settings.nk_hint), tuple(settings.nk_least)
    choice = linear_choice(settings, train, validation)
    if choice is None:
        return None
    label, model = choice
    assert isinstance(model, Linear)
    if settings.rules == 1:
        said = "one rule was requested, and one rule is a linear model."
    elif count == 1:
        said = "a search for rules found none that lowers the error."
    elif (
        shortfall(rules, {"linear": model}, train, 0.0)
        or not advantage([block_errors((model, rules), validation or train)]).gain < 0.0
    ):
        said = f"its free run is closer than that of the {count} rules found."
    else:
        again = same_orders(model, settings.search) or linear_rivals(*delays, settings.search)[label]
        parts = parts_to_compare_on(train, validation, found.taken.least)
        said = unproven(lambda data: model if data is train else again.fit(data), found.taken.again, parts)
        if not said:
            return None
        said = f"{count} rules of {rules.n_parameters} numbers were found and not kept: {said}."
    tried = [note for note in rules.notes if note.startswith(SWEEP)]
    return replace(model, notes=(f"{LINEAR_ENOUGH}{said}", *tried, *model.notes))
