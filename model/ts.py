"""Dynamic Takagi-Sugeno models, refined on the simulation error: the estimator.

It grows the model from a refined linear one, rule by rule, and stops by the validation free run. What comes
out is a `FittedTS`, flysid.model.rules.fitted, or the linear side's choice where no rules pay. Models over
lagged outputs must see the state in the outputs; where a tank, an actuator or a friction element stands
between, a hidden state says it with fewer lags.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

from flysid.dataset import Dataset
from flysid.errors import FlysidError, UsageError
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.flight_offsets import with_own_constants
from flysid.model.last_gates import refuse, shortfall
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.one_rule import linear_choice
from flysid.model.rules import learning
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stabilise import with_stable_rules
from flysid.model.selection import in_flight_order
from flysid.model.shared import sharing
from flysid.model.threads import on_one_thread
from flysid.model.ts_choice import contest

__all__ = ["TS", "FittedTS"]

S = TypeVar("S", bound=RuleSettings)
Search = Callable[[S, Dataset, Dataset | None], FittedTS]


@dataclass(frozen=True)
class TS(RuleSettings):
    """Settings of a dynamic TS model; the defaults choose by themselves.

    Parameters
    ----------
    rules : number of rules, or "auto": as many as the validation free run supports.
    na : past outputs in every consequent, or "auto".
    nb, nk : past inputs and their delay, one number, one per input, or "auto".
    antecedents : names such as ("v_x(k-1)", "theta_in(k-1)"), or "auto": found by splitting. An input
        without a lag, "theta_in", is the one after its delay: theta_in(k-nk).
    refine : lower the simulation error; False keeps clusters and one-step least squares, the
        literature's default, whose free run shows what refinement is for.
    most_rules : where "auto" stops.
    iterations : Levenberg-Marquardt steps per stage.
    nk_hint : delays that "auto" tries as well, one per input: the dead time that the log shows
        (`flysid.ingest.excitation.dead_time`).
    nk_least : delays that "auto" does not go below, one per input: what the log shows for certain.
    stable : no rule keeps a pole outside the unit circle (`rules.stabilise`); without it a rule may,
        as long as the blend comes back from random inputs. The pole at one of an integrating process stays.
    search : what the search weighs and how long it looks, see `SearchSettings`.
    states : "auto": what `flysid fit` delivers: rules over lags, rules over hidden states where these explain
        clearly more, or the best linear model where no rules pay. 0: rules over lags of the outputs, be it a
        single one. A number: rules over so many states, the outputs included; na, nb, refine and stable are
        then left as they are. Where one of these four is given, "auto" means 0.
    flight_offsets : a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.
    ridge : weight on the difference of the rules, in shares of the error that is left, or "auto".

    Source: Takagi & Sugeno (1985), IEEE Trans. SMC 15; the search: `flysid.model.rules.learning`.

    Examples
    --------
    >>> model = flysid.TS().fit(train)  # train: see `flysid.Dataset`; its plant is linear
    >>> model.notes[0]
    'A linear model is enough: a search for rules found none that lowers the error.'
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)
    >>> len(model.rules())
    1
    """

    states: int | Literal["auto"] = "auto"

    @on_one_thread
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        """Grow, refine and choose a model: rules, or the best linear model where the choice is open.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        train = in_flight_order(train)
        if self.states == "auto" and not self._of_lags():
            return best(self, train, validation)
        if self.states == "auto" or (self.states == 0 and not isinstance(self.states, bool)):
            return over_lags(self, train, validation)
        if self._of_lags():
            raise UsageError(
                "na, nb, refine=False and stable=True are for rules over lags", hint="give states=0"
            )
        return gated(self, over_states, train, validation)

    def _of_lags(self) -> bool:
        """Whether something is given that only rules over lags have."""
        return (self.na, self.nb) != ("auto", "auto") or not self.refine or self.stable


def of_lags(**asked: Any) -> TS:
    """The settings of rules over lags; the others as `TS`."""
    return TS(**asked, states=0)


def best(settings: RuleSettings, train: Dataset, validation: Dataset | None = None) -> Fitted:
    """Rules over lags or over hidden states, or the linear model where no rules pay; raises as `TS.fit`.

    >>> from flysid.model.ts import TS, best
    >>> best(TS(), train).structure  # train: see `flysid.Dataset`; its plant is linear
    'arx'
    """
    with sharing():
        model = contest(settings, train, validation).winner
        if not isinstance(model, FittedTS):
            return model
        return _checked(model, settings, train, validation)


def over_lags(settings: RuleSettings, train: Dataset, validation: Dataset | None = None) -> FittedTS:
    """Rules over lags, be it a single one, whatever `settings.states` is; raises as `TS.fit`.

    Examples
    --------
    >>> from flysid.model.ts import TS, over_lags
    >>> model = over_lags(TS(na=1, nb=1, nk=1), train)  # train: see `flysid.Dataset`; its plant is linear
    >>> len(model.rules())
    1
    """
    return gated(replace(settings, states=0), _found, train, validation)


def _found(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> FittedTS:
    """What the search for rules over lags finds."""
    found = learning.over_lags(settings, train, validation, linear_choice)
    model = found.model if settings.refine else found.bare
    if not settings.stable or found.stage.problem.integrates:
        return model
    return with_stable_rules(model, train)


def over_states(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> FittedTS:
    """Rules over hidden states, whose number may be chosen; raises as `TS.fit`."""
    if settings.states == 0:
        raise UsageError("states=0", hint='give "auto" or a whole number from 1 on')
    return learning.over_states(settings, train, validation).model


def gated(settings: S, search: Search[S], train: Dataset, validation: Dataset | None) -> FittedTS:
    """What a search finds; one rule, split if asked for, where more miss what ARX follows in training.

    Rules of clusters and least squares (`refine=False`) are what the literature has, and pass as they are.
    Raises FitError: what was found errs clearly more there than ARX, or than the first value held.
    """
    with sharing():
        model = search(settings, train, validation)
        if not settings.refine:
            return model
        many = len(model.parameters.theta) > 1
        if many and settings.rules == "auto":
            linear = _linear(settings, train, validation)
            if shortfall(model, linear, train, margin=0.0):
                model = search(replace(settings, rules=1), train, validation)
        return _checked(model, settings, train, validation)


def _checked(model: FittedTS, settings: RuleSettings, train: Dataset, validation: Dataset | None) -> FittedTS:
    """The model; one rule over lags split where more that were asked for miss what ARX follows."""
    linear = _linear(settings, train, validation)
    many = len(model.parameters.theta) > 1
    if many and settings.rules != "auto" and not model.layout.hidden and shortfall(model, linear, train):
        model = learning.split_from_one(settings, train, validation, linear_choice).model
    return refuse(model, linear, train)


def _linear(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> dict[str, FittedLinear]:
    """ARX of the orders asked for, by its name; nothing where there is none, as of a number of states."""
    if settings.states not in ("auto", 0):
        return {}
    asked: dict[str, Any] = {"na": settings.na, "nb": settings.nb, "nk": settings.nk}
    try:
        return {"ARX": ARX(**asked, nk_hint=settings.nk_hint).fit(train, validation)}
    except FlysidError:
        return {}
