"""What a search for rules knows after each of its steps, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.model.rules.families import Family
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.judging import Candidate
from flysid.model.rules.linear_starts import Asked
from flysid.model.rules.refit import on_all_runs
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.search_context import SPARE_ROWS, SearchContext

LinearSide = Callable[[Asked, Dataset, Dataset | None], tuple[str, Fitted] | None]
"""What the linear side chooses for settings and data, and its name; None where it has nothing."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage and how it was chosen, in words.

    Attributes
    ----------
    least : rows that a segment of a part must have.
    neighbour : one with a rule more, or fewer where growth ended.
    linear : the linear model that one rule is, where it is one.
    made : makes a single rule over states from other data, where it is at no minimum of the simulation error.
    """

    stage: Stage
    notes: tuple[str, ...]
    least: int
    neighbour: Stage | None = None
    linear: Fitted | None = None
    made: Callable[[Dataset], Stage] | None = None

    @property
    def intervals(self) -> bool:
        """The stage stands at a minimum of the simulation error, which intervals presume."""
        return self.made is None

    def again(self, data: Dataset, iterations: int) -> Stage:
        """The stage refined from where it is on a part of the data, or made from it as it was."""
        if self.made is not None:
            return self.made(data)
        return on_all_runs(self.stage, runs_of(self.stage.layout, data.segments, self.least), iterations)


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
    made: Callable[[Dataset], Stage] | None = None

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
        return Learned(self.stage, (*self.notes, *self.verdict), least, neighbour, self.linear, self.made)
