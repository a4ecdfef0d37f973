"""The demand of a flight on its rate loop: the error that another controller would leave, and its noise.

The error is setpoint less rate. Its part that the sticks make is (1 - T) r. The rest comes from the air and
the gyro, and another controller changes it as it changes the sensitivity 1 / (1 + G C).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import welch

from flysid.dataset import FloatArray
from flysid.loops.controller import Controller
from flysid.loops.known_axis import KnownAxis
from flysid.loops.stick_response import ComplexArray

WINDOW_S = 2.0
NOISE_FROM_HZ = 30.0
"""Above, sticks move little and a gyro is noise; in a slow log, in the upper half of what it shows."""
HIGHEST = 0.4
"""Of a log's rate, up to which it shows a signal."""


@dataclass(frozen=True, eq=False)
class Errors:
    """The last flight's errors, line by line.

    `f`: (F,) Hz, up to the end of the band.
    `plants`: (1 + D, F) the plant, and what else it may be.
    `misses`: (1 + D, F) of the law, see `KnownAxis`.
    `sticks`: (F,) power of the setpoint.
    `rest`: (1 + D, F) power of the error that the setpoint does not make, times |1 + G C|^2 as it flew.
    """

    f: FloatArray
    plants: ComplexArray
    misses: ComplexArray
    sticks: FloatArray
    rest: FloatArray

    @classmethod
    def of(cls, known: KnownAxis) -> Errors:
        """Of the last flight, with the law that flew it."""
        f, sticks, errors = powers(known, known.band_hz[1])
        plants, law = _plants(known, f), known.last.controller
        misses = known.misses_at(f)
        left, turned = _loops(plants, misses, law.feedback(f), law.reference(f))
        rest = np.maximum(errors - np.abs(left) ** 2 * sticks, 0.0) * np.abs(turned) ** 2
        return cls(f, plants, misses, sticks, rest)

    def under(self, controller: Controller) -> FloatArray:
        """(1 + D,) deg/s, root mean square, of every plant."""
        return self.between(controller.feedback(self.f), controller.reference(self.f))

    def of_plant(self) -> Errors:
        """Those of the plant alone."""
        return replace(self, plants=self.plants[:1], misses=self.misses[:1], rest=self.rest[:1])

    def between(self, back: ComplexArray, forward: ComplexArray) -> FloatArray:
        """As `under`, of a controller's answers (F,) to the rate and to the setpoint."""
        left, turned = _loops(self.plants, self.misses, back, forward)
        power = np.abs(left) ** 2 * self.sticks + self.rest / np.abs(turned) ** 2
        return np.asarray(np.sqrt(power.sum(axis=1) * (self.f[1] - self.f[0])))


def powers(known: KnownAxis, up_to_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(F,) Hz above 0, and the power of setpoint and error of the last flight there."""
    record = known.last.record
    size = round(WINDOW_S * record.rate_hz)
    pieces = [piece for piece in record.pieces if piece.shape[1] >= size]
    found = [
        np.array([welch(x, record.rate_hz, nperseg=size)[1] for x in (piece[0], piece[0] - piece[2])])
        for piece in pieces
    ]
    sticks, errors = np.average(found, axis=0, weights=[piece.shape[1] for piece in pieces])
    f = np.asarray(np.fft.rfftfreq(size, 1.0 / record.rate_hz), dtype=np.float64)
    at = (f > 0.0) & (f <= up_to_hz)
    return f[at], sticks[at], errors[at]


def _plants(known: KnownAxis, f: FloatArray) -> ComplexArray:
    """(1 + D, F) measured inside the band, fitted below it."""
    fitted, draws = known.everywhere(f)
    found = np.vstack([fitted, draws])
    inside = np.isin(f, known.f)
    found[:, inside] = np.vstack([known.centre, known.draws])[:, np.isin(known.f, f)]
    return found


def _loops(
    plants: ComplexArray, misses: ComplexArray, back: ComplexArray, forward: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """(1 + D, F) 1 - T and 1 + G C."""
    turned = 1.0 + plants * back
    return np.asarray(1.0 - misses * plants * forward / turned), np.asarray(turned)


@dataclass(frozen=True, eq=False)
class Noise:
    """The last flight's gyro above what the sticks move.

    `f`: (F,) Hz.
    `plants`: (1 + D, F), see `KnownAxis.everywhere`.
    `rate`: (1 + D, F) power of the rate, times |1 + G C|^2 as it flew: what a loop that is open would see.
    `others`: (1 + D,) what the noise of another stretch of flight is of this one's.
    """

    f: FloatArray
    plants: ComplexArray
    rate: FloatArray
    others: FloatArray

    @classmethod
    def of(cls, known: KnownAxis) -> Noise:
        """Of the last flight."""
        loop, record = known.last.loop, known.last.record
        step_s = 1.0 / record.rate_hz
        high = HIGHEST * record.rate_hz
        at = (loop.f >= min(NOISE_FROM_HZ, 0.5 * high)) & (loop.f < high)
        f = loop.f[at]
        power = loop.mean[2, 2][at].real / np.abs(1.0 - np.exp(-2j * np.pi * f * step_s)) ** 2
        plants = np.vstack([part.reshape(-1, len(f)) for part in known.everywhere(f)])
        turned = np.abs(1.0 + plants * known.last.controller.feedback(f)) ** 2
        back = np.abs(known.last.controller.feedback(f)) ** 2
        blocks = np.concatenate(loop.blocks)[:, 2, 2][:, at].real
        sizes = np.log((blocks * back * power / loop.mean[2, 2][at].real).sum(axis=1))
        scatter = 0.5 * sizes.std() * np.random.default_rng(0).standard_normal(len(plants))
        scatter[0] = 0.0
        return cls(f, plants, power * turned, np.exp(scatter))

    def under(self, controller: Controller) -> FloatArray:
        """(1 + D,) root mean square of the controller's output, in units that two controllers share."""
        return self.between(controller.feedback(self.f))

    def of_plant(self) -> Noise:
        """That of the plant alone."""
        return replace(self, plants=self.plants[:1], rate=self.rate[:1], others=self.others[:1])

    def between(self, back: ComplexArray) -> FloatArray:
        """As `under`, of a controller's answer (F,) to the rate."""
        return np.asarray(np.sqrt((np.abs(back / (1.0 + self.plants * back)) ** 2 * self.rate).sum(axis=1)))
