"""From settings and data to a chosen TS state-space model: states, coordinates, rules, and the reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.arguments import is_count
from flysid.model.rules.free_run_error import Stage
from flysid.model.rules.judging import INTEGRATES, hold_out, is_bounded
from flysid.model.rules.regressor_layout import runs_of, scaling
from flysid.model.rules.saturation import saturation_limits
from flysid.model.rules.stages import on_other_runs, ordered, refine
from flysid.model.rules.state_choice import Family, fewest_rules
from flysid.model.rules.state_context import SPARE_ROWS, StateContext
from flysid.model.rules.state_context import Settings as GrowthSettings
from flysid.model.rules.state_search import searched
from flysid.model.rules.state_systems import Settings as SystemSettings
from flysid.model.rules.state_systems import System, linear_systems


class Settings(SystemSettings, GrowthSettings, Protocol):
    """What `learn` needs to know; `TSStateSpace` is one."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage on all training runs, and how it was chosen.

    Attributes
    ----------
    intervals : the stage stands at a minimum of the simulation error, which intervals presume.
    context, system : what it was made with, and from.
    neighbour : with one rule more, or one fewer where growth ended.
    """

    stage: Stage
    notes: tuple[str, ...]
    context: StateContext
    system: System
    intervals: bool = True
    neighbour: Stage | None = None

    @property
    def least(self) -> int:
        """Rows that a segment of a part must have."""
        return self.context.least

    def again(self, data: Dataset, iterations: int) -> Stage:
        """The stage refined from where it is on a part of the data, by the method that found it."""
        if not self.intervals:
            return self.context.single(self.system, data)[0]
        runs = runs_of(self.stage.layout, data.segments, self.context.least)
        return refine(on_other_runs(self.stage, runs), iterations, 1e-4)


def check(settings: Settings) -> None:
    """Raise UsageError for settings that cannot be."""
    for name in ("states", "rules"):
        value = getattr(settings, name)
        if value != "auto" and not is_count(value, 1):
            raise UsageError(f"{name}={value!r}", hint='give "auto" or a whole number from 1 on')
    for name in ("most_rules", "iterations"):
        if not is_count(getattr(settings, name), 1):
            raise UsageError(f"{name}={getattr(settings, name)!r}", hint="give a whole number, at least 1")
    ridge = settings.ridge
    if ridge != "auto" and not (isinstance(ridge, int | float) and 0 <= ridge < np.inf):
        raise UsageError(f"ridge={settings.ridge!r}", hint='give "auto", or 0 or more; 0.01 is usual')
    if settings.antecedents != "auto" and (isinstance(settings.antecedents, str) or not settings.antecedents):
        raise UsageError(f"antecedents={settings.antecedents!r}", hint='give "auto" or a list of names')


def learn(settings: Settings, train: Dataset, validation: Dataset | None) -> Learned:
    """Choose states and coordinates, then rules, by the validation free run; then learn from all data."""
    check(settings)
    settings.search.check()
    scaled = scaling(train)
    systems = linear_systems(settings, train, validation, scaled)
    least = _least(systems, train)
    context = StateContext(settings, least, saturation_limits(train), scaled)
    found = searched(context, systems, _parts(settings, train, validation, least))
    at = fewest_rules(found.best, found.plain) if settings.rules == "auto" else settings.rules - 1
    _check_count(settings, found.best)
    family = found.plain if at == 0 else found.best
    if at == 0:
        final, words = context.single(family.start.system, train)
    else:
        final = ordered(context.on_everything(family, at, train))
        words = family.words
    notes = [
        _why(family, words, systems),
        *_ends(context.ends, train),
        *_rule_notes(settings, found.best, found.plain, final.rules),
    ]
    refined = final.rules > 1 or family.start.system.again is None
    if not is_bounded(final):
        notes.append(INTEGRATES)
    kids = found.best.folds[0]
    near = [kid.stage for kid in (*kids[at + 1 :], *kids[at - 1 : at]) if kid.stable]
    return Learned(final, tuple(notes), context, family.start.system, refined, near[0] if near else None)


def _least(systems: Sequence[System], train: Dataset) -> int:
    """Rows that a segment must have.

    Raises
    ------
    DataError : no segment has them.
    """
    depth = max(lag for s in systems for own in s.real.input_lags for lag in own)
    least = depth + 2 * max(len(s.real.A) for s in systems) + SPARE_ROWS
    longest = max(len(s) for s in train.segments)
    if longest < least:
        raise DataError(
            f"the longest segment has {longest} samples; these states and delays need {least}",
            hint="record longer, allow longer gaps, or ask for fewer states",
        )
    return least


def _check_count(settings: Settings, family: Family) -> None:
    stage = family.folds[0][-1].stage
    if settings.rules != "auto" and stage.rules < settings.rules:
        raise DataError(
            f"{settings.rules} rules of {stage.body.a[0].size} numbers need more than the "
            f"{stage.problem.samples} samples there are",
            hint="ask for fewer rules or states, or record longer",
        )


def _parts(
    settings: Settings, train: Dataset, validation: Dataset | None, least: int
) -> list[tuple[Dataset, Dataset]]:
    """Fitting and judging parts: the given validation, else one held-out quarter, or every one in turn."""
    if validation is not None and any(len(s) >= least for s in validation.segments):
        return [(train, validation)]
    folds = range(settings.search.folds if len(train) < settings.search.short else 1)
    return [hold_out(train, least, fold) for fold in folds]


def _why(family: Family, words: str, systems: Sequence[System]) -> str:
    tried = "; ".join(dict.fromkeys(s.title for s in systems))
    many = f" (tried, in several coordinates: {tried})" if len(systems) > 1 else ""
    layout = family.folds[0][0].stage.layout
    title = family.start.system.title
    hidden = f" Hidden states: {words}, in units of their spread in training." if layout.hidden else ""
    return f"From {title}{many}.{hidden}"


def _ends(ends: FloatArray, train: Dataset) -> list[str]:
    return [
        f"{signal.name} {word} {ends[side, i]:.4g} {signal.unit}".rstrip()
        + ", where it came to a stop repeatedly: taken as an end of its travel."
        for side, word in enumerate(("never falls below", "never exceeds"))
        for i, signal in enumerate(train.outputs)
        if np.isfinite(ends[side, i])
    ]


def _rule_notes(settings: Settings, best: Family, plain: Family, rules: int) -> list[str]:
    errors = [float(plain.rmse[0]), *(float(e) for e in best.rmse[1:])]
    tried = ", ".join(f"{i + 1}: {e:.3g}" for i, e in enumerate(errors))
    sweep = f"Validation free-run error by number of rules, in standard deviations of the output: {tried}."
    if settings.rules != "auto":
        return [
            sweep,
            f"{rules} rules, as asked." if rules == settings.rules else f"{rules} rules came back.",
        ]
    if rules == 1:
        return [sweep, "One rule is enough: more rules do not lower the validation error beyond its spread."]
    return [sweep, f"{rules} rules: the fewest that are not clearly worse than the best."]
