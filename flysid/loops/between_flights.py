"""How much the plants of an axis differ from flight to flight: battery, air, throttle, props.

Stretches of one flight share all of these, so their scatter does not show it. Gains do not change a linear
plant: flights under any gains show the scatter. A plant that does answer to gains, as at the motors' limits,
makes flights differ by more, and intervals wider.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from flysid.dataset import FloatArray
from flysid.loops.stick_response import ComplexArray, Loop

Curve = tuple[FloatArray, ComplexArray]
"""The lines of a flight's trusted band, Hz, and its smooth plant there."""


@dataclass(frozen=True, eq=False)
class FlightScatter:
    """What sets the plants of single flights apart from their mean.

    `f`: (F,) Hz, the band in which every flight's plant is known.
    `away`: (N, F) ln of a flight's plant over the flights' geometric mean.
    """

    f: FloatArray
    away: ComplexArray

    def moves(self, f: FloatArray, loop: Loop) -> ComplexArray:
        """(N, F) what the standard errors of a mean make of its plant at f, Hz, one flight after the other.

        The mean is that of the flights of `loop`, each as heavy as it is long. Beyond the common band the
        nearest line counts.
        """
        long = np.array([len(blocks) for blocks in loop.blocks], dtype=np.float64)
        share = np.sqrt(np.sum(long**2)) / np.sum(long)
        size, turn = (
            np.array([np.interp(f, self.f, row) for row in part]) for part in (self.away.real, self.away.imag)
        )
        return np.asarray(np.exp(share * (size + 1j * turn)))

    def reach(self, moved: FloatArray) -> FloatArray:
        """(M,) half the widths of 95 % intervals of figures that these moves change by (N, M)."""
        free = len(moved) - 1
        return np.asarray(stdtrit(free, 0.975) * np.sqrt(np.sum(moved**2, axis=0) / free))

    @classmethod
    def of(cls, every: Sequence[Curve], needed_hz: float) -> FlightScatter | None:
        """Of the flights whose plants are known up to `needed_hz`; None of fewer than two.

        A flight known below alone would say by its line at the end of its band what it does not know.
        """
        curves = [curve for curve in every if curve[0][-1] >= needed_hz]
        if len(curves) < 2:
            return None
        low, high = max(f[0] for f, _ in curves), min(f[-1] for f, _ in curves)
        f = curves[0][0]
        f = f[(f >= low) & (f <= high)]
        if not len(f):
            return None
        sizes = np.array([np.interp(f, own, np.log(np.abs(g))) for own, g in curves])
        turns = np.array([np.interp(f, own, np.unwrap(np.angle(g))) for own, g in curves])
        turns -= 2.0 * np.pi * np.round((turns - turns[0]).mean(axis=1, keepdims=True) / (2.0 * np.pi))
        logs = sizes + 1j * turns
        return cls(f, np.asarray(logs - logs.mean(axis=0)))
