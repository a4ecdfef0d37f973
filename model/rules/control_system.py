"""TS models as python-control systems; python-control is imported only when this is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.kernel import free_run
from flysid.model.rules.rule_model import RuleModel


def next_step(model: RuleModel, s: FloatArray, u: FloatArray) -> FloatArray:
    """(n,) x(k) from u(k) and s(k): x(k-1), ..., x(k-`layout.moving`), u(k-1), ..., u(k-`layout.depth`)."""
    layout = model.layout
    n = layout.n
    d = layout.depth
    own = layout.moving * n
    W = np.zeros((d + 1, len(layout.scale)))
    W[d - layout.moving : d, :n] = np.asarray(s[:own]).reshape(-1, n)[::-1]
    W[:, n:] = np.vstack([np.asarray(s[own:]).reshape(d, -1)[::-1], np.atleast_1d(u)])
    W = (W - layout.shift) / layout.scale
    free_run(W, d, layout.lags, model.free)
    return np.asarray(W[d, :n] * layout.scale[:n] + layout.shift[:n])


def to_nonlinear_system(model: RuleModel) -> Any:
    """The model as a discrete `control.NonlinearIOSystem` with the state s(k) of `next_step`, physical units.

    Driven by the same inputs from the same past it follows `simulate` sample by sample.
    """
    import control

    n = model.layout.n
    own = model.layout.moving * n
    n_u = len(model.inputs)

    def output(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        return np.asarray(np.clip(next_step(model, s, u)[: model.layout.n_y], *model.output_limits))

    def step(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        x = np.concatenate([next_step(model, s, u), s[:own]])[:own]
        return np.concatenate([x, np.atleast_1d(u), s[own : len(s) - n_u]])

    return control.NonlinearIOSystem(
        step,
        output,
        inputs=[s.name for s in model.inputs],
        outputs=[s.name for s in model.outputs],
        states=own + model.layout.depth * n_u,
        dt=model.dt_s,
        name="takagi_sugeno",
    )
