"""What a run most likely starts from, given its first outputs and what training says about starts.

A start is not measured: hidden states show in later outputs only, and at a fast rate the lags of a model
encode derivatives, so that measured ones carry more noise than speed. The most likely start is searched for,
a Bayesian estimate with Gaussian noise and prior, over lags and hidden states alike:

    weight * sum_k |y(k) - yhat(k; x)|^2 + (x - mean)' inverse(covariance) (x - mean)

The search runs in coordinates in which the prior is a unit ball, whatever lags or states are nearly dependent
(Gauss-Newton with step halving): it needs no floor under small variances, which would allow absurd speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.polynomials import VANISHING
from flysid.model.rules.free_run_error import run_sensitivities, started_run
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.regressor_layout import Layout
from flysid.model.start import full_window

STEPS = 12
"""Of a search, at most."""
HALVINGS = 4
"""Of a step that does not help, at most."""
_CLOSED = 60  # rows that suffice to start a run while fitting, and that put hidden states to rest
_TWICE = 2.0  # spreads of training: a run may start outside of what training went through
_PLACES = 8  # of the training data, along which starts are tried


@dataclass(frozen=True, eq=False)
class Prior:
    """What training says about starts (q,) before any output is seen; all normalised.

    Attributes
    ----------
    mean : (q,) the last rows before the first computed one, oldest first.
    root : (q, q) of their covariance, root @ root.T.
    weight : inverse variance of the simulation error.
    """

    mean: FloatArray
    root: FloatArray
    weight: float

    @classmethod
    def of(cls, starts: FloatArray, variance: float) -> Prior:
        """From starts (M, q) seen in training, and the mean square of the simulation error."""
        mean = starts.mean(axis=0)
        triangle = np.linalg.qr(starts - mean, mode="r") / np.sqrt(len(starts))
        square = np.zeros((len(mean), len(mean)))
        square[:, : len(triangle)] = _TWICE * triangle.T
        return cls(mean, square, 1.0 / max(variance, 1e-12))

    @classmethod
    def of_inverse(cls, mean: FloatArray, inverse: FloatArray, weight: float) -> Prior:
        """From the inverse of the covariance, as files had it."""
        return cls(mean, np.linalg.inv(np.linalg.cholesky(inverse)).T, weight)


def rows_before(layout: Layout, run: FloatArray) -> FloatArray:
    """(M, moving n) every stretch of a run W that another run could start from."""
    rows = np.lib.stride_tricks.sliding_window_view(run[:, : layout.n], layout.moving, axis=0)
    return np.asarray(rows.transpose(0, 2, 1).reshape(len(rows), -1))


def initial_states(
    layout: Layout, runs: Sequence[FloatArray], par: Parameters, prior: Prior, rows: int = _CLOSED
) -> FloatArray:
    """(S, moving, n) the most likely start of every run, from its first `rows` rows, its own among them."""
    end = layout.depth - layout.moving + max(rows, layout.moving)
    found = [_StartSearch(layout, np.array(W[:end]), par, prior).found() for W in runs]
    return np.array(found).reshape(len(found), layout.moving, layout.n)  # of no runs, too


@dataclass(frozen=True, eq=False)
class _StartSearch:
    """One run W whose start is searched for."""

    layout: Layout
    W: FloatArray
    par: Parameters
    prior: Prior

    def found(self) -> FloatArray:
        """(q,) where the search ends that begins at the likelier of two guesses: the mean, as measured."""
        tried = [(self.misses(z), z) for z in (np.zeros(len(self.prior.mean)), self.as_measured())]
        misses, z = min(tried, key=lambda t: _cost(*t))
        for _ in range(STEPS):
            A = np.vstack([self.slopes(z), np.eye(len(z))])
            if not np.isfinite(A).all():
                break
            step = np.linalg.lstsq(A, -np.concatenate([misses, z]), rcond=None)[0]
            cost = _cost(misses, z)
            if not np.square(A @ step).sum() > VANISHING * cost:
                break
            for _ in range(HALVINGS):
                trial = self.misses(z + step)
                if _cost(trial, z + step) < cost:
                    break
                step = 0.5 * step
            else:
                break
            misses = trial
            z = z + step
        return self.at(z)

    def at(self, z: FloatArray) -> FloatArray:
        """The start in the units of the data."""
        return np.asarray(self.prior.mean + self.prior.root @ z)

    def as_measured(self) -> FloatArray:
        """z of the start that suits the outputs measured in its own rows best."""
        layout = self.layout
        mean = self.prior.mean
        seen = np.flatnonzero(np.tile(np.arange(layout.n) < layout.n_y, layout.moving))
        gap = self.W[layout.uncompared : layout.depth, : layout.n].ravel() - mean
        root = np.sqrt(self.prior.weight)
        A = np.vstack([root * self.prior.root[seen], np.eye(len(mean))])
        right = np.concatenate([root * gap[seen], np.zeros(len(mean))])
        return np.asarray(np.linalg.lstsq(A, right, rcond=None)[0])

    def misses(self, z: FloatArray) -> FloatArray:
        """Simulated less measured outputs, in standard deviations of the simulation error."""
        layout = self.layout
        start = self.at(z).reshape(layout.moving, layout.n)
        gap = (started_run(layout, self.W, start, self.par) - self.W)[layout.uncompared :, : layout.n_y]
        return np.asarray(np.sqrt(self.prior.weight) * gap.ravel())

    def slopes(self, z: FloatArray) -> FloatArray:
        """(., q) derivatives of `misses`."""
        _, J = run_sensitivities(self.layout, self.par, self.W, self.at(z))
        return np.asarray(np.sqrt(self.prior.weight) * J.reshape(-1, len(z)) @ self.prior.root)


def _cost(misses: FloatArray, z: FloatArray) -> float:
    """What a search lowers; infinite where the run is none."""
    cost = float(misses @ misses + z @ z)
    return cost if np.isfinite(cost) else np.inf


def start_spread(
    layout: Layout, runs: Sequence[FloatArray], par: Parameters, prior: Prior, horizon: int
) -> Callable[[int], float]:
    """How far free runs err for want of the right start, by the number of samples that it is told from.

    In standard deviations of the noise, to first order, along simulated `runs`; those of the start itself are
    among the samples.
    """
    responses = list(_responses(layout, runs, par, prior, horizon))

    def spread(rows: int) -> float:
        squares = []
        for J in responses:
            q = J.shape[2]
            seen = J[:rows].reshape(-1, q)
            sure = np.asarray(np.linalg.qr(np.vstack([seen, np.eye(q)]), mode="r"))
            left = np.linalg.solve(sure.T, J.reshape(-1, q).T)
            squares.append((left * left).sum() / (len(J) * J.shape[1]))
        return float(np.sqrt(np.mean(squares))) if squares else 0.0

    return spread


def _responses(
    layout: Layout, runs: Sequence[FloatArray], par: Parameters, prior: Prior, horizon: int
) -> Iterator[FloatArray]:
    """(rows, n_y, q) derivatives of free runs to their starts, in deviations of the error and the prior."""
    d = layout.depth
    long = [run for run in runs if len(run) > d + 1]
    for run in long[:: max(len(long) // _PLACES, 1)][:_PLACES]:
        count = max(1, _PLACES // len(long))
        for begin in np.linspace(0, max(len(run) - d - horizon, 0), count).astype(int):
            W = run[begin : begin + d + horizon].copy()
            start = W[layout.uncompared : d, : layout.n].ravel()
            _, J = run_sensitivities(layout, par, W, start)
            yield np.sqrt(prior.weight) * J @ prior.root


@dataclass(frozen=True, eq=False)
class LikelyStart:
    """The most likely start, whose lags or hidden states training has an expectation of.

    Attributes
    ----------
    prior : what training says about starts.
    samples : measured samples that start a simulation.
    """

    prior: Prior
    samples: int

    def settled(self, dt_s: float) -> int:  # noqa: ARG002
        """Samples after which predictions may lean on a free run."""
        return self.samples

    def rest(self, layout: Layout) -> int:
        """Rows of zeros before a run from rest; as many as put hidden states to rest."""
        return _CLOSED + self.samples if layout.hidden else layout.depth

    def write(self, layout: Layout, par: Parameters, W: FloatArray, known: int) -> None:
        """Put the start into W (N, n + n_u), of which the outputs of `known` rows are measured.

        At rest (`known` 0) hidden states are searched for, and lags are known: zeros.
        """
        d = layout.depth
        if len(W) < d or not (known or layout.hidden):
            return
        rows = max(min(known or self.rest(layout), len(W)) - layout.uncompared, 1)
        W[layout.uncompared : d, : layout.n] = initial_states(layout, [W], par, self.prior, rows)[0]

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        prior = self.prior
        return {
            "prior": {"mean": prior.mean.tolist(), "root": prior.root.tolist(), "weight": prior.weight},
            "n_init": self.samples,
        }


@dataclass(frozen=True, eq=False)
class MeasuredStart:
    """The first outputs as measured, and what is known of their error: rules over lags, as 0.1.0 wrote them.

    Attributes
    ----------
    gain : (samples n_y, samples (n_y + n_u) + 1) correction of the first rows, normalised.
    samples : measured ones that start a simulation, as many as the rules look back.
    """

    gain: FloatArray
    samples: int

    def settled(self, dt_s: float) -> int:
        """Samples after which predictions may lean on a free run."""
        return full_window(self.samples, dt_s)

    def rest(self, layout: Layout) -> int:  # noqa: ARG002
        """Rows of zeros before a run from rest."""
        return self.samples

    def write(self, layout: Layout, par: Parameters, W: FloatArray, known: int) -> None:  # noqa: ARG002
        """Put the start into W (N, n + n_u), of which the outputs of `known` rows are measured: corrected.

        At rest (`known` 0) and in a record that ends with them they stand.
        """
        d = self.samples
        if d <= known and d < len(W):
            n_y = layout.n_y
            window = np.append(W[:d].ravel(), 1.0)
            W[:d, :n_y] += (self.gain @ window).reshape(d, n_y)

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {"initial_gain": self.gain.tolist()}


RunStart = MeasuredStart | LikelyStart
