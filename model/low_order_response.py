"""An impulse response that is that of a system of low order, as far as the data say so.

The prior of `fir` knows that taps are smooth and decay, no more, and pays for it where a curve turns: a peak
comes out lower or higher than it is. Most loops answer as systems of few poles do. Beside the TC prior alone,
priors about such systems are tried: taps of a fitted b / a of order 1 to 3 and what changing its coefficients
makes of them, with the information of one sample (Kass & Wasserman, 1995, JASA 90), plus a remainder with a
TC prior, which may vanish. One sample says nothing where the input never moves fast: there the change is
taken to be no larger than the response. All of them are averaged by their marginal likelihood, so that
neither order nor decay is taken for known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, hankel, solve_triangular

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.filters import ONE, apply_filter
from flysid.model.fir import (
    LEAST_REST,
    Posterior,
    explained_by_priors,
    kernel_root,
    refuse_extreme,
    under_prior,
)
from flysid.model.refine import levenberg_marquardt

MOST_ORDER = 3
NEGLIGIBLE = 1e-3
"""Of the likelihood of the best prior: what weighs less changes no digit that is printed."""


@dataclass(frozen=True, eq=False)
class _Data:
    """What the samples say of all taps.

    inner (n, n), cross (n,), power : products of the taps' regressors, with the output, of the output.
    `rows`: how many samples. `shape`: taps, inputs.
    """

    inner: FloatArray
    cross: FloatArray
    power: float
    rows: float
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class _Prior:
    """Directions (n, p) that a system of low order may take, each of prior variance 1 in noise variances, and
    a remainder with a TC kernel."""

    directions: FloatArray
    decay: float
    weight: float


def averaged_posterior(gram: FloatArray, rows: float, shape: tuple[int, int]) -> Posterior:
    """Of all priors, by their marginal likelihood; `gram` is about the means, the output behind the taps.

    Raises FitError: values too extreme for any of them.
    """
    n = shape[0] * shape[1]
    data = _Data(gram[:n, :n], gram[:n, n], float(gram[n, n]), rows, shape)
    tried = list(_likelihoods(data, np.zeros((n, 0))))
    _, smooth = max(tried, key=lambda pair: pair[0])
    taps = _posterior(data, smooth).mean
    for order in range(1, MOST_ORDER + 1):
        found = _low_order(data, taps, order)
        if found is not None:
            tried += _likelihoods(data, _in_prior_units(data, found, taps))
    best = max(likelihood for likelihood, _ in tried)
    refuse_extreme(best)
    shares = [(np.exp(0.5 * (likelihood - best)), prior) for likelihood, prior in tried]
    kept = [(share, prior) for share, prior in shares if share > NEGLIGIBLE]
    total = sum(share for share, _ in kept)
    posteriors = [(share / total, _posterior(data, prior)) for share, prior in kept]
    mean = np.asarray(sum(share * p.mean for share, p in posteriors))
    covariance = sum(
        share * (p.covariance + np.outer(p.mean - mean, p.mean - mean)) for share, p in posteriors
    )
    return Posterior(mean, np.asarray(covariance), "")


def _likelihoods(data: _Data, directions: FloatArray) -> Iterator[tuple[float, _Prior]]:
    """(twice the logarithm of the marginal likelihood, prior) for every decay and weight of the remainder."""
    inner, cross, power, price = _without(data, directions)
    if directions.shape[1]:
        yield _score(data, power) - price, _Prior(directions, 0.0, 0.0)
    for decay, weight, explained, size in explained_by_priors(inner, cross, data.shape):
        yield _score(data, power - explained) - size - price, _Prior(directions, decay, weight)


def _score(data: _Data, rest: float) -> float:
    return -data.rows * float(np.log(_noise_variance(data, rest)))


def _noise_variance(data: _Data, rest: float) -> float:
    return max(rest, LEAST_REST * data.power) / data.rows


def _in_prior_units(data: _Data, basis: FloatArray, taps: FloatArray) -> FloatArray:
    """(n, p) orthonormal directions, scaled to a prior variance of 1 in noise variances.

    The prior knows what one sample tells of them, and that no change is larger than the taps.
    """
    rest = data.power - 2.0 * float(data.cross @ taps) + float(taps @ data.inner @ taps)
    least = _noise_variance(data, rest) / max(float(taps @ taps), LEAST_REST)
    information = basis.T @ data.inner @ basis / data.rows + least * np.eye(basis.shape[1])
    return np.asarray(solve_triangular(np.linalg.cholesky(information), basis.T, lower=True).T)


def _without(data: _Data, directions: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Gram, cross and power of what the directions leave under their prior, and the price of that prior."""
    if not directions.shape[1]:
        return data.inner, data.cross, data.power, 0.0
    seen = data.inner @ directions
    triangle = np.linalg.cholesky(np.eye(directions.shape[1]) + directions.T @ seen)
    known = solve_triangular(triangle, np.column_stack([seen.T, directions.T @ data.cross]), lower=True)
    taken, answer = known[:, :-1], known[:, -1]
    price = 2.0 * float(np.log(np.diag(triangle)).sum())
    rest = data.power - float(answer @ answer)
    return data.inner - taken.T @ taken, data.cross - taken.T @ answer, rest, price


