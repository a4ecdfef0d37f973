"""TS over lagged outputs, over hidden states, or no rules at all: which of these the data ask for.

The model over lags comes first: its rules speak of measured signals only. A state-space model is tried where
the free run of the first leaves an error that its own past foretells, as a state does that the lags do not
show. It is taken only if it does clearly better on held-out parts, both refitted on the rest each time, and
better on the training data. Where one rule is enough, it is the linear side's choice, and that model is what
comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.base import Fitted
from flysid.model.linear.model import FittedLinear
from flysid.model.noise import noise_model
from flysid.model.one_rule import linear_choice, linear_rivals
from flysid.model.rules.fitted import FittedTS, finished
from flysid.model.rules.judging import INTEGRATES, hold_out
from flysid.model.rules.learning import SWEEP, Learned
from flysid.model.rules.learning import learn as learn_lagged
from flysid.model.rules.refit import on_all_runs
from flysid.model.rules.regressor_layout import runs_of, scaling
from flysid.model.rules.search_context import SPARE_ROWS
from flysid.model.rules.search_settings import NORMAL, SearchSettings
from flysid.model.rules.state_learning import Learned as LearnedStates
from flysid.model.rules.state_learning import learn
from flysid.model.rules.structure_choice import Advantage, Refit, advantage, block_errors, compared, unproven
from flysid.model.shared import sharing
from flysid.model.start import estimate_start, start_window
from flysid.model.subspace.model import FittedStateSpace
from flysid.model.threads import on_one_thread
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace

LINEAR_ENOUGH = "A linear model is enough: "
"""How the notes of a model begin that the search for rules gave up for."""
Linear = FittedLinear | FittedStateSpace | FittedTS
"""What the linear side may choose; of rules, a single one."""
_FORETOLD = 0.5  # share of the free run's error that its own past must explain
_RESOLUTION = 1e-3  # of the outputs' spread: a free-run error below leaves nothing to explain
_MOST_OUTPUTS = 2
_MOST_SAMPLES = 100_000
_PARTS = 4  # every one held out in turn,
_STEPS = 6  # of both models' refinement on the rest


@dataclass(frozen=True)
class BestTS:
    """Settings of a TS model over lags, or over hidden states where these clearly explain more.

    Where no rules pay, the best linear model comes out instead, and its first note says so.

    Parameters
    ----------
    rules, antecedents, most_rules, nk_hint, search : see `TS`.

    Examples
    --------
    >>> model = flysid.BestTS().fit(train)  # train: see `flysid.Dataset`; its plant is linear
    >>> len(model.rules())
    1
    >>> model.notes[0]
    'A linear model is enough: rules were searched for, and none paid.'
    """

    rules: int | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    most_rules: int = 5
    nk_hint: Sequence[int] = ()
    search: SearchSettings = NORMAL

    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        """Fit the model over lags, the other one where that may help, and linear ones; keep the best.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        return contest(self, train, validation).winner


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

    lags: _Lags
    states: _States | None = None
    advantage: Advantage = field(default_factory=Advantage)
    fits: bool = False
    linear: Linear | None = None

    @property
    def lagged(self) -> FittedTS:
        """The model over lags."""
        return self.lags.model

    @property
    def hidden(self) -> FittedTS | None:
        """The model over hidden states."""
        return None if self.states is None else self.states.model

    @property
    def taken(self) -> _Lags | _States:
        """The search whose rules are the better ones."""
        return self.states if self.states is not None and self.clear else self.lags

    @property
    def clear(self) -> bool:
        """The hidden states win."""
        return self.hidden is not None and self.advantage.clear and self.fits

    @property
    def winner(self) -> Fitted:
        """The model to take, with a note on why."""
        if self.linear is not None:
            return self.linear
        return self.of_rules

    @property
    def of_rules(self) -> FittedTS:
        """The better of the two kinds, with a note on why."""
        if self.hidden is None:
            return self.lagged
        times = np.exp(0.5 * self.advantage.gain)
        ratio = f"{times:.2f} times the free-run error of rules over lags on held-out parts"
        if not self.clear:
            but = "but more in training" if self.advantage.clear else "not clearly less"
            note = f"A hidden state was tried and not taken: {ratio}, {but}."
            return replace(self.lagged, notes=(*self.lagged.notes, note))
        note = f"A hidden state explains what lagged outputs do not: {ratio}."
        return replace(self.hidden, notes=(note, *self.hidden.notes))


@on_one_thread
def contest(settings: BestTS, train: Dataset, validation: Dataset | None = None) -> Contest:
    """Both kinds, the second where the first hints at it; the linear model where neither pays."""
    with sharing():
        found = _of_rules(settings, train, validation)
        return replace(found, linear=_linear_enough(settings, found, train, validation))


