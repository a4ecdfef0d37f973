"""A linear model good for free runs: what every search hands on before noise and covariance are known."""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference
from flysid.model.linear.data import Parts
from flysid.model.linear.difference_equation import FittedLinear


def free_runner(
    structure: str, parts: Parts, system: Difference, starts: FloatArray | None, free: tuple[int, ...]
) -> FittedLinear:
    """The model of a system found: its noise is white, its covariance unknown.

    `system`: in the units of `parts.scaling`.
    `starts`: see `FittedLinear`; None: the lags are taken as measured.
    `free`: indices of the estimated parameters in `FittedLinear.flat` order.
    """
    return FittedLinear(
        structure=structure,
        dt_s=parts.train.dt_s,
        inputs=parts.train.inputs,
        outputs=parts.train.outputs,
        n_init=max(system.depth, 1) if starts is None else starts.shape[2],
        output_limits=parts.limits,
        system=parts.scaling.physical(system),
        u_origin=parts.scaling.u_origin,
        y_origin=parts.scaling.y_origin,
        noise=np.ones((1, len(system.c))),
        starts=starts,
        free=free,
        covariance=np.full((len(free), len(free)), np.nan),
    )
