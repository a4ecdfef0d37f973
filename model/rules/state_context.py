"""What all stages of one fit of a TS state-space model share: how they are made, judged and finished."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.growth import Training, one_rule_more
from flysid.model.rules.judging import Candidate, is_bounded, judged
from flysid.model.rules.realisation import PLAIN, PLAIN_WORDS, Realisation, coordinates
from flysid.model.rules.regressor_layout import Antecedent, Layout, Orders, parse_antecedents, runs_of
from flysid.model.rules.search_settings import SearchSettings
from flysid.model.rules.stages import on_runs_of, refine, with_ridge
from flysid.model.rules.state_choice import Family
from flysid.model.rules.state_systems import System, linear_stage

LARGE = 6000  # samples from which on one start and one ridge must do, and a sample of the data
SPARE_ROWS = 12  # a segment must be longer than its start by this to say anything
_SAMPLES = 2  # that there must be per consequent
_READABLE = 4  # states up to which rates of change and modes say more than uncorrelated numbers
_LINEAR_STEPS = 20  # of a linear system's refinement


class Settings(Protocol):
    """What growing needs to know; `TSStateSpace` is one."""

    @property
    def rules(self) -> int | Literal["auto"]: ...
    @property
    def antecedents(self) -> Sequence[str] | Literal["auto"]: ...
    @property
    def most_rules(self) -> int: ...
    @property
    def iterations(self) -> int: ...
    @property
    def ridge(self) -> float | Literal["auto"]: ...
    @property
    def search(self) -> SearchSettings: ...


@dataclass(frozen=True, eq=False)
class StateContext:
    """What all stages of one fit share."""

    settings: Settings
    least: int
    ends: FloatArray
    scaled: tuple[FloatArray, FloatArray]

    def linear(self, system: System, data: Dataset) -> Stage:
        """One rule: the system as it is, or refined on the data where that is what it stands for."""
        return self._stage(system.on(data), data, 0 if system.again else _LINEAR_STEPS)

    def in_coordinates(self, stage: Stage, name: str) -> tuple[Stage, str]:
        """A single rule in other coordinates, and what its hidden states are then."""
        real = Realisation.of(stage.layout, stage.body.a[0])
        if name == PLAIN:
            return stage, PLAIN_WORDS
        choices = coordinates(real, stage.layout.n_y)
        real = choices.get(name, next(iter(choices.values())))
        ends = stage.problem.limits[:, : stage.layout.n_y]
        return linear_stage(
            replace(stage.layout, antecedents=()), stage.problem.runs, real, ends, 0
        ), real.words

    def _stage(self, real: Realisation, data: Dataset, iterations: int) -> Stage:
        shift, scale = self.scaled
        n_y = len(data.outputs)
        hidden = len(real.A) - len(data.outputs)
        layout = Layout(
            data.outputs,
            data.inputs,
            Orders.of_states(real.input_lags),
            (),
            np.concatenate([shift[:n_y], np.zeros(hidden), shift[n_y:]]),
            np.concatenate([scale[:n_y], np.ones(hidden), scale[n_y:]]),
            hidden,
            0.0,
        )
        ends = (self.ends - shift[:n_y]) / scale[:n_y]
        return linear_stage(
            layout, runs_of(layout, data.segments, self.least), real, ends, iterations, whiten=True
        )

    def candidates(self, layout: Layout) -> tuple[Antecedent, ...]:
        """Variables that rules may look at: those asked for, or all."""
        if self.settings.antecedents == "auto":
            of_inputs = enumerate(layout.orders.input_lags)
            inputs = [Antecedent(layout.n + j, lags[0]) for j, lags in of_inputs if lags]
            return (*(Antecedent(i, 1) for i in range(layout.n)), *inputs)
        states = layout.signals[: layout.n]
        return parse_antecedents(self.settings.antecedents, states, layout.inputs, layout.orders.nk)

    @property
    def most(self) -> int:
        """Where growth stops."""
        return self.settings.most_rules if self.settings.rules == "auto" else self.settings.rules

    def judge(self, stage: Stage, check: Dataset) -> Candidate:
        """A stage on a judging part."""
        return judged(stage, runs_of(stage.layout, check.segments, self.least), self.least - SPARE_ROWS)

    def room(self, stage: Stage) -> bool:
        """Whether there are samples enough for one rule more."""
        return stage.body.a.size * (stage.rules + 1) / stage.rules * _SAMPLES < stage.problem.samples

    def single(self, system: System, train: Dataset) -> tuple[Stage, str]:
        """One rule on all training data, in the most readable coordinates, and what its hidden states are."""
        stage = self.linear(system, train)
        return self.in_coordinates(stage, "" if len(system.real.A) <= _READABLE else PLAIN)

    def on_everything(self, family: Family, at: int, train: Dataset) -> Stage:
        """The chosen model on all training data: grown again, or refined from the first part's.

        Long records are spared growing again. Fewer rules where the model does not come back from bounded
        random inputs.
        """
        start, _ = self.in_coordinates(self.linear(family.start.system, train), family.start.coordinates)
        kept = on_runs_of(family.folds[0][at].stage, start)
        kept = with_ridge(kept, family.ridge * kept.mean_square())
        kept = refine(kept, self.settings.iterations, 1e-6)
        options = [kept] if np.isfinite(kept.cost) else []
        if not is_bounded(start):
            return min([*options, *self._regrown(start, family.ridge, at)[-1:]], key=Stage.mean_square)
        if len(train) > LARGE and options and is_bounded(kept):
            return kept
        again = self._regrown(start, family.ridge, at)
        options = sorted([*options, again[-1]], key=Stage.mean_square) + again[-2::-1]
        return next((s for s in options if is_bounded(s)), start)

    def _regrown(self, start: Stage, ridge: float, at: int) -> list[Stage]:
        how = Training(ridge=ridge, iterations=self.settings.iterations)
        stages = [start]
        while len(stages) <= at:
            found = one_rule_more(stages[-1], self.candidates(start.layout), how)
            stages.append(found[0].stage if found else stages[-1])
        return stages
