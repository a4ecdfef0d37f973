"""What one channel of the page is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from flysid.dataset import Dataset
from flysid.validate.compare.comparison import Comparison
from flysid.validate.diagnose.context import Sweep
from flysid.validate.diagnose.diagnostics import Diagnosis

if TYPE_CHECKING:
    from flysid.model.rules.rule_uncertainty import Uncertainty


@dataclass(frozen=True, eq=False)
class Source:
    """One channel.

    `train`, `sweep`: where known.
    `points`: samples of a segment worth drawing.
    """

    channel: str
    comparison: Comparison
    diagnosis: Diagnosis
    train: Dataset | None
    sweep: Sweep | None
    points: int

    def sure(self, model: str) -> Uncertainty | None:
        """What is known of a fuzzy model's numbers."""
        checks = self.diagnosis.checks.get(model)
        return None if checks is None else checks.fuzzy
