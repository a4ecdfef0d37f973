"""Compare the plants of several flights: does the same controller output turn the vehicle as much?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.margins import trusted_band
from flysid.loops.stick_response import Loop, plant

PERCENT = 100.0


@dataclass(frozen=True)
class Sameness:
    """How the plants of one axis differ.

    `axis`: which.
    `is_same`: whether they differ by no more than their own scatter, or by less than matters.
    `largest`: the largest difference to all together, percent of the gain, with its sign.
    `flight`: whose that is.
    `band_hz`: where they were compared.
    """

    axis: str
    is_same: bool
    largest: float
    flight: str
    band_hz: tuple[float, float]

    @property
    def words(self) -> str:
        """For people."""
        low, high = self.band_hz
        where = f"between {low:.1f} and {high:.0f} Hz"
        if self.is_same:
            alike = f"its response alike to {abs(self.largest):.0f} %"
            return f"{self.axis}: the same vehicle in all, {alike} {where}"
        size = f"{abs(self.largest):.0f} % {'more' if self.largest > 0.0 else 'less'}"
        return f"{self.axis}: not the same vehicle, in {self.flight} it answers {size} {where}"

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "axis": self.axis,
            "same": self.is_same,
            "largest_percent": self.largest,
            "flight": self.flight,
            "band_hz": list(self.band_hz),
        }


def compare_plants(
    axis: str, loops: Sequence[tuple[str, Loop]], *, matters: float = 0.25, unlikely: float = 0.001
) -> Sameness | None:
    """Of flights whose loop is known, by name; None of fewer than two, or where no band is common to them.

    `matters`: difference of the gain from which on it may be another vehicle: batteries and air make less.
    `unlikely`: probability below which chance does not explain the differences.
    """
    known = [found for name, loop in loops if (found := _measure(name, loop)) is not None]
    if len(known) < 2:
        return None
    low, high = max(one.band_hz[0] for one in known), min(one.band_hz[1] for one in known)
    f = known[0].f
    at = (f >= low) & (f <= high)
    if at.sum() < 2 or any(len(one.f) != len(f) for one in known):
        return None
    means = np.array([one.level[at].mean() for one in known])
    spreads = np.array([max(float(one.drawn[:, at].mean(axis=1).std()), 1e-6) for one in known])
    weights = 1.0 / spreads**2
    away = means - (weights * means).sum() / weights.sum()
    chance = float(chdtrc(len(known) - 1, float(((away / spreads) ** 2).sum())))
    worst = int(np.argmax(np.abs(away)))
    largest = float(np.expm1(away[worst]))
    same = chance >= unlikely or abs(largest) < matters
    return Sameness(axis, same, PERCENT * largest, known[worst].name, (float(low), float(high)))


@dataclass(frozen=True, eq=False)
class _Measured:
    """Of one flight: ln |G| (F,) and of its resampled ones (D, F), and the band in which it is known."""

    name: str
    f: FloatArray
    level: FloatArray
    drawn: npt.NDArray[np.float32]
    band_hz: tuple[float, float]


def _measure(name: str, loop: Loop) -> _Measured | None:
    """None where the sticks moved the vehicle too little. Spectra are made in a copy: they are large."""
    own = replace(loop)
    try:
        band = trusted_band(own)
    except DataError:
        return None
    tiny = np.finfo(np.float32).tiny
    level, drawn = (np.log(np.maximum(np.abs(plant(s)), tiny)) for s in (own.mean, own.draws))
    return _Measured(name, own.f, level, drawn.astype(np.float32), band)
