"""Which part of a channel's work each of its models is, so that progress can be shown as a share."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from flysid import progress
from flysid.model.structures import row_of

CHOICE = "choice of the baseline"
COST_OF_CHOICE = 8.0
"""In fits of an ARX model, as `Structure.cost`: of a usual fit of the demo."""


@dataclass(frozen=True)
class FitPlan:
    """The work on one channel: the choice of the baseline, the models, and these again for every fold.

    `labels`: of the models, in the order in which they are fitted.
    `folds`: how often all models are fitted again.
    """

    labels: Sequence[str]
    folds: int = 0

    def choice(self) -> AbstractContextManager[None]:
        """Steps reported in the block belong to the choice of the baseline."""
        return progress.part(0.0, _cost(CHOICE) / self._total)

    def model(self, label: str, fold: int = 0) -> AbstractContextManager[None]:
        """Steps reported in the block belong to the fit of a model; `fold` counts from 1; 0 is the whole."""
        ahead = list(self.labels)[: list(self.labels).index(label)]
        begin = _cost(CHOICE) + fold * self._once + sum(map(_cost, ahead))
        return progress.part(begin / self._total, (begin + _cost(label)) / self._total, model=label)

    @property
    def _once(self) -> float:
        return sum(map(_cost, self.labels))

    @property
    def _total(self) -> float:
        return _cost(CHOICE) + (1 + self.folds) * self._once


def _cost(label: str) -> float:
    return COST_OF_CHOICE if label == CHOICE else row_of(label).cost
