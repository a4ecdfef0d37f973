"""What the errors of a free run tell of the slope that a model misses at a level of its output.

A model that cannot express its plant errs alike whenever the plant comes by a level. How, hangs on where the
lack is: a curve that the sensor adds stands in the errors as it is (a Wiener plant); one that is missing in
the law reaches them through the model's own tangents along the run (drag). Either curve is sought with a
slope that walks at random along the output, in errors of the colour that they have, as far as is likeliest
(Wahba 1978, Improper priors, spline smoothing and the problem of guarding against model errors in regression,
Journal of the Royal Statistical Society B 40). Errors that do not hang on the output leave no slope.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter
from flysid.model.noise import noise_model
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.local_models import all_terms, derivatives
from flysid.model.rules.regressor_layout import Layout
from flysid.model.rules.rule_uncertainty import Uncertainty

_UNSEEN = float(-np.log(np.finfo(float).eps))  # logarithm of a walk that rounding hides, or that hides all


def missing_slopes(sure: Uncertainty, output: int, knots: FloatArray, levels: FloatArray) -> FloatArray:
    """(2, L) mean squares of the slopes that the sensor's curve and the law's lack at levels, normalised.

    The first adds to the logarithm of a steady gain, the second to the weight of the output one sample ago.

    Parameters
    ----------
    knots : (K,) levels between which slopes are interpolated.
    """
    layout = sure.problem.layout
    par = sure.problem.parameters(sure.body)
    runs = sure.problem.simulate(sure.body, sure.starts)
    begun = layout.depth
    errors = [(W - run)[begun:, output] for W, run in zip(sure.problem.runs, runs, strict=True)]
    noise, _ = noise_model(errors)

    def whitened(signals: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([apply_filter(noise, np.ones(1), x) for x in signals])

    curves = [_curves(run[:, output], knots) for run in runs]
    through = [through_law(layout, par, run, output, own) for run, own in zip(runs, curves, strict=True)]
    left = whitened(errors)
    at = _hats(levels, knots)
    return np.array(
        [_mean_square_slopes(whitened([x[begun:] for x in felt]), left, at) for felt in (curves, through)]
    )


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """(N, K) weights of what is known at knots, interpolated, constant beyond."""
    return np.stack([np.interp(x, knots, own) for own in np.eye(len(knots))], axis=1)


def _curves(x: FloatArray, knots: FloatArray) -> FloatArray:
    """(N, 1 + K) a constant, and the curves whose slopes are the hats."""
    ends = np.array([min(x.min(), knots[0]), max(x.max(), knots[-1])])
    corners = np.unique(np.concatenate([ends, knots]))
    slopes = _hats(corners, knots)
    steps = 0.5 * (slopes[1:] + slopes[:-1]) * np.diff(corners)[:, None]
    heights = np.concatenate([np.zeros((1, len(knots))), np.cumsum(steps, axis=0)])
    before = np.clip(np.searchsorted(corners, x, side="right") - 1, 0, len(corners) - 2)
    within = (x - corners[before])[:, None]
    parabola = heights[before] + 0.5 * within * (slopes[before] + _hats(x, knots))
    return np.hstack([np.ones((len(x), 1)), parabola])


def through_law(
    layout: Layout, par: Parameters, run: FloatArray, output: int, curves: FloatArray
) -> FloatArray:
    """(N, K) an output's answer to curves (N, K) of its last sample that its equation adds, along a run."""
    first = layout.depth
    A = _tangents(layout, par, run)
    count = curves.shape[1]
    deep = A.shape[2]
    answer = np.zeros((len(run) + deep, layout.n, count))
    for k, own in enumerate(A.reshape(len(A), layout.n, -1), start=first):
        answer[k + deep] = own @ answer[k : k + deep][::-1].reshape(-1, count)
        answer[k + deep, output] += curves[k - 1]
    return np.asarray(answer[deep:, output])


def _tangents(layout: Layout, par: Parameters, run: FloatArray) -> FloatArray:
    """(N - depth, n, lags, n) derivatives of every row from `depth` on to the simulated ones before."""
    n = layout.n
    x = layout.regressor_values(run)
    _, slopes, _ = derivatives(layout.lags, par, x, layout.antecedent_values(run))
    every = all_terms(layout.lags)
    own = np.flatnonzero((every.column >= 0) & (every.column < n))
    A = np.zeros((len(x), n, max(1, every.lag[own].max(initial=0)), n))
    for term in own:
        A[:, :, every.lag[term] - 1, every.column[term]] += slopes[:, :, term]
    return A


def _mean_square_slopes(curves: FloatArray, errors: FloatArray, at: FloatArray) -> FloatArray:
    """(L,) squared mean and variance of a curve's slope, of white errors (N,).

    Parameters
    ----------
    curves : (N, 1 + K) a constant, and the curves of slopes that are one at one knot.
    at : (L, K) weights of the knots' slopes.
    """
    walk = np.tril(np.ones((at.shape[1],) * 2))
    own = curves[:, 1:] @ walk
    place = at @ walk
    Q, R = np.linalg.qr(np.hstack([curves[:, :1], own[:, :1]]))  # a constant and a common slope are free
    shadow = Q.T @ own[:, 1:]
    steps = own[:, 1:] - Q @ shadow
    left = errors - Q @ (Q.T @ errors)
    values, ways = np.linalg.eigh(steps.T @ steps)
    values = np.maximum(values, 0.0)
    along = ways.T @ (steps.T @ left)
    freedom = len(errors) - len(R)
    ratios = np.exp(np.arange(-_UNSEEN, _UNSEEN))[:, None] / max(values[-1], np.finfo(float).tiny)
    grown = 1.0 + values * ratios
    noise = np.maximum(left @ left - (along**2 * ratios / grown).sum(axis=1), 0.0) / freedom
    with np.errstate(divide="ignore"):
        likelihood = -0.5 * (np.log(grown).sum(axis=1) + freedom * np.log(noise))
    best = int(likelihood.argmax())
    spread = ratios[best] / grown[best]
    common = np.outer(place[:, 0], np.linalg.pinv(R)[1])
    bent = (place[:, 1:] - common @ shadow) @ ways
    mean = common @ (Q.T @ errors) + bent @ (spread * along)
    variance = ((common**2).sum(axis=1) + bent**2 @ spread) * noise[best]
    return np.asarray(mean**2 + variance)
