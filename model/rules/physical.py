"""Rules in physical units: what is stored is normalised by the spread of every signal in training."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.memberships import Partition


class Scaled(Protocol):
    """What a layout tells of its scaling: mean and spread of every signal, regressors as (column, lag)."""

    @property
    def shift(self) -> FloatArray: ...
    @property
    def scale(self) -> FloatArray: ...
    @property
    def regressors(self) -> list[tuple[int, int]]: ...
    def antecedent_scaling(self) -> tuple[FloatArray, FloatArray]: ...


class Rules(Protocol):
    """Normalised rules: consequents (R, n, n_x), the constant last, and Gaussian memberships (R, n_z)."""

    @property
    def theta(self) -> FloatArray: ...
    @property
    def centre(self) -> FloatArray: ...
    @property
    def width(self) -> FloatArray: ...
    @property
    def z_range(self) -> FloatArray: ...


def physical_partition(layout: Scaled, rules: Rules) -> Partition:
    """The memberships over the antecedents as they are measured."""
    shift, scale = layout.antecedent_scaling()
    width = rules.width * scale
    low, high = rules.z_range * scale + shift
    return Partition(rules.centre * scale + shift, width, width, low, high)


def physical_consequents(layout: Scaled, rules: Rules) -> FloatArray:
    """(R, n, n_x) consequents for regressors and outputs as they are measured; the last is the offset."""
    n = rules.theta.shape[1]
    theta = rules.theta * layout.scale[:n][None, :, None]
    columns = np.array([c for c, _ in layout.regressors[:-1]])
    gains = theta[:, :, :-1] / layout.scale[columns]
    offset = theta[:, :, -1] + layout.shift[:n] - gains @ layout.shift[columns]
    return np.concatenate([gains, offset[:, :, None]], axis=2)
