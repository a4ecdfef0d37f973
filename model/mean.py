"""Mean: y = the mean of the training part, whatever the input does. A reference: a model that loses to it has
learnt nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset
from flysid.model.freerun import Difference
from flysid.model.linear.data import Parts
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.settings import Settings
from flysid.model.stream import Source
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class Mean(Settings):
    """A reference without settings.

    Examples
    --------
    >>> flysid.Mean().fit(train).simulate(np.zeros((3, 1))).shape  # train: see `flysid.Dataset`
    (3, 1)
    """

    @on_one_thread
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedLinear:  # noqa: ARG002
        """The mean of every output over all samples.

        Raises
        ------
        DataError : no samples, or a signal that never changes.
        """
        parts = Parts.measured(train)
        n_u = len(train.inputs)
        n_y = len(train.outputs)
        variance = parts.scaling.y_scale**2 / len(train)
        return FittedLinear(
            structure="mean",
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            n_init=0,
            output_limits=parts.limits,
            system=Difference(np.eye(n_y)[None], np.zeros((1, n_y, n_u)), np.zeros(n_y)),
            u_origin=np.zeros(n_u),
            y_origin=parts.scaling.y_origin,
            noise=None,
            starts=None,
            free=tuple(range(n_y * n_u, n_y * n_u + n_y)),
            covariance=np.diag(variance),
        )
