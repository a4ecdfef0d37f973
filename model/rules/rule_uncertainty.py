"""How sure a TS model is of its numbers: intervals on consequents and gains, a band on the free run.

At the minimum of the simulation error the estimate is a nonlinear least-squares one, so that its covariance
is the sandwich (J'J)^-1 J'RJ (J'J)^-1 with the exact sensitivities J and the residual's own correlation R
(Soderstrom and Stoica, 1989, section 7.5): simulation errors are never white. The first outputs of every
segment were estimated too and are projected out. What a model cannot express (too few rules) is not in these
intervals; the held-out comparison is there for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.model.covariance import root_of
from flysid.model.noise import coloured_gram, noise_model
from flysid.model.polynomials import Z95
from flysid.model.rules.fitted_lags import FittedTS, dc_gain, refuse_other_models, time_constant
from flysid.model.rules.free_run_error import Body, Problem, run_sensitivities, runs_of, swept
from flysid.model.rules.growth import best_started
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.refit import as_problem
from flysid.model.rules.rule_poles import pole_radius
from flysid.model.threads import on_one_thread

_MOST_ROWS = 20_000  # sensitivities kept at a time; longer records are cut, which widens the intervals
_LEVEL = (2.5, 97.5)


class Uncertain(Protocol):
    """What a model must offer to be drawn again with other numbers: a dataclass with `parameters`."""

    @property
    def dt_s(self) -> float: ...
    @property
    def consequents(self) -> FloatArray: ...
    def local_polynomials(self) -> Sequence[tuple[FloatArray, FloatArray, FloatArray]]: ...


class Coordinates(Protocol):
    """What turns a body into a model's parameters."""

    def parameters(self, body: Body) -> Parameters: ...


M = TypeVar("M", bound=Uncertain)


