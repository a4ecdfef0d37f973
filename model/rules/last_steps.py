"""The last steps of a search for rules: the linear side's choice where one rule is enough, and the refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.judging import INTEGRATES
from flysid.model.rules.linear_starts import as_linear, as_stage
from flysid.model.rules.refit import refit
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.saturation import saturation_limits
from flysid.model.rules.search_context import SPARE_ROWS
from flysid.model.rules.search_record import LinearSide, Search
from flysid.model.rules.stages import Stage, on_runs_of, ordered
from flysid.model.rules.state_systems import in_coordinates, system_stage

_READABLE = 4  # states up to which rates of change and modes say more than uncorrelated numbers
_ON_ALL = "The model was refined once more on the held-out part together with the rest."
_AS_IT_WAS = (
    "The held-out part only chose the model: refined once more on all the data, it was no longer stable."
)


def take_linear_side(linear_side: LinearSide | None, found: Search) -> Search:
    """One rule is the linear side's choice, parameter for parameter.

    As it was where there is more than one rule, where the process integrates, which one rule can say exactly,
    or where the choice is no equation over lags that runs free.
    """
    context = found.context
    chosen = found.chosen.stage
    if linear_side is None or chosen.rules > 1 or chosen.problem.integrates or not context.settings.refine:
        return found
    choice = linear_side(context.settings, found.train, found.validation)
    model = None if choice is None else as_linear(choice[1])
    if choice is None or model is None:
        return found
    least = max(context.least, model.orders.depth + SPARE_ROWS)
    if not any(len(s) >= least for s in found.train.segments):
        return found
    whole = replace(context, fit_part=found.train, least=least)
    stage = whole.ready(as_stage(model, whole.problem(model.orders)))
    if not np.isfinite(stage.cost) or (context.must_be_bounded and not is_bounded(stage)):
        return found
    said = f"One rule is the linear side's choice, parameter for parameter: {choice[0].upper()}."
    return replace(found, stage=stage, linear=choice[1], notes=(said, *choice[1].notes))


def refit_lags(found: Search) -> Search:
    """The chosen model refined on all the data, if it stays stable."""
    context = found.context
    settings = context.settings
    if found.linear is not None:
        return found
    if not settings.refine:
        method = "Consequents are one-step least squares; the simulation error was not refined."
        return replace(found, verdict=(*found.verdict, method))
    data = found.train if found.own else context.fit_part
    runs = runs_of(found.stage.layout, data.segments, context.least)
    stage = refit(replace(found.chosen, stage=found.stage), data, runs, settings.iterations)
    notes = [_AS_IT_WAS if stage is found.stage else _ON_ALL] if found.own else []
    if stage.problem.integrates and context.must_be_bounded:
        notes.append(INTEGRATES)
    method = (
        "Consequents and memberships were refined on the simulation error with exact sensitivities; only "
        "models that stayed bounded under random inputs were considered."
    )
    return replace(found, stage=stage, verdict=(*found.verdict, method)).said(*notes)


def refit_states(found: Search) -> Search:
    """The chosen model on all the data: one rule in the most readable coordinates, more grown again."""
    context = found.context
    family = found.plain if found.at == 0 else found.best
    system = family.system
    assert system is not None
    ends = saturation_limits(found.train)

    start = system_stage(system, found.train, context.least, (context.shift, context.scale), ends)
    if found.at == 0:
        stage, words = in_coordinates(start, "" if len(system) <= _READABLE else "plain")
        drifts = not is_bounded(stage)
    else:
        words = family.words
        start, _ = in_coordinates(start, family.coordinates)
        drifts = not is_bounded(start)
        stage = ordered(_on_everything(found, start, family.ridge, drifts=drifts))
    hidden = f" Hidden states: {words}, in units of their spread in training." if stage.layout.hidden else ""
    notes = [f"From {system.title}.{hidden}", *found.notes]
    if drifts:
        notes.append(INTEGRATES)
    if stage.rules <= found.at:
        count = f"{stage.rules} rules" if stage.rules > 1 else "One rule"
        notes.append(f"{count} stayed bounded under random inputs.")
    return replace(found, stage=stage, notes=tuple(notes))


def _on_everything(found: Search, start: Stage, ridge: float, *, drifts: bool) -> Stage:
    """The chosen model refined on all the data from the first part's.

    Fewer rules where the model does not come back from bounded random inputs, though one rule does
    (`drifts` is False).
    """
    for model in found.models[found.at : 0 : -1]:
        stage = on_runs_of(model.stage, start)
        stage = stage.under(ridge=ridge * stage.mean_square()).refined(
            found.context.settings.iterations, 1e-6
        )
        if np.isfinite(stage.cost) and (drifts or is_bounded(stage)):
            return stage
    return start
