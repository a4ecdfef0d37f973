"""Rules over lagged outputs, or over hidden states: which of these the data ask for.

The model over lags comes first: its rules speak of measured signals only. Hidden states are tried where rules
over lags were kept, or a second one lowers the training error clearly, as it does wherever something bends,
and where the free run of the first leaves an error that its own past foretells, as a state does that lags do
not show.
They are taken only if they do clearly better on held-out parts, both refitted on the rest each time, and
better on the training data.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError, UsageError
from flysid.model.base import Fitted
from flysid.model.noise import noise_model
from flysid.model.rules import learning
from flysid.model.rules.assembly import free_run_errors
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.judging import hold_out
from flysid.model.rules.operating_points import described
from flysid.model.rules.regressor_layout import scaling
from flysid.model.rules.search_record import LinearSide, Search
from flysid.model.rules.search_settings import QUARTERS, RuleSettings
from flysid.model.rules.structure_choice import CLEARLY, Advantage, advantage, block_errors, compared

_FORETOLD = 0.5  # share of the free run's error that its own past must explain
_RESOLUTION = 1e-3  # of the outputs' spread: a free-run error below leaves nothing to explain
_MOST_OUTPUTS = 2
_MOST_SAMPLES = 100_000


@dataclass(frozen=True, eq=False)
class Contest:
    """The model over lags; the one over hidden states where it was tried, with the notes of either's winning.

    Attributes
    ----------
    lags, states : what both searches found; states is None where nothing asked for it, or none was found.
    advantage : of hidden states, on held-out parts.
    fits : they fit the training data better, too.
    linear : the linear side's choice, where rules do not pay.
    """

    lags: Search
    states: Search | None = None
    advantage: Advantage = field(default_factory=Advantage)
    fits: bool = False
    linear: Fitted | None = None

    @property
    def taken(self) -> Search:
        """The search whose rules are the better ones."""
        wins = self.advantage.clear and self.fits
        return self.states if self.states is not None and wins else self.lags

    @property
    def winner(self) -> Fitted:
        """The model to take, with a note on why."""
        return self.described if self.linear is None else self.linear

    @property
    def described(self) -> FittedTS:
        """The better of the two kinds, and what it does at operating points unless one rule is linear."""
        taken = self.taken
        return self.of_rules if taken.linear else described(self.of_rules, taken.train, taken.neighbour)

    @property
    def of_rules(self) -> FittedTS:
        """The better of the two kinds, with a note on why."""
        model = self.taken.bare
        if self.states is None:
            return model
        times = np.exp(0.5 * self.advantage.gain)
        ratio = f"{times:.2f} times the free-run error of rules over lags on held-out parts"
        if self.taken is self.lags:
            but = "but more in training" if self.advantage.clear else "not clearly less"
            note = f"A hidden state was tried and not taken: {ratio}, {but}."
            return replace(model, notes=(*model.notes, note))
        note = f"A hidden state explains what lagged outputs do not: {ratio}."
        return replace(model, notes=(note, *model.notes))


def contest(
    settings: RuleSettings, train: Dataset, validation: Dataset | None, linear_side: LinearSide
) -> Contest:
    """Both kinds, the second where the first hints at it."""
    lags = learning.over_lags(settings, train, validation, linear_side)
    straight = lags.stage.rules == 1 and lags.fit > -CLEARLY
    if straight or not (settings.search.hidden_states and hints_at_hidden_state(lags.bare, train)):
        return Contest(lags)
    try:
        states = learning.over_states(settings, train, validation)
        if states.stage.rules == 1 == lags.stage.rules:
            return Contest(lags)
        judgement = _judge(lags, states, train, validation)
    except (DataError, FitError, UsageError, np.linalg.LinAlgError):  # e.g. antecedents that it does not have
        return Contest(lags)
    return Contest(lags, states, *judgement)


def _judge(
    lags: Search, states: Search, train: Dataset, validation: Dataset | None
) -> tuple[Advantage, bool]:
    """The advantage of hidden states on held-out parts, and whether they fit the training data better."""
    fits = advantage([block_errors((lags.bare, states.bare), train)]).gain < 0.0
    if validation is not None:
        return compared(lambda _: lags.bare, lambda _: states.bare, [(train, validation)]), fits
    least = max(lags.least, states.least)
    parts = [hold_out(train, least, fold) for fold in range(QUARTERS)]
    return compared(lags.again, states.again, parts), fits


def hints_at_hidden_state(model: FittedTS, train: Dataset) -> bool:
    """Whether the free run errs more than the data resolve, in a way that its own past foretells."""
    if len(model.outputs) > _MOST_OUTPUTS or len(train) > _MOST_SAMPLES:
        return False
    errors = free_run_errors(model, train)
    if not errors:
        return False
    _, scale = scaling(train)
    for j in range(len(model.outputs)):
        own = [e[:, j] for e in errors]
        square = float(np.mean(np.concatenate(own) ** 2))
        foreseen = 1.0 - noise_model(own)[1] / square if square > 0 else 0.0
        if square > (_RESOLUTION * scale[j]) ** 2 and foreseen > _FORETOLD:
            return True
    return False
