"""The angle loop around a rate loop that is designed: its gain, as large as the new rate loop carries.

PX4 and ArduCopter ask for a rate of P times the angle's error. The loop is P T / s, with the rate loop's
response T to its setpoint.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.loops.controller import Controller
from flysid.loops.gain_bounds import QUANTILE, RateBounds
from flysid.loops.known_axis import KnownAxis
from flysid.loops.parameterlogs import parameters_of
from flysid.loops.stick_response import ComplexArray
from flysid.loops.tunable import FACTOR, Setting, own_law

STEPS = FACTOR ** (np.arange(8, -9, -1) / 8.0)
LINES = 300
LOWEST_SHARE = 0.02
"""Of the present gain's crossover, about gain / (2 pi): the lowest line."""


@dataclass(frozen=True)
class AngleLoop:
    """An angle loop under the present settings, and with the new ones.

    `name`, `old`, `new`: of the gain, 1/s.
    `peak`: largest answer of the angle to its setpoint, before and after, on 97.5 % of the plants.
    `crossover_hz`: before and after.
    """

    axis: str
    name: str
    old: float
    new: float
    peak: tuple[float, float]
    crossover_hz: tuple[float, float]

    def line(self) -> str:
        """For people."""
        gain = f"{self.old:g} -> {self.new:g}" if self.new != self.old else f"{self.old:g}"
        crossing = " -> ".join(f"{value:.2f}" for value in self.crossover_hz)
        peaks = " -> ".join(f"{value:.2f}" for value in self.peak)
        return f"{self.axis} angle: {self.name} {gain}, crossover {crossing} Hz, largest answer {peaks} times"

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return asdict(self)


def angle_loop(known: KnownAxis, controller: Controller, bounds: RateBounds) -> AngleLoop | None:
    """The angle loop around a rate loop under a controller; None where the log states no gain of it.

    The gain is the largest within a factor of two whose answer stays below the bound; the least, where none
    does. Raises DataError: the gain was changed in flight.
    """
    if "Firmware revision" in known.last.settings:
        return None
    law = own_law(known.last.settings)
    name = law.name_of("angle", axis=law.part("axes")[known.axis])
    stated = parameters_of(known.log, lambda other: other == name)
    if not stated.get(name, 0.0) > 0.0:
        return None
    gain = Setting(name, "angle", float(f"{stated[name]:.6g}"), False)
    f = np.geomspace(LOWEST_SHARE * gain.value / (2.0 * np.pi), known.band_hz[1], LINES)
    before = _answers(known, known.last.controller, f)
    after = _answers(known, controller, f)
    values = [float(gain.times(factor)) for factor in STEPS]
    new = next((value for value in values if _peak(value, after, f) <= bounds.angle_peak), values[-1])
    return AngleLoop(
        known.axis,
        name,
        gain.value,
        new,
        (_peak(gain.value, before, f), _peak(new, after, f)),
        (_crossover(gain.value, before, f), _crossover(new, after, f)),
    )


def _answers(known: KnownAxis, controller: Controller, f: FloatArray) -> ComplexArray:
    """(1 + D, F) of the rate to its setpoint."""
    fitted, draws = known.everywhere(f)
    plants = np.vstack([fitted, draws])
    closed = plants * controller.reference(f) / (1.0 + plants * controller.feedback(f))
    return np.asarray(known.misses_at(f) * closed)


def _peak(gain: float, answers: ComplexArray, f: FloatArray) -> float:
    loop = gain * answers / (2j * np.pi * f)
    return float(np.quantile(np.abs(loop / (1.0 + loop)).max(axis=1), QUANTILE))


def _crossover(gain: float, answers: ComplexArray, f: FloatArray) -> float:
    """Hz, of the plant that fits: where the loop's gain is last 1."""
    over = np.flatnonzero(np.abs(gain * answers[0] / (2.0 * np.pi * f)) >= 1.0)
    return float(f[over[-1]]) if len(over) else float(f[0])
