"""Persistence: y(k) = y(k - 1), whatever the input does. A reference: nothing to learn, nothing to tune.

k steps ahead it repeats the output measured k steps before; in free run it holds its starting state.
"""

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
class Persistence(Settings):
    """A reference without settings.

    Examples
    --------
    >>> flysid.Persistence().fit(train).n_init  # train: see `flysid.Dataset`
    1
    """

    @on_one_thread
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedLinear:  # noqa: ARG002
        """Takes only the signals and their range from the data.

        Raises
        ------
        DataError : no samples, or a signal that never changes.
        """
        n_u = len(train.inputs)
        n_y = len(train.outputs)
        return FittedLinear(
            structure="persistence",
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            n_init=1,
            output_limits=Parts.measured(train).limits,
            system=Difference(np.stack([np.eye(n_y), -np.eye(n_y)]), np.zeros((1, n_y, n_u)), np.zeros(n_y)),
            u_origin=np.zeros(n_u),
            y_origin=np.zeros(n_y),
            noise=None,
            starts=None,
            free=(),
            covariance=np.zeros((0, 0)),
        )
