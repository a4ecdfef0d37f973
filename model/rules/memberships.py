"""Membership functions and firing strengths, always finite.

A rule fires with the conjunction of its memberships, the paper's eq. (7), and the
strengths are normalised, eq. (2). Both are computed as logarithms: where every membership underflows, the
quotient of (2) is 0/0, but the logarithms still tell the nearest rule, which then speaks alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError

Shape = Literal["gaussian", "triangle", "trapezoid"]
Conjunction = Literal["product", "minimum"]

_FAR = float(np.finfo(float).max) ** 0.25  # standardised distances stop here: their squares stay finite


def standardise(x: FloatArray, centre: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """(N, R) signed distance of x (N,) from each centre (R,) in widths of the side it lies on."""
    # a row per rule: NumPy takes several times as long along a short last axis
    gap = x[None, :] - centre[:, None]
    below = np.minimum(gap, 0.0)
    below /= left[:, None]
    np.maximum(gap, 0.0, out=gap)
    gap /= right[:, None]
    gap += below
    return np.asarray(np.clip(gap, -_FAR, _FAR, out=gap).T)


def log_grade(distance: FloatArray, shape: Shape = "gaussian") -> FloatArray:
    """Logarithm of the membership at a standardised distance; -inf outside a bounded support.

    The triangle and the trapezoid have the half-value points of the Gaussian nearly: the triangle falls
    to 0 at 2 widths, the trapezoid is 1 up to half a width and 0 from 2 widths on.
    """
    if shape == "gaussian":
        return -0.5 * distance * distance
    reach = np.abs(distance)
    grade = 1.0 - reach / 2.0 if shape == "triangle" else (2.0 - reach) / 1.5
    with np.errstate(divide="ignore"):
        return np.log(np.clip(grade, 0.0, 1.0))


def normalise(log_strength: FloatArray, distance: FloatArray) -> FloatArray:
    """(N, R) firing strengths that sum to 1, eq. (2), from their logarithms.

    `distance` (N, R) decides where no rule fires (all -inf): the nearest rule speaks alone.
    """
    # columns by columns: NumPy's own reductions along a short last axis take ten times as long
    top = reduce(np.maximum, log_strength.T)
    silent = ~np.isfinite(top)
    if silent.any():
        nearest = distance[silent].argmin(axis=1)
        log_strength = log_strength.copy()
        top = np.where(silent, 0.0, top)
        log_strength[np.flatnonzero(silent), nearest] = 0.0
    strength = np.exp(log_strength - top[:, None])
    strength /= (strength @ np.ones(strength.shape[1]))[:, None]
    return np.asarray(strength)


@dataclass(frozen=True, eq=False)
class Partition:
    """Memberships of R rules over n_z antecedent variables.

    Attributes
    ----------
    centre : (R, n_z) centres A_rj.
    left, right : (R, n_z) widths below and above the centre (equal for symmetric memberships).
    low, high : (n_z,) range seen in training; values outside are read as its nearest end.
    shape, conjunction : of the memberships.
    """

    centre: FloatArray
    left: FloatArray
    right: FloatArray
    low: FloatArray
    high: FloatArray
    shape: Shape = "gaussian"
    conjunction: Conjunction = "product"

    def __post_init__(self) -> None:
        if self.shape not in ("gaussian", "triangle", "trapezoid"):
            raise UsageError(f"unknown membership shape {self.shape!r}", hint="gaussian, triangle, trapezoid")
        if self.conjunction not in ("product", "minimum"):
            raise UsageError(f"unknown conjunction {self.conjunction!r}", hint="product, minimum")
        if not ((self.left > 0).all() and (self.right > 0).all()):
            raise UsageError("membership widths must be positive")

    def __len__(self) -> int:
        return len(self.centre)

    def grades(self, variable: int, x: FloatArray) -> FloatArray:
        """(len(x), R) membership of each value of one antecedent variable in every rule's set.

        Raises
        ------
        UsageError : no such variable.
        """
        j = variable
        count = self.centre.shape[1]
        if not 0 <= j < count:
            raise UsageError(f"no antecedent variable {j!r}", hint=f"there are {count}, counted from 0")
        distance = standardise(
            np.asarray(x, dtype=np.float64), self.centre[:, j], self.left[:, j], self.right[:, j]
        )
        return np.asarray(np.exp(log_grade(distance, self.shape)))

    def firing(self, z: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths of z (N, n_z), eq. (7) and (2); rows sum to 1."""
        z = np.clip(z, self.low, self.high)
        total = np.zeros((len(self), len(z))).T  # in memory as `standardise` has it
        far = np.zeros_like(total)
        for j in range(z.shape[1]):
            d = standardise(z[:, j], self.centre[:, j], self.left[:, j], self.right[:, j])
            grade = log_grade(d, self.shape)
            total = total + grade if self.conjunction == "product" else np.minimum(total, grade)
            if self.shape != "gaussian":  # which always fires
                far = far + d * d
        return normalise(total, far)

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        arrays = {name: getattr(self, name).tolist() for name in ("centre", "left", "right", "low", "high")}
        return arrays | {"shape": self.shape, "conjunction": self.conjunction}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Partition:
        """Rebuild what `to_dict` gave."""
        arrays = {
            name: np.array(document[name], dtype=np.float64)
            for name in ("centre", "left", "right", "low", "high")
        }
        return cls(**arrays, shape=document["shape"], conjunction=document["conjunction"])
