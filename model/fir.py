"""FIR: the impulse response itself, regularised so that it is smooth and decays.

    y(k) = sum_j sum_l g_j(l) u_j(k - l) + c + v(k)

with a Gaussian prior of covariance c λ^max(i, j) on the taps (the TC kernel; Chen, Ohlsson, Ljung, 2012,
Automatica 48). Its scale, its decay and the noise variance are those of highest marginal likelihood, so no
order has to be chosen, and many taps on few data do no harm. The model is unbiased by coloured noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError
from flysid.model.arguments import check_inputs
from flysid.model.freerun import Difference
from flysid.model.linear.data import Parts, Scaling, as_tuple
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.orders import grid_gram
from flysid.model.noise import noise_model
from flysid.model.regressors import LagTerms
from flysid.model.settings import Settings
from flysid.model.stream import Source
from flysid.model.threads import on_one_thread

MOST_TAPS = 120
DECAYS = (0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.92, 0.95, 0.97, 0.985, 0.995)
SCALES = tuple(10.0 ** np.arange(-4.0, 12.1, 0.5))
LEAST_REST = 1e-12
"""Of the output's power: less cannot be left over but by rounding."""

MOST_ROUNDING = 0.1
"""What rounding of the data may seem to tell of a tap, in units of what its prior tells."""


