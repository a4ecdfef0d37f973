"""The state a linear model's free run starts from, estimated from its first measured outputs.

With fast sampling the lags of a model encode derivatives; taken as measured they turn 0.02 m/s of noise into
metres per second of transient. The state that training data lead one to expect is weighed against the
measured samples instead (linear least mean square estimate), which is exact when there is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference
from flysid.model.linear.data import EXACT, SEARCH_ROWS, Parts, shorten
from flysid.model.simulation_error import free_space, without
from flysid.model.start import most_start_rows, settled_start_rows


@dataclass(frozen=True, eq=False)
class Past:
    """One output's equation, the states it went through in training, and the noise on top.

    `single`: the equation of this output alone.
    `states`: (M, L) states along the free run that fits the training segments best.
    `sigma`: standard deviation of the measured minus that free run.
    """

    single: Difference
    states: FloatArray
    sigma: float


def pasts(system: Difference, parts: Parts) -> list[Past]:
    """One per output of a system whose outputs do not feed each other."""
    depth = system.depth
    small = parts.scaling.apply(shorten(parts.train, SEARCH_ROWS))
    found = []
    for i in range(len(system.c)):
        pick = slice(i, i + 1)
        single = Difference(system.a[:, pick, pick], system.b[:, pick], system.c[pick])
        states = [np.zeros((0, depth))]
        squares = 0.0
        rows = 0
        for segment in small.segments:
            if len(segment) <= 2 * depth + 1:
                continue
            run = single.run(segment.u, np.zeros((depth, 1)))[depth:, 0]
            miss = run - segment.y[depth:, i]
            left = without(free_space(single.a[:, 0, 0], len(miss)), miss)
            fitted = segment.y[depth:, i] + left
            states.append(single.state_history(segment.u[depth:], fitted[:, None])[depth:, :, 0])
            squares = squares + float(left @ left)
            rows = rows + len(left)
        found.append(Past(single, np.concatenate(states), float(np.sqrt(squares / rows)) if rows else 1.0))
    return found


def start_gains(system: Difference, parts: Parts, n_init: int | None) -> FloatArray:
    """(n_y, L, n) start gains; n is n_init, or grows until more samples help little."""
    depth = max(system.depth, 1)
    shortest = min(len(s) for s in parts.train.segments)
    past = pasts(system, parts)
    if n_init is None:
        most = most_start_rows(depth, parts.train.dt_s, shortest)
        rows = settled_start_rows(partial(_start_spread, past), depth, most)
    else:
        rows = max(n_init, 1)
    return np.stack([start_gain(p, rows) for p in past])


def _start_spread(past: Sequence[Past], rows: int) -> float:
    """How far the free run errs for want of the right start, in standard deviations of the noise."""
    worst = 0.0
    for p in past:
        some = p.states[:: max(len(p.states) // 500, 1)]
        gain = start_gain(p, rows)
        basis = responses(p.single, max(rows, min(max(10 * rows, 100), 2000)))
        missed = some - some @ (gain @ basis[:rows]).T
        bias = np.mean((missed @ basis.T) ** 2) if len(some) else 0.0
        scatter = np.mean((basis @ gain) ** 2) * rows * p.sigma**2
        worst = max(worst, float(np.sqrt(bias + scatter)) / max(p.sigma, EXACT))
    return worst


def responses(single: Difference, rows: int) -> FloatArray:
    """(rows, L) free responses to every state."""
    zero = np.zeros((rows, 1))
    columns = [single.respond(zero, e[:, None])[:, 0] for e in np.eye(single.depth)]
    return np.stack(columns, axis=1) if columns else np.zeros((rows, 0))


def start_gain(past: Past, rows: int) -> FloatArray:
    """(L, rows) linear estimate of the state from how far `rows` outputs are off the forced response.

    The least mean square estimate for a state drawn from the states seen in training.
    """
    root = np.linalg.qr(past.states, mode="r") / np.sqrt(max(len(past.states), 1))
    left, sigma, right = np.linalg.svd(responses(past.single, rows) @ root.T, full_matrices=False)
    damped = sigma / np.maximum(sigma**2 + past.sigma**2, np.finfo(float).tiny)
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
    past = pasts(system, parts)
    if max(p.sigma for p in past) < EXACT:
        return None
    return np.stack([start_gain(p, rows) for p in past])
