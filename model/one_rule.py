"""Models of one rule among the linear ones: what the search for rules finds before it adds a second.

Such a model is linear: an equation over lags, or a state space, refined on the free run. The search for rules
weighs orders and delays otherwise than ARX and its like do, and finds on slow processes what they miss. So
one rule stands among the candidates for the baseline, and more rules never look useful for what one does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.flight_offsets import with_own_constants
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear_choice import best_linear
from flysid.model.oe import OE
from flysid.model.own_constants import FlightOffsets
from flysid.model.rules import learning, linear_starts
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.search_settings import NORMAL, RuleSettings, SearchSettings
from flysid.model.shared import fit_key, once
from flysid.model.structures import OWN
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class OneRule(RuleSettings):
    """Settings of one rule.

    Parameters
    ----------
    nk_hint, nk_least : delays per input to try besides its own choices, and not to go below.
    states : 0: over lags; a number or "auto": over states, hidden ones among them.
    """

    rules: int = 1
    most_rules: int = 1

    @on_one_thread
    @once(fit_key)
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Choose orders, or states, by the validation free run and refine on it.

        Raises
        ------
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        learn = learning.over_lags if self.states == 0 else learning.over_states
        return learn(self, train, validation).model


def over_lags(**asked: Any) -> OneRule:
    """One rule over lags; settings as `TS`."""
    return OneRule(**asked)


def over_states(*, search: SearchSettings, **asked: Any) -> OneRule | None:
    """One rule over states; settings as `TS`. None where the search leaves hidden states out."""
    return OneRule(states="auto", search=search, **asked) if search.hidden_states else None


def linear_rivals(
    nk_hint: tuple[int, ...] = (),
    nk_least: tuple[int, ...] = (),
    search: SearchSettings = NORMAL,
    flight_offsets: FlightOffsets = "auto",
) -> dict[str, Estimator]:
    """All that competes for the baseline, by label: linear structures, then one rule over lags, over states.

    `nk_hint`: delays per input that they try besides their own.
    `nk_least`: below which one rule does not go.
    `search`: how long one rule is looked for; without hidden states there is none over states.
    `flight_offsets`: as `flysid.ARX` takes it.
    """
    given = {
        "flight_offsets": flight_offsets,
        "nk_hint": nk_hint,
        "nk_least": nk_least,
        "search": search,
    }
    rivals = {name: row.settings(given) for name, row in OWN.items() if row.competes}
    return {name: estimator for name, estimator in rivals.items() if estimator is not None}


def same_orders(model: Fitted, search: SearchSettings) -> Estimator | None:
    """Settings that fit the linear side's choice again with its orders, on a part of the data, or on more.

    None for several outputs, whose orders differ.

    `search`: how long one rule is refined.
    """
    if len(model.outputs) > 1:
        return None
    if isinstance(model, FittedTS):
        orders = model.layout.orders
        if model.layout.hidden:
            return OneRule(states=model.layout.n, search=search)
        return OneRule(na=orders.na, nb=orders.nb, nk=orders.nk, search=search)
    return linear_starts.same_orders(model) if isinstance(model, FittedLinear | FittedStateSpace) else None


def linear_choice(
    settings: RuleSettings, train: Dataset, validation: Dataset | None
) -> tuple[str, Fitted] | None:
    """The linear side's choice among models of the orders asked for, and its name; None where it has none.

    Where nothing is asked for it is the baseline of `flysid fit`, the same fit.
    """
    hint = tuple(settings.nk_hint)
    candidates = linear_rivals(hint, tuple(settings.nk_least), settings.search)
    if (settings.na, settings.nb, settings.nk) != ("auto", "auto", "auto"):
        asked: dict[str, Any] = {"na": settings.na, "nb": settings.nb, "nk": settings.nk, "nk_hint": hint}
        candidates = {"arx": ARX(**asked), "oe": OE(**asked)}
    try:
        choice, model = best_linear(train, validation, candidates)
    except FlysidError:
        return None
    return choice.label, model
