"""What a search for rules knows after each of its steps, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.model.rules.families import Family
from flysid.model.rules.fitted import FittedTS, finished
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.judging import Candidate
from flysid.model.rules.refit import on_all_runs
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.search_context import SPARE_ROWS, SearchContext
from flysid.model.rules.search_settings import RuleSettings

LinearSide = Callable[[RuleSettings, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage and how it was chosen, in words.

    Attributes
    ----------
    least : rows that a segment of a part must have.
    neighbour : one with a rule more, or fewer where growth ended.
    linear : the linear model that one rule is, where it is one.
    fit : change of the training mean square by a second rule, in logarithms.
    """

    stage: Stage
    notes: tuple[str, ...]
    least: int
    neighbour: Stage | None = None
    linear: Fitted | None = None
    fit: float = -np.inf

    def model(self, train: Dataset, *, intervals: bool = True) -> FittedTS:
        """The fitted model; with `intervals` it says what it does at operating points, and how surely."""
        return finished(self.stage, train, self.notes, intervals=intervals, neighbour=self.neighbour)

    def again(self, data: Dataset, iterations: int) -> FittedTS:
        """The model refined from where it is on a part of the data."""
        runs = runs_of(self.stage.layout, data.segments, self.least)
        return finished(on_all_runs(self.stage, runs, iterations), data, (), intervals=False)


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
    def learned(self) -> Learned:
        """What comes of it."""
        near = [*self.models[self.at + 1 :], *self.models[max(self.at - 1, 0) : self.at]]
        neighbour = next((m.stage for m in near if m.stable), None)
        least = self.context.least if self.stage.layout.hidden else self.stage.layout.depth + SPARE_ROWS
        said = (*self.notes, *self.verdict)
        return Learned(self.stage, said, least, neighbour, self.linear, self.fit)
