"""The outer loop whose gains are designed: position to velocity to the input of the identified channel.

    wanted velocity  w = position (r - p)  [+ r', with feed-forward]
    input            u = velocity (w - v) + integral of (w - v) - derivative v' + feedforward r'

as PX4, ArduPilot and others compute it, sampled at the model's rate: backward Euler for the integral,
first-order filters. ArduPilot filters w - v and takes its slope instead of that of v. The integral stands
still while the input is at its limit and the error would drive it further.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray

ComplexArray = npt.NDArray[np.complex128]
TUNED = ("position", "velocity", "integral", "derivative", "cut_hz")


@dataclass(frozen=True)
class Gains:
    """Gains in the channel's own units.

    `position`: 1/s, wanted velocity per error of position.
    `velocity`: input per m/s.
    `integral`: input per m/s and second.
    `derivative`: input per m/s^2.
    `cut_hz`: of the derivative's filter.
    `error_hz`: of the filter on the error of velocity; 0 for none.
    `on_error`: 1 where the derivative is that of the error of velocity, 0 where it is that of the velocity.
    `feedforward`: input per m/s of the reference; where it is not 0 the reference's velocity is wanted, too.

    >>> Gains(1.4, 4.2).times(2.0).velocity
    8.4
    """

    position: float
    velocity: float
    integral: float = 0.0
    derivative: float = 0.0
    cut_hz: float = 5.0
    error_hz: float = 0.0
    on_error: float = 0.0
    feedforward: float = 0.0

    def times(self, factor: float) -> Gains:
        """The input that much larger for the same errors: position, a speed per distance, stays."""
        names = ("velocity", "integral", "derivative", "feedforward")
        return replace(self, **{name: factor * getattr(self, name) for name in names})

    def tuned(self) -> FloatArray:
        """(5,) what a search may move."""
        return np.array([getattr(self, name) for name in TUNED])

    def packed(self) -> FloatArray:
        """(8,) all of them, for compiled code."""
        return np.array([getattr(self, f.name) for f in fields(self)])

    def to_dict(self) -> dict[str, float]:
        """JSON types only."""
        return asdict(self)


def keeping(cut_hz: npt.ArrayLike, dt_s: float) -> FloatArray:
    """Share of the old value that a first-order filter keeps a sample; 0 where there is none."""
    cut = np.asarray(cut_hz, dtype=np.float64)
    return np.where(cut > 0.0, np.exp(-2.0 * np.pi * cut * dt_s), 0.0)


@dataclass(frozen=True, eq=False)
class LoopParts:
    """(F,) responses of what a loop is made of, at omega in rad/s, computed every dt_s.

    `back`: one sample earlier.
    `place`: the vehicle's position over its velocity, by the trapezoidal rule.
    `total`: the controller's integral.
    """

    dt_s: float
    omega: FloatArray
    back: ComplexArray
    place: ComplexArray
    total: ComplexArray

    @classmethod
    def at(cls, omega: FloatArray, dt_s: float) -> LoopParts:
        """At these frequencies."""
        z = np.exp(1j * omega * dt_s)
        return cls(dt_s, omega, 1.0 / z, 0.5 * dt_s * (z + 1.0) / (z - 1.0), dt_s * z / (z - 1.0))

    def filtered(self, cut_hz: npt.ArrayLike) -> ComplexArray:
        """Of a first-order filter; shape of cut_hz followed by (F,)."""
        keep = keeping(cut_hz, self.dt_s)[..., None]
        return np.asarray((1.0 - keep) / (1.0 - keep * self.back))

    def slope(self, cut_hz: npt.ArrayLike) -> ComplexArray:
        """Of a filtered difference; shape of cut_hz followed by (F,)."""
        return np.asarray(self.filtered(cut_hz) * (1.0 - self.back) / self.dt_s)
