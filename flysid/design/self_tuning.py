"""A PD whose two gains rules change in flight, by the error and how fast it falls.

    u = Kp e - Kd v,    e = r - p,    Kp, Kd between a low and a high end

The rules, their fuzzy sets and the way they are put together are those of fuzzy gain scheduling (Zhao,
Tomizuka and Isaka, IEEE Trans. SMC 23(5), 1993) without its integral: seven triangles for the error, seven
for its slope, 49 rules that call either gain small or big, grades by the product. It is there to compare:
no design proposes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.design.law import Gains
from flysid.errors import UsageError

SETS = 7
KP_RULES = np.array(
    [list(row) for row in ("BBBBBBB", "SBBBBBS", "SSBBBSS", "SSSBSSS", "SSBBBSS", "SBBBBBS", "BBBBBBB")]
) == "B"  # fmt: skip
"""Whether Kp is big: a row for each set of the error, from large negative to large positive, by its slope."""
KD_RULES = np.array(
    [list(row) for row in ("SSSSSSS", "BBSSSBB", "BBBSBBB", "BBBBBBB", "BBBSBBB", "BBSSSBB", "SSSSSSS")]
) == "B"  # fmt: skip


@dataclass(frozen=True)
class Tuner:
    """The ends of both gains, and the error and speed at which the outer sets stand.

    `kp`: input per m. `kd`: input per m/s.
    `error_m`, `speed_m_s`: beyond them the outermost sets hold.
    """

    kp: tuple[float, float]
    kd: tuple[float, float]
    error_m: float
    speed_m_s: float

    def __post_init__(self) -> None:
        if not (0.0 < self.kp[0] <= self.kp[1] and 0.0 < self.kd[0] <= self.kd[1]):
            raise UsageError("the ends of a gain are above 0, the lower one first")
        if not (self.error_m > 0.0 and self.speed_m_s > 0.0):
            raise UsageError("an error or a speed that is not above 0")

    def packed(self) -> FloatArray:
        """(6,) for compiled code."""
        return np.array([*self.kp, *self.kd, self.error_m, self.speed_m_s])

    def laws(self) -> list[Gains]:
        """The fixed laws at the ends and in the middle of both gains."""
        ends = [(low, 0.5 * (low + high), high) for low, high in (self.kp, self.kd)]
        return [Gains(kp / kd, kd) for kp, kd in product(*ends)]


def packed_tuners(tuners: Sequence[Tuner | None]) -> FloatArray:
    """(L, 6); zeros where the gains stand still."""
    return np.array([np.zeros(6) if tuner is None else tuner.packed() for tuner in tuners])


@njit(cache=True)
def tuned_gains(error, slope, numbers):  # type: ignore[no-untyped-def]
    """Kp and Kd at an error and its slope.

    A rule of grade m says exp(-4 m) of the way from low to high where it calls a gain small, 1 - exp(-4 m)
    where it calls it big: logarithmic sets, read backwards. Grades sum to 1, and weight what rules say.
    """
    kp_low, kp_high, kd_low, kd_high, error_span, slope_span = numbers
    places = (
        min(max(error / error_span, -1.0), 1.0) * 0.5 * (SETS - 1) + 0.5 * (SETS - 1),
        min(max(slope / slope_span, -1.0), 1.0) * 0.5 * (SETS - 1) + 0.5 * (SETS - 1),
    )
    kp = 0.0
    kd = 0.0
    for i in range(SETS):
        of_error = max(0.0, 1.0 - abs(places[0] - i))
        for j in range(SETS):
            grade = of_error * max(0.0, 1.0 - abs(places[1] - j))
            if grade > 0.0:
                small = np.exp(-4.0 * grade)
                kp += grade * (1.0 - small if KP_RULES[i, j] else small)
                kd += grade * (1.0 - small if KD_RULES[i, j] else small)
    return kp_low + (kp_high - kp_low) * kp, kd_low + (kd_high - kd_low) * kd
