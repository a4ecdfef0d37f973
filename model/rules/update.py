"""New flights into an old TS model: recursive least squares on the consequents, memberships untouched.

With the memberships fixed a TS model is linear in its consequents one step ahead, so that exponentially
forgotten least squares (Ljung 1999, section 11.2) applies as it stands. On lags as they are measured it is
biased by their noise, and a model whose free run was good may come out with rules that are unstable. So the
free run's error is minimised instead, unless the other is requested: its exact sensitivities are the
regressors (recursive prediction error method, the same book, sections 11.4 and 11.5). What the recursion
arrives at is computed flight by flight, as weighted least squares with what was known before as one more
term, and taken only as far as the free run gets better and stays bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.polynomials import ROUNDING
from flysid.model.regressors import CHUNK_ROWS
from flysid.model.rules.boundedness import PUSHES, is_bounded
from flysid.model.rules.consequents import refuse_other_data, weighted
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import best_started
from flysid.model.rules.kernel import Parameters, firing
from flysid.model.rules.phrases import from_to
from flysid.model.rules.recursion import rule_radius
from flysid.model.rules.refit import as_problem, free_run_rmse, with_noise_model
from flysid.model.rules.regressor_layout import Layout, runs_of, windows
from flysid.model.rules.rule_uncertainty import run_slopes, steep, without_start
from flysid.model.rules.stages import Stage
from flysid.model.start import STEPS
from flysid.model.threads import on_one_thread

Error = Literal["free run", "one step"]

_SHARES = (1.0, 0.5, 0.25, 0.1)  # of a step that are tried
_FLOOR = 1e-6  # of a sample in which a regressor stands at 1: what nothing excites stays where it was
_OUTSIDE = 0.1  # of the new samples


@on_one_thread
def update(
    model: FittedTS,
    data: Dataset,
    *,
    forgetting: float = 1.0,
    trust_samples: float = 1000.0,
    error: Error = "free run",
) -> FittedTS:
    """The model after seeing `data`, the oldest segment first.

    Parameters
    ----------
    forgetting : weight that a sample loses with every newer one; 1 forgets nothing, 0.999 remembers about a
        thousand samples.
    trust_samples : how many samples the present consequents count for, of random steps in their range.
    error : what is lowered: "free run", or "one step" for models that are used one step ahead.

    Raises
    ------
    UsageError : other signals or sample time than the model's; forgetting outside (0, 1]; another error.
    DataError : no segment is long enough.

    Examples
    --------
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> newer = flysid.update(model, train, forgetting=0.999)
    >>> newer.n_parameters == model.n_parameters
    True
    """
    _check(model, data, forgetting, trust_samples, error)
    if not any(len(s) > model.n_init + 1 for s in data.segments):
        raise DataError(f"no segment is longer than {model.n_init + 1} samples", hint="record longer")
    before = _errors(model, data)
    if error == "free run":
        theta = _in_free_run(model, data, forgetting, trust_samples)
    else:
        theta = _one_step_ahead(model, data, forgetting, trust_samples)
    moved = replace(model, parameters=model.parameters._replace(theta=theta), noise=None, operating_points=())
    notes = (
        *model.notes,
        *_far_away(model, data),
        _told(error, forgetting, data, before, _errors(moved, data)),
        *_unstable(moved),
    )
    return with_noise_model(replace(moved, notes=notes), data)


def _check(model: FittedTS, data: Dataset, forgetting: float, trust_samples: float, error: str) -> None:
    if not 0.0 < forgetting <= 1.0 or not 0.0 < trust_samples < np.inf:
        raise UsageError(
            f"forgetting={forgetting!r}, trust_samples={trust_samples!r}",
            hint="0 < forgetting <= 1, and trust_samples above 0",
        )
    if error not in ("free run", "one step"):
        raise UsageError(f"error={error!r}", hint='give "free run" or "one step"')
    refuse_other_data(model, data)


def _errors(model: FittedTS, data: Dataset) -> tuple[FloatArray, FloatArray]:
    """(n_y,) RMSE of the free run and one step ahead, physical units."""
    one = np.vstack([(model.one_step(s.u, s.y) - s.y)[model.n_init :] for s in data.segments])
    return free_run_rmse(model, data), np.sqrt((one * one).mean(axis=0))


def _told(
    error: Error,
    forgetting: float,
    data: Dataset,
    before: tuple[FloatArray, FloatArray],
    after: tuple[FloatArray, FloatArray],
) -> str:
    """What was done and what it did to both errors."""
    steps = [from_to(old, new, data.outputs) for old, new in zip(before, after, strict=True)]
    return (
        f"Consequents were updated by recursive least squares on the {error} error over {len(data)} new "
        f"samples (forgetting {forgetting:g}); on them, free run {steps[0]}, one step ahead {steps[1]}. "
        "Memberships are as before."
    )


def _far_away(model: FittedTS, data: Dataset) -> list[str]:
    parts = [s for s in data.segments if len(s) > model.n_init]
    share = sum(len(s) * model.outside_share(s.u, s.y) for s in parts) / sum(len(s) for s in parts)
    if share < _OUTSIDE:
        return []
    return [
        f"{100 * share:.0f} % of the new samples lie outside the range that the memberships were made for: "
        "fit a new model rather than update this one."
    ]


def _unstable(model: FittedTS) -> list[str]:
    labels = [rule.label for rule in model.rules() if rule.pole_radius >= 1.0 + ROUNDING]
    if not labels:
        return []
    return [
        f"After the update unstable by itself: {', '.join(labels)}. Try the free run before it is trusted."
    ]


# ---------------------------------------------------------------------------------------------- free run


def _in_free_run(model: FittedTS, data: Dataset, forgetting: float, trust: float) -> FloatArray:
    """(R, n_y, n_x) consequents that lower the free run's error."""
    whole = runs_of(model.layout, data.segments, model.n_init + 2)
    runs = windows(whole, model.layout.depth, CHUNK_ROWS)  # memory stays bounded
    problem, body = as_problem(model.layout, model.parameters, (_wandering(model.layout),))
    problem = replace(problem, runs=runs)
    stage = best_started(problem, body)
    asked = is_bounded(stage)
    known = _Known.of(stage, forgetting, trust)
    for _ in range(STEPS):  # the free run bends with the consequents
        better = _step(stage, known, bounded=asked)
        if better is None:
            break
        stage = better
    return problem.parameters(stage.body).theta


