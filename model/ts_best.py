"""TS over lagged outputs, or over hidden states: which of the two the data ask for.

The model over lags comes first: its rules speak of measured signals only. A state-space model is tried where
the free run of the first leaves an error that its own past foretells, as a state does that the lags do not
show. It is taken only if its settings do clearly better on the same held-out parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.base import Fitted
from flysid.model.fuzzy.estimate import learn as learn_lagged
from flysid.model.fuzzy.finish import finished as finished_lagged
from flysid.model.fuzzy.layout import scaling
from flysid.model.fuzzy.model import FittedTS
from flysid.model.hidden.finish import finished
from flysid.model.hidden.fit import learn
from flysid.model.hidden.model import FittedTSStateSpace
from flysid.model.noise import noise_model
from flysid.model.start import estimate_start, start_window
from flysid.model.threads import on_one_thread
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace

_FORETOLD = 0.5  # share of the free run's error that its own past must explain
_RESOLUTION = 1e-3  # of the outputs' spread: a free-run error below leaves nothing to explain
_CLEARLY = 0.3  # in logarithms of the mean square: about 14 % of the error
_MOST_OUTPUTS = 2
_MOST_SAMPLES = 100_000


@dataclass(frozen=True)
class BestTS:
    """Settings of a TS model over lags, or over hidden states where these clearly explain more.

    Parameters
    ----------
    rules, antecedents, most_rules, nk_hint : see `TS`.
    """

    rules: int | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    most_rules: int = 5
    nk_hint: Sequence[int] = ()

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        """Fit the model over lags, and the other one where that may help; keep the better.

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
    lagged, hidden : the models; hidden is None where nothing asked for it, or none was found.
    gain, clear : see `advantage`.
    """

    lagged: FittedTS
    hidden: FittedTSStateSpace | None = None
    gain: float = 0.0
    clear: bool = False

    @property
    def winner(self) -> Fitted:
        """The model to take, with a note on why."""
        ratio = f"{np.exp(0.5 * self.gain):.2f} times the validation free-run error of the model over lags"
        if self.hidden is None:
            return self.lagged
        if not self.clear:
            note = f"A hidden state was tried and not taken: {ratio}, not clearly less."
            return replace(self.lagged, notes=(*self.lagged.notes, note))
        note = f"A hidden state explains what lagged outputs do not: {ratio}."
        return replace(self.hidden, notes=(note, *self.hidden.notes))


def contest(settings: BestTS, train: Dataset, validation: Dataset | None = None) -> Contest:
    """Both kinds, the second where the first hints at it."""
    asked = {name: getattr(settings, name) for name in ("rules", "antecedents", "most_rules", "nk_hint")}
    over_lags = TS(**asked)
    known = learn_lagged(over_lags, train, validation)
    lagged = finished_lagged(known.stage, train, known.notes)
    if not hints_at_hidden_state(lagged, train):
        return Contest(lagged)
    try:
        learned = learn(TSStateSpace(**asked), train, validation)
    except (DataError, FitError, UsageError):  # e.g. antecedents that it does not have
        return Contest(lagged)
    found = finished(train, learned.stage, learned.notes, intervals=learned.intervals)
    return Contest(lagged, found, *advantage(known.folds, learned.folds))


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


def advantage(lagged: Sequence[FloatArray], hidden: Sequence[FloatArray]) -> tuple[float, bool]:
    """Mean logarithm of the ratio of mean squares (below 0: the hidden state helps), and whether it is clear.

    Clear is what exceeds one standard error, over the parts or over the blocks of a single one, and
    `_CLEARLY`.

    Parameters
    ----------
    lagged, hidden : block errors of both on the same parts.
    """
    pairs = [(a, b) for a, b in zip(lagged, hidden, strict=False) if len(a) and len(b)]
    if not pairs:
        return 0.0, False
    gaps = [float(np.log(max(b.mean(), 1e-12) / max(a.mean(), 1e-12))) for a, b in pairs]
    error = float(np.hypot(_relative_error(pairs[0][0]), _relative_error(pairs[0][1])))
    if len(gaps) > 1:
        error = float(np.std(gaps, ddof=1) / np.sqrt(len(gaps)))
    gain = float(np.mean(gaps))
    return gain, gain < -max(error, _CLEARLY)


def _relative_error(errors: FloatArray) -> float:
    """Standard error of the mean of block errors, relative to it."""
    if len(errors) < 2:
        return 0.0
    return float(errors.std(ddof=1) / np.sqrt(len(errors)) / max(errors.mean(), 1e-12))


def _errors(model: FittedTS, u: FloatArray, y: FloatArray, window: int) -> FloatArray:
    """(N - window, n_y) free run less measured, from the start that the first rows suggest."""
    start = estimate_start(model, u[:window], y[:window])
    return np.asarray((model.simulate(u, start) - y)[window:])