@dataclass(frozen=True)
class FIR(Settings):
    """Settings of a finite impulse response.

    Parameters
    ----------
    taps : coefficients per input, or "auto": a quarter of the shortest segment, at most 120.
    nk : delay in samples, one number or one per input.
    offset : estimate a constant.

    Source: Ljung (1999), System Identification, 4.2.

    Examples
    --------
    >>> model = flysid.FIR(taps=40).fit(train)  # train: see `flysid.Dataset`
    >>> model.dc_gain.round(1)
    array([[2.]])
    """

    taps: int | Literal["auto"] = "auto"
    nk: int | Sequence[int] = 0
    offset: bool = True

    def check_values(self) -> None:
        """Raise UsageError for no taps."""
        self.at_least(1, "taps")

    @on_one_thread
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedLinear:  # noqa: ARG002
        """Posterior mean and covariance of the taps. Nothing is chosen on validation data.

        From disk (`flysid.datasetfile.open_dataset`) in bounded memory; the noise that predictions model is
        that of the first samples.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too short segments, a signal that never changes.
        """
        n_y = len(train.outputs)
        n_u = len(train.inputs)
        check_inputs(n_u)
        parts = Parts.measured(train, centred=self.offset)
        taps = self._taps(parts.train, cut=len(parts.train) < len(train))
        lags = LagTerms.arx((0,) * n_y, (taps,) * n_u, as_tuple(self.nk, n_u))
        gram = grid_gram(train, lags, parts.scaling)
        rows = float(gram[-1, -1])
        means = gram[-1] / gram[-1, -1]
        if self.offset:
            gram = centred_gram(gram)
        posteriors = [posterior_of(gram, rows, i, (taps, n_u)) for i in range(n_y)]
        return self._model(parts, lags, posteriors, means)

    def _taps(self, train: Dataset, *, cut: bool) -> int:
        lengths = [len(s) for s in train.segments]
        if cut:  # the last one goes on beyond what was read
            lengths = lengths[:-1] or lengths
        shortest = min(lengths, default=0)
        return max(min(MOST_TAPS, shortest // 4), 1) if self.taps == "auto" else self.taps

    def _model(
        self, parts: Parts, lags: LagTerms, posteriors: Sequence[Posterior], means: FloatArray
    ) -> FittedLinear:
        n_y = len(lags.y)
        n_u = len(lags.u)
        scaling = parts.scaling
        b = np.zeros((lags.depth + 1, n_y, n_u))
        free: list[int] = []
        for i, posterior in enumerate(posteriors):
            position = 0
            for j, own in enumerate(lags.u):
                b[list(own), i, j] = posterior.mean[position : position + len(own)]
                position += len(own)
                free += [lag * n_y * n_u + i * n_u + j for lag in own]
        c = np.zeros(n_y)
        if self.offset:  # the mean simulation error becomes zero
            taps = np.stack([p.mean for p in posteriors])
            c = means[taps.shape[1] : -1] - taps @ means[: taps.shape[1]]
        system = Difference(np.eye(n_y)[None], b, c)
        note = "; ".join(f"{o.name}: {p.words}" for o, p in zip(parts.train.outputs, posteriors, strict=True))
        return FittedLinear(
            structure="fir",
            dt_s=parts.train.dt_s,
            inputs=parts.train.inputs,
            outputs=parts.train.outputs,
            n_init=max(lags.depth, 1),
            output_limits=parts.limits,
            system=scaling.physical(system),
            u_origin=scaling.u_origin,
            y_origin=scaling.y_origin,
            noise=_noise(system, parts),
            starts=None,
            free=tuple(free),
            covariance=_covariance(posteriors, scaling, lags),
            notes=(
                f"{len(lags.u[0])} taps per input, smoothed by a TC kernel of highest likelihood ({note}).",
            ),
        )


@dataclass(frozen=True, eq=False)
class Posterior:
    mean: FloatArray
    covariance: FloatArray
    words: str


def centred_gram(gram: FloatArray) -> FloatArray:
    """The Gram about the means of its columns: the constant is eliminated exactly."""
    means = gram[-1] / gram[-1, -1]
    return gram - np.outer(means, gram[-1])


def posterior_of(gram: FloatArray, rows: float, output: int, shape: tuple[int, int]) -> Posterior:
    """Over a grid of decays and scales, the posterior of highest marginal likelihood."""
    taps, n_u = shape
    n = taps * n_u
    inner = gram[:n, :n]
    cross = gram[:n, n + output]
    power = float(gram[n + output, n + output])
    best = (-np.inf, 0.0, 0.0, 0.0)
    for decay, weight, explained, size in explained_by_priors(inner, cross, shape):
        rest = max(power - explained, LEAST_REST * power)
        likelihood = -rows * np.log(rest / rows) - size
        if likelihood > best[0]:
            best = (likelihood, decay, weight, rest / rows)
    likelihood, decay, weight, variance = best
    refuse_extreme(likelihood)
    mean, covariance = under_prior(kernel_root(taps, n_u, decay) * np.sqrt(weight), inner, cross)
    words = f"decay {decay:g} per sample, noise {np.sqrt(variance):.3g} standard deviations of the output"
    return Posterior(mean, covariance * variance, words)


def refuse_extreme(likelihood: float) -> None:
    """Raises FitError where the best of all priors has no likelihood."""
    if not np.isfinite(likelihood):
        raise FitError(
            "the impulse response could not be estimated", hint="check the data for extreme values"
        )


def explained_by_priors(
    inner: FloatArray, cross: FloatArray, shape: tuple[int, int]
) -> Iterator[tuple[float, float, float, float]]:
    """(decay, weight, explained, size) of every TC prior of the taps under which rounding is not data.

    `weight` is the prior variance of the first tap in noise variances, `explained` the part of the output's
    power that the taps take, `size` the logarithm of the determinant that the marginal likelihood pays.
    """
    for decay in DECAYS:
        root = kernel_root(*shape, decay)
        values, vectors = np.linalg.eigh(root.T @ inner @ root)
        values = np.maximum(values, 0.0)
        rotated = (vectors.T @ (root.T @ cross)) ** 2
        rounding = len(values) * np.finfo(float).eps * values[-1]
        for weight in SCALES:
            if weight * rounding > MOST_ROUNDING:
                break
            explained = float((weight / (1.0 + weight * values)) @ rotated)
            yield decay, weight, explained, float(np.sum(np.log1p(weight * values)))


def under_prior(root: FloatArray, inner: FloatArray, cross: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of the taps under a prior covariance root rootᵀ, and their covariance in noise variances."""
    inverse = np.linalg.inv(np.eye(root.shape[1]) + root.T @ inner @ root)
    covariance = root @ inverse @ root.T
    return covariance @ cross, covariance


def kernel_root(taps: int, n_u: int, decay: float) -> FloatArray:
    """L with L Lᵀ = λ^max(i, j) per input: a sum of independent steps λ^i - λ^(i+1)."""
    powers = decay ** np.arange(taps)
    steps = np.sqrt(np.append(powers[:-1] - powers[1:], powers[-1]))
    one = np.triu(np.ones((taps, taps))) * steps
    root: FloatArray = np.kron(np.eye(n_u), one)
    return root


def _noise(system: Difference, parts: Parts) -> FloatArray:
    """(p + 1, n_y) autoregressions of what the taps leave over."""
    depth = system.depth
    usable = [s for s in parts.whole.segments if len(s) > depth]
    found = [
        noise_model([(s.y - system.drive(s.u))[depth:, i] for s in usable])[0] for i in range(len(system.c))
    ]
    noise = np.zeros((max(len(d) for d in found), len(found)))
    for i, d in enumerate(found):
        noise[: len(d), i] = d
    return noise


def _covariance(posteriors: Sequence[Posterior], scaling: Scaling, lags: LagTerms) -> FloatArray:
    size = lags.count
    joint = np.zeros((size * len(posteriors),) * 2)
    for i, posterior in enumerate(posteriors):
        factor = np.repeat(scaling.y_scale[i] / scaling.u_scale, [len(own) for own in lags.u])
        block = slice(i * size, (i + 1) * size)
        joint[block, block] = posterior.covariance * np.outer(factor, factor)
    return joint
