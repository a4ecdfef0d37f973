"""Peaks of a spectrum over its floor, and the frequencies that they may stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.spectra.spectrum import Windows


@dataclass(frozen=True)
class Peak:
    """A peak.

    `hz`, `interval`: where, and its 95 % interval.
    `height_db`: over the floor.
    `rms`: of what stands above the floor, in the signal's unit.
    `band`: from where to where it stands above twice the floor, Hz.
    `nyquist_hz`: half the rate of the stream: a faster tone shows below it.
    `cause`: words; "" where the log does not show it.
    `true_hz`: of the tone, where its cause shows that it lies above half the rate; else None.
    """

    hz: float
    interval: tuple[float, float]
    height_db: float
    rms: float
    band: tuple[float, float]
    nyquist_hz: float
    cause: str = ""
    true_hz: float | None = None

    def folded(self, highest_hz: float) -> tuple[float, ...]:
        """Frequencies above half the rate, up to the highest, of tones that would show here, too."""
        rate = 2.0 * self.nyquist_hz
        turns = np.arange(1, int(highest_hz / rate) + 2)
        found = np.concatenate([turns * rate - self.hz, turns * rate + self.hz])
        return tuple(float(hz) for hz in np.sort(found) if hz <= highest_hz)

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "hz": self.hz,
            "ci95": list(self.interval),
            "height_db": self.height_db,
            "rms": self.rms,
            "band_hz": list(self.band),
            "nyquist_hz": self.nyquist_hz,
            "folded_hz": list(self.folded(4.0 * self.nyquist_hz)),
            "cause": self.cause,
            "true_hz": self.true_hz,
        }


def fold(hz: FloatArray, rate_hz: float) -> FloatArray:
    """Where tones show in samples of this rate.

    >>> fold(np.array([15.0]), 25.0).tolist()
    [10.0]
    """
    return np.asarray(np.abs(hz - rate_hz * np.rint(np.asarray(hz) / rate_hz)))


def floor_of(density: FloatArray, octaves: float = 1.0) -> FloatArray:
    """(F,) the median of what lies within so many octaves on both sides, and at least 10 steps.

    Near zero, where spectra are steep, it is taken from as many steps on both sides as there are.
    """
    count = len(density)
    place = np.arange(count)
    reach = np.maximum(10, np.rint((place + 1) * (2.0**octaves - 1.0)).astype(np.int64))
    reach = np.minimum(reach, np.maximum(place, 4))
    ends = np.unique(np.rint(np.geomspace(1, count, 8 * int(np.log2(count + 1)) + 1)).astype(np.int64)) - 1
    logs = np.log(np.maximum(density, 1e-300))
    known = [np.median(logs[max(0, k - reach[k]) : k + reach[k] + 1]) for k in ends]
    return np.asarray(np.exp(np.interp(place, ends, known)))


def peaks_of(
    windows: Windows,
    *,
    lowest_hz: float = 0.0,
    by_chance: float = 0.01,
    least_db: float = 6.0,
    faintest_db: float = 30.0,
    most: int = 5,
) -> list[Peak]:
    """The peaks of a signal's spectrum, the strongest first.

    A peak stands so high over the floor that noise alone would do so anywhere in this spectrum with the
    probability `by_chance`, and at least `least_db`.

    `lowest_hz`: below it, what moves is the vehicle.
    `faintest_db`: below the highest peak, smaller ones are what the windows make of it.
    `most`: of them.
    """
    density, hz = windows.mean, windows.hz
    if len(hz) < 16:
        return []
    floor = floor_of(density)
    over_db = 10.0 * np.log10(np.maximum(density, np.finfo(float).tiny) / floor)  # 0 of a field that stands
    threshold = max(least_db, _by_chance_db(windows.freedom, by_chance / len(hz)))
    inner = np.flatnonzero((density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])) + 1
    found: list[Peak] = []
    faintest = 0.0
    taken = np.zeros(len(hz), dtype=bool)
    for k in sorted(inner.tolist(), key=lambda k: -density[k]):
        if hz[k] < lowest_hz or over_db[k] < threshold or taken[k] or density[k] < faintest:
            continue
        faintest = max(faintest, density[k] * 10.0 ** (-faintest_db / 10.0))
        low, high = _foot(density, floor, k)
        taken[low : high + 1] = True
        excess = np.maximum(density[low : high + 1] - floor[low : high + 1], 0.0).sum() * windows.step_hz
        at, interval = _place(windows, k)
        found.append(
            Peak(
                at,
                interval,
                float(over_db[k]),
                float(np.sqrt(excess)),
                (float(hz[low]), float(hz[high])),
                windows.nyquist_hz,
            )
        )
        if len(found) == most:
            break
    return sorted(found, key=lambda peak: -peak.rms)


PARABOLA = 0.016
"""Of a step: by how much a parabola through the logarithms of a Hann window's top is off at most."""


def _by_chance_db(freedom: float, probability: float) -> float:
    """By how much a mean of so many degrees of freedom lies above its median with this probability."""
    from scipy.special import chdtri

    return float(10.0 * np.log10(chdtri(freedom, probability) / chdtri(freedom, 0.5)))


def _foot(density: FloatArray, floor: FloatArray, k: int) -> tuple[int, int]:
    """First and last frequency of a peak: down to twice its floor."""
    low = high = k
    while low > 0 and density[low - 1] > 2.0 * floor[low - 1]:
        low -= 1
    while high < len(density) - 1 and density[high + 1] > 2.0 * floor[high + 1]:
        high += 1
    return low, high


def _place(windows: Windows, k: int, draws: int = 50) -> tuple[float, tuple[float, float]]:
    """Frequency of a peak between the steps, and its interval: how much it moves from draw to draw.

    What the parabola is off is part of it.
    """
    reach = slice(max(0, k - 5), k + 6)
    near = windows.density[:, reach]
    rng = np.random.default_rng(k)
    weights = rng.multinomial(len(near), np.full(len(near), 1.0 / len(near)), size=draws) / len(near)
    places = reach.start + _tops(weights @ near)
    at = windows.hz[0] * (1.0 + reach.start + _tops(windows.mean[None, reach])[0])
    error = windows.step_hz * np.hypot(np.std(places), PARABOLA)
    return float(at), (float(at - 1.96 * error), float(at + 1.96 * error))


def _tops(rows: FloatArray) -> FloatArray:
    """(R,) places of the largest values, by a parabola through the logarithms beside them."""
    logs = np.log(np.maximum(rows, 1e-300))
    k = np.clip(logs.argmax(axis=1), 1, rows.shape[1] - 2)
    row = np.arange(len(rows))
    left, middle, right = logs[row, k - 1], logs[row, k], logs[row, k + 1]
    bend = left - 2.0 * middle + right
    shift = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(k + np.clip(shift, -0.5, 0.5))
