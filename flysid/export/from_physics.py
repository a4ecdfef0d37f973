"""The physical model of a multirotor as a program: quadratic in what its motors turn with.

Held commands move a motor exactly from row to row, so that its speed after a part of a row, and the integrals
of the speed and of its square over the part, are a linear form and quadratic forms in v = [speed, command
before, command now] (`flysid.model.rotorcraft.rotor_axis` has the equations). Every output has motors of its
own, since its lag and dead time are its own.
"""

from __future__ import annotations

import math

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.export.program import BOUND, AffinePast, Program, Worked
from flysid.model.multirotor import FittedMultirotor
from flysid.model.rotorcraft.axis_fit import FittedAxis
from flysid.model.rotorcraft.rotor_axis import CURVE, DELAY, FIRST, LAG, TRIM, what_a_row_keeps
from flysid.model.rules.kernel import Lags

_SPEED, _BEFORE, _NOW = np.eye(3)


def multirotor_program(model: FittedMultirotor) -> Program:
    """Outputs, then the motors of every output. Raises UsageError: the model feels the battery's voltage."""
    if model.battery is not None:
        raise UsageError(
            "a physical model with the battery's voltage cannot be exported",
            hint="fit one without the input in volts",
        )
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    n = n_y * (1 + n_u)
    single: dict[tuple[int, int], FloatArray] = {}
    double: dict[tuple[tuple[int, int], tuple[int, int]], FloatArray] = {}

    def told(row: int, place: tuple[int, int], value: float) -> None:
        if value:
            single.setdefault(place, np.zeros(n))[row] += value

    rest = np.zeros((n + n_u, 1 + max(_whole(axis, model.dt_s) + 2 for axis in model.axes)))
    for i, (axis, integrates) in enumerate(zip(model.axes, model.integrates, strict=True)):
        keeps, adds = what_a_row_keeps(axis.theta, model.dt_s) if integrates else (0.0, 1.0)
        trim = adds * float(axis.theta[TRIM])
        told(i, (i, 1), keeps)
        told(i, (-1, 0), trim)
        if integrates:
            rest[i, 0] = -trim / keeps  # so that the first output is zero
        end, mean, square = _row_of_a_motor(axis, model.dt_s)
        if not integrates:
            mean, square = end, np.outer(end, end)
        curve = float(axis.theta[CURVE])
        late = 1 + _whole(axis, model.dt_s)
        for j in range(n_u):
            motor = n_y + i * n_u + j
            places = ((motor, 1), (n + j, late + 1), (n + j, late))
            torque = adds * float(axis.theta[FIRST + j])
            for a, place in enumerate(places):
                told(motor, place, end[a])
                told(i, place, torque * (1.0 - curve) * mean[a])
                for b in range(a, 3):
                    value = torque * curve * square[a, b] * (1.0 if a == b else 2.0)
                    if value:
                        double.setdefault((place, places[b]), np.zeros(n))[i] += value
    first = n + n_u
    regressors = [*single, *((first + i, 0) for i in range(len(double)))]
    columns, lags = np.array(regressors, dtype=np.int64).reshape(-1, 2).T
    none = np.zeros(0, dtype=np.int64)
    motors = tuple(
        Signal(f"motor of {u.name} for {y.name}, share of its largest command")
        for y in model.outputs
        for u in model.inputs
    )
    return Program(
        title=f"Physical model, {n_u * n_y} motors",
        dt_s=model.dt_s,
        inputs=model.inputs,
        outputs=model.outputs,
        states=(*model.outputs, *motors),
        lags=Lags(columns, lags, none, none, none),
        theta=np.stack([*single.values(), *double.values()], axis=1)[None],
        memberships=None,
        limits=np.stack([np.full(n, -BOUND), np.full(n, BOUND)]),
        shift=np.zeros(n + n_u),
        scale=np.concatenate([model.y_scale, np.ones(n - n_y), model.u_scale]),
        output_limits=model.output_limits,
        rest=rest,
        worked=tuple(Worked("product", a, b) for a, b in double),
        find_past=lambda: _first_sample(multirotor_program(model)),
    )


def _first_sample(program: Program) -> AffinePast:
    """Outputs as measured in one sample; motors turn, and have always turned, as its commands want."""
    n_y = len(program.outputs)
    n_u = len(program.inputs)
    matrix = np.zeros((len(program.memory), n_u + n_y + 1))
    for row, (column, _) in zip(matrix, program.memory, strict=True):
        if column < n_y:
            row[n_u + column] = 1.0
        elif column < program.n:
            row[(column - n_y) % n_u] = 1.0
        else:
            row[column - program.n] = 1.0
    return AffinePast(1, matrix)


def _whole(axis: FittedAxis, dt: float) -> int:
    """Full rows of dead time."""
    return math.floor(float(axis.theta[DELAY]) / dt)


def _row_of_a_motor(axis: FittedAxis, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(3,) the speed after a row, (3,) its mean over the row, (3, 3) the mean of its square."""
    lag = float(axis.theta[LAG])
    past = float(axis.theta[DELAY]) - _whole(axis, dt) * dt
    speed = _SPEED
    mean = np.zeros(3)
    square = np.zeros((3, 3))
    for command, seconds in ((_BEFORE, past), (_NOW, dt - past)):
        fade = math.exp(-seconds / lag)
        apart = speed - command
        once = lag * (1.0 - fade)
        twice = 0.5 * lag * (1.0 - fade * fade)
        mean = mean + (command * seconds + apart * once) / dt
        cross = np.outer(command, apart)
        square = square + np.outer(command, command) * (seconds / dt)
        square = square + ((cross + cross.T) * once + np.outer(apart, apart) * twice) / dt
        speed = command + apart * fade
    return speed, mean, square
