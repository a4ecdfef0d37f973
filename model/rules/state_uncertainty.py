"""How sure a TS state-space model is of its numbers: `rule_uncertainty` over hidden states.

The choice of what a hidden state means leaves directions of the consequents that no output shows; they are
held where they are. Gains, time constants of rules and the free run do not hang on that choice, single
consequents of hidden states do.

What hangs on the numbers in a curved way is taken to first order. Memberships and consequents trade off along
bent valleys of the simulation error: draws from the distribution would leave the valley at its ends, and
call a free run unsure that every refit agrees on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.rules.fitted_lags import time_constant
from flysid.model.rules.fitted_states import FittedTSStateSpace
from flysid.model.rules.free_run_error import Body, RuleProblem, run_sensitivities, swept
from flysid.model.rules.realisation import initial_states
from flysid.model.rules.rule_uncertainty import Uncertainty, check_signals, covariance_of, shortened
from flysid.model.rules.state_growth import StateProblem, unmoved
from flysid.model.rules.state_layout import runs_of
from flysid.model.threads import on_one_thread

_START_ROWS = 400  # of a run, from which the state it starts from is estimated
_NUDGE = 1e-6
_Z95 = 1.959964


@dataclass(frozen=True, eq=False)
class StateUncertainty(Uncertainty[FittedTSStateSpace]):
    """The distribution of a TS state-space model's numbers; intervals to first order."""

    @cached_property
    def gain_interval(self) -> FloatArray:
        """(2, R, n_y, n_u) 95 % interval of every rule's steady gain; NaN where the data do not bound it.

        Of the ratio N / D that a gain is, by Fieller's theorem (1954): where D, which vanishes for a rule
        that integrates, is not surely another number than 0, nothing bounds it.
        """
        top = _numerators(self.model)
        under = _denominators(self.model)
        J = self._slopes(_numerators)
        K = self._slopes(_denominators)
        a = under**2 - self._product(K, K)
        b = top * under - self._product(J, K)
        root = np.sqrt(np.maximum(b * b - a * (top**2 - self._product(J, J)), 0.0))
        with np.errstate(all="ignore"):
            return np.where(a > 0.0, np.stack([(b - root) / a, (b + root) / a]), np.nan)

    @cached_property
    def time_constant_interval_s(self) -> FloatArray:
        """(2, R) 95 % interval of every rule's slowest time constant; inf where the rule may integrate."""
        return np.array([[time_constant(r, self.model.dt_s) for r in end] for end in self._radius])

    def simulation_band(self, u: FloatArray, y0: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over what is uncertain."""
        model = self.model
        layout = self.model.layout
        middle = model.simulate(u, y0)
        W = model.started(u, y0)
        rows = len(W) - len(middle)
        run = model.run(W, rows if y0 is None else model.n_init)
        half = np.zeros_like(middle)
        for within, J in swept(self.problem_of_states, self.body, run):
            part = np.sqrt(np.maximum(np.einsum("kip,pq,kiq->ki", J, self.covariance, J), 0.0))
            first = max(within.start - rows, 0)
            last = within.stop - rows
            if last > 0:
                half[first:last] = part[len(part) - (last - first) :]
        half *= _Z95 * layout.scale[: layout.n_y]
        if y0 is not None:
            half[: model.n_init] = 0.0
        low, high = model.output_limits
        return np.clip(middle - half, low, high), np.clip(middle + half, low, high)

    @property
    def problem_of_states(self) -> StateProblem:
        """The problem, as what it is."""
        assert isinstance(self.problem, RuleProblem)
        return self.problem

    @cached_property
    def _radius(self) -> FloatArray:
        """(2, R) 95 % interval of every rule's pole radius, from 0 on."""
        radius = np.array([rule.pole_radius for rule in self.model.rules()])
        half = self._half_width(lambda m: np.array([np.abs(p).max() for p in m.local_poles()]))
        return np.maximum(np.stack([radius - half, radius + half]), 0.0)

    def _half_width(self, of: Callable[[FittedTSStateSpace], FloatArray]) -> FloatArray:
        """1.96 standard errors of a figure of the model."""
        J = self._slopes(of)
        return np.sqrt(np.maximum(self._product(J, J), 0.0))

    def _slopes(self, of: Callable[[FittedTSStateSpace], FloatArray]) -> FloatArray:
        """(..., P) derivatives of a figure to all consequents, by central differences."""
        centre = self.body.vector()
        slopes = []
        for j in range(self.body.a.size):  # no rule's own figures hang on memberships
            step = np.zeros(len(centre))
            step[j] = _NUDGE
            slopes.append((of(self._at(centre + step)) - of(self._at(centre - step))) / (2.0 * _NUDGE))
        return np.stack(slopes, axis=-1)

    def _product(self, J: FloatArray, K: FloatArray) -> FloatArray:
        """1.96 squared times the covariance of two figures of these derivatives."""
        size = self.body.a.size
        return np.asarray(_Z95**2 * np.einsum("...p,pq,...q->...", J, self.covariance[:size, :size], K))


def _numerators(model: FittedTSStateSpace) -> FloatArray:
    """(R, n_y, n_u) of the steady gains."""
    return np.array([B.sum(axis=0) for _, B, _ in model.local_polynomials()])


def _denominators(model: FittedTSStateSpace) -> FloatArray:
    """(R, n_y, n_u) of the steady gains: one number per rule."""
    found = [np.full(B.shape[1:], 1.0 - A.sum(axis=0)[0, 0]) for A, B, _ in model.local_polynomials()]
    return np.array(found)


@on_one_thread
def uncertainty(model: FittedTSStateSpace, train: Dataset) -> StateUncertainty:
    """How sure the model is of its numbers, from the data that it was fitted to.

    Raises
    ------
    UsageError : the data hold other signals than the model.
    DataError : fewer samples than numbers in the model.
    """
    layout = model.layout
    par = model.parameters
    check_signals((*layout.outputs, *layout.inputs), train)
    runs = shortened(runs_of(layout, train.segments, model.n_init + 2))
    if sum(len(W) - layout.depth for W in runs) * layout.n_y <= model.n_parameters:
        raise DataError("fewer samples than numbers in the model: nothing can be said about its uncertainty")
    body = Body(par.theta.copy(), par.centre.copy(), par.width.copy())
    problem = unmoved(layout, runs, par.z_range, par.limits)
    starts = initial_states(layout, runs, par, model.prior, _START_ROWS)
    found = [_sensitivities(problem, body, W, x) for W, x in zip(runs, starts, strict=True)]
    covariance = covariance_of(body, [J for J, _ in found], [e for _, e in found])
    return StateUncertainty(model, body, problem, covariance)


def _sensitivities(
    problem: StateProblem, body: Body, W: FloatArray, initial: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, n_y, P) sensitivities of a free run, its own initial state projected out, and (N, n_y) errors."""
    J, error = (part[problem.layout.uncompared :] for part in run_sensitivities(problem, body, W, initial))
    flat = J.reshape(-1, J.shape[2])
    own = np.linalg.qr(flat[:, body.size :])[0]
    rest = flat[:, : body.size]
    rest = rest - own @ (own.T @ rest)
    return rest.reshape(len(J), J.shape[1], -1), error
