"""Dynamic Takagi-Sugeno models, refined on the simulation error: the estimator.

It grows the model from a refined linear one, rule by rule, and stops by the validation free run; what comes
out is a `FittedTS`, flysid.model.rules.fitted. Models over lagged outputs must see the state in the outputs;
where a tank, an actuator or a friction element stands between, a hidden state says it with fewer lags.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import FlysidError, UsageError
from flysid.model.arx import ARX
from flysid.model.flight_offsets import with_own_constants
from flysid.model.last_gates import refuse, shortfall
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.one_rule import linear_choice
from flysid.model.rules import learning
from flysid.model.rules.contest import contest
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stabilise import with_stable_rules
from flysid.model.shared import sharing
from flysid.model.threads import on_one_thread

__all__ = ["TS", "FittedTS"]

Search = Callable[["TS", Dataset, Dataset | None], FittedTS]


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
    states : 0: rules over lags of the outputs. A number: rules over so many states, the outputs included;
        na, nb, refine and stable are then left as they are. "auto": rules over lags, or over hidden states
        where these explain clearly more.
    flight_offsets : a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.
    ridge : weight on the difference of the rules, in shares of the error that is left, or "auto".

    Source: Takagi & Sugeno (1985), IEEE Trans. SMC 15; the search: `flysid.model.rules.learning`.

    Examples
    --------
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> len(model.rules())
    1
    """

    @on_one_thread
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Grow, refine and choose a model.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        return gated(self, _found, train, validation)

    def _check_states(self) -> None:
        for name in ("na", "nb"):
            if getattr(self, name) != "auto":
                raise UsageError(f"{name}={getattr(self, name)!r} with hidden states", hint="give states=0")
        if not self.refine or self.stable:
            raise UsageError("refine=False and stable=True are for rules over lags", hint="give states=0")


def _found(settings: TS, train: Dataset, validation: Dataset | None) -> FittedTS:
    """What the search that is asked for finds."""
    if settings.states != 0 or isinstance(settings.states, bool):
        settings._check_states()
        if settings.states != "auto":
            return over_states(settings, train, validation)
        return contest(settings, train, validation, linear_choice).described
    found = learning.over_lags(settings, train, validation, linear_choice)
    model = found.model if settings.refine else found.bare
    if not settings.stable or found.stage.problem.integrates:
        return model
    return with_stable_rules(model, train)


def over_states(settings: TS, train: Dataset, validation: Dataset | None) -> FittedTS:
    """Rules over hidden states, whose number may be chosen; raises as `TS.fit`."""
    if settings.states == 0:
        raise UsageError("states=0", hint='give "auto" or a whole number from 1 on')
    return learning.over_states(settings, train, validation).model


def gated(settings: TS, search: Search, train: Dataset, validation: Dataset | None) -> FittedTS:
    """What a search finds; one rule, split if asked for, where more miss what ARX follows in training.

    Rules of clusters and least squares (`refine=False`) are what the literature has, and pass as they are.

    Raises
    ------
    FitError : what was found errs clearly more there than ARX, or than the first value held.
    """
    with sharing():
        model = search(settings, train, validation)
        if not settings.refine:
            return model
        linear = _linear(settings, train, validation)
        many = len(model.parameters.theta) > 1
        if many and settings.rules == "auto" and shortfall(model, linear, train, margin=0.0):
            model = search(replace(settings, rules=1), train, validation)
        elif many and not settings.states and shortfall(model, linear, train):
            model = learning.split_from_one(settings, train, validation, linear_choice).model
        return refuse(model, linear, train)


def _linear(settings: TS, train: Dataset, validation: Dataset | None) -> dict[str, FittedLinear]:
    """ARX of the orders asked for, by its name; nothing where there is none, as of a number of states."""
    asked: dict[str, Any] = {"nk_hint": settings.nk_hint}
    if settings.states == 0:
        asked |= {"na": settings.na, "nb": settings.nb, "nk": settings.nk}
    elif settings.states != "auto":
        return {}
    try:
        return {"ARX": ARX(**asked).fit(train, validation)}
    except FlysidError:
        return {}
