"""Models of rules as programs: over lags, over hidden states, static."""

from __future__ import annotations

import numpy as np

from flysid.dataset import Signal
from flysid.export.program import AffinePast, LikelyPast, Memberships, Past, Program
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.kernel import Lags
from flysid.model.rules.likely_start import LikelyStart, MeasuredStart
from flysid.model.static_ts import FittedStaticTS
from flysid.showing import counted


def program_of_rules(model: FittedTS) -> Program:
    """Rules over lagged inputs and outputs, or over outputs and hidden states."""
    parameters = model.free
    start = model.run(np.zeros((1, len(model.inputs))))[:-1]  # normalised, the newest last
    layout = model.layout
    hidden = tuple(s for s in layout.signals if s not in (*model.outputs, *model.inputs))
    count = len(parameters.theta)
    return Program(
        title=f"Takagi-Sugeno model, {counted(count, 'rule')}",
        dt_s=model.dt_s,
        inputs=model.inputs,
        outputs=model.outputs,
        states=(*model.outputs, *hidden),
        lags=layout.lags,
        theta=parameters.theta,
        memberships=None
        if count == 1
        else Memberships(
            parameters.centre,
            parameters.width,
            parameters.width,
            parameters.z_range[0],
            parameters.z_range[1],
        ),
        limits=parameters.limits,
        shift=layout.shift,
        scale=layout.scale,
        output_limits=model.output_limits,
        rest=start[::-1].T,
        find_past=lambda: _past_of_rules(model),
    )


def _past_of_rules(model: FittedTS) -> Past:
    """What a run starts from, as the model finds it."""
    layout = model.layout
    if isinstance(model.start, LikelyStart):
        prior = model.start.prior
        rows = max(model.start.samples, layout.depth)
        return LikelyPast(rows, layout.depth, layout.moving, prior.mean, prior.root, prior.weight)
    return _corrected_lags(model, model.start)


def _corrected_lags(model: FittedTS, start: MeasuredStart) -> AffinePast:
    """The last rows as measured, and their correction: both are linear in them."""
    n_y = model.layout.n_y
    n_u = len(model.inputs)
    rows = start.samples
    unit = np.eye(rows * (n_u + n_y) + 1)
    windows = np.concatenate(
        [
            unit[rows * n_u : -1].reshape(rows, n_y, -1),
            unit[: rows * n_u].reshape(rows, n_u, -1),
        ],
        axis=1,
    )
    joined = np.concatenate([windows.reshape(rows * (n_u + n_y), -1), unit[-1:]])
    windows[:, :n_y] += (start.gain @ joined).reshape(rows, n_y, -1)
    memory = program_of_rules(model).memory
    return AffinePast(rows, np.stack([windows[rows - lag, column] for column, lag in memory]))


def static_program(model: FittedStaticTS) -> Program:
    """Rules over the present inputs; there is nothing to remember."""
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    p = model.partition
    columns = np.array([*range(n_y, n_y + n_u), -1], dtype=np.int64)
    inputs = columns[:-1]
    none = np.full(n_u, -1, dtype=np.int64)
    count = len(p)
    far = np.abs(model.output_limits).max() * 1e6 + 1.0
    return Program(
        title=f"Static Takagi-Sugeno model, {counted(count, 'rule')}",
        dt_s=model.dt_s,
        inputs=model.inputs,
        outputs=model.outputs,
        states=model.outputs,
        lags=Lags(columns, np.zeros(n_u + 1, dtype=np.int64), inputs, 0 * inputs, none),
        theta=model.consequents,
        memberships=None
        if count == 1
        else Memberships(p.centre, p.left, p.right, p.low, p.high, p.shape, p.conjunction),
        limits=np.stack([np.full(n_y, -far), np.full(n_y, far)]),
        shift=np.zeros(n_y + n_u),
        scale=np.ones(n_y + n_u),
        output_limits=model.output_limits,
        rest=np.zeros((n_y + n_u, 0)),
    )


def hidden_names(count: int) -> tuple[Signal, ...]:
    """States that have no name of their own."""
    return tuple(Signal(f"state {i + 1}") for i in range(count))
