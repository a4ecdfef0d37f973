"""A model on its way, over lags and hidden states alike: refined, ranked, a rule inserted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.bordered import Bordered
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.descent import Cost, descended
from flysid.model.rules.free_run_error import Body, Problem
from flysid.model.rules.kernel import IntArray
from flysid.model.rules.likely_start import Prior, initial_states, rows_before
from flysid.model.rules.regressor_layout import Layout

_PROMISE_DAMPING = 1e-3


@dataclass(frozen=True, eq=False)
class Stage:
    """A model on its way: problem, numbers, starts of runs (S, moving, n), the cost reached in training."""

    problem: Problem
    body: Body
    initial: FloatArray
    cost: float = np.inf

    @property
    def rules(self) -> int:
        """Number of rules."""
        return len(self.body.a)

    @property
    def layout(self) -> Layout:
        """Lags or states, antecedents, scaling."""
        return self.problem.layout

    @property
    def unknowns(self) -> FloatArray:
        """[a | centre | log width | starts] as one vector."""
        return np.concatenate([self.body.vector(), self.initial.ravel()])

    def at(self, p: FloatArray, cost: float) -> Stage:
        """The stage at another vector of unknowns."""
        body = self.body.moved(p[: self.body.size]).within(self.problem.z_range)
        return replace(self, body=body, initial=p[self.body.size :].reshape(self.initial.shape), cost=cost)

    def under(self, **changes: Any) -> Stage:
        """The same stage under a problem that is changed so, its runs started as they were."""
        return replace(self, problem=replace(self.problem, **changes))

    def simulated(self) -> list[FloatArray]:
        """W of every run, simulated."""
        return self.problem.simulate(self.body, self.initial)

    def mean_square(self) -> float:
        """Mean squared simulation error, without the ridge."""
        first = self.layout.uncompared
        n_y = self.layout.n_y
        total = 0.0
        for run, W in zip(self.simulated(), self.problem.runs, strict=True):
            gap = run[first:, :n_y] - W[first:, :n_y]
            total += float((gap * gap).sum())
        return total / self.problem.samples

    def cost_of(self, chosen: IntArray | None = None) -> Cost:
        """The cost by the unknowns; the ridge holds memberships where they are in this stage.

        Parameters
        ----------
        chosen : indices of the numbers of the body that move beside the starts; all free ones where None.
        """
        return Cost(self.problem, self.body, self.body.free if chosen is None else chosen)

    def priced(self) -> Stage:
        """The same stage with the cost of where it is: mean squared error in variances, ridge, stress."""
        return replace(self, cost=self.cost_of().at(self.unknowns))

    def normal(self) -> tuple[float, Bordered, FloatArray]:
        """Cost, its Gauss-Newton matrix H and half its gradient g, so that a full step is -H^-1 g."""
        return self.cost_of().normal(self.unknowns)

    def refined(self, iterations: int, tolerance: float, chosen: IntArray | None = None) -> Stage:
        """The stage after Levenberg-Marquardt on the simulation error.

        Itself, its cost infinite, where it diverges from the start. `chosen` as in `cost_of`.
        """
        cost, p = descended(self.cost_of(chosen), self.unknowns, iterations, tolerance)
        return self.at(p, cost) if np.isfinite(cost) else replace(self, cost=np.inf)


def on_runs_of(stage: Stage, other: Stage) -> Stage:
    """A stage's model on the runs of another, started where that one is; hidden states where is likely."""
    runs = other.problem.runs
    kept = replace(stage.under(runs=runs), initial=other.initial)
    if not stage.layout.hidden:
        return kept
    return min((on_other_runs(stage, runs), kept), key=lambda s: s.mean_square())


def on_other_runs(stage: Stage, runs: tuple[FloatArray, ...]) -> Stage:
    """A model over hidden states on other runs, from the most likely states."""
    problem = replace(stage.problem, runs=runs)
    par = problem.parameters(stage.body)
    return replace(
        stage, problem=problem, initial=initial_states(stage.layout, runs, par, prior_of(stage), 100)
    )


def prior_of(stage: Stage) -> Prior:
    """What training says about the starts of other runs."""
    layout = stage.layout
    starts = [rows_before(layout, run[layout.uncompared :]) for run in stage.simulated()]
    return Prior.of(np.vstack(starts), stage.mean_square())


def expected_cost(stage: Stage) -> float:
    """The cost that one regularised Gauss-Newton step on all unknowns promises; inf where it cannot."""
    cost, H, g = stage.normal()
    if not (H.is_finite() and np.isfinite(g).all()):
        return float("inf")
    diagonal = H.diagonal()
    scale = np.sqrt(np.maximum(diagonal, ROUNDING * diagonal.max()))
    step = H.damped_step(scale, _PROMISE_DAMPING, g)
    return float("inf") if step is None else cost + float(step @ g)


def inserted(stage: Stage, centre: FloatArray, width: FloatArray) -> Stage:
    """One rule more, whose consequents are what the others conclude together at its centre.

    The blend near the centre stays nearly what it was, so that nothing learned is lost, whereas replacing
    a rule by two changes its weight against all others.
    """
    body = stage.body
    z_range = stage.problem.z_range
    distance = (centre - body.centre) / body.width
    strength = -0.5 * (distance * distance).sum(axis=1)
    phi = np.exp(strength - strength.max())
    blend = np.einsum("r,rim->im", phi / phi.sum(), body.a)
    if stage.rules == 1:  # the first rule moves to the other side, or the two would be one
        mirrored = 2.0 * z_range.mean(axis=0) - centre
        away = np.where(width < 1.5 * np.ptp(z_range, axis=0), mirrored, centre)
        body = Body(body.a, np.clip(away, *z_range)[None], width[None])
    grown = Body(
        np.concatenate([body.a, blend[None]]),
        np.vstack([body.centre, centre]),
        np.vstack([body.width, width]),
    )
    return replace(stage, body=grown)


def ordered(stage: Stage) -> Stage:
    """The same model with its rules in the order of their centres, first antecedent first."""
    body = stage.body
    if body.centre.shape[1] == 0:
        return stage
    order = np.lexsort(body.centre.T[::-1])
    return replace(stage, body=Body(body.a[order], body.centre[order], body.width[order]))