def _wandering(layout: Layout) -> FloatArray:
    """W of signals that move a little from sample to sample: coordinates in it suit any data.

    New flights may show next to nothing, and coordinates made of them would magnify that beyond measure.
    """
    steps = np.random.default_rng(0).standard_normal((500, len(layout.signals)))
    W = np.cumsum(steps, axis=0)
    return np.ascontiguousarray((W - W.mean(axis=0)) / W.std(axis=0))


@dataclass(frozen=True, eq=False)
class _Known:
    """What the consequents were before, and how sure.

    Attributes
    ----------
    a : (P,) consequent coordinates.
    information : (P, P) of them, forgotten by the new samples.
    weights : per run (rows,) weight of every compared row.
    """

    a: FloatArray
    information: FloatArray
    weights: tuple[FloatArray, ...]

    @classmethod
    def of(cls, stage: Stage, forgetting: float, trust: float) -> _Known:
        """As sure as `trust` samples of random steps in the training range would make them.

        Not as samples like the new ones would: those may show next to nothing.
        """
        lengths = [len(W) for W in stage.problem.runs]
        total = sum(lengths)
        ages = np.split(np.arange(total)[::-1], np.cumsum(lengths)[:-1])
        uncompared = stage.layout.uncompared
        gram, _ = _normal(_random_steps(stage), [np.ones(PUSHES - uncompared)])
        basis = stage.problem.basis
        floor = np.kron(np.eye(stage.body.a.size // len(basis)), _FLOOR * trust * basis @ basis.T)
        information = trust * (forgetting**total / PUSHES * gram) + floor
        weights = tuple(np.asarray(forgetting ** age[uncompared:], dtype=np.float64) for age in ages)
        return cls(stage.body.a.ravel(), information, weights)

    def cost(self, stage: Stage) -> float:
        """Weighted squared free-run error, and how far the consequents are from what they were."""
        away = stage.body.a.ravel() - self.a
        gaps = [_run(stage, i)[1] for i in range(len(self.weights))]
        squares = (float(w @ (e * e).sum(axis=1)) for w, e in zip(self.weights, gaps, strict=True))
        return sum(squares) + float(away @ self.information @ away)


def _random_steps(stage: Stage) -> Stage:
    """The model under random steps of all lengths, from rest: what a flight usually shows."""
    layout = stage.problem.layout
    rng = np.random.default_rng(0)
    W = np.zeros((PUSHES, len(layout.signals)))
    for column in range(layout.n_y, len(layout.signals)):
        lengths = np.exp(rng.uniform(0.0, np.log(0.1 * PUSHES), PUSHES)).astype(int) + 1
        W[:, column] = np.repeat(rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), PUSHES), lengths)[:PUSHES]
    initial = np.zeros((1, layout.moving, layout.n_y))
    return replace(stage.under(runs=(W,)), initial=initial)


