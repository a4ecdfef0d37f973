"""Everything about one model that no comparison shows: stability, conditioning, how sure its numbers are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.validate.conditioning import conditions
from flysid.validate.parameters import Intervals, intervals
from flysid.validate.robustness import Robustness, robustness

if TYPE_CHECKING:
    from flysid.validate.bands import Drawn


@dataclass(frozen=True, eq=False)
class Checks:
    """One model.

    Attributes
    ----------
    robustness : long free run, forgetting of the start.
    conditions : of the regressors, per rule; () where not known.
    intervals : of gains, time constants and coefficients; None where the model does not tell.
    certificate : what is proved about the stability of any blend of the rules, in words; "" where there is
        one rule, whose poles say all.
    proved : a common quadratic Lyapunov function was found.
    """

    robustness: Robustness
    conditions: tuple[float, ...]
    intervals: Intervals | None
    certificate: str
    proved: bool

    @property
    def fuzzy(self) -> Drawn | None:
        """What is known of a TS model's numbers."""
        return None if self.intervals is None else self.intervals.fuzzy


def check(model: Fitted, test: Dataset, train: Dataset | None = None) -> Checks:
    """Try `model` on the ranges of `train` (of `test` where there is none)."""
    seen = test if train is None else train
    proved, words = _certificate(model)
    return Checks(robustness(model, seen), conditions(model, seen), intervals(model, train), words, proved)


def _certificate(model: Fitted) -> tuple[bool, str]:
    from flysid.model.fuzzy.local import certificate
    from flysid.model.fuzzy.model import FittedTS
    from flysid.model.hidden.local import certificate as of_states
    from flysid.model.hidden.model import FittedTSStateSpace

    if not isinstance(model, FittedTS | FittedTSStateSpace) or len(model.rules()) < 2:
        return False, ""
    found = certificate(model) if isinstance(model, FittedTS) else of_states(model)
    return found.proved, found.reason
