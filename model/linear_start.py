"""The state a linear model's free run starts from, estimated from its first measured outputs.

With fast sampling the lags of a model encode derivatives; taken as measured they turn 0.02 m/s of noise into
metres per second of transient. The state that training data lead one to expect is weighed against the
measured samples instead (linear least mean square estimate), which is exact when there is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference
from flysid.model.linear_data import EXACT, SEARCH_ROWS, Parts, shortened
from flysid.model.simulation_error import free_space, without

START_SHARE = 0.05


def start_gains(system: Difference, parts: Parts, sigmas: Sequence[float], n_init: int | None) -> FloatArray:
    """(n_y, L, n) start gains in physical units; n grows until more samples help little."""
    depth = max(system.depth, 1)
    shortest = min(len(s) for s in parts.train.segments)
    most = max(depth, min(round(1.0 / parts.train.dt_s), int(START_SHARE * shortest)))
    small = shortened(parts.whole, SEARCH_ROWS)
    zero = np.zeros((system.depth, len(sigmas)))
    states = np.concatenate([system.state_history(s.u, system.run(s.u, zero)) for s in small.segments])
    singles = [_single(system, i) for i in range(len(sigmas))]

    def gains(rows: int) -> FloatArray:
        return np.stack([start_gain(s, states[:, :, i], sigmas[i], rows) for i, s in enumerate(singles)])

    if n_init is not None:
        return gains(max(n_init, 1))
    rows = depth
    spread = _start_spread(singles, states, sigmas, rows)
    while rows < most:
        wider = min(2 * rows, most)
        better = _start_spread(singles, states, sigmas, wider)
        if spread < 0.3 or better > 0.8 * spread:
            break
        rows, spread = wider, better
    return gains(rows)


def _single(system: Difference, i: int) -> Difference:
    pick = slice(i, i + 1)
    return Difference(system.a[:, pick, pick], system.b[:, pick], system.c[pick])


def _start_spread(
    singles: Sequence[Difference], states: FloatArray, sigmas: Sequence[float], rows: int
) -> float:
    """How far the free run errs for want of the right start, in standard deviations of the noise."""
    worst = 0.0
    for i, single in enumerate(singles):
        prior = states[:: max(len(states) // 500, 1), :, i]
        gain = start_gain(single, states[:, :, i], sigmas[i], rows)
        horizon = min(max(10 * rows, 100), 2000)
        basis = np.stack(
            [single.respond(np.zeros((horizon, 1)), e[:, None])[:, 0] for e in np.eye(single.depth)], axis=1
        )
        missed = prior - prior @ (gain @ basis[:rows]).T
        bias = np.mean((missed @ basis.T) ** 2)
        scatter = np.mean((basis @ gain) ** 2) * rows * sigmas[i] ** 2
        worst = max(worst, float(np.sqrt(bias + scatter)) / max(sigmas[i], EXACT))
    return worst


def start_gain(system: Difference, prior: FloatArray, noise: float, rows: int) -> FloatArray:
    """(L, rows) linear estimate of the state from `rows` deviations of outputs from the forced response.

    For one output. The least mean square estimate for a state drawn from the states seen in training:
    with fast sampling, lags taken as measured would put the noise into the derivatives.

    Parameters
    ----------
    prior : (M, L) states along training data.
    noise : standard deviation of the simulation error.
    """
    root = np.linalg.qr(prior, mode="r") / np.sqrt(max(len(prior), 1))
    response = np.stack(
        [system.respond(np.zeros((rows, 1)), e[:, None])[:, 0] for e in np.eye(system.depth)], axis=1
    )
    left, sigma, right = np.linalg.svd(response @ root.T, full_matrices=False)
    damped = sigma / np.maximum(sigma**2 + noise**2, np.finfo(float).tiny)
    gain: FloatArray = root.T @ (right.T * damped) @ left.T
    return gain


def equation_starts(system: Difference, parts: Parts, rows: int) -> FloatArray | None:
    """Start gains of an equation-error model from `rows` samples; None where lags as measured must do.

    That is: outputs that feed each other, a model that is not stable, or no noise.
    """
    if not system.is_diagonal or system.depth == 0:
        return None
    n_y = len(system.c)
    radius = max(float(np.abs(np.roots(system.a[:, i, i])).max(initial=0.0)) for i in range(n_y))
    if radius >= 1.0:
        return None
    zero = np.zeros((system.depth, n_y))
    small = shortened(parts.whole, SEARCH_ROWS)
    sigmas = []
    for i in range(n_y):
        misses = [(system.run(s.u, zero) - s.y)[system.depth :, i] for s in small.segments]
        left = [
            without(free_space(system.a[:, i, i], len(m)), m) for m in misses if len(m) > 2 * system.depth
        ]
        sigmas.append(float(np.sqrt(np.mean(np.concatenate(left) ** 2))) if left else 1.0)
    if max(sigmas) < EXACT:
        return None
    return start_gains(system, parts, sigmas, rows)
