"""Rules over lags against rules over hidden states: the same held-out parts, the same rows, refitted alike.

What either found is refined again on the fitting part of every fold, from where it stands, and run free over
the part held out. Errors are compared in blocks, block by block, so that what is hard for both cancels;
blocks of one record are no independent voices, which their correlation says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.rules.judging import EXACT, blocks
from flysid.model.start import run_from_window, start_window

CLEARLY = 0.3
"""In logarithms of the mean square, about 14 % of the error: what another kind of rules must win."""
_SURE = 1.645  # standard errors
_PERSISTENT = 0.8  # the most correlation from block to block that is reckoned with


class FreeRunning(Protocol):
    """What is asked of a fitted model here."""

    @property
    def n_init(self) -> int: ...
    @property
    def dt_s(self) -> float: ...
    @property
    def output_limits(self) -> FloatArray: ...
    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray: ...


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

    @property
    def clear(self) -> bool:
        """It exceeds its spread and `CLEARLY`."""
        return self.gain < -max(_SURE * self.error, CLEARLY)


def refitted(
    first: Refit, second: Refit, parts: Sequence[tuple[Dataset, Dataset]]
) -> Iterator[tuple[tuple[FreeRunning, FreeRunning], Dataset]]:
    """Both models of every fold, and its judging part, as far as a part holds enough for both."""
    for fit, check in parts:
        with suppress(DataError, FitError):
            yield (first(fit), second(fit)), check


def compared(first: Refit, second: Refit, parts: Sequence[tuple[Dataset, Dataset]]) -> Advantage:
    """The second over the first on the judging part of every fold."""
    return advantage([block_errors(*pair) for pair in refitted(first, second, parts)])


def unproven(first: Refit, second: Refit, parts: Sequence[tuple[Dataset, Dataset]]) -> str:
    """Why the second is not to be kept instead of the first, in words; "" where it is.

    It is where its advantage on parts that neither was refitted to exceeds its standard error, and where it
    runs to its output limits on none of them that the first gets through.
    """
    pairs = []
    for models, check in refitted(first, second, parts):
        if _lost(models[1], check) and not _lost(models[0], check):
            return "on a held-out part of the training data their free run went to its limits"
        pairs.append(block_errors(models, check))
    found = advantage(pairs)
    if not pairs or found.gain < -found.error:
        return ""
    low, mid, high = np.exp(0.5 * (found.gain + found.error * np.array([-1.0, 0.0, 1.0])))
    return (
        f"on held-out parts of the training data their free run has {mid:.2f} times the linear one's error, "
        f"{low:.2f} to {high:.2f} within one standard error"
    )


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


def block_errors(models: tuple[FreeRunning, FreeRunning], data: Dataset) -> tuple[FloatArray, FloatArray]:
    """Mean squared free-run errors of two models over the same blocks, in variances of the outputs."""
    scale = np.vstack([s.y for s in data.segments]).std(axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found: tuple[list[FloatArray], list[FloatArray]] = [], []
    for s in data.segments:
        window = max(start_window(m.n_init, len(s), m.dt_s) for m in models)
        if len(s) <= 2 * window:
            continue
        for model, errors in zip(models, found, strict=True):
            errors.append((run_from_window(model, s, window) - s.y)[window:] / scale)
    one, other = (blocks(e) if e else np.zeros(0) for e in found)
    return one, other


def advantage(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> Advantage:
    """Of the second of each pair of block errors; nothing where there are none."""
    known = [(np.maximum(a, EXACT), np.maximum(b, EXACT)) for a, b in pairs if len(a)]
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
    r = min(max(float(own[1:] @ own[:-1] / (own @ own)), 0.0), _PERSISTENT)
    return float(gaps.std(ddof=1) / np.sqrt(len(gaps)) * np.sqrt((1.0 + r) / (1.0 - r)))
