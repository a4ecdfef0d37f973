"""Gains under the names and in the units of a firmware, and its parameter files.

Names changed where units did, so that a name tells the unit: PX4's MPC_XY_VEL_P_ACC asks for acceleration
(MPC_XY_VEL_P asked for thrust), ArduCopter's PSC_VELXY_P became PSC_NE_VEL_P in 4.7. Acceleration becomes
tilt by a = g tan(tilt), for small tilts. tum_ardrone's terms act on position and velocity:

    tilt / limit = agressiveness (Kp e - Kd v + Ki integral of e)

Sources: PX4 mc_pos_control parameters and PositionControl; ArduPilot AC_PosControl and AC_PID_2D; the
configuration of tum_ardrone.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.constants import g

from flysid.dataset import FloatArray
from flysid.design.law import Gains
from flysid.errors import DataError, UsageError
from flysid.loops.new_settings import read_settings

SAFETY = (
    "Calculated from a model of past flights; not tested on your vehicle. Margins hold for the models "
    "listed, below saturation. Fly first in SITL; then in calm air, high, with a switch back to the old "
    "gains and one axis at a time. Do not fly gains that you could not explain."
)
Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Scheme:
    """One firmware's way to state these gains.

    `words`: firmware and versions, for people.
    `names`: gain -> parameter.
    `optional`: gain -> parameter and the value where a vehicle does not state it.
    `in_acceleration`: velocity, integral and derivative are m/s^2, not the channel's input.
    `shared`: one set of gains for both horizontal axes.
    `on_error`: see `Gains`.
    `published`: gains that are published with the firmware.
    """

    words: str
    names: Mapping[str, str]
    optional: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    in_acceleration: bool = False
    shared: bool = False
    on_error: bool = False
    published: Mapping[str, float] = field(default_factory=dict)


SCHEMES: Mapping[str, tuple[Scheme, ...]] = {
    "pid": (
        Scheme(
            "a position loop in the channel's own units",
            {name: name for name in ("position", "velocity")},
            {"integral": ("integral", 0.0), "derivative": ("derivative", 0.0), "cut_hz": ("cut_hz", 5.0)},
        ),
    ),
    "px4": (
        Scheme(
            "PX4 whose velocity gains end in _ACC",
            {
                "position": "MPC_XY_P",
                "velocity": "MPC_XY_VEL_P_ACC",
                "integral": "MPC_XY_VEL_I_ACC",
                "derivative": "MPC_XY_VEL_D_ACC",
            },
            {"cut_hz": ("MPC_VELD_LP", 5.0)},
            in_acceleration=True,
            shared=True,
        ),
    ),
    "ardupilot": tuple(
        Scheme(
            words,
            {
                "position": f"PSC_{a}_P",
                "velocity": f"PSC_{b}_P",
                "integral": f"PSC_{b}_I",
                "derivative": f"PSC_{b}_D",
            },
            {"cut_hz": (f"PSC_{b}_FLTD", 5.0), "error_hz": (f"PSC_{b}_FLTE", 5.0)},
            in_acceleration=True,
            shared=True,
            on_error=True,
        )
        for words, a, b in (
            ("ArduCopter 4.7 and later", "NE_POS", "NE_VEL"),
            ("ArduCopter 4.0 to 4.6", "POSXY", "VELXY"),
        )
    ),
    "tum-ardrone": (
        Scheme(
            "tum_ardrone's autopilot",
            {"position": "Kp_rp", "velocity": "Kd_rp", "integral": "Ki_rp"},
            {"agressiveness": ("agressiveness", 1.0)},
            shared=True,
            published={"Kp_rp": 0.5, "Kd_rp": 0.35, "Ki_rp": 0.0, "agressiveness": 1.0},
        ),
    ),
}


@dataclass(frozen=True)
class Firmware:
    """A scheme on one channel: per what the channel's input is counted in.

    `tilt_per_g`: of the channel's input for an acceleration of one g, small tilts.
    `limit`: of the channel's input.
    """

    name: str
    scheme: Scheme
    tilt_per_g: float = math.nan
    limit: float = math.nan

    @property
    def _unit(self) -> float:
        """Channel's input per unit of the firmware's velocity gain."""
        if self.name == "tum-ardrone":
            return self.limit
        return self.tilt_per_g / g if self.scheme.in_acceleration else 1.0

    def gains(self, stated: Parameters) -> Gains:
        """From parameters. Raises DataError: parameters are missing, or state no such loop."""
        missing = [name for name in self.scheme.names.values() if name not in stated]
        if missing:
            raise DataError(
                f"the parameters lack {', '.join(missing)} of {self.scheme.words}",
                hint="give the vehicle's parameter file: --old FILE",
            )
        values = {gain: float(stated[name]) for gain, name in self.scheme.names.items()}
        more = {gain: stated.get(name, value) for gain, (name, value) in self.scheme.optional.items()}
        if not all(math.isfinite(v) and v >= 0.0 for v in (*values.values(), *more.values())):
            raise DataError(f"gains of {self.scheme.words} are finite and not negative: {values}")
        if self.name == "tum-ardrone":
            return self._from_tum(values, more["agressiveness"])
        for gain in ("velocity", "integral", "derivative"):
            if gain in values:
                values[gain] *= self._unit
        return Gains(**values, **more, on_error=float(self.scheme.on_error))

    def _from_tum(self, values: Mapping[str, float], agressiveness: float) -> Gains:
        """Kp e - Kd v + Ki integral e is a cascade: position (Kd position) = Kp - integral, and so on."""
        p, d, i = (agressiveness * self._unit * values[k] for k in ("position", "velocity", "integral"))
        inside = p * p - 4.0 * d * i
        if d <= 0.0 or inside < 0.0:
            raise DataError(
                "tum_ardrone's gains are no position loop around a velocity loop: Kd or Ki is off"
            )
        position = (p + math.sqrt(inside)) / (2.0 * d)
        return Gains(position, d, i / position)

    def stated(self, gains: Gains, old: Parameters) -> dict[str, float]:
        """As parameters; those that the gains do not touch are left out."""
        told = self._told(gains.tuned()[None], old.get("agressiveness", 1.0))
        return {name: float(f"{values[0]:.5g}") for name, values in told.items()}

    def beyond(self, tuned: FloatArray, old: Parameters, factor: float) -> FloatArray:
        """(S,) how far the parameters of (S, 5) gains move by more than a factor from the old; 0 inside."""
        told = self._told(tuned, old.get("agressiveness", 1.0))
        ways = [
            np.abs(np.log(np.maximum(values, 1e-12) / old[name])) - math.log(factor)
            for name, values in told.items()
            if old.get(name, 0.0) > 0.0
        ]
        return np.asarray(np.maximum(np.max(ways, axis=0, initial=0.0), 0.0))

    def _told(self, tuned: FloatArray, agressiveness: float) -> dict[str, FloatArray]:
        """Parameters of (S, 5) gains, (S,) each."""
        position, velocity, integral, derivative = (tuned[:, k] for k in range(4))
        unit = self._unit
        if self.name == "tum-ardrone":
            unit *= agressiveness
            numbers = {
                "position": (velocity * position + integral) / unit,
                "velocity": velocity / unit,
                "integral": integral * position / unit,
            }
        else:
            numbers = {
                "position": position,
                "velocity": velocity / unit,
                "integral": integral / unit,
                "derivative": derivative / unit,
            }
        names = {**self.scheme.names, **{k: name for k, (name, _) in self.scheme.optional.items()}}
        return {names[k]: np.asarray(v) for k, v in numbers.items() if k in names}


def firmware_for(name: str, stated: Parameters, input_unit: str, limit: float | None) -> Firmware:
    """The scheme of a firmware that a vehicle's parameters belong to.

    `stated`: the present parameters; the first scheme where there are none.
    `input_unit`: of the channel.
    `limit`: of the channel's input, where the firmware counts in shares of it.
    Raises DataError: the parameters are of a version that is not known here. Raises UsageError: the channel's
    input is no tilt, or a limit is needed and not given.
    """
    schemes = SCHEMES[name]
    fitting = [s for s in schemes if not stated or set(s.names.values()) <= set(stated)]
    if not fitting:
        known = "; ".join(f"{s.words}: {', '.join(s.names.values())}" for s in schemes)
        raise DataError(f"the parameters match no known version of {name}", hint=f"known are {known}")
    per_g = {"deg": math.degrees(1.0), "rad": 1.0}.get(input_unit, math.nan)
    if fitting[0].in_acceleration and math.isnan(per_g):
        raise UsageError(
            f"{name} asks for acceleration, and the channel's input is in {input_unit or 'no unit'}",
            hint="give a channel from tilt (deg or rad) to velocity",
        )
    if name == "tum-ardrone" and limit is None:
        raise UsageError(
            "tum_ardrone counts tilt in shares of its limit", hint="--limit 12 (euler_angle_max, in deg)"
        )
    return Firmware(name, fitting[0], per_g, math.nan if limit is None else limit)


def read_parameters(path: Path) -> dict[str, float]:
    """Names and values of a parameter file: Mission Planner, QGroundControl, or NAME VALUE lines.

    Raises UsageError: no such file. Raises DataError: a line is not a parameter, or a name stands twice with
    two values.
    """
    return {name: float(value) for name, value in read_settings(path, numbers=True).items()}


def parameter_file(values: Parameters, head: tuple[str, ...]) -> str:
    """NAME VALUE lines below comments, as both ground stations read them."""
    comments = [f"# {line}" for words in head for line in textwrap.wrap(words, 100)]
    return "\n".join([*comments, *(f"{name} {value:.6g}" for name, value in values.items())]) + "\n"
