"""Whether a model may be exported in float32: tried on the inputs of training before it is written."""

from __future__ import annotations

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.export.program import Program
from flysid.export.programs import program_of
from flysid.export.reference import run
from flysid.model.base import Fitted
from flysid.model.capabilities import HasMembers
from flysid.model.rules.recursion import pole_radius
from flysid.model.start import run_from_window, start_window

REMEDY = (
    "export it in double (without --float32), take a linear model (--model), which is balanced, or fit a "
    "lower order or at a lower rate"
)


def loss_in_float32(model: Fitted, program: Program, train: Dataset, *, largest_loss: float = 0.01) -> float:
    """What rounding to float32 adds to the free run's error, as a share of that error's RMSE.

    Both programs run from rest along the inputs of training; the worst output counts. Raises UsageError: the
    share is above 1 %, or the poles of a rule leave the unit circle by being rounded. Raises DataError: no
    segment is long enough to run on.
    """
    refuse_poles(program)
    rounding = np.zeros(len(program.outputs))
    error = np.zeros(len(program.outputs))
    rows = 0
    for segment in train.segments:
        window = start_window(model.n_init, len(segment), train.dt_s)
        if len(segment) <= window:
            continue
        u = _held(segment.u, train.dt_s / program.dt_s)
        rounding += ((run(program, u, single=True)[0] - run(program, u)[0]) ** 2).mean(axis=0) * len(segment)
        free = run_from_window(model, segment, window)
        error += ((free - segment.y)[window:] ** 2).mean(axis=0) * len(segment)
        rows += len(segment)
    if not rows:
        raise DataError("no segment is long enough to try float32 on", hint="record longer, or export double")
    size = np.concatenate([s.y for s in train.segments]).var(axis=0) * rows
    share = float(np.sqrt(rounding / np.where(error > 0.0, error, size)).max())
    if not share <= largest_loss:
        raise UsageError(
            f"in float32 the model strays by {100.0 * share:.3g} % of its free run's RMSE on the inputs of "
            f"training; {100.0 * largest_loss:.0f} % are allowed",
            hint=REMEDY,
        )
    return share


def worst_loss_in_float32(model: Fitted, train: Dataset, rate_hz: float | None = None) -> float:
    """`loss_in_float32` of the model's program; of an ensemble the largest among its members'."""
    if isinstance(model, HasMembers):
        return max(worst_loss_in_float32(member, train, rate_hz) for member in model.members)
    return loss_in_float32(model, program_of(model, rate_hz), train)


def refuse_poles(program: Program) -> None:
    """Raise UsageError where a rule is stable as it was fitted, and not in float32."""
    for r, theta in enumerate(program.theta):
        before = pole_radius(_past(program, theta))
        after = pole_radius(_past(program, theta.astype(np.float32).astype(np.float64)))
        if before < 1.0 <= after:
            whose = f"rule {r + 1}" if len(program.theta) > 1 else "the model"
            raise UsageError(
                f"rounded to float32, a pole of {whose} leaves the unit circle: "
                f"radius {before:.9f} -> {after:.9f}",
                hint=REMEDY,
            )


def _past(program: Program, rule: FloatArray) -> FloatArray:
    """(deepest lag, n, n) what past simulated quantities weigh in small signals, normalised."""
    n = program.n
    taps = np.zeros((max(program.depths[:n], default=0), n, n))
    for column, lag, weight in zip(program.lags.column, program.lags.lag, rule.T, strict=True):
        parts = [(column, lag, 1.0)]
        if column >= len(program.signals):
            worked = program.worked[column - len(program.signals)]
            parts = [(*worked.a, 1.0), (*worked.b, -1.0)] if worked.operation == "change" else []
        for own, ago, sign in parts:
            if 0 <= own < n:
                taps[ago - 1, :, own] += sign * weight
    return taps


def _held(u: FloatArray, ratio: float) -> FloatArray:
    """Inputs held through `ratio` steps a sample."""
    rows = np.minimum((np.arange(round(len(u) * ratio)) / ratio).astype(int), len(u) - 1)
    return np.asarray(u[rows])