def _posterior(data: _Data, prior: _Prior) -> Posterior:
    roots = []
    if prior.directions.shape[1]:
        roots.append(prior.directions)
    if prior.weight > 0.0:
        roots.append(kernel_root(*data.shape, prior.decay) * np.sqrt(prior.weight))
    mean, covariance = under_prior(np.hstack(roots), data.inner, data.cross)
    return Posterior(mean, covariance * _noise_variance(data, data.power - float(data.cross @ mean)), "")


def _low_order(data: _Data, taps: FloatArray, order: int) -> FloatArray | None:
    """(n, p) what the coefficients of the best b / a of an order move, of the best of some dead times."""
    size, count = data.shape
    values, vectors = eigh(data.inner)
    wide = np.sqrt(np.maximum(values, 0.0))
    root = (vectors * wide).T
    goal = vectors.T @ data.cross / np.maximum(wide, 1e-9 * wide[-1])
    best: tuple[float, FloatArray] | None = None
    starts = [taps[j * size : (j + 1) * size] for j in range(count)]
    lags = _dead(data, taps)
    for late in sorted({0, lags // 2, lags}):
        if (size - late) // 2 <= order:  # no more taps than a system of that order has coefficients
            continue
        start = np.concatenate([_realise(own[late:], order) for own in starts])

        def evaluate(theta: FloatArray, late: int = late) -> tuple[FloatArray, FloatArray]:
            answer, slopes = _answers(theta, order, late, data.shape)
            with np.errstate(all="ignore"):
                return root @ answer - goal, root @ slopes

        try:
            found = levenberg_marquardt(evaluate, start, max_iterations=30)
        except FitError:
            continue
        if best is None or found.cost < best[0]:
            best = (found.cost, _answers(found.theta, order, late, data.shape)[1])
    if best is None or not np.isfinite(best[1]).all():
        return None
    basis, sigma, _ = np.linalg.svd(best[1] / np.linalg.norm(best[1], axis=0), full_matrices=False)
    return np.asarray(basis[:, sigma > 1e-8 * sigma[0]])


def _dead(data: _Data, taps: FloatArray) -> int:
    """Samples before the first input's taps reach a tenth of their largest."""
    own = np.abs(taps[: data.shape[0]])
    return int(np.argmax(own >= 0.1 * own.max()))


def _realise(taps: FloatArray, order: int) -> FloatArray:
    """b (order + 1) and a (order) of taps, by the singular vectors of their Hankel matrix (Kung, 1978)."""
    half = len(taps) // 2
    left, sigma, _ = np.linalg.svd(hankel(taps[1 : half + 1], taps[half : 2 * half]), full_matrices=False)
    reach = left[:, :order] * np.sqrt(sigma[:order])
    poles = np.linalg.eigvals(np.linalg.lstsq(reach[:-1], reach[1:], rcond=None)[0])
    poles = poles * np.minimum(1.0, 0.99 / np.maximum(np.abs(poles), 1e-12))
    a = np.real(np.poly(poles))
    b = np.convolve(a, taps[: order + 1])[: order + 1]
    return np.concatenate([b, a[1:]])


def _answers(
    theta: FloatArray, order: int, late: int, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """(n,) impulse responses of z^-late b / a of every input, and (n, p) their derivatives."""
    size, count = shape
    each = theta.reshape(count, -1)
    answer = np.zeros(size * count)
    slopes = np.zeros((size * count, len(theta)))
    pulse = np.zeros(size)
    pulse[late] = 1.0
    with np.errstate(all="ignore"):
        for j, own in enumerate(each):
            b = own[: order + 1]
            a = np.append(1.0, own[order + 1 :])
            rows = slice(j * size, (j + 1) * size)
            free = apply_filter(ONE, a, pulse)
            answer[rows] = apply_filter(b, ONE, free)
            again = apply_filter(-ONE, a, answer[rows])
            moved = [(free, k) for k in range(order + 1)] + [(again, k) for k in range(1, order + 1)]
            for column, (curve, k) in enumerate(moved):
                slopes[j * size + k : (j + 1) * size, j * len(own) + column] = curve[: size - k]
    return answer, slopes
