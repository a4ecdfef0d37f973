"""Whether what a free run leaves still depends on what it simulates: rules, lags or a state that are missing.

Noise and wind know nothing of where the model is. Errors of the free run over the training data are regressed
on polynomials of the simulated output and the inputs, and on these times the output's rate; by how much the
regression exceeds what errors of their own colour would show by chance is the factor by which physicists
widen the errors of measurements that disagree (Birge, 1932, Physical Review 40).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.noise import coloured_gram, noise_model
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.rule_uncertainty import MOST_ROWS, steep
from flysid.model.start import start_window

_DEGREE = 3


def scale_factor(model: RuleModel, train: Dataset) -> float:
    """By which standard errors from noise alone are too small, at least 1.

    The root of a chi square over its degrees of freedom: the Wald statistic of all terms of the regression,
    with the covariance of the errors' own autoregression.
    """
    runs = list(_follow(model, train))
    if not runs:
        return 1.0
    square = 0.0
    freedom = 0
    for output in range(len(train.outputs)):
        features = [_features(u, run[:, output]) for u, run, _ in runs]
        errors = [left[:, output] for _, _, left in runs]
        root = steep(np.asarray(sum(x.T @ x for x in features)))
        seen = np.asarray(sum((x @ root).T @ e for x, e in zip(features, errors, strict=True)))
        noise, variance = noise_model(errors)
        chance = variance * coloured_gram([x @ root for x in features], noise)
        square += float(seen @ np.linalg.pinv(chance) @ seen)
        freedom += len(seen)
    return float(np.sqrt(max(1.0, square / freedom)))


def _follow(model: RuleModel, data: Dataset) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Inputs, free run and what it leaves of every segment, behind the samples that start it, normalised."""
    n_y = len(data.outputs)
    signals = np.vstack([np.hstack([s.y, s.u]) for s in data.segments])
    mean = signals.mean(axis=0)
    spread = signals.std(axis=0)
    scale = np.where(spread > 0.0, spread, 1.0)
    rows = 0
    for s in data.segments:
        window = start_window(model.n_init, len(s), model.dt_s)
        if len(s) <= 2 * window or rows > MOST_ROWS:
            continue
        run = model.run_from_measured(s.u, s.y[:window])[window:]
        rows += len(run)
        yield (
            (s.u[window:] - mean[n_y:]) / scale[n_y:],
            (run - mean[:n_y]) / scale[:n_y],
            (s.y[window:] - run) / scale[:n_y],
        )


def _features(u: FloatArray, run: FloatArray) -> FloatArray:
    """(N, p) powers of a simulated output, with every input's, and up to one less times its rate."""
    rate = np.gradient(run)
    columns = []
    for degree, times in ((_DEGREE, np.ones_like(run)), (_DEGREE - 1, rate)):
        own = [times * run**a for a in range(degree + 1)]
        mixed = [
            times * run**a * given**b
            for given in u.T
            for b in range(1, degree + 1)
            for a in range(degree + 1 - b)
        ]
        columns += [*own, *mixed]
    return np.stack(columns, axis=1)
