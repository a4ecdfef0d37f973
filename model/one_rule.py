"""Models of one rule among the linear ones: what the search for rules finds before it adds a second.

Such a model is linear: an equation over lags, or a state space, refined on the free run. The search for rules
weighs orders and delays otherwise than ARX and its like do, and finds on slow processes what they miss. So
one rule stands among the candidates for the baseline, and more rules never look useful for what one does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.linear_choice import best_linear, linear_estimators
from flysid.model.oe import OE
from flysid.model.rules import learning
from flysid.model.rules.fitted import FittedTS, finished
from flysid.model.rules.linear_starts import Asked
from flysid.model.rules.search_settings import NORMAL, SearchSettings
from flysid.model.shared import fit_key, once
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class OneRule:
    """Settings of one rule.

    Parameters
    ----------
    nk_hint, nk_least : delays per input to try besides its own choices, and not to go below.
    states : 0: over lags; a number or "auto": over states, hidden ones among them.
    """

    nk_hint: Sequence[int] = ()
    nk_least: Sequence[int] = ()
    states: Any = 0
    rules: int = 1
    na: Any = "auto"
    nb: Any = "auto"
    nk: Any = "auto"
    antecedents: Any = "auto"
    refine: bool = True
    most_rules: int = 1
    iterations: int = 30
    ridge: Any = "auto"
    search: SearchSettings = NORMAL

    @on_one_thread
    @once(fit_key)
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Choose orders, or states, by the validation free run and refine on it.

        Raises
        ------
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        learn = learning.over_lags if self.states == 0 else learning.over_states
        learned = learn(self, train, validation)
        return finished(learned.stage, train, learned.notes, intervals=learned.intervals)


def linear_rivals(nk_hint: tuple[int, ...] = (), nk_least: tuple[int, ...] = ()) -> dict[str, Estimator]:
    """All that competes for the baseline, by label: linear structures, then one rule over lags, over states.

    `nk_hint`: delays per input that they try besides their own; `nk_least`: below which one rule does not go.
    """
    alone: dict[str, Estimator] = {
        "one_rule": OneRule(nk_hint=nk_hint, nk_least=nk_least),
        "one_rule_ss": OneRule(nk_hint=nk_hint, states="auto"),
    }
    return linear_estimators(nk_hint) | alone


def linear_choice(settings: Asked, train: Dataset, validation: Dataset | None) -> tuple[str, Fitted] | None:
    """The linear side's choice among models of the orders asked for, and its name; None where it has none.

    Where nothing is asked for it is the baseline of `flysid fit`, the same fit.
    """
    hint = tuple(settings.nk_hint)
    candidates = linear_rivals(hint, tuple(settings.nk_least))
    if (settings.na, settings.nb, settings.nk) != ("auto", "auto", "auto"):
        asked: dict[str, Any] = {"na": settings.na, "nb": settings.nb, "nk": settings.nk, "nk_hint": hint}
        candidates = {"arx": ARX(**asked), "oe": OE(**asked)}
    try:
        choice, model = best_linear(train, validation, candidates)
    except FlysidError:
        return None
    return choice.label, model
