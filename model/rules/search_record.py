"""What a search for rules knows after each of its steps, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.model.rules.families import Family
from flysid.model.rules.fitted import FittedTS, finished
from flysid.model.rules.judging import Candidate
from flysid.model.rules.operating_points import described
from flysid.model.rules.refit import on_all_runs
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.search_context import SPARE_ROWS, SearchContext
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage

LinearSide = Callable[[RuleSettings, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""
_STEPS = 6  # of a refinement on a part of the data


@dataclass(frozen=True, eq=False)
class Search:
    """What a search knows after each of its steps.

    Attributes
    ----------
    own : the judging part was taken from the training data.
    plain : the best single rule, judged over all parts.
    starts : linear models that rules may be grown from.
    best : the best family of models with 1, 2, 3, ... rules.
    chosen : the model that is to be offered, as grown on the first part; `at` + 1 is its number of rules.
    stage : the same on all the data.
    notes, verdict : reasons, in words; those on the number of rules.
    linear : the linear model that one rule is, where it is one.
    fit : change of the training mean square by a second rule, in logarithms.
    """

    context: SearchContext
    train: Dataset
    validation: Dataset | None
    own: bool
    plain: Family
    starts: tuple[Family, ...]
    best: Family
    chosen: Candidate
    stage: Stage
    at: int = 0
    notes: tuple[str, ...] = ()
    verdict: tuple[str, ...] = ()
    linear: Fitted | None = None
    fit: float = -np.inf

    @classmethod
    def begun(
        cls,
        context: SearchContext,
        data: tuple[Dataset, Dataset | None],
        own: bool,
        plain: Family,
        starts: Sequence[Family],
        notes: Sequence[str],
    ) -> Search:
        """Before anything is grown: the best single rule is what is offered."""
        one = plain.linear
        return cls(context, *data, own, plain, tuple(starts), plain, one, one.stage, notes=tuple(notes))

    @property
    def models(self) -> list[Candidate]:
        """Models by number of rules, as grown on the first part."""
        return [self.plain.linear, *self.best.folds[0][1:]]

    def said(self, *notes: str) -> Search:
        """With notes more."""
        return replace(self, notes=(*self.notes, *notes))

    @property
    def neighbour(self) -> Stage | None:
        """The model with a rule more, or one fewer where growth ended."""
        near = [*self.models[self.at + 1 :], *self.models[max(self.at - 1, 0) : self.at]]
        return next((m.stage for m in near if m.stable), None)

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.context.least if self.stage.layout.hidden else self.stage.layout.depth + SPARE_ROWS

    @cached_property
    def bare(self) -> FittedTS:
        """The fitted model, without what it does at operating points."""
        return finished(self.stage, self.train, (*self.notes, *self.verdict))

    @property
    def model(self) -> FittedTS:
        """The fitted model; it says what it does at operating points, and how surely."""
        return described(self.bare, self.train, self.neighbour)

    def again(self, data: Dataset) -> FittedTS:
        """The model refined from where it is on a part of the data."""
        runs = runs_of(self.stage.layout, data.segments, self.least)
        return finished(on_all_runs(self.stage, runs, _STEPS), data, ())
