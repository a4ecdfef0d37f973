"""Plants that integrate: the pole at one is kept exactly, in the linear model and in every rule from it.

A pole that the record cannot tell from one is put at one: estimated freely it comes out a little inside or
outside the unit circle by what friction and noise happen to be, and a free run that is longer or otherwise
excited than the record drifts away from it. Where the sum over an output's lags is one in every rule, it is
one in every blend of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.free_run_error import Body, Problem
from flysid.model.rules.growth import embedded_start, first_basis, linear_stage, unrefined
from flysid.model.rules.stages import Stage


def holds_integrator(theta: FloatArray, lags: int) -> bool:
    """Whether consequents (R, 1, n_x) sum to one over the output's lags, their first terms, in every rule."""
    sums = theta[:, 0, :lags].sum(axis=1)
    return theta.shape[1] == 1 and lags > 0 and bool((np.abs(sums - 1.0) < ROUNDING).all())


def slowest_pole(stage: Stage) -> float:
    """The largest real pole of a linear stage of one output; 0 of other stages, and where there is none."""
    layout = stage.problem.layout
    if layout.n_y != 1 or layout.orders.na == 0 or stage.rules > 1:
        return 0.0
    theta = stage.problem.parameters(stage.body).theta[0, 0, : layout.orders.na]
    poles = np.roots(np.concatenate([[1.0], -theta]))
    return float(poles[np.abs(poles.imag) < ROUNDING].real.max(initial=0.0))


def looks_integrating(stage: Stage) -> bool:
    """A linear stage of one output with a real pole that its longest run cannot tell from one."""
    longest = max(len(W) for W in stage.problem.runs)
    return slowest_pole(stage) > 1.0 - 1.0 / longest


def with_integrator(
    stage: Stage, iterations: int, known: Sequence[Stage] = (), *, dearer: float = 1.5
) -> tuple[Stage, ...]:
    """The linear stage with its pole at one, refined; without it as well where it may be a slow lag.

    A pole outside the unit circle is offered only where one on it explains the record badly.

    Parameters
    ----------
    known : stages of lower orders that hold an integrator: further starts.
    dearer : times the mean square error that keeping the integrator may cost in training.
    """
    problem = integrating(stage.problem)
    theta = stage.problem.parameters(stage.body).theta[0].copy()
    theta[0, 0] += 1.0 - theta[0, : problem.layout.orders.na].sum()
    still = Body(np.zeros((1, 1, len(problem.basis))), stage.body.centre, stage.body.width)
    near = unrefined(replace(problem, offset=theta), still)
    nested = (embedded_start(lower, problem) for lower in reversed(known) if lower.problem.integrates)
    held = linear_stage(problem, iterations, (*next(filter(None, nested), ()), near))
    outside = slowest_pole(stage) > 1.0 and held.cost <= dearer * stage.cost
    return (held,) if outside else (held, stage)


def integrating(problem: Problem) -> Problem:
    """The problem in which the sum over the output's lags stays at one."""
    offset = np.zeros((1, len(problem.layout.regressors)))
    offset[0, 0] = 1.0
    basis = first_basis(problem.layout, problem.runs, integrating=True)
    return replace(problem, basis=np.ascontiguousarray(basis), offset=offset)
