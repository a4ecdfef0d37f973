"""Named transforms of a recipe: columns of one stream -> one signal.

Every transform takes (N, k) columns scaled to physical values, the time of each row in seconds, and the
heading in radians where it needs one. "forward" and "right" turn a vector given as (north, east) by a yaw
that is clockwise from north; given as (x, y) with a yaw that is counter-clockwise from x (ENU, motion
capture) the second of them points left. It returns (N,) values in `unit` or, where that is None, in the
unit of its first column.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flysid.ingest.align import frames
from flysid.stretch import FloatArray

Apply = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Transform:
    """A transform and what it needs.

    `apply`: (columns (N, k), time_s (N,), yaw (N,) or empty) -> (N,).
    `field_counts`: how many columns a recipe may name; one column may be a list of fixed size.
    `unit`: unit of the result; None: that of the first column.
    `per_second`: the result is a rate of the first column's unit.
    `needs_yaw`: `yaw` must be given.
    `elementwise`: the quantisation of the column is that of the result.
    `wraps`: the result is an angle whose turns are to be counted on.
    """

    apply: Apply
    field_counts: tuple[int, ...] = (1,)
    unit: str | None = None
    per_second: bool = False
    needs_yaw: bool = False
    elementwise: bool = False
    wraps: bool = False


def derivative(columns: FloatArray, time_s: FloatArray, yaw: FloatArray) -> FloatArray:  # noqa: ARG001
    """Central difference on the samples' own times, second order also where they are uneven."""
    if len(time_s) < 2:
        return np.full(len(time_s), np.nan)
    return np.asarray(np.gradient(columns[:, 0], time_s), dtype=np.float64)


def _rates(columns: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the first two columns."""
    return derivative(columns[:, :1], time_s, time_s), derivative(columns[:, 1:2], time_s, time_s)


def _difference(columns: FloatArray, time_s: FloatArray, yaw: FloatArray) -> FloatArray:  # noqa: ARG001
    """The mean of the first half of the columns less that of the second: a torque of motors on two sides."""
    half = columns.shape[1] // 2
    return np.asarray(columns[:, :half].mean(axis=1) - columns[:, half:].mean(axis=1))


def _of_quaternion(function: Callable[[FloatArray], FloatArray]) -> Transform:
    return Transform(lambda c, _t, _y: function(c), field_counts=(1, 4), unit="rad")


TRANSFORMS: Mapping[str, Transform] = {
    "none": Transform(lambda c, _t, _y: c[:, 0], elementwise=True),
    "plain": Transform(lambda c, _t, _y: c[:, 0], unit="", elementwise=True),
    "unwrap": Transform(lambda c, _t, _y: c[:, 0], elementwise=True, wraps=True),
    "roll": _of_quaternion(frames.roll_of),
    "pitch": _of_quaternion(frames.pitch_of),
    "yaw": _of_quaternion(frames.yaw_of),
    "forward": Transform(
        lambda c, _t, yaw: frames.forward_of(c[:, 0], c[:, 1], yaw), field_counts=(2,), needs_yaw=True
    ),
    "right": Transform(
        lambda c, _t, yaw: frames.right_of(c[:, 0], c[:, 1], yaw), field_counts=(2,), needs_yaw=True
    ),
    "derivative": Transform(derivative, per_second=True),
    "forward_rate": Transform(
        lambda c, t, yaw: frames.forward_of(*_rates(c, t), yaw),
        field_counts=(2,),
        per_second=True,
        needs_yaw=True,
    ),
    "right_rate": Transform(
        lambda c, t, yaw: frames.right_of(*_rates(c, t), yaw),
        field_counts=(2,),
        per_second=True,
        needs_yaw=True,
    ),
    "mean": Transform(lambda c, _t, _y: np.asarray(c.mean(axis=1)), field_counts=tuple(range(1, 17))),
    "difference": Transform(_difference, field_counts=tuple(range(2, 17, 2))),
    "norm": Transform(
        lambda c, _t, _y: np.asarray(np.linalg.norm(c, axis=1)), field_counts=tuple(range(1, 17))
    ),
}
