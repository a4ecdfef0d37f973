"""Does a vehicle oscillate by itself? A body rate of one frequency, while its setpoint is quiet there.

The fastest gyro of the log is looked at. Below twice the highest frequency at which loops oscillate, the log
folds: what shows at one frequency may be another, and all that it may be are named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.follow import Counting, means
from flysid.reviews.logged import BoolArray, Column, LoggedFlight
from flysid.reviews.pairs import recipe_of

SLOWEST_HZ, FASTEST_HZ = 3.0, 50.0
"""Between which the loops of multirotors oscillate: below, a pilot does; above, rotors shake."""
MANOEUVRES_HZ = 1.0
"""What is slower is flown, and counts on neither side."""


@dataclass(frozen=True)
class Oscillation:
    """Of one body rate.

    `address`, `rate_hz`: of the gyro that shows it.
    `rms`: deg/s, in the windows in which it oscillates, in a narrow band; 0 where it does in none.
    `share`: of the windows.
    `frequency_hz`: as it shows in this log.
    `at_s`: where it is largest.
    """

    address: str
    rate_hz: float
    rms: float = 0.0
    share: float = 0.0
    frequency_hz: float = float("nan")
    at_s: float | None = None

    @property
    def is_unfolded(self) -> bool:
        """Its frequency is the one that shows: nothing as fast as loops oscillate is folded."""
        return self.rate_hz >= 2.0 * FASTEST_HZ

    @property
    def candidates(self) -> str:
        """ "10, 15 or 35 Hz": all that it may be."""
        *some, last = (f"{hz:.0f}" for hz in self.may_be_hz)
        return f"{', '.join(some)} or {last} Hz" if some else f"{last} Hz"

    @property
    def may_be_hz(self) -> tuple[float, ...]:
        """Frequencies up to `FASTEST_HZ` that show at this one: several where the log folds."""
        if not self.rms:
            return ()
        folds = range(round(FASTEST_HZ / self.rate_hz) + 1)
        every = {abs(n * self.rate_hz + sign * self.frequency_hz) for n in folds for sign in (-1, 1)}
        return tuple(sorted(hz for hz in every if SLOWEST_HZ <= hz <= FASTEST_HZ))


def fastest_gyro(flight: LoggedFlight, axis: str, known: Column | None = None) -> Column | None:
    """The body rate of an axis that was logged fastest.

    `known` may be it; where it is fast enough, no other is looked for.
    """
    if known is not None and known.rate_hz >= 2.0 * FASTEST_HZ:
        return known
    spec = recipe_of("rotorcraft-motors").signals[f"{axis}_rate"]
    every = (known, *(flight.signal(replace(spec, sources=(source,))) for source in spec.sources))
    return max((found for found in every if found is not None), key=lambda c: c.rate_hz, default=None)


def oscillation(
    gyro: Column,
    setpoint: Column,
    counts: Counting,
    *,
    window_s: float = 2.0,
    narrow: float = 0.5,
    quiet: float = 0.5,
    least: tuple[float, float] = (4.0, 15.0),
    least_windows: int = 3,
) -> Oscillation | None:
    """Whether a rate oscillates; None where there is too little flight to tell.

    `setpoint`: of this rate: what it does not hold is the vehicle's own.
    `narrow`: share that a narrow band must hold, of what is quicker than manoeuvres and not in the setpoint.
    `quiet`: the setpoint moves by less than this share of it.
    `least`: deg/s, root mean square: less does not count; and where the log folds, since the shaking of
        rotors may lie behind what it shows.
    `least_windows`: that must be there, and that must oscillate.
    """
    slow = means(gyro, 0.25 / FASTEST_HZ)
    windows = list(_windows(slow, setpoint, counts, window_s))
    if len(windows) < least_windows:
        return None
    floor = least[0] if gyro.rate_hz >= 2.0 * FASTEST_HZ else least[1]
    shaken = [
        w
        for w in windows
        if w.rms >= floor
        and w.frequency_hz >= SLOWEST_HZ
        and w.narrow >= narrow
        and w.wanted <= quiet * w.rms
    ]
    if len(shaken) < least_windows:
        return Oscillation(gyro.address, gyro.rate_hz)
    top = max(shaken, key=lambda w: w.rms)
    return Oscillation(
        gyro.address,
        gyro.rate_hz,
        float(np.sqrt(np.mean([w.rms**2 for w in shaken]))),
        len(shaken) / len(windows),
        float(np.median([w.frequency_hz for w in shaken])),
        top.at_s,
    )


@dataclass(frozen=True)
class _Window:
    """Middle, strongest frequency, what a band around it holds, and the setpoint there.

    `narrow` is the band's share of what the setpoint does not hold.
    """

    at_s: float
    frequency_hz: float
    rms: float
    narrow: float
    wanted: float


def _windows(
    gyro: Column, setpoint: Column, counts: Counting, window_s: float, least_samples: int = 16
) -> Iterator[_Window]:
    if not gyro.rate_hz:
        return
    size = max(round(window_s * gyro.rate_hz), least_samples)
    f = np.asarray(np.fft.rfftfreq(size, gyro.period_s), dtype=np.float64)
    inside = (f >= MANOEUVRES_HZ) & (f <= FASTEST_HZ)
    if inside.sum() < 2:
        return
    taper = np.hanning(size)
    for piece in gyro.pieces():
        flown = counts(piece.time_s)
        wanted = np.nan_to_num(setpoint.at(piece.time_s))
        for at in range(0, len(piece) - size + 1, max(size // 2, 1)):
            rows = slice(at, at + size)
            if flown[rows].all():
                both = (_power(piece.values[rows], taper), _power(wanted[rows], taper))
                yield _window(float(piece.time_s[at + size // 2]), f, inside, *both)


def _power(values: FloatArray, taper: FloatArray) -> FloatArray:
    """(F,) of a tapered window; its sum is the mean square of what the window holds beside its line."""
    n = np.arange(len(values))
    line = np.polynomial.polynomial.polyval(n, np.polynomial.polynomial.polyfit(n, values, 1))
    both_sides = 2.0 / (len(values) * float(taper @ taper))
    return np.asarray(both_sides * np.abs(np.fft.rfft((values - line) * taper)) ** 2)


def _window(
    at_s: float, f: FloatArray, inside: BoolArray, rate: FloatArray, wanted: FloatArray, lines: int = 2
) -> _Window:
    """`lines`: to either side of the strongest, as wide as the taper spreads one frequency."""
    own = np.where(inside, np.maximum(rate - wanted, 0.0), 0.0)
    k = int(np.argmax(own))
    band = slice(max(k - lines, 0), k + lines + 1)
    held = float(rate[band].sum())
    whole = float(own.sum())
    return _Window(
        at_s,
        float(f[k]),
        float(np.sqrt(held)),
        float(own[band].sum()) / whole if whole > 0.0 else 0.0,
        float(np.sqrt(wanted[band].sum())),
    )
