"""Everything about one model that no comparison shows: stability, conditioning, how sure its numbers are."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from flysid.dataset import Dataset
from flysid.errors import DataError, UsageError
from flysid.extras import Extra, extra
from flysid.model.base import Fitted
from flysid.model.capabilities import HasCertificate, HasSimplifications
from flysid.showing import percent
from flysid.validate.diagnose.conditioning import conditions
from flysid.validate.diagnose.parameters import Intervals, intervals
from flysid.validate.diagnose.robustness import Robustness, robustness

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty


NOT_GIVEN = "not given: see what is missing"
"""Of a certificate that broke."""
MOST_SAMPLES = 200_000
"""Training samples up to which simplifications are priced: each is refined on all of them."""


@dataclass(frozen=True)
class Simpler:
    """An edit of the rules in words, and by how much it raises the free run's RMSE on the training data."""

    what: str
    loss_pct: float

    def __str__(self) -> str:
        return f"{self.what}: {percent(self.loss_pct, 1)}"


@dataclass(frozen=True, eq=False)
class Checks:
    """One model.

    Attributes
    ----------
    robustness : long free run, forgetting of the start; None where it could not be tried.
    conditions : of the regressors, per rule; () where not known.
    intervals : of gains, time constants and coefficients; None where the model does not tell.
    certificate : what is proved about the stability of any blend of the rules, in words; "" where there is
        one rule, whose poles say all.
    proved : a common quadratic Lyapunov function was found.
    simpler : what could be said with fewer words and its price on the training data, cheapest first.
    """

    robustness: Robustness | None
    conditions: tuple[float, ...]
    intervals: Intervals | None
    certificate: str
    proved: bool
    simpler: tuple[Simpler, ...] = ()

    @property
    def fuzzy(self) -> Uncertainty | None:
        """What is known of a TS model's numbers."""
        return None if self.intervals is None else self.intervals.fuzzy


def check(model: Fitted, test: Dataset, train: Dataset | None = None, of: str = "") -> Checks:
    """Try `model` on the ranges of `train` (of `test` where there is none); `of`: its name, for sentences."""
    seen = test if train is None else train
    proved, words = extra(Extra.CERTIFICATE, partial(_certificate, model), (False, NOT_GIVEN), of)
    return Checks(
        extra(Extra.ROBUSTNESS, partial(robustness, model, seen), None, of),
        extra(Extra.CONDITIONING, partial(conditions, model, seen), (), of),
        extra(Extra.INTERVALS, partial(intervals, model, train), None, of),
        words,
        proved,
        () if train is None else extra(Extra.SIMPLER, partial(_simpler, model, train), (), of),
    )


def _simpler(model: Fitted, train: Dataset) -> tuple[Simpler, ...]:
    """Edits of rules over lags; none of other rules, or where the data are too many or too short."""
    if not isinstance(model, HasSimplifications) or len(model.rules()) < 2 or len(train) > MOST_SAMPLES:
        return ()
    with suppress(DataError, UsageError):
        return tuple(Simpler(s.what, s.loss_pct) for s in model.simplifications(train))
    return ()


def _certificate(model: Fitted) -> tuple[bool, str]:
    if not isinstance(model, HasCertificate) or len(model.rules()) < 2:
        return False, ""
    found = model.certificate()
    return found.proved, found.reason
