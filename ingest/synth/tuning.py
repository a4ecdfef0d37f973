"""The inner loop's small motions against (10), (11) and (12): linearisation, Bode comparison, tuning.

The closed loop is linearised about hover by central differences; its frequency responses are exact for that
linear system. `tune` finds gains whose responses come nearest to the paper's, in the mean square of the
relative error over a band; the defaults of `inner_loop` are what it found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.ingest.synth.inner_loop import Axis, InnerLoop
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.quadrotor import INPUTS, STATES
from flysid.ingest.synth.rigid_body import SimulatedVehicle, closed_loop_rates

ComplexArray = npt.NDArray[np.complex128]

# Up to here the vehicle is promised to agree with the paper's loops, rad/s.
BANDWIDTH_RAD_S: Mapping[str, float] = {"longitudinal": 6.0, "lateral": 3.0, "vertical": 8.0}


@dataclass(frozen=True)
class Linear:
    """dx/dt = A x + B u, y = C x about hover: theta_in, phi_in (deg), vz_in to vx, vy (right), vz."""

    a: FloatArray
    b: FloatArray
    c: FloatArray

    def response(self, omega_rad_s: npt.ArrayLike) -> ComplexArray:
        """(N, 3, 3) outputs over inputs at j omega."""
        omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
        eye = np.eye(len(self.a))
        systems = 1j * omega[:, None, None] * eye - self.a
        return np.asarray(self.c @ np.linalg.solve(systems, self.b.astype(np.complex128)))


def linearise(
    vehicle: SimulatedVehicle, altitude_m: float = 20.0, around: FloatArray | None = None
) -> Linear:
    """Vehicle and inner loop about hover, in still air, on a full battery, without the link's delay.

    `around` is another state (26,): a vehicle heavier than its inner loop believes hovers elsewhere.
    """
    physics = vehicle.physics().packed()
    x0 = vehicle.hover(altitude_m) if around is None else around
    u0 = np.zeros(INPUTS)

    def slope(direction: FloatArray, on_input: bool, size: float) -> FloatArray:
        ends = []
        for step in (size * direction, -size * direction):
            x, u = (x0, u0 + step) if on_input else (x0 + step, u0)
            ends.append(closed_loop_rates(x, u, physics))
        return (ends[0] - ends[1]) / (2.0 * size)

    sizes = np.full(STATES, 1e-5)
    sizes[12:16] = 1e-3
    a = np.column_stack([slope(e, False, h) for e, h in zip(np.eye(STATES), sizes, strict=True)])
    b = np.column_stack([slope(e, True, 1e-5) for e in np.eye(INPUTS)[:3]])
    b[:, :2] *= np.pi / 180.0
    c = np.zeros((3, STATES))
    c[0, 3] = 1.0
    c[1, 4] = -1.0
    c[2, 5] = 1.0
    return Linear(a, b, c)


@dataclass(frozen=True, eq=False)
class Bode:
    """One loop of the vehicle beside the paper's, at (N,) frequencies.

    `gain_db` and `phase_deg` are differences, vehicle less paper; `relative` is |G_v / G_p - 1|.
    """

    omega_rad_s: FloatArray
    gain_db: FloatArray
    phase_deg: FloatArray
    relative: FloatArray


def compare_loop(vehicle: SimulatedVehicle, loop: str, omega_rad_s: npt.ArrayLike | None = None) -> Bode:
    """The Bode comparison of one loop, from 0.1 rad/s to its bandwidth unless frequencies are given."""
    omega = _band(loop) if omega_rad_s is None else np.asarray(omega_rad_s, dtype=np.float64)
    index = list(LOOPS).index(loop)
    ratio = linearise(vehicle).response(omega)[:, index, index] / LOOPS[loop].response(omega)
    return Bode(omega, 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio)), np.abs(ratio - 1.0))


def _band(loop: str, points: int = 60, *, lowest_rad_s: float = 0.1) -> FloatArray:
    return np.geomspace(lowest_rad_s, BANDWIDTH_RAD_S[loop], points)


def _with_axis(loop: InnerLoop, axis: str, gains: Axis) -> InnerLoop:
    return replace(loop, pitch=gains) if axis == "pitch" else replace(loop, roll=gains)


def tune(vehicle: SimulatedVehicle) -> InnerLoop:
    """Inner-loop gains whose small motions come nearest to (10) and (11); the climb loop needs none.

    The search starts at the vehicle's own gains and stays at positive ones. The roll axis keeps its lag: (11)
    has none to speak of.
    """
    from scipy.optimize import least_squares

    def fitted(loop: str, axis: str, names: tuple[str, ...]) -> Axis:
        start: Axis = getattr(vehicle.loop, axis)

        def changed(log_gains: FloatArray) -> Axis:
            return replace(start, **{n: float(g) for n, g in zip(names, np.exp(log_gains), strict=True)})

        def error(log_gains: FloatArray) -> FloatArray:
            tried = replace(vehicle, loop=_with_axis(vehicle.loop, axis, changed(log_gains)))
            return compare_loop(tried, loop).relative

        first = np.log([getattr(start, n) for n in names])
        return changed(least_squares(error, first, x_scale=0.3).x)

    pitch = fitted("longitudinal", "pitch", ("gain", "lag_s", "kp"))
    roll = fitted("lateral", "roll", ("gain", "kp", "ki", "leak_1_s"))
    return replace(vehicle.loop, pitch=pitch, roll=roll)
