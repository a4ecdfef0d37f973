"""Models from python-control, without loss; `model.to_control()` is the way there.

python-control is imported inside the functions: it costs seconds of CPU at import.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.subspace.fitted_model import FittedStateSpace, resting

if TYPE_CHECKING:
    from collections.abc import Sequence


def from_control(
    system: Any,
    dt_s: float | None = None,
    *,
    inputs: Sequence[Signal | str] | None = None,
    outputs: Sequence[Signal | str] | None = None,
) -> FittedLinear:
    """A python-control transfer function as a model that predicts and compares like a fitted one.

    Parameters
    ----------
    system : control.TransferFunction, or control.StateSpace with one input and output. A continuous one is
        sampled behind a zero-order hold.
    dt_s : sample time of a continuous system.

    Raises
    ------
    UsageError : continuous and no sample time given, or improper.
    """
    import control

    timed = not (system.dt is None or system.dt is True or system.dt == 0)
    if not timed and dt_s is None:
        raise UsageError("the system has no sample time", hint="give dt_s, in seconds")
    step = float(system.dt) if timed else float(dt_s or 0.0)
    try:
        transfer = control.tf(control.sample_system(system, step, "zoh") if system.dt == 0 else system)
    except control.ControlMIMONotImplemented as error:
        raise UsageError(f"python-control cannot convert this system: {error}") from error
    n_y = transfer.noutputs
    n_u = transfer.ninputs
    rows = [_common(transfer, i) for i in range(n_y)]
    size = max(len(a) for a, _ in rows)
    a = np.zeros((size, n_y, n_y))
    b = np.zeros((size, n_y, n_u))
    for i, (den, nums) in enumerate(rows):
        a[: len(den), i, i] = den
        b[: len(den), i] = nums.T
    found = Difference(a, b, np.zeros(n_y))
    return FittedLinear(
        structure="arx",
        dt_s=step,
        inputs=_signals(inputs, transfer.input_labels),
        outputs=_signals(outputs, transfer.output_labels),
        n_init=max(found.depth, 1),
        output_limits=np.array([[-1e12] * n_y, [1e12] * n_y]),
        system=found,
        u_origin=np.zeros(n_u),
        y_origin=np.zeros(n_y),
        noise=None,
        starts=None,
        free=(),
        covariance=np.zeros((0, 0)),
        notes=("Imported from python-control; nothing was estimated.",),
    )


def from_control_states(
    system: Any,
    *,
    inputs: Sequence[Signal | str] | None = None,
    outputs: Sequence[Signal | str] | None = None,
) -> FittedStateSpace:
    """A discrete python-control StateSpace as a model, matrix by matrix; it simulates from rest.

    Raises
    ------
    UsageError : not a StateSpace, or it has no sample time.
    """
    import control

    if not isinstance(system, control.StateSpace):
        raise UsageError(f"a {type(system).__name__} is not a state space", hint="use from_control")
    if system.dt in (None, True, 0):
        raise UsageError("the system has no sample time", hint="sample it: control.sample_system")
    signals = _signals(inputs, system.input_labels), _signals(outputs, system.output_labels)
    return resting((system.A, system.B, system.C, system.D), float(system.dt), signals)


def _common(transfer: Any, i: int) -> tuple[FloatArray, FloatArray]:
    """Monic denominator and (n_u, size) numerators of one output over their common denominator."""
    dens = [np.trim_zeros(np.asarray(d, dtype=np.float64), "f") for d in transfer.den[i]]
    nums = [np.asarray(n, dtype=np.float64) for n in transfer.num[i]]
    same = all(len(d) == len(dens[0]) and np.array_equal(d, dens[0]) for d in dens)
    if same:
        common = dens[0]
        factors = [np.ones(1)] * len(dens)
    else:
        common = np.ones(1)
        for d in dens:
            common = np.convolve(common, d)
        factors = [_product(dens[:j] + dens[j + 1 :]) for j in range(len(dens))]
    out = np.zeros((len(nums), len(common)))
    for j, (n, f) in enumerate(zip(nums, factors, strict=True)):
        taps = np.trim_zeros(np.convolve(n, f), "f")
        if len(taps) > len(common):
            raise UsageError("the transfer function is improper (more zeros than poles), so it is not causal")
        out[j, len(common) - len(taps) :] = taps
    return common / common[0], out / common[0]


def _product(polynomials: list[FloatArray]) -> FloatArray:
    out = np.ones(1)
    for p in polynomials:
        out = np.convolve(out, p)
    return out


def _signals(given: Sequence[Signal | str] | None, labels: Sequence[str]) -> tuple[Signal, ...]:
    return tuple(s if isinstance(s, Signal) else Signal(s) for s in (labels if given is None else given))
