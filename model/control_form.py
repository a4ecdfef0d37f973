"""Linear models as python-control systems, without loss.

python-control is imported inside the functions: it costs seconds of CPU at import.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.freerun import Difference

ControlForm = Literal["auto", "tf", "ss"]
Signals = tuple[tuple[Signal, ...], tuple[Signal, ...]]


def control_of_difference(system: Difference, signals: Signals, dt_s: float, form: ControlForm) -> Any:
    """A difference equation as control.TransferFunction ("tf") or control.StateSpace ("ss").

    `signals`: inputs, outputs.
    `form`: "auto" is "tf" for one input and output, else "ss".
    Raises UsageError: a transfer matrix was asked for of coupled outputs.
    """
    import control

    n_u = len(signals[0])
    n_y = len(signals[1])
    if form == "tf" and not system.is_diagonal:
        raise UsageError("coupled outputs have no common denominators to keep", hint="use form='ss'")
    if form == "ss" or (form == "auto" and not n_u == n_y == 1):
        return control.ss(*state_space(system), dt_s, **_names(signals))
    size = system.depth + 1
    num = [[_pad(system.b[:, i, j], size) for j in range(n_u)] for i in range(n_y)]
    den = [[_pad(system.a[:, i, i], size)] * n_u for i in range(n_y)]
    return control.tf(num, den, dt_s, **_names(signals))


def control_of_states(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    signals: Signals,
    dt_s: float,
    form: ControlForm,
) -> Any:
    """(A, B, C, D) as control.StateSpace, or for "tf" as control.TransferFunction."""
    import control

    space = control.ss(*matrices, dt_s, **_names(signals))
    return control.ss2tf(space, **_names(signals)) if form == "tf" else space


def _names(signals: Signals) -> dict[str, list[str]]:
    return {"inputs": [s.name for s in signals[0]], "outputs": [s.name for s in signals[1]]}


def state_space(system: Difference) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(A, B, C, D) of a difference equation in observer form, order L n_y."""
    depth = system.depth
    n_y = system.a.shape[1]
    n_u = system.b.shape[2]
    a = np.zeros((depth + 1, n_y, n_y))
    b = np.zeros((depth + 1, n_y, n_u))
    a[: len(system.a)] = system.a
    b[: len(system.b)] = system.b
    n = depth * n_y
    big_a = np.eye(n, k=n_y)
    big_b = np.zeros((n, n_u))
    for lag in range(1, depth + 1):
        rows = slice((lag - 1) * n_y, lag * n_y)
        big_a[rows, :n_y] -= a[lag]
        big_b[rows] = b[lag] - a[lag] @ b[0]
    return big_a, big_b, np.eye(n_y, n), b[0]


def _pad(values: FloatArray, size: int) -> FloatArray:
    """Coefficients in rising powers of the delay are those in falling powers of z, both of degree L."""
    out = np.zeros(size)
    out[: len(values)] = values
    return out


def with_registers(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray], delays: Sequence[int]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(A, B, C, D) with a shift register of states for every input that enters late."""
    a, b, c, d = matrices
    for j, late in enumerate(delays):
        for _ in range(late):  # one more state, the last input as it enters; the others follow
            a = np.block([[a, b[:, [j]]], [np.zeros((1, len(a) + 1))]])
            c = np.hstack([c, d[:, [j]]])
            b = np.vstack([b, np.zeros((1, b.shape[1]))])
            d = d.copy()
            b[:, j] = 0.0
            d[:, j] = 0.0
            b[-1, j] = 1.0
    return a, b, c, d