def _of_rules(settings: BestTS, train: Dataset, validation: Dataset | None) -> Contest:
    asked = {
        name: getattr(settings, name) for name in ("rules", "antecedents", "most_rules", "nk_hint", "search")
    }
    known = learn_lagged(TS(**asked), train, validation, linear_choice)
    lagged = finished(
        known.stage, train, known.notes, intervals=known.linear is None, neighbour=known.neighbour
    )
    lags = _Lags(known, lagged)
    alone = Contest(lags)
    if not (settings.search.hidden_states and hints_at_hidden_state(lagged, train)):
        return alone
    try:
        learned = learn(TSStateSpace(**asked), train, validation)
        if learned.stage.rules == 1 == known.stage.rules:
            return alone
        found = finished(
            learned.stage, train, learned.notes, intervals=learned.intervals, neighbour=learned.neighbour
        )
        states = _States(learned, found)
        judgement = _judged(lags, states, train, validation)
    except (DataError, FitError, UsageError, np.linalg.LinAlgError):  # e.g. antecedents that it does not have
        return alone
    return Contest(lags, states, *judgement)


def _linear_enough(
    settings: BestTS, found: Contest, train: Dataset, validation: Dataset | None
) -> Linear | None:
    """The linear side's choice where one rule is enough, or where the rules do not clearly run nearer.

    None where rules are kept, or where the one rule holds an integrator, which no linear structure does.
    """
    rules = found.of_rules
    count = len(rules.parameters.theta)
    if settings.rules not in ("auto", 1) or INTEGRATES in rules.notes:
        return None
    hint = tuple(settings.nk_hint)
    choice = linear_choice(TS(nk_hint=hint), train, validation)
    if choice is None:
        return None
    label, model = choice
    assert isinstance(model, Linear)
    if count == 1:
        said = "rules were searched for, and none paid."
    elif not advantage([block_errors((model, rules), validation or train)]).gain < 0.0:
        said = f"its free run is nearer than that of the {count} rules found."
    else:
        if validation is not None:
            parts = [(train, validation)]
            models: tuple[Refit, Refit] = (lambda _: model, lambda _: rules)
        else:
            parts = [hold_out(train, found.taken.least, fold) for fold in range(_PARTS)]
            models = (linear_rivals(hint)[label].fit, found.taken.again)
        said = unproven(*models, parts)
        if not said:
            return None
        said = f"{count} rules of {rules.n_parameters} numbers were found and not kept: {said}."
    tried = [note for note in rules.notes if note.startswith(SWEEP)]
    return replace(model, notes=(f"{LINEAR_ENOUGH}{said}", *tried, *model.notes))


@dataclass(frozen=True, eq=False)
class _Lags:
    """What the search over lags found, and how it is fitted to a part of the data."""

    known: Learned
    model: FittedTS

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.known.stage.problem.layout.depth + SPARE_ROWS

    def again(self, data: Dataset) -> FittedTS:
        """Refined from where it is on other data."""
        runs = runs_of(self.model.layout, data.segments, self.least)
        return finished(on_all_runs(self.known.stage, runs, _STEPS), data, (), intervals=False)


@dataclass(frozen=True, eq=False)
class _States:
    """What the search over states found, and how it is fitted to a part of the data."""

    known: LearnedStates
    model: FittedTS

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.known.context.least

    def again(self, data: Dataset) -> FittedTS:
        """Refined from where it is on other data."""
        return finished(self.known.again(data, _STEPS), data, (), intervals=False)


def _judged(
    lags: _Lags, states: _States, train: Dataset, validation: Dataset | None
) -> tuple[Advantage, bool]:
    """The advantage of hidden states on held-out parts, and whether they fit the training data better."""
    fits = advantage([block_errors((lags.model, states.model), train)]).gain < 0.0
    if validation is not None:
        return compared(lambda _: lags.model, lambda _: states.model, [(train, validation)]), fits
    least = max(lags.least, states.least)
    parts = [hold_out(train, least, fold) for fold in range(_PARTS)]
    return compared(lags.again, states.again, parts), fits


def hints_at_hidden_state(model: FittedTS, train: Dataset) -> bool:
    """Whether the free run errs more than the data resolve, in a way that its own past foretells."""
    if len(model.outputs) > _MOST_OUTPUTS or len(train) > _MOST_SAMPLES:
        return False
    errors = []
    for s in train.segments:
        window = start_window(model.n_init, len(s), model.dt_s)
        if len(s) > 2 * window:
            errors.append(_errors(model, s.u, s.y, window))
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


def _errors(model: FittedTS, u: FloatArray, y: FloatArray, window: int) -> FloatArray:
    """(N - window, n_y) free run less measured, from the start that the first rows suggest."""
    start = estimate_start(model, u[:window], y[:window])
    return np.asarray((model.simulate(u, start) - y)[window:])
