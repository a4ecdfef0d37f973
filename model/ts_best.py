"""TS over lagged outputs, over hidden states, or no rules at all: which of these the data ask for.

`TS(states="auto")` finds the rules. Where one rule is enough, it is the linear side's choice, and that model
is what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.model.flight_offsets import with_own_constants
from flysid.model.last_gates import LINEAR_ENOUGH, shortfall
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.one_rule import linear_choice, linear_rivals, same_orders
from flysid.model.own_constants import FlightOffsets
from flysid.model.rules.contest import Contest, advantage, block_errors, parts_to_compare_on, unproven
from flysid.model.rules.contest import contest as contest_of_rules
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.learning import SWEEP
from flysid.model.rules.search_settings import NORMAL, SearchSettings
from flysid.model.shared import sharing
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.threads import on_one_thread
from flysid.model.ts import TS

Linear = FittedLinear | FittedStateSpace | FittedTS
"""What the linear side may choose; of rules, a single one."""


@dataclass(frozen=True)
class BestTS:
    """Settings of a TS model over lags, or over hidden states where these clearly explain more.

    Where no rules pay, the best linear model comes out instead, and its first note says so.

    Parameters
    ----------
    rules, antecedents, most_rules, nk_hint, nk_least, search, flight_offsets : see `TS`.

    Examples
    --------
    >>> model = flysid.BestTS().fit(train)  # train: see `flysid.Dataset`; its plant is linear
    >>> len(model.rules())
    1
    >>> model.notes[0]
    'A linear model is enough: a search for rules found none that lowers the error.'
    """

    rules: int | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    most_rules: int = 5
    nk_hint: Sequence[int] = ()
    nk_least: Sequence[int] = ()
    search: SearchSettings = NORMAL
    flight_offsets: FlightOffsets = "auto"

    @on_one_thread
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        """Fit the model over lags, the other one where that may help, and linear ones; keep the best.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        return contest(self, train, validation).winner


@on_one_thread
def contest(settings: BestTS, train: Dataset, validation: Dataset | None = None) -> Contest:
    """Both kinds, the second where the first hints at it; the linear model where neither pays."""
    names = ("rules", "antecedents", "most_rules", "nk_hint", "nk_least", "search")
    asked = TS(states="auto", **{name: getattr(settings, name) for name in names})
    with sharing():
        found = contest_of_rules(asked, train, validation, linear_choice)
        return replace(found, linear=_linear_enough(settings, found, train, validation))


def _linear_enough(
    settings: BestTS, found: Contest, train: Dataset, validation: Dataset | None
) -> Linear | None:
    """The linear side's choice where one rule is enough, or where the rules do not clearly run nearer.

    None where rules are kept.
    """
    rules = found.of_rules
    count = len(rules.parameters.theta)
    if settings.rules not in ("auto", 1):
        return None
    delays = tuple(settings.nk_hint), tuple(settings.nk_least)
    choice = linear_choice(
        TS(nk_hint=delays[0], nk_least=delays[1], search=settings.search), train, validation
    )
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
