"""How sure a TS model is of its numbers: intervals on consequents and gains, a band on the free run.

At the minimum of the simulation error the estimate is a nonlinear least-squares one, so that its covariance
is the sandwich (J'J)^-1 J'RJ (J'J)^-1 with the exact sensitivities J and the residual's own correlation R
(Soderstrom and Stoica, 1989, section 7.5): simulation errors are never white. What every run started from was
estimated too and is projected out. What a model cannot express is not in these intervals; the held-out
comparison is there for that, and `flysid.model.rules.lack_of_fit` at operating points.

The choice of what a hidden state means leaves directions of the consequents that no output shows; they are
held where they are. Gains, time constants of rules and the free run do not hang on that choice, single
consequents of hidden states do.

What hangs on the numbers in a curved way is taken to first order. Memberships and consequents trade off along
bent valleys of the simulation error: draws from the distribution would leave the valley at its ends, always
to the same side of the run, and call a free run unsure that every refit agrees on (2 to 120 times too wide on
the plants of `bench.ts_bands`, where small steps agree with this band to 2 %).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.covariance import CONFIDENCE_ROWS, root_of
from flysid.model.noise import coloured_gram, noise_model
from flysid.model.polynomials import VANISHING, Z95
from flysid.model.rules.free_run_error import Body, Problem, run_sensitivities, swept
from flysid.model.rules.growth import best_started
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.likely_start import LikelyStart
from flysid.model.rules.refit import as_problem
from flysid.model.rules.rule_model import RuleModel
from flysid.model.start import estimate_start
from flysid.model.threads import on_one_thread

NUDGE = float(np.cbrt(np.finfo(float).eps))
"""Of a coordinate, for central differences."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The distribution of a model's numbers, normal to first order.

    Attributes
    ----------
    model : the model, as fitted.
    body, problem : its numbers in the coordinates that the covariance is given in.
    covariance : (P, P) of `body.vector()`: consequent coordinates, centres, log widths.
    starts : (S, moving, n) what every run of the problem starts from.
    """

    model: RuleModel
    body: Body
    problem: Problem
    covariance: FloatArray
    starts: FloatArray

    @cached_property
    def consequent_errors(self) -> FloatArray:
        """(R, n, n_x) standard errors of `model.consequents`, physical units."""
        J = self._slopes(lambda m: m.consequents)
        return np.sqrt(np.maximum(self._product(J, J), 0.0)) / Z95

    @cached_property
    def gain_interval(self) -> FloatArray:
        """(2, R, n_y, n_u) 95 % interval of every rule's steady gain; NaN where the data do not bound it.

        Of the ratio N / D that a gain is, by Fieller's theorem (1954): where D, which vanishes for a rule
        that integrates, is not surely another number than 0, nothing bounds it. None for rules over hidden
        states: theirs held the truth in four of five refits (`bench.hidden_intervals`); intervals at
        operating points hold it.
        """
        top, under = _gains(self.model)
        if self.model.layout.hidden and len(top) > 1:
            return np.full((2, *top.shape), np.nan)
        J, K = self._slopes(lambda m: np.stack(_gains(m)))
        a = under**2 - self._product(K, K)
        b = top * under - self._product(J, K)
        root = np.sqrt(np.maximum(b * b - a * (top**2 - self._product(J, J)), 0.0))
        with np.errstate(all="ignore"):
            return np.where(a > 0.0, np.stack([(b - root) / a, (b + root) / a]), np.nan)

    def simulation_band(self, u: FloatArray, y0: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over what is uncertain."""
        model = self.model
        given = None if y0 is None else y0[: model.n_init]
        return self._band(model.simulate(u, y0), model.started(u, given), 0 if y0 is None else model.n_init)

    def band_from_measured(self, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`simulation_band` around `run_from_measured`, whose start suits all of the first rows y best."""
        model = self.model
        if not isinstance(model.start, LikelyStart):
            return self.simulation_band(u, estimate_start(model, u[: len(y)], y))
        return self._band(model.run_from_measured(u, y), model.started(u, y), 0)

    def _band(self, middle: FloatArray, run: FloatArray, known: int) -> tuple[FloatArray, FloatArray]:
        """Around a free run (N, n_y), from the run W that holds its start; `known` rows are given."""
        model = self.model
        n_y = model.layout.n_y
        half = np.zeros((len(run), n_y))
        for rows, J in swept(self.problem, self.body, run):
            half[rows] = np.sqrt(np.maximum(np.sum((J @ self.covariance) * J, axis=2), 0.0))
        half = Z95 * model.layout.scale[:n_y] * half[len(run) - len(middle) :]
        half[:known] = 0.0
        return np.clip(middle - half, *model.output_limits), np.clip(middle + half, *model.output_limits)

    def draws(self, count: int = 200, seed: int = 0) -> list[RuleModel]:
        """Models whose numbers are drawn from the distribution; the same ones for the same seed."""
        normal = np.random.default_rng(seed).standard_normal((count, len(self.covariance)))
        return [self._move(step) for step in normal @ root_of(self.covariance).T]

    def beside(self, step: FloatArray) -> Parameters:
        """The model's parameters with its numbers moved by a step (P,)."""
        return self.problem.parameters(self.body.moved(self.body.vector() + step))

    def _move(self, step: FloatArray) -> RuleModel:
        return replace(self.model, parameters=self.beside(step))

    def _slopes(self, of: Callable[[RuleModel], FloatArray]) -> FloatArray:
        """(..., P) derivatives of a figure to all consequent coordinates, by central differences."""
        steps = NUDGE * np.eye(self.body.a.size, self.body.size)  # no rule's own figures hang on memberships
        slopes = [(of(self._move(step)) - of(self._move(-step))) / (2.0 * NUDGE) for step in steps]
        return np.stack(slopes, axis=-1)

    def _product(self, J: FloatArray, K: FloatArray) -> FloatArray:
        """1.96 squared times the covariance of two figures of these derivatives."""
        size = self.body.a.size
        return np.asarray(Z95**2 * np.einsum("...p,pq,...q->...", J, self.covariance[:size, :size], K))


def _gains(model: RuleModel) -> tuple[FloatArray, FloatArray]:
    """(R, n_y, n_u) numerators and denominators of every rule's steady gains."""
    top, under = zip(*(rule.gain_fraction for rule in model.recursions()), strict=True)
    above = np.array(top)[:, : model.layout.n_y]
    return above, np.broadcast_to(np.array(under)[:, None, None], above.shape)


@on_one_thread
def uncertainty(model: RuleModel, train: Dataset) -> Uncertainty:
    """How sure the model is of its numbers, from the data that it was fitted to.

    Raises
    ------
    UsageError : the data hold other signals than the model.
    DataError : fewer samples than numbers in the model.
    """
    layout = model.layout
    names = [s.name for s in (*train.outputs, *train.inputs)]
    own = [s.name for s in (*layout.outputs, *layout.inputs)]
    if names != own:
        raise UsageError(
            f"the data hold {names}, the model has {own}", hint="give the data that the model was fitted to"
        )
    runs = _shorten([model.seen(s.u, s.y) for s in train.segments if len(s) >= model.n_init + 2])
    if sum(len(W) - layout.depth for W in runs) * layout.n_y <= model.n_parameters:
        raise DataError("fewer samples than parameters: the model's uncertainty cannot be estimated")
    problem, body = as_problem(layout, model.parameters, runs)
    starts = best_started(problem, body).initial
    found = [run_slopes(problem, body, W, x) for W, x in zip(runs, starts, strict=True)]
    slopes = [without_start(J.reshape(-1, J.shape[2]), body.size).reshape(*e.shape, -1) for J, e in found]
    chosen = body.free
    covariance = np.zeros((body.size, body.size))
    known = _covariance([J[:, :, chosen] for J in slopes], [e for _, e in found])
    covariance[np.ix_(chosen, chosen)] = known
    return Uncertainty(model, body, problem, covariance, starts)


def _shorten(runs: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """As many whole runs as fit into the rows kept at a time, and the beginning of the next."""
    kept: list[FloatArray] = []
    left = CONFIDENCE_ROWS
    for W in runs:
        if left > 0:
            kept.append(W[:left])
            left -= len(W)
    return tuple(kept)


def run_slopes(
    problem: Problem, body: Body, W: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(rows, n_y, P + moving n) sensitivities of a free run, its start's last, and (rows, n_y) errors."""
    layout = problem.layout
    run, J = run_sensitivities(layout, problem.parameters(body), W, start.ravel(), problem.basis)
    return J, (W - run)[layout.uncompared :, : layout.n_y]


def without_start(slopes: FloatArray, size: int) -> FloatArray:
    """The first `size` columns of sensitivities (rows, P), the others, those to the start, projected out."""
    own = np.linalg.qr(slopes[:, size:])[0]
    rest = slopes[:, :size]
    return np.asarray(rest - own @ (own.T @ rest))


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
    steep = values > VANISHING * values[-1]
    return np.asarray(vectors[:, steep] / np.sqrt(values[steep]) / size[:, None])
