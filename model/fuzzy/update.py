"""New flights into an old TS model: recursive least squares on the consequents, memberships untouched.

With the memberships fixed a TS model is linear in its consequents, so that exponentially forgotten least
squares (Ljung 1999, section 11.2) applies as it stands. It minimises the one-step error: use it to follow
slow changes (battery, payload), and refit when the free run gets worse; `update` says what it did to both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.fuzzy.consequents import refuse_other_data, weighted
from flysid.model.fuzzy.kernel import Parameters, firing
from flysid.model.fuzzy.layout import Layout
from flysid.model.fuzzy.model import FittedTS


def update(
    model: FittedTS, data: Dataset, *, forgetting: float = 1.0, trust_samples: float = 1000.0
) -> FittedTS:
    """The model after seeing `data`, sample by sample.

    Parameters
    ----------
    forgetting : weight that a sample loses with every newer one; 1 forgets nothing, 0.999 remembers about a
        thousand samples.
    trust_samples : how many samples the present consequents count for.

    Raises
    ------
    UsageError : other signals or sample time than the model's; forgetting outside (0, 1].
    DataError : no segment is long enough.
    """
    _check(model, data, forgetting, trust_samples)
    layout, par = model.layout, model.parameters
    rules, n_y, n_x = par.theta.shape
    theta = par.theta.transpose(0, 2, 1).reshape(rules * n_x, n_y).copy()
    parts = [_design(layout, par, s.u, s.y) for s in data.segments if len(s) > model.n_init]
    if not parts:
        raise DataError(f"no segment is longer than {model.n_init} samples", hint="record longer")
    power = np.mean([np.einsum("nm,nm->m", X, X) / len(X) for X, _ in parts], axis=0)
    P = np.diag(1.0 / (trust_samples * np.maximum(power, 1e-3 * power.max())))
    before = _one_step_error(parts, theta)
    for X, Y in parts:
        theta, P = _follow(theta, P, X, Y, forgetting)
    consequents = np.ascontiguousarray(theta.reshape(rules, n_x, n_y).transpose(0, 2, 1))
    count = sum(len(Y) for _, Y in parts)
    note = (
        f"Consequents were updated by recursive least squares over {count} new samples (forgetting "
        f"{forgetting:g}): one-step error on them {before:.3g} -> {_one_step_error(parts, theta):.3g} of the "
        "output's spread. Memberships are as before."
    )
    parameters = par._replace(theta=consequents)
    return replace(model, parameters=parameters, notes=(*model.notes, note), noise=None)


def _check(model: FittedTS, data: Dataset, forgetting: float, trust_samples: float) -> None:
    if not 0.0 < forgetting <= 1.0 or not trust_samples > 0.0:
        raise UsageError(
            f"forgetting={forgetting!r}, trust_samples={trust_samples!r}", hint="0 < forgetting <= 1"
        )
    refuse_other_data(model, data)


def _design(layout: Layout, par: Parameters, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Regressors weighted by firing strengths (M, R n_x) and outputs (M, n_y), normalised units."""
    W, d = layout.stack(u, y), layout.depth
    phi = firing(W, d, layout.lags, par)[d:]
    return weighted(phi, layout.regressor_values(W)), W[d:, : layout.n_y]


def _follow(
    theta: FloatArray, P: FloatArray, X: FloatArray, Y: FloatArray, forgetting: float
) -> tuple[FloatArray, FloatArray]:
    """Recursive least squares over the rows of X and Y."""
    for x, y in zip(X, Y, strict=True):
        Px = P @ x
        gain = Px / (forgetting + float(x @ Px))
        theta = theta + np.outer(gain, y - x @ theta)
        P = (P - np.outer(gain, Px)) / forgetting
        P = 0.5 * (P + P.T)
    return theta, P


def _one_step_error(parts: list[tuple[FloatArray, FloatArray]], theta: FloatArray) -> float:
    gaps = np.vstack([Y - X @ theta for X, Y in parts])
    return float(np.sqrt((gaps * gaps).mean()))
