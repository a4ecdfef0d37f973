"""Line: y = gain u + offset, the best static straight line. The least that a model must beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import Dataset
from flysid.model.freerun import Difference
from flysid.model.gram import reduce_data, solve
from flysid.model.linear.data import Parts
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.regressors import LagTerms, chunks
from flysid.model.settings import Settings
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class Line(Settings):
    """Settings of a static line.

    Parameters
    ----------
    offset : estimate a constant; without it the line goes through the origin of the axes.

    Examples
    --------
    >>> model = flysid.Line().fit(train)  # train: see `flysid.Dataset`
    >>> model.n_init, model.poles  # no dynamics
    (0, array([], dtype=complex128))
    """

    offset: bool = True

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedLinear:  # noqa: ARG002
        """Least squares over all samples.

        Raises
        ------
        DataError : no samples, or a signal that never changes.
        """
        parts = Parts.of(train, train, centred=self.offset)
        n_u = len(train.inputs)
        n_y = len(train.outputs)
        data = parts.whole if self.offset else train
        lags = LagTerms(y=((),) * n_y, u=((0,),) * n_u)
        triangle = reduce_data(lambda: chunks(data, lags))
        fits = [solve(triangle, range(n_u), i) for i in range(n_y)]
        b = np.stack([f.theta for f in fits])[None]
        system = Difference(np.eye(n_y)[None], b, np.zeros(n_y))
        gain = parts.scaling.y_scale[:, None] / parts.scaling.u_scale
        if self.offset:
            system = parts.scaling.physical(system)
        factors = gain if self.offset else np.ones_like(gain)
        free = tuple(range(n_y * n_u))
        covariance = np.zeros((len(free), len(free)))
        for i, fit in enumerate(fits):
            block = slice(i * n_u, (i + 1) * n_u)
            covariance[block, block] = fit.covariance * np.outer(factors[i], factors[i])
        return FittedLinear(
            structure="line",
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            n_init=0,
            output_limits=parts.limits,
            system=system,
            u_origin=parts.scaling.u_origin if self.offset else np.zeros(n_u),
            y_origin=parts.scaling.y_origin if self.offset else np.zeros(n_y),
            noise=None,
            starts=None,
            free=(*free, *range(len(free), len(free) + n_y)) if self.offset else free,
            covariance=_with_offset(covariance, fits, parts) if self.offset else covariance,
        )


def _with_offset(covariance: np.ndarray[Any, Any], fits: list[Any], parts: Parts) -> Any:
    """The covariance with the offsets' variances: of a mean, independent of the centred gains."""
    n = len(covariance)
    full = np.zeros((n + len(fits), n + len(fits)))
    full[:n, :n] = covariance
    for i, fit in enumerate(fits):
        full[n + i, n + i] = fit.rss / max(fit.rows, 1) ** 2 * parts.scaling.y_scale[i] ** 2
    return full
