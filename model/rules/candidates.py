"""What the search begins with: linear models over lags and over hidden states, refined and judged.

Over lags, short to long, with and without the present input, and what the linear side finds with its own
parametrisations, delays and orders. Over hidden states, the best linear state space and output-error models
of few states, in several coordinates each: the linear model is the same in all of them, but rules look along
single states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.linear.data import SEARCH_ROWS
from flysid.model.polynomials import VANISHING
from flysid.model.rules.growth import (
    embedded_start,
    linear_stage,
    looks_integrating,
    rebase,
    skip_refining,
    thin,
    with_integrator,
)
from flysid.model.rules.judging import Candidate, fewest
from flysid.model.rules.linear_starts import (
    PLAIN,
    LinearStart,
    StateRealisation,
    arx_start,
    as_stage,
    linear_models,
)
from flysid.model.rules.regressor_layout import Orders
from flysid.model.rules.search_context import SearchContext, without_present
from flysid.model.rules.stages import Stage
from flysid.model.rules.state_systems import coordinate_names, in_coordinates, system_stage
from flysid.model.selection import FEWEST
from flysid.model.shared import once

_ALIKE = 1e-3  # of the training error: linear models of the same lags are one


def over_lags(context: SearchContext, choices: Sequence[Orders]) -> tuple[list[Candidate], list[str]]:
    """Linear models of the orders, and of those of the linear side, simplest first; notes on them."""
    found = list(_of_orders(context, tuple(choices)))
    notes: list[str] = []
    needless = _needless(context, found) if len(choices) > 1 else ()
    if needless:
        found += _of_orders(context, tuple(dict.fromkeys(_without(o, needless) for o in choices)))
        names = ", ".join(context.train.inputs[j].name for j in needless)
        notes = [f"A linear model simulates the record as well without past values of {names}."]
    return sorted(found, key=lambda c: c.stage.body.size), notes


@once(SearchContext.key)
def _of_orders(context: SearchContext, choices: tuple[Orders, ...]) -> tuple[Candidate, ...]:
    stages: list[Start] = [(s, None) for s in _chain(context, choices)]
    stages += [(s, None) for s in _chain(context, without_present(context.settings, choices))]
    if context.settings.refine and len(choices) > 1:
        stages += _of_the_linear_side(context)
    kept = _different([start for start in _settled(context, stages) if np.isfinite(start[0].cost)])
    return tuple(context.judge(context.ready(s), linear=m) for s, m in kept)


def _chain(context: SearchContext, choices: Sequence[Orders]) -> list[Stage]:
    """A linear model of each, refined from the one before as well."""
    settings = context.settings
    found: list[Stage] = []
    for orders in choices:
        problem = context.problem(orders)
        if not settings.refine:
            found.append(skip_refining(problem))
            continue
        nested = (embedded_start(known, problem) for known in reversed(found))
        start = next(filter(None, nested), ())
        if settings.na != "auto":  # else the linear side's model of its own orders comes in
            start += arx_start(problem, context.train)
        found.append(linear_stage(problem, settings.iterations, start))
    return found


Start = tuple[Stage, LinearStart | None]
"""A linear stage, and the linear side's model that it comes from."""


def _of_the_linear_side(context: SearchContext) -> list[Start]:
    """What the linear side chooses by itself, with its delays, refined once more."""
    found: list[Start] = []
    for model in linear_models(context.train, context.check, context.settings.nk_hint):
        if _may_start(context, model.orders):
            plain = rebase(as_stage(model, context.problem(model.orders)))
            found.append((plain.refined(context.settings.iterations, 1e-6), model))
    return found


def _may_start(context: SearchContext, orders: Orders) -> bool:
    """The data hold these lags, and none is shorter than the dead time that the log shows."""
    least = tuple(context.settings.nk_least) or (0,) * len(orders.nk)
    late = all(k >= floor or not b for k, floor, b in zip(orders.nk, least, orders.nb, strict=True))
    return late and orders.depth + FEWEST <= context.least


def _settled(context: SearchContext, starts: Sequence[Start]) -> list[Start]:
    """The starts; their integrator kept where linear models of all orders see one.

    Where single ones do, they lend a lag to what rules will say, and would drift in other flights: they are
    left out.
    """
    if not context.settings.refine:
        return list(starts)
    drifting = [looks_integrating(stage) for stage, _ in starts]
    if not all(drifting):
        return [start for start, drifts in zip(starts, drifting, strict=True) if not drifts]
    found: list[Start] = []
    for stage, model in starts:
        known = [s for s, _ in found]
        found += [(s, model) for s in with_integrator(stage, context.settings.iterations, known)]
    return found


def _different(starts: Sequence[Start]) -> list[Start]:
    """Without linear models that were found before, from another side: they would be grown from twice."""
    kept: list[tuple[Start, float]] = []
    for stage, model in starts:
        square = max(stage.mean_square(), VANISHING)
        layout = stage.layout
        twins = (k for (s, _), k in kept if s.layout.regressors == layout.regressors)
        if all(abs(np.log(square / known)) > _ALIKE for known in twins):
            kept.append(((stage, model), square))
    return [start for start, _ in kept]


def _needless(context: SearchContext, candidates: Sequence[Candidate]) -> tuple[int, ...]:
    """Inputs whose past values a linear model of the best of these orders does as well without.

    Left out one after the other, the least missed one first, while the loss stays within what simpler orders
    may cost. Every rule would weigh their lags anew, and few rules could be afforded.
    """
    settings = context.settings
    if not settings.refine or settings.nb != "auto" or len(context.train.inputs) < 2:
        return ()
    best = min(candidates, key=lambda c: (not c.stable, c.score))
    orders = best.stage.layout.orders
    alone = {j: _left_out(context, orders, (j,)) for j, lags in enumerate(orders.nb) if lags}
    needless: tuple[int, ...] = ()
    for j in sorted(alone, key=lambda j: alone[j].score):
        tried = (*needless, j)
        if len(tried) == len(alone):
            break
        rest = alone[j] if len(tried) == 1 else _left_out(context, orders, tried)
        if fewest([rest, best], settings.search.rule_gain):
            break
        needless = tried
    return tuple(sorted(needless))


def _left_out(context: SearchContext, orders: Orders, inputs: Sequence[int]) -> Candidate:
    (stage,) = _chain(context, [_without(orders, inputs)])
    return context.judge(context.ready(stage))


def _without(orders: Orders, inputs: Sequence[int]) -> Orders:
    """The orders with no past values of these inputs."""
    return replace(orders, nb=tuple(0 if j in inputs else lags for j, lags in enumerate(orders.nb)))


def over_states(
    context: SearchContext, systems: Sequence[StateRealisation], ends: FloatArray
) -> list[Candidate]:
    """Linear systems refined, in the coordinates that rules look along, the most readable first.

    A system of many states is offered as it is: of more, rates and modes say little.
    """
    settings = context.settings.search
    found = []
    for system in systems:
        stage = system_stage(system, context.train, context.least, (context.shift, context.scale), ends)
        stage = thin(stage, SEARCH_ROWS)
        small = len(system) <= 2 * settings.highest_order
        names = coordinate_names(stage) if small else (PLAIN,)
        for name in names:
            seen, words = in_coordinates(stage, name)
            said = f"From {system.title}."
            if seen.layout.hidden:
                said += f" Hidden states: {words}, in units of their spread in training."
            found.append(context.judge(seen, origin=said, may_grow=small))
    return found