def _step(stage: Stage, known: _Known, *, bounded: bool) -> Stage | None:
    """The stage after one Gauss-Newton step, or as much of it as helps; None where nothing does."""
    H, g = _normal(stage, known.weights)
    away = stage.body.a.ravel() - known.a
    root = steep(H + known.information)
    step = root @ (root.T @ (g - known.information @ away))
    limit = known.cost(stage)
    for share in _SHARES:
        a = (stage.body.a.ravel() + share * step).reshape(stage.body.a.shape)
        trial = best_started(stage.problem, replace(stage.body, a=a))
        if known.cost(trial) < limit and _as_stable(trial, known) and (not bounded or is_bounded(trial)):
            return trial
    return None


def _as_stable(stage: Stage, known: _Known) -> bool:
    """Whether no rule has become unstable by itself: new flights may be too short or too quiet to show it."""
    now = _radii(stage, stage.body.a)
    before = _radii(stage, known.a.reshape(stage.body.a.shape))
    return bool((now <= np.maximum(before, 1.0) + ROUNDING).all())


def _radii(stage: Stage, a: FloatArray) -> FloatArray:
    """(R,) pole radius of every rule at consequent coordinates a."""
    layout = stage.problem.layout
    theta = stage.problem.parameters(replace(stage.body, a=a)).theta
    return np.array([rule_radius(layout.lags, rule) for rule in theta])


def _normal(stage: Stage, weights: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """J'wJ (P, P) and J'we (P,) over consequents, first outputs of every run projected out."""
    size = stage.body.a.size
    H = np.zeros((size, size))
    g = np.zeros(size)
    for i, weight in enumerate(weights):
        J, error = _run(stage, i)
        root = np.sqrt(weight)[:, None]
        flat = (J * root[:, :, None]).reshape(-1, J.shape[2])
        rest = without_start(np.delete(flat, slice(size, stage.body.size), axis=1), size)
        H += rest.T @ rest
        g += rest.T @ (error * root).ravel()
    return H, g


def _run(stage: Stage, i: int) -> tuple[FloatArray, FloatArray]:
    """Sensitivities (rows, n_y, P + Q) and errors (rows, n_y) of one run."""
    return run_slopes(stage.problem, stage.body, stage.problem.runs[i], stage.initial[i])


# ------------------------------------------------------------------------------------------ one step ahead


def _one_step_ahead(model: FittedTS, data: Dataset, forgetting: float, trust: float) -> FloatArray:
    """(R, n_y, n_x) consequents where recursive least squares on lags as measured ends: in one solve."""
    layout = model.layout
    par = model.parameters
    rules, n_y, n_x = par.theta.shape
    theta = par.theta.transpose(0, 2, 1).reshape(rules * n_x, n_y)
    parts = [_design(layout, par, s.u, s.y) for s in data.segments if len(s) > model.n_init]
    power = np.mean([np.einsum("nm,nm->m", X, X) / len(X) for X, _ in parts], axis=0)
    X, Y = (np.vstack(pieces) for pieces in zip(*parts, strict=True))
    known = np.sqrt(forgetting ** len(X) * trust * np.maximum(power, 1e-3 * power.max()))
    root = np.sqrt(forgetting ** np.arange(len(X))[::-1])[:, None]
    rows = np.vstack([root * X, np.diag(known)])
    gaps = np.vstack([root * (Y - X @ theta), np.zeros_like(theta)])
    moved = theta + np.linalg.lstsq(rows, gaps, rcond=1e-12)[0]
    return np.ascontiguousarray(moved.reshape(rules, n_x, n_y).transpose(0, 2, 1))


def _design(layout: Layout, par: Parameters, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Regressors weighted by firing strengths (M, R n_x) and outputs (M, n_y), normalised units."""
    W = layout.stack(u, y)
    d = layout.depth
    phi = firing(W, d, layout.lags, par)[d:]
    return weighted(phi, layout.regressor_values(W)), W[d:, : layout.n_y]
