"""Damage of telemetry: straight lines over link losses, commands beyond full scale, a clock that wanders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from flysid.ingest.align.resample import lowpass
from flysid.showing import counted
from flysid.stretch import FloatArray

BoolArray = npt.NDArray[np.bool_]

STRAIGHT_S = 0.08
STRAIGHT_ROWS = 8
"""A shorter straight line, or one of fewer samples, may be chance."""
CHANCE = 1e-6
"""Chance runs that may be expected in a flight beyond the length that counts."""
LINE = 1e-5
"""Of a signal's spread: a second difference below it is what writing in decimals leaves of a line."""
ROUNDS = 1e-3
"""Of a signal's spread: a motor at its stop moves by less, as commands are rounded and filtered."""
WINDOW_S = 4.0
"""Over which two clocks are compared."""
LATEST_S = 0.12
"""Two clocks are sought no further apart."""
WANDERS_S = 0.01
"""Standard deviation of two clocks that a slow estimator of attitude leaves."""
ALIKE = 0.6
"""Least correlation of two rates that show how their clocks stand."""


@dataclass(frozen=True)
class SampleFaults:
    """What is wrong with a flight's samples.

    Attributes
    ----------
    dt_s : between samples.
    samples : looked at.
    straight, beyond : samples in straight lines, and with a command beyond full scale.
    straight_runs : how many lines.
    least, most : smallest and largest command, as a share of full scale.
    clock_sd_s, clock_range_s : of the gyro's clock against the attitude's; None where either is missing.
    """

    flight: str
    dt_s: float
    samples: int
    straight: int
    straight_runs: int
    beyond: int
    least: float
    most: float
    clock_sd_s: float | None = None
    clock_range_s: float | None = None

    @property
    def lines(self) -> list[str]:
        """In words, one a kind; none where nothing is wrong."""
        said = []
        if self.straight:
            share = 100.0 * self.straight / self.samples
            said.append(
                f"straight lines, as a link loss leaves them: {self.straight} of {self.samples} samples "
                f"({share:.1f} %) in {counted(self.straight_runs, 'stretch')}"
            )
        if self.beyond:
            said.append(
                f"commands below 0 or beyond full scale in {self.beyond} of {self.samples} samples, "
                f"from {self.least:.3g} to {self.most:.3g} times full scale"
            )
        if self.clock_sd_s is not None and self.clock_range_s is not None and self.wanders:
            said.append(
                f"the on-board clock wanders against the attitude's: sd {1e3 * self.clock_sd_s:.0f} ms, "
                f"range {1e3 * self.clock_range_s:.0f} ms"
            )
        return said

    @property
    def wanders(self) -> bool:
        """The gyro's clock against the attitude's moves by more than comparing windows leaves.

        Offsets that are even over one sample have a standard deviation of a sample over the root of 12.
        """
        floor_s = max(WANDERS_S, self.dt_s / np.sqrt(12.0))
        return self.clock_sd_s is not None and self.clock_sd_s > floor_s


def straight_lines(signals: FloatArray, dt_s: float, *, standing: bool = False) -> BoolArray:
    """(N,) samples in stretches of at least 80 ms and 8 samples over which every column is a straight line.

    Stretches that a coarse instrument shows by chance do not count, see `longest_by_chance`.

    Parameters
    ----------
    standing : lines along which nothing moves count, too: an instrument always moves, a motor at its stop
        does not.
    """
    n = len(signals)
    found = np.zeros(n, dtype=bool)
    spread = signals.std(axis=0)
    moving = signals[:, spread > 0.0]
    if n < 3 or not moving.shape[1]:
        return found
    size = np.maximum(spread[spread > 0.0], np.abs(moving[1:-1]))
    bend = np.abs(np.diff(moving, 2, axis=0)) <= LINE * size
    straight = np.concatenate([[False], bend.all(axis=1), [False]])
    bends = runs(straight)
    least = max(round(STRAIGHT_S / dt_s), STRAIGHT_ROWS) - 1
    least = max(least, longest_by_chance([last - first for first, last in bends], least))
    for first, last in bends:
        moved = (np.abs(moving[last] - moving[first - 1]) > ROUNDS * spread[spread > 0.0]).any()
        if last - first >= least and (standing or moved):
            found[first - 1 : last + 1] = True
    return found


def longest_by_chance(lengths: Sequence[int], least: int) -> int:
    """Samples that a straight run must have so that it is no chance: coarse instruments often repeat a value.

    Runs shorter than `least` show how likely a run goes on for another sample. A longer run counts where
    fewer than `CHANCE` of its length are to be expected in the flight.
    """
    short = np.array([n for n in lengths if n < least])
    if not len(short) or least < 3 or short.mean() <= 1.0:
        return 0
    places = np.arange(1, least)

    def beyond(goes_on: float) -> float:
        weights = goes_on**places
        return float((weights * places).sum() / weights.sum() - short.mean())

    if beyond(1.0) <= 0.0:
        return int(np.iinfo(np.int64).max)
    goes_on = _root(beyond)
    return 1 + int(np.ceil(np.log(CHANCE / len(lengths)) / np.log(goes_on)))


def _root(rising: Callable[[float], float]) -> float:
    """Where a rising function of a share passes zero."""
    from scipy.optimize import brentq

    return float(brentq(rising, 1e-9, 1.0))


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """(first, behind the last) of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def beyond_full_scale(commands: FloatArray) -> BoolArray:
    """(N,) samples with a command above full scale or below zero, by more than the low-pass rings."""
    rings = ringing()
    return np.asarray(((commands > 1.0 + rings) | (commands < -rings)).any(axis=1))


@cache
def ringing() -> float:
    """Share of a step by which the low-pass that brings commands onto the grid overshoots it at most."""
    return float(np.cumsum(lowpass(2)).max()) - 1.0  # of the ratios that there are, 2 rings most


def clock_offsets(
    gyro: FloatArray, rates: FloatArray, usable: BoolArray, dt_s: float
) -> tuple[FloatArray, FloatArray]:
    """How late the rates of another instrument are against the gyro, window by window.

    Parameters
    ----------
    gyro, rates : (N, 3) rad/s, of the two clocks.
    usable : (N,) samples that are not damaged.

    Returns
    -------
    (W,) seconds at the middle of each window; (W,) seconds by which `rates` are late there.
    """
    width = max(round(WINDOW_S / dt_s), 8)
    reach = max(round(LATEST_S / dt_s), 1)
    times = []
    offsets = []
    for first in range(reach, len(gyro) - width - reach, width // 2):
        middle = slice(first, first + width)
        if not usable[first - reach : first + width + reach].all():
            continue
        own = gyro[middle] - gyro[middle].mean(axis=0)
        likeness = []
        for lag in range(-reach, reach + 1):
            other = rates[first + lag : first + lag + width]
            other = other - other.mean(axis=0)
            size = np.sqrt((own**2).sum() * (other**2).sum())
            likeness.append(float((own * other).sum() / size) if size > 0.0 else 0.0)
        best = int(np.argmax(likeness))
        if likeness[best] < ALIKE or best in (0, 2 * reach):
            continue
        left, top, right = likeness[best - 1 : best + 2]
        bow = left - 2.0 * top + right
        offsets.append((best - reach + (0.5 * (left - right) / bow if bow < 0.0 else 0.0)) * dt_s)
        times.append((first + 0.5 * width) * dt_s)
    return np.array(times), np.array(offsets)
