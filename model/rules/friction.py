"""Dry friction in a position: two rules on the direction of motion that differ in a constant alone.

A force that turns its sign with the speed is a step where the speed is zero. No linear model follows it, and
to a linear model a record that sticks does not even look like an integrator: friction holds it as a spring
would. Rules grown from such a model find the step badly. So these two begin with a mass: two lags of the
position, with the pole at one held. The ridge holds together all but the constants. The change of the
simulated position stands for the speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.polynomials import VANISHING
from flysid.model.rules.free_run_error import SETS, Body, Problem
from flysid.model.rules.growth import Training, integrating, linear_stage, with_variables, z_and_firing
from flysid.model.rules.judging import Family, simplest_of
from flysid.model.rules.regressor_layout import Antecedent, Orders
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage

CHANGE = Antecedent(0, 1, 2)
"""The output's newest change, which stands for the speed."""


def rubbing(context: SearchContext, starts: Sequence[Family]) -> list[Family]:
    """A mass and its two rules, judged over all parts, with the widest sets that do; or nothing.

    Nothing where no pair follows the training data more closely than every linear start, as they do where
    there is friction.

    Parameters
    ----------
    starts : linear models over lags.
    """
    if not context.asks_nothing or len(context.fit_part.outputs) > 1 or starts[0].system is not None:
        return []
    iterations = context.settings.iterations
    how = Training(ridge=context.ridges[-1], iterations=iterations)
    known = min(s.linear.stage.mean_square() for s in starts)
    found: list[Family] = []
    for orders in _masses(context):
        mass = context.ready(linear_stage(integrating(context.problem(orders)), iterations))
        rungs = list(with_friction(mass, how)) if context.room(mass) else []
        closest = min((s.mean_square() for s in rungs), default=np.inf)
        if np.log(max(closest, VANISHING) / max(known, VANISHING)) > -context.promise:
            continue
        one = context.completed(Family(((context.judge(mass),),), ridge=how.ridge))
        for two in (context.completed(Family(((context.judge(rung),),))) for rung in rungs):
            folds = zip(one.folds, two.folds, strict=True)
            found.append(replace(one, folds=tuple((*first, *second) for first, second in folds)))
    return [found[simplest_of(list(map(_drifts, found)), found[0], context.promise)]] if found else []


def _drifts(family: Family) -> FloatArray:
    """Mean squares of the two rules: of every part, as short windows do not see a position drift away.

    Of a single part those of its blocks.
    """
    return np.exp(family.logs[:, 1]) if len(family.folds) > 1 else family.units(1)


def _masses(context: SearchContext) -> Iterator[Orders]:
    """Two lags of position and inputs, as a mass has behind a hold, a sample late or behind the dead time.

    What linear models take for a dead time is often the friction.
    """
    inputs = len(context.fit_part.inputs)
    least = tuple(context.settings.nk_least) or (0,) * inputs
    hint = tuple(context.settings.nk_hint) or (0,) * inputs
    one = tuple(max(1, k) for k in least)
    for nk in dict.fromkeys((one, tuple(map(max, one, hint)))):
        orders = Orders(CHANGE.depth, (2,) * inputs, nk)
        if context.holds(orders):
            yield orders


def with_friction(stage: Stage, how: Training) -> Iterator[Stage]:
    """Two rules, of backward and of forward motion, refined, with ever narrower sets.

    The sets lie in the middle between rest and the mean speed, and meet at rest. Wide ones say that friction
    sets in gradually, narrow ones that it sticks. Each begins with the constants of the one before.

    Parameters
    ----------
    stage : of one rule over two lags of one output at least.
    how : its ridge, in shares of the error that is left, is on all that the rules say but their constants.
    """
    wide = with_variables(stage, (CHANGE,))
    changes, _ = z_and_firing(wide, wide.simulated())
    middle = 0.5 * float(np.abs(changes).mean())
    if not middle > 0.0:
        return
    wide = wide.under(metric=_but_constants(wide.problem))
    found = replace(wide, body=replace(wide.body, a=np.concatenate([wide.body.a, wide.body.a])))
    narrowest = SETS[0] * float(np.ptp(wide.problem.z_range))
    width = middle
    while True:
        sets = Body(found.body.a, np.array([[-middle], [middle]]), np.full((2, 1), width))
        begun = replace(found, body=sets.within(wide.problem.z_range))
        found = begun.under(ridge=how.ridge * found.mean_square()).refined(how.iterations, how.tolerance)
        if np.isfinite(found.cost):
            yield found
        if width <= narrowest or not np.isfinite(found.cost):
            return
        width = max(0.5 * width, narrowest)


def _but_constants(problem: Problem) -> FloatArray:
    """(n_b, n_b) the metric of a departure of one rule's coordinates in which its constant is free."""
    constant = np.array([float(column < 0) for column, _ in problem.layout.regressors])
    along = np.linalg.lstsq(problem.basis.T, constant, rcond=None)[0]
    return np.asarray(np.eye(len(along)) - np.outer(along, along) / (along @ along))