@dataclass(frozen=True, eq=False)
class Uncertainty(Generic[M]):
    """The distribution of a model's numbers, normal to first order.

    Attributes
    ----------
    model : the model, as fitted.
    body, problem : its numbers in the coordinates that the covariance is given in.
    covariance : (P, P) of `body.vector()`: consequent coordinates, centres, log widths.
    """

    model: M
    body: Body
    problem: Coordinates
    covariance: FloatArray

    @cached_property
    def consequent_errors(self) -> FloatArray:
        """(R, n_y, n_x) standard errors of `model.consequents`, physical units."""
        return np.asarray(np.std([m.consequents for m in self.draws()], axis=0))

    @cached_property
    def gain_interval(self) -> FloatArray:
        """(2, R, n_y, n_u) 95 % interval of every rule's steady gain; NaN where the data do not bound it.

        A draw that is unstable has no steady gain: where more than one in twenty is, nothing bounds it.
        """
        gains = np.array([[_steady_gain(A, B) for A, B, _ in m.local_polynomials()] for m in self.draws()])
        bounded = np.isfinite(gains).mean(axis=0) >= 0.95
        interval = np.full((2, *gains.shape[1:]), np.nan)
        interval[:, bounded] = np.nanpercentile(gains[:, bounded], _LEVEL, axis=0)
        return interval

    @cached_property
    def time_constant_interval_s(self) -> FloatArray:
        """(2, R) 95 % interval of every rule's slowest time constant; inf where draws integrate."""
        times = [
            [time_constant(pole_radius(A), m.dt_s) for A, _, _ in m.local_polynomials()] for m in self.draws()
        ]
        return np.percentile(times, _LEVEL, axis=0, method="nearest")

    def simulation_band(self, u: FloatArray, y0: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over what is uncertain."""
        raise NotImplementedError

    def draws(self, count: int = 200, seed: int = 0) -> list[M]:
        """Models whose numbers are drawn from the distribution; the same ones for the same seed."""
        centre = self.body.vector()
        normal = np.random.default_rng(seed).standard_normal((count, len(centre)))
        steps = normal @ root_of(self.covariance).T
        return [self._at(centre + step) for step in steps]

    def centre(self) -> FloatArray:
        """(P,) the model's own numbers, in the coordinates of the covariance."""
        return self.body.vector()

    def parameters_at(self, vector: FloatArray) -> Parameters:
        """The model's parameters at other numbers (P,)."""
        return self.problem.parameters(self.body.moved(vector))

    def _at(self, vector: FloatArray) -> M:
        model: Any = self.model
        moved: M = replace(model, parameters=self.parameters_at(vector))
        return moved


class RuleUncertainty(Uncertainty[FittedTS]):
    """The distribution of the numbers of rules over lags."""

    problem: Problem

    def simulation_band(self, u: FloatArray, y0: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over what is uncertain.

        To first order, with the exact sensitivities of the run. Memberships and consequents make up for each
        other along bent valleys of the simulation error: draws from the normal distribution leave the valley
        at its ends, always to the same side of the run, and their band is lopsided and too wide: 2 to 120
        times on the plants of `bench.ts_bands`, where small steps agree with this band to 2 %.
        """
        model = self.model
        n_y = self.model.layout.n_y
        middle = model.simulate(u, y0)
        run = model.started(u, y0)
        half = np.zeros((len(run), n_y))
        for rows, J in swept(self.problem, self.body, run):
            half[rows] = np.sqrt(np.maximum(np.sum((J @ self.covariance) * J, axis=2), 0.0))
        half = Z95 * model.layout.scale[:n_y] * half[len(run) - len(middle) :]
        return np.clip(middle - half, *model.output_limits), np.clip(middle + half, *model.output_limits)


@on_one_thread
def uncertainty(model: FittedTS, train: Dataset) -> RuleUncertainty:
    """How sure the model is of its numbers, from the data that it was fitted to.

    Raises
    ------
    UsageError : the data hold other signals than the model.
    DataError : fewer samples than numbers in the model.
    """
    refuse_other_models(model)
    check_signals(model.layout.signals, train)
    runs = shortened(runs_of(model.layout, train.segments, model.n_init + 2))
    if sum(len(W) - model.n_init for W in runs) * model.layout.n_y <= model.n_parameters:
        raise DataError("fewer samples than numbers in the model: nothing can be said about its uncertainty")
    problem, body = as_problem(model.layout, model.parameters, runs)
    jacobians = []
    errors = []
    for W, initial in zip(runs, best_started(problem, body).initial, strict=True):
        J, e = _sensitivities(problem, body, W, initial)
        jacobians.append(J)
        errors.append(e)
    return RuleUncertainty(model, body, problem, covariance_of(body, jacobians, errors))


def check_signals(signals: Sequence[Signal], train: Dataset) -> None:
    """Raise UsageError where the data hold other signals than a model's outputs and inputs."""
    names = [s.name for s in (*train.outputs, *train.inputs)]
    known = [s.name for s in signals]
    if names != known:
        raise UsageError(
            f"the data hold {names}, the model has {known}", hint="give the data that the model was fitted to"
        )


def _steady_gain(A: FloatArray, B: FloatArray) -> FloatArray:
    """(n_y, n_u) steady gain; NaN where there is none."""
    return dc_gain(A, B) if pole_radius(A) < 1.0 else np.full(B.shape[1:], np.nan)


def shortened(runs: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """As many whole runs as fit into the rows kept at a time, and the beginning of the next."""
    kept: list[FloatArray] = []
    left = _MOST_ROWS
    for W in runs:
        if left > 0:
            kept.append(W[:left])
            left -= len(W)
    return tuple(kept)


def _sensitivities(
    problem: Problem, body: Body, W: FloatArray, initial: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, n_y, P) sensitivities of a free run, its own first outputs projected out, and (N, n_y) errors."""
    J, error = run_sensitivities(problem, body, W, initial)
    flat = J.reshape(-1, J.shape[2])
    own = np.linalg.qr(flat[:, body.size :])[0]
    rest = flat[:, : body.size]
    rest = rest - own @ (own.T @ rest)
    return rest.reshape(*error.shape, -1), error


def covariance_of(body: Body, jacobians: Sequence[FloatArray], errors: Sequence[FloatArray]) -> FloatArray:
    """(P, P) of `body.vector()`; a single rule's memberships mean nothing, and are certain."""
    chosen = np.arange(body.size if len(body.a) > 1 else body.a.size)
    covariance = np.zeros((body.size, body.size))
    covariance[np.ix_(chosen, chosen)] = _covariance([J[:, :, chosen] for J in jacobians], errors)
    return covariance


def _covariance(jacobians: Sequence[FloatArray], errors: Sequence[FloatArray]) -> FloatArray:
    """(P, P) sandwich, every output with a noise model of its own, flat directions left at zero.

    Outputs are weighted alike, as the fit weighs them.
    """
    n = jacobians[0].shape[2]
    gram = sum((J.reshape(-1, n).T @ J.reshape(-1, n) for J in jacobians), np.zeros((n, n)))
    root = steep(gram)
    middle = np.zeros((root.shape[1], root.shape[1]))
    for i in range(errors[0].shape[1]):
        noise, variance = noise_model([e[:, i] for e in errors])
        middle += variance * coloured_gram([J[:, i, :] @ root for J in jacobians], noise)
    return np.asarray(root @ middle @ root.T)


def steep(gram: FloatArray) -> FloatArray:
    """(P, keep) coordinates in which the Gram matrix is the identity, without its flat directions."""
    size = np.sqrt(np.maximum(gram.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    steep = values > 1e-10 * values[-1]
    return np.asarray(vectors[:, steep] / np.sqrt(values[steep]) / size[:, None])
