"""Rules over lagged outputs, over hidden states, or a linear model: which of these the data ask for.

The model over lags comes first: its rules speak of measured signals only. Hidden states are tried where rules
over lags were kept, or a second one lowers the training error clearly, as it does wherever something bends,
and where the free run of the first leaves an error that its own past foretells, as a state does that lags do
not show. They are taken only if they do clearly better on held-out parts, and better on the training data.

What either found is refined again on the fitting part of every fold, from where it stands, and run free over
the part held out. Errors are compared block by block, so that what is hard for both cancels; blocks of one
record are no independent voices, which their correlation says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.base import Fitted
from flysid.model.noise import noise_model
from flysid.model.polynomials import ONE_SIDED, VANISHING
from flysid.model.rules import learning
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.free_run_error import range_of
from flysid.model.rules.judging import blocks, hold_out
from flysid.model.rules.kernel import IntArray
from flysid.model.rules.learning import LinearSide, Search
from flysid.model.rules.operating_points import describe
from flysid.model.rules.refit import free_run_errors
from flysid.model.rules.regressor_layout import scaling
from flysid.model.rules.search_settings import QUARTERS, RuleSettings
from flysid.model.selection import FEWEST, FreeRunning
from flysid.model.start import run_from_window, start_window

_FORETOLD = 0.5  # share of the free run's error that its own past must explain
_MOST_OUTPUTS = 2
_MOST_SAMPLES = 100_000


Refit = Callable[[Dataset], FreeRunning]
"""The model refitted on a part of the data."""


@dataclass(frozen=True)
class Advantage:
    """How much better the second of two is on held-out parts.

    Attributes
    ----------
    gain : mean over parts of the logarithm of the ratio of mean squares; below 0 the second is better.
    error : its standard error.
    """

    gain: float = 0.0
    error: float = 0.0

    def exceeds(self, least: float) -> bool:
        """Whether it is surely there, and at least so large."""
        return self.gain < -max(ONE_SIDED * self.error, least)


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
        return self.states if self.states is not None and self.clear and self.fits else self.lags

    @property
    def clear(self) -> bool:
        """Hidden states are clearly better on held-out parts."""
        return self.advantage.exceeds(self.lags.context.settings.search.hidden_gain)

    @property
    def winner(self) -> Fitted:
        """The model to take, with a note on why."""
        return self.described if self.linear is None else self.linear

    @property
    def described(self) -> FittedTS:
        """The better of the two kinds, and what it does at operating points unless one rule is linear."""
        taken = self.taken
        return self.of_rules if taken.linear else describe(self.of_rules, taken.train, settled=True)

    @property
    def of_rules(self) -> FittedTS:
        """The better of the two kinds, with a note on why."""
        model = self.taken.bare
        if self.states is None:
            return model
        times = np.exp(0.5 * self.advantage.gain)
        ratio = f"{times:.2f} times the free-run error of rules over lags on held-out parts"
        if self.taken is self.lags:
            but = "but more in training" if self.clear else "not clearly less"
            note = f"A hidden state was tried and not taken: {ratio}, {but}."
            return replace(model, notes=(*model.notes, note))
        note = f"A hidden state explains what lagged outputs do not: {ratio}."
        return replace(model, notes=(note, *model.notes))


def contest(
    settings: RuleSettings, train: Dataset, validation: Dataset | None, linear_side: LinearSide
) -> Contest:
    """Both kinds, the second where the first hints at it."""
    lags = learning.over_lags(settings, train, validation, linear_side)
    straight = lags.stage.rules == 1 and lags.fit > -settings.search.hidden_gain
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
    parts = parts_to_compare_on(train, validation, max(lags.least, states.least))
    pairs = [block_errors(models, check) for models, (_, check) in refit(lags.again, states.again, parts)]
    return advantage(pairs), fits


def hints_at_hidden_state(model: FittedTS, train: Dataset) -> bool:
    """Whether the free run errs at all, in a way that its own past foretells."""
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
        if square > VANISHING * scale[j] ** 2 and foreseen > _FORETOLD:
            return True
    return False


def refit(
    first: Refit, second: Refit, parts: Sequence[tuple[Dataset, Dataset]]
) -> Iterator[tuple[tuple[FreeRunning, FreeRunning], tuple[Dataset, Dataset]]]:
    """Both models of every fold, and its parts, as far as a part holds enough for both."""
    for fit, check in parts:
        with suppress(DataError, FitError):
            yield (first(fit), second(fit)), (fit, check)


def parts_to_compare_on(
    train: Dataset, validation: Dataset | None, least: int
) -> list[tuple[Dataset, Dataset]]:
    """Fitting and judging parts: what was given, or quarters of the training data held out in turn."""
    if validation is not None:
        return [(train, validation)]
    return [hold_out(train, least, fold) for fold in range(QUARTERS)]


def unproven(first: Refit, second: Refit, parts: Sequence[tuple[Dataset, Dataset]]) -> str:
    """Why the second is not to be kept instead of the first, in words; "" where it is.

    It is where its advantage on parts that neither was refitted to exceeds its standard error, where it runs
    to its output limits on none of them that the first gets through, and where it is not worse on those rows
    whose outputs leave the range of what it was refitted to.
    """
    pairs = []
    beyond = []
    for models, (fit, check) in refit(first, second, parts):
        if _lost(models[1], check) and not _lost(models[0], check):
            return "on a held-out part of the training data their free run went to its limits"
        pairs.append(block_errors(models, check))
        beyond.append(block_errors(models, check, range_of([s.y for s in fit.segments])))
    found = advantage(pairs)
    if pairs and not found.gain < -found.error:
        return f"on held-out parts of the training data their free run has {_in_words(found)}"
    found = advantage(beyond)
    if found.gain > found.error:
        return f"where held-out parts leave the range of the others, their free run has {_in_words(found)}"
    return ""


def _in_words(found: Advantage) -> str:
    low, mid, high = np.exp(0.5 * (found.gain + found.error * np.array([-1.0, 0.0, 1.0])))
    return f"{mid:.2f} times the linear one's error, {low:.2f} to {high:.2f} within one standard error"


def _lost(model: FreeRunning, data: Dataset) -> bool:
    """The free run is at the model's limits, and farther off than all that was measured spans.

    A limit may be an end of travel, which vehicle and model reach together.
    """
    low, high = model.output_limits
    y = np.vstack([s.y for s in data.segments])
    span = np.ptp(y, axis=0)
    for s in data.segments:
        window = start_window(model.n_init, len(s), model.dt_s)
        if len(s) > 2 * window:
            run = run_from_window(model, s, window)[window:]
            held = ((run <= low) | (run >= high)) & (np.abs(run - s.y[window:]) > span)
            if (held | ~np.isfinite(run)).any():
                return True
    return False


def block_errors(
    models: tuple[FreeRunning, FreeRunning], data: Dataset, beyond: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Mean squared free-run errors of two models over the same blocks, in variances of the outputs.

    Parameters
    ----------
    beyond : (2, n_y) range of outputs; only rows that leave it count, where there are `FEWEST`. None: all.
    """
    scale = np.vstack([s.y for s in data.segments]).std(axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found: tuple[list[FloatArray], list[FloatArray]] = [], []
    for s in data.segments:
        window = max(start_window(m.n_init, len(s), m.dt_s) for m in models)
        if len(s) <= 2 * window:
            continue
        rows = slice(window, None) if beyond is None else _outside(s.y, beyond, window)
        for model, errors in zip(models, found, strict=True):
            errors.append((run_from_window(model, s, window) - s.y)[rows] / scale)
    if beyond is not None and sum(map(len, found[0])) < FEWEST:
        return np.zeros(0), np.zeros(0)
    one, other = (blocks(e) if e else np.zeros(0) for e in found)
    return one, other


def _outside(y: FloatArray, seen: FloatArray, window: int) -> IntArray:
    """Rows after the window in which an output leaves what was seen."""
    outside = ((y < seen[0]) | (y > seen[1])).any(axis=1)
    return window + np.flatnonzero(outside[window:])


def advantage(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> Advantage:
    """Of the second of each pair of block errors; nothing where there are none."""
    known = [(np.maximum(a, VANISHING), np.maximum(b, VANISHING)) for a, b in pairs if len(a)]
    if not known:
        return Advantage()
    gaps = np.array([np.log(b.mean() / a.mean()) for a, b in known])
    within = np.array([_error(b / b.mean() - a / a.mean()) for a, b in known])
    error = float(np.sqrt((within**2).sum()) / len(within))
    if len(gaps) > 1:
        error = max(error, float(gaps.std(ddof=1) / np.sqrt(len(gaps))))
    return Advantage(float(gaps.mean()), error)


def _error(gaps: FloatArray) -> float:
    """Standard error of the mean of consecutive blocks, correlated from one to the next."""
    if len(gaps) < 3 or not gaps.std() > 0.0:
        return 0.0
    own = gaps - gaps.mean()
    whole = (len(gaps) - 1.0) / (len(gaps) + 1.0)  # all blocks are one voice then
    r = min(max(float(own[1:] @ own[:-1] / (own @ own)), 0.0), whole)
    return float(gaps.std(ddof=1) / np.sqrt(len(gaps)) * np.sqrt((1.0 + r) / (1.0 - r)))
