"""Multirotor: what physics says of a vehicle that flies on rotors, as one more contender.

Commands of motors (each its own input, or a mix of them) drive a body rate or a body acceleration through
motors with a lag and a dead time, a thrust curve, a torque each, drag of the rotors and a trim:
`rotorcraft/rotor_axis` has the equations. Every number has a name and a unit; an interval beside it says how
well the flights determine it, and one that they do not determine is named instead of printed. Parameters are
those that predict one step ahead best beside disturbances of torque that wander, so that a controller's
feedback does not bend them (as it does a fit to the free run); cf. Eschmann, Albani & Loianno, Data-driven
system identification of quadrotors subject to motor delays (2024).

An input in volts is the battery's voltage: commands then act as much as its power says, from 0 (governed
speed) by way of 1 (a share of the voltage) on.

What it leaves out: what rotors' own inertia does to yaw, coupling of axes, translation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.model.arguments import as_columns, as_record, check_start
from flysid.model.base import Rule, write_document
from flysid.model.capabilities import Coefficient
from flysid.model.documents import array_of, head_of, signals_of, with_null
from flysid.model.freerun import saturate
from flysid.model.linear.data import Parts
from flysid.model.polynomials import Z95
from flysid.model.rotorcraft.axis_fit import FittedAxis, Record, fit_axis
from flysid.model.rotorcraft.battery import find_battery, is_voltage, quieten, voltage_of
from flysid.model.rotorcraft.rotor_axis import (
    CURVE,
    DAMPING,
    DELAY,
    FIRST,
    LAG,
    TRIM,
    forgets,
    free_run,
    steps_ahead,
)
from flysid.model.settings import Settings
from flysid.model.start import OneRule
from flysid.model.threads import on_one_thread
from flysid.showing import counted

Kind = Literal["auto", "rate", "acceleration"]
ACCELERATIONS = ("m/s/s", "m/s^2", "m/s²", "m/s2", "g")
UNDETERMINED = 0.5
"""Of the value, half an interval: then the flights do not determine it."""


@dataclass(frozen=True)
class AxisFigure:
    """A number of the vehicle.

    Attributes
    ----------
    name : "motor lag", "torque of motor 1".
    half_width : of its 95 % interval; NaN where it stands at an end of its range.
    scale : what the half-width is held against: the value, or 1 for a thrust curve.
    """

    name: str
    value: float
    unit: str
    half_width: float
    scale: float

    @property
    def is_determined(self) -> bool:
        """Half the interval is small beside the value."""
        return bool(self.half_width <= UNDETERMINED * abs(self.scale))

    def __str__(self) -> str:
        if not self.is_determined:
            return f"{self.name}: not determined by these flights"
        return f"{self.name} {self.value:.4g} +- {self.half_width:.2g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Multirotor(Settings):
    """Settings of the physical model.

    Parameters
    ----------
    kind : what every output is: "rate", "acceleration", or "auto", by its unit (m/s/s is an acceleration).
    curve : seek the thrust curve; None: where no command is ever negative, as of single motors.

    Examples
    --------
    >>> model = flysid.Multirotor().fit(train)  # train: see `flysid.Dataset`
    >>> [figure.name for figure in model.figures()][:2]
    ['motor lag', 'dead time']
    """

    kind: Kind = "auto"
    curve: bool | None = None

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedMultirotor:  # noqa: ARG002
        """Fit every output by itself.

        Raises
        ------
        UsageError : settings that cannot be, or no dataset; two inputs in volts, or no command beside one.
        DataError : too few samples, a signal that never changes, a voltage that is not above 0.
        FitError : no start is finite.
        """
        limits = Parts.of(train, None).limits
        u = np.concatenate([s.u for s in train.segments])
        y = np.concatenate([s.y for s in train.segments])
        needed = 10 * (FIRST + u.shape[1])
        if len(u) < needed:
            raise DataError(
                f"{len(u)} samples are too few for a physical model", hint=f"record at least {needed}"
            )
        battery = find_battery(train.inputs)
        if battery is not None and not (u[:, battery] > 0.0).all():
            raise DataError(f"{train.inputs[battery].name} is not above 0 V throughout")
        motors = [j for j in range(u.shape[1]) if j != battery]
        u_scale = np.abs(u).max(axis=0)
        y_scale = np.sqrt(np.mean(y**2, axis=0))
        curved = bool((u >= 0.0).all()) if self.curve is None else self.curve
        kinds = tuple(self._integrates(signal) for signal in train.outputs)
        u_mean = u.mean(axis=0)
        voltages = [quieten(voltage_of(s.u, battery, u_mean)) for s in train.segments]
        axes = []
        for i, integrates in enumerate(kinds):
            records: list[Record] = [
                (s.u[:, motors] / u_scale[motors], s.y[:, i] / y_scale[i], volts)
                for s, volts in zip(train.segments, voltages, strict=True)
            ]
            axes.append(fit_axis(records, train.dt_s, integrates, curved))
        return FittedMultirotor(
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            output_limits=limits,
            integrates=kinds,
            axes=tuple(axes),
            u_scale=u_scale,
            u_mean=u_mean,
            y_scale=y_scale,
        )

    def _integrates(self, output: Signal) -> bool:
        if self.kind != "auto":
            return self.kind == "rate"
        return output.unit.lower() not in ACCELERATIONS


@dataclass(frozen=True, eq=False, repr=False)
class FittedMultirotor(OneRule):
    """A physical model; the laws of `flysid.model.base` hold.

    Attributes
    ----------
    integrates : of every output, whether it is a rate (otherwise an acceleration).
    axes : one an output, in shares of `u_scale` and `y_scale`.
    u_scale, u_mean : (n_u,) largest and mean command of training; y_scale : (n_y,) root mean squares.
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    output_limits: FloatArray
    integrates: tuple[bool, ...]
    axes: tuple[FittedAxis, ...]
    u_scale: FloatArray
    u_mean: FloatArray
    y_scale: FloatArray

    structure = "multirotor"
    n_init = 1

    @property
    def battery(self) -> int | None:
        """Which input is the battery's voltage."""
        return find_battery(self.inputs)

    @property
    def motors(self) -> list[int]:
        """Which inputs are commands."""
        return [j for j in range(len(self.inputs)) if j != self.battery]

    @property
    def n_parameters(self) -> int:
        """Estimated numbers of all outputs, of the disturbance's too."""
        return sum(len(a.free) for a in self.axes)

    @property
    def notes(self) -> tuple[str, ...]:
        """What these flights do not determine, a sentence an output."""
        said = []
        for i, output in enumerate(self.outputs):
            vague = [f.name for f in self.figures(i) if not f.is_determined]
            if vague:
                said.append(f"{output.name}: these flights do not determine {', '.join(vague)}.")
        return tuple(said)

    # -- what an engineer asks of it ---------------------------------------------------------------------

    def figures(self, output: int = 0) -> tuple[AxisFigure, ...]:
        """Lag, dead time, thrust curve, drag, every command's effect about its mean, trim."""
        axis = self.axes[output]
        theta = axis.theta
        unit = self.outputs[output].unit or "1"
        size = float(self.y_scale[output])
        found = [
            self._figure(axis, "motor lag", LAG, "s"),
            self._figure(axis, "dead time", DELAY, "s", least=self.dt_s),
        ]
        if theta[CURVE] != 0.0:
            found.append(self._figure(axis, "thrust curve (0 straight, 1 square)", CURVE, "", least=1.0))
        if self.integrates[output]:
            found.append(self._figure(axis, "drag of the rotors", DAMPING, "1/s"))
            unit = f"{unit}/s"
        if self.battery is not None:
            found += self._battery_figures(output)
        per_torque, by_curve = self._effects(output)
        for at, j in enumerate(self.motors):
            command = self.inputs[j]
            torque = theta[FIRST + at]
            slope = np.zeros(len(theta))
            slope[[FIRST + at, CURVE]] = per_torque[at], torque * by_curve[at]
            value = float(torque * per_torque[at])
            half = Z95 * math.sqrt(max(float(slope @ axis.covariance @ slope), 0.0))
            per_unit = f"{unit} per {command.unit or '1'}"
            found.append(AxisFigure(f"effect of {command.name}", value, per_unit, half, value))
        half = Z95 * size * float(np.sqrt(max(axis.covariance[TRIM, TRIM], 0.0)))
        largest = size * float(np.abs(self._torques(axis)).max())
        found.append(AxisFigure("trim", size * float(theta[TRIM]), unit, half, largest))
        return tuple(found)

    def hover_command(self, volts: float, output: int = 0) -> tuple[float, float]:
        """By how much larger commands must be at a voltage than at the mean one for the same thrust.

        Returns
        -------
        ratio, half_width : commands over those at the mean voltage of training, and half its 95 % interval.

        Raises
        ------
        UsageError : the model has no input in volts; a voltage that is not above 0.

        Examples
        --------
        >>> ratio, half_width = model.hover_command(10.5)  # an input of the model is in V
        """
        if self.battery is None:
            raise UsageError("no input is in volts", hint="fit with the battery's voltage among the inputs")
        if not volts > 0.0:
            raise UsageError(f"the battery's voltage must be above 0 V, not {volts:g} V")
        axis = self.axes[output]
        far = math.log(volts / float(self.u_mean[self.battery]))
        ratio = math.exp(-float(axis.theta[-1]) * far)
        known = len(axis.theta) - 1 in axis.free
        error = math.sqrt(max(float(axis.covariance[-1, -1]), 0.0)) if known else np.nan
        return ratio, Z95 * error * abs(far) * ratio

    def _effects(self, output: int) -> FloatArray:
        """(2, n) every command's effect about its mean over its torque, and its slope by the thrust curve."""
        mean = (self.u_mean / self.u_scale)[self.motors]
        curve = self.axes[output].theta[CURVE]
        per = self.y_scale[output] / self.u_scale[self.motors]
        return np.asarray(per * [1.0 - curve + 2.0 * curve * mean, 2.0 * mean - 1.0])

    def _torques(self, axis: FittedAxis) -> FloatArray:
        return axis.theta[FIRST : FIRST + len(self.motors)]

    def _driven(self, u: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Commands over their largest (N, n), and the logarithm of the voltage over its mean (N,)."""
        return u[:, self.motors] / self.u_scale[self.motors], voltage_of(u, self.battery, self.u_mean)

    def _figure(self, axis: FittedAxis, name: str, index: int, unit: str, least: float = 0.0) -> AxisFigure:
        value = float(axis.theta[index])
        known = index in axis.free
        half = Z95 * float(np.sqrt(max(axis.covariance[index, index], 0.0))) if known else np.nan
        return AxisFigure(name, value, unit, half, max(abs(value), least))

    def _battery_figures(self, output: int) -> list[AxisFigure]:
        """The power of the voltage, and what it means where the battery has lost a tenth."""
        axis = self.axes[output]
        power = self._figure(axis, "power of the battery's voltage", len(axis.theta) - 1, "", least=1.0)
        if not power.is_determined:
            return [power]
        mean = float(self.u_mean[self.battery])
        low = 0.9 * mean
        ratio, half = self.hover_command(low, output)
        name = f"commands for the same thrust at {low:.4g} V, over those at {mean:.4g} V"
        return [power, AxisFigure(name, ratio, "", half, ratio)]

    def coefficients(self) -> list[Coefficient]:
        """Every figure that these flights determine."""
        return [
            Coefficient("", output.name, f.name, f.value, f.half_width)
            for i, output in enumerate(self.outputs)
            for f in self.figures(i)
            if f.is_determined
        ]

    # -- the laws ----------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first measured output; motors begin at the first command.

        From standing motors and zero outputs when y0 is None.

        Raises
        ------
        UsageError : shapes do not fit the model.
        """
        u = as_columns(u, len(self.inputs), "u")
        n_y = len(self.outputs)
        if y0 is None:
            first = np.zeros((1, n_y))
        else:
            first = as_columns(y0, n_y, "y0")[:1]
            check_start(len(first), min(1, len(u)))
        if not len(u):
            return np.zeros((0, n_y))
        x, volts = self._driven(u)
        columns = [
            free_run(x, first[0, i] / self.y_scale[i], a.theta, self.dt_s, kind, y0 is None, volts)
            for i, (a, kind) in enumerate(zip(self.axes, self.integrates, strict=True))
        ]
        out = saturate(np.column_stack(columns) * self.y_scale, self.output_limits)
        if y0 is not None:
            out[0] = first[0]
        return out

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) prediction from outputs at least k steps old; the first k rows are NaN.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        out = np.full(y.shape, np.nan)
        if len(y) <= k:
            return out
        x, volts = self._driven(u)
        for i, (axis, kind) in enumerate(zip(self.axes, self.integrates, strict=True)):
            scaled = y[:, i] / self.y_scale[i]
            ahead = steps_ahead(x, scaled, axis.theta, self.dt_s, kind, k, volts)
            out[k:, i] = ahead[k:] * self.y_scale[i]
        return out

    def rules(self) -> tuple[Rule, ...]:
        """One rule that always holds: physics."""
        words = "; ".join(
            f"{o.name}: " + ", ".join(str(f) for f in self.figures(i) if f.is_determined)
            for i, o in enumerate(self.outputs)
        )
        gain = np.full((len(self.outputs), len(self.inputs)), np.nan)
        slow = 0.0
        for i, axis in enumerate(self.axes):
            push = np.full(len(self.inputs), np.nan)
            push[self.motors] = self._torques(axis) * self._effects(i)[0]
            damping = float(axis.theta[DAMPING])
            if not self.integrates[i]:
                gain[i] = push
                slow = max(slow, float(axis.theta[LAG]))
            elif damping > 0.0:
                gain[i] = push / damping
                slow = max(slow, 1.0 / damping)
            else:
                slow = np.inf
        radius = float(np.exp(-self.dt_s / slow)) if slow > 0.0 else 0.0
        return (Rule("R1", "always", words, gain, slow, radius, 1.0),)

    def __str__(self) -> str:
        lines = [f"physical model, {counted(self.n_parameters, 'parameter')}, sample time {self.dt_s:g} s"]
        for i, output in enumerate(self.outputs):
            kind = "a rate" if self.integrates[i] else "an acceleration"
            lines += ["", f"{output.name}, {kind}", *(f"  {f}" for f in self.figures(i))]
        return "\n".join(lines)

    # -- storage -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **head_of(self),
            "output_limits": self.output_limits.tolist(),
            "integrates": list(self.integrates),
            "theta": [a.theta.tolist() for a in self.axes],
            "free": [list(a.free) for a in self.axes],
            "covariance": [with_null(a.covariance) for a in self.axes],
            "u_scale": self.u_scale.tolist(),
            "u_mean": self.u_mean.tolist(),
            "y_scale": self.y_scale.tolist(),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON; `flysid.load` reads it."""
        write_document(self.to_dict(), path)


def from_dict(document: Mapping[str, Any]) -> FittedMultirotor:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError."""
    inputs = signals_of(document, "inputs")
    if sum(is_voltage(signal) for signal in inputs) > 1:
        raise ValueError("two voltages")
    outputs = signals_of(document, "outputs")
    dt_s = float(document["dt_s"])
    size = FIRST + len(inputs)  # a torque for every command; the power of an input in volts
    theta = array_of(document, "theta", len(outputs), size)
    kinds = tuple(bool(k) for k in document["integrates"])
    axes = []
    for row, free, covariance, kind in zip(
        theta, document["free"], document["covariance"], kinds, strict=True
    ):
        if not (row[LAG] > 0.0 and 0.0 <= row[DELAY] < 1e6 * dt_s and row[DAMPING] >= 0.0):
            raise ValueError("an impossible lag, dead time or drag")
        if not forgets(row, dt_s, kind):
            raise ValueError("its predictor never forgets")
        table = np.array(covariance, dtype=np.float64).reshape(size, size)
        axes.append(FittedAxis(row, tuple(int(i) for i in free), table))
    scales = {key: array_of(document, key, len(inputs)) for key in ("u_scale", "u_mean")}
    y_scale = array_of(document, "y_scale", len(outputs))
    if not ((scales["u_scale"] > 0.0).all() and (y_scale > 0.0).all()):
        raise ValueError("a scale that is not positive")
    return FittedMultirotor(
        dt_s=dt_s,
        inputs=inputs,
        outputs=outputs,
        output_limits=array_of(document, "output_limits", 2, len(outputs)),
        integrates=kinds,
        axes=tuple(axes),
        y_scale=y_scale,
        **scales,
    )
