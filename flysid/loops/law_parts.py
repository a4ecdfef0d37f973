"""Parts of a rate controller that move in flight, and how well its terms are those that a log recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.lake.headers import WHOLE
from flysid.loops.stages import Filters

NO_THROTTLE = 1000.0
"""us."""
LARGEST_MISS = 0.15
"""Of a term, root mean square: the share up to which the law counts as the one that flew."""


@dataclass(frozen=True)
class Means:
    """What the parts of a law that move were on average over a flight, as shares of what the header states.

    `p`, `i`, `d`: of the gains.
    `lowpass_hz`: cut-off of the first low-pass where it moves.
    """

    p: float = 1.0
    i: float = 1.0
    d: float = 1.0
    lowpass_hz: float | None = None


@dataclass(frozen=True)
class Boost:
    """How D grows from the gain `d`: by up to `most` with quick motions.

    `most`: of D, over the least.
    `by_rate`, `by_setpoint`: what a deg/s^2 of the filtered rate, or of the setpoint, adds to the share.
    `range_filters`, `smooth_filters`: of the rate's slope, and of the factor.
    """

    most: float
    by_rate: float
    by_setpoint: float
    range_filters: Filters
    smooth_filters: Filters


@dataclass(frozen=True)
class Relax:
    """The integral while the setpoint moves: times 1 - |r - its low-pass| / threshold, never below 0."""

    cutoff_hz: float
    threshold: float


@dataclass(frozen=True)
class Moving:
    """A low-pass between two cut-offs (Hz) by the throttle; expo 0 is the older, cubic curve."""

    kind: str
    low: float
    high: float
    expo: float

    def cutoff(self, throttle: FloatArray) -> FloatArray:
        """(N,) Hz, of throttles from 0 to 1."""
        if self.expo:
            curve = throttle * (1.0 - throttle) * self.expo / 10.0 + throttle
            return np.asarray((self.high - self.low) * curve + self.low)
        return np.asarray(np.maximum(1.5 * throttle * (1.0 - throttle**2 / 3.0) * self.high, self.low))


@dataclass(frozen=True)
class AntiGravity:
    """How the integral speeds up as the throttle moves: steps, highpass or slope, with what they need."""

    kind: str
    gain: float
    threshold: float = np.inf
    cutoff_hz: float = 0.0
    p: float = 0.0


@dataclass(frozen=True)
class TermCheck:
    """One term of the law against the recorded one.

    `term`: P, I, D or F.
    `miss`: root mean square of the difference, over that of the recorded term.
    `slope`: recorded over rebuilt, by least squares.
    `cause`: the part of the law without which the term fits, and how well; "" where there is none.
    `scaled`: the miss under another gain.
    """

    term: str
    miss: float
    slope: float
    cause: str = ""
    scaled: float = 1.0

    @property
    def fits(self) -> bool:
        """Whether the term is the one that flew."""
        return self.miss <= LARGEST_MISS

    def said(self) -> str:
        """ "P 2 %"."""
        return f"{self.term} {100.0 * self.miss:.0f} %"

    def complaint(self) -> str:
        """What is off, for people."""
        by = f"recorded over rebuilt is {self.slope:.2f}"
        return f"the {self.term} term is {100.0 * self.miss:.0f} % off ({self.cause or by})"


def taper(throttle: FloatArray, share: float, begins: float, ends: float) -> FloatArray:
    """(N,) what TPA takes of a gain: nothing up to where it begins, more and more up to its share at the end.

    It takes nothing where it begins at its end or beyond.

    >>> taper(np.array([1200.0, 1500.0, 2000.0]), 0.6, 1500.0, 2000.0).tolist()
    [0.0, 0.0, 0.6]
    """
    if begins >= ends:
        return np.zeros(len(throttle))
    return np.asarray(share * np.clip((throttle - begins) / (ends - begins), 0.0, 1.0))


def unpack_limit(value: float) -> float:
    """A limit of the setpoint's acceleration; 3.1 prints the bits of a float, which counts ten times as much.

    >>> unpack_limit(100.0), unpack_limit(1092616192.0)
    (100.0, 100.0)
    """
    if value < 2.0**24:
        return value
    if value >= 2.0**32:
        raise DataError(f"the log's header limits the acceleration by {value:.0f}", hint=WHOLE)
    return 10.0 * float(np.array(int(value), dtype=np.uint32).view(np.float32))
