"""Digital filters of firmwares: their difference equations, and what they do at a frequency.

Every filter is one or more sections y[n] = b0 x[n] + b1 x[n-1] + b2 x[n-2] - a1 y[n-1] - a2 y[n-2]. They pass
what is constant. A row of five numbers (b0, b1, b2, a1, a2) is a section. The frequency of a filter that
follows the throttle or a motor changes from sample to sample: there is then a row for each sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray

ComplexArray = npt.NDArray[np.complex128]


class Kind(StrEnum):
    """A law of a filter."""

    PT1 = "pt1"
    PT2 = "pt2"
    PT3 = "pt3"
    BIQUAD = "biquad"
    NOTCH = "notch"


@dataclass(frozen=True, eq=False)
class Stage:
    """A filter of a chain.

    `kind`: its law. PT1 to PT3 are that many filters of first order, BIQUAD is Butterworth's of second order.
    `hz`: -3 dB of a low-pass filter, or the centre of a notch; (N,) where it changes from sample to sample.
    `q`: of a notch: its centre over its width at -3 dB.
    `left`: of a notch: the gain that is left at its centre.
    `weight`: the share of the signal that goes through it, the rest goes past it; (N,) where it changes.

    >>> low = Stage(Kind.PT1, 100.0)
    >>> round(float(abs(low.response(np.array([100.0]), 8000.0)[0])), 2)
    0.72
    """

    kind: Kind
    hz: float | FloatArray
    q: float | FloatArray = 1.0
    left: float = 0.0
    weight: float | FloatArray = 1.0

    def sections(self, rate_hz: float) -> list[FloatArray]:
        """(1, 5) or (N, 5) each, of a filter that runs this often."""
        made = _LAWS[self.kind](self, rate_hz)
        return [_weighed(rows, self.weight) for rows in made]

    def response(self, hz: FloatArray, rate_hz: float) -> ComplexArray:
        """(F,) gain and phase at frequencies, as complex numbers; of a filter that moves, on average."""
        return response_of(self.sections(rate_hz), hz, rate_hz)

    @property
    def words(self) -> str:
        """ "notch 86 Hz, Q 2.1"."""
        low, high = float(np.min(self.hz)), float(np.max(self.hz))
        hz = f"{low:.4g} Hz" if high <= low else f"{low:.4g} to {high:.4g} Hz"
        return f"{self.kind} {hz}" + (f", Q {float(np.mean(self.q)):.2g}" if self.kind is Kind.NOTCH else "")


def response_of(sections: Sequence[FloatArray], hz: FloatArray, rate_hz: float) -> ComplexArray:
    """(F,) of sections one behind the other; where their rows change, the mean over the rows."""
    back = np.exp(-2j * np.pi * np.asarray(hz) / rate_hz)[:, None]
    through: ComplexArray = np.ones((len(back), 1), dtype=np.complex128)
    for rows in sections:
        b0, b1, b2, a1, a2 = _few(rows).T
        through = through * (b0 + back * (b1 + back * b2)) / (1.0 + back * (a1 + back * a2))
    return np.asarray(through.mean(axis=1))


def _few(rows: FloatArray, most: int = 200) -> FloatArray:
    """Rows evenly chosen: enough for their mean."""
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]


def run_sections(sections: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """(N,) x through sections one behind the other, which have settled on its first value."""
    from flysid.spectra.running import run_section

    y = np.ascontiguousarray(x, dtype=np.float64)
    for rows in sections:
        y = run_section(np.ascontiguousarray(rows), y)
    return y


def run_both_ways(sections: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """(N,) x through constant sections and, turned round, through them again: without a phase.

    Beyond its ends x goes on turned about its end points, as in `scipy.signal.sosfiltfilt`. To import that
    costs half a second of CPU. A record that is shorter than the filter's reach goes on for as many rows as
    it has.
    """
    if not len(x):
        return x
    reach = min(3 * (2 * len(sections) + 1), len(x) - 1)
    before = 2.0 * x[0] - x[reach:0:-1]
    behind = 2.0 * x[-1] - x[-2 : -reach - 2 : -1]
    longer = np.concatenate([before, x, behind])
    back = run_sections(sections, run_sections(sections, longer)[::-1])[::-1]
    return back[reach : reach + len(x)]


def band_pass(band_hz: tuple[float, float], rate_hz: float) -> list[FloatArray]:
    """Two sections of a Butterworth band-pass, of second order at either edge, warped so that both are met.

    The prototype's pole p becomes the roots of s^2 - p (high - low) s + low high; z = (1 + s) / (1 - s).
    """
    low, high = np.tan(np.pi * np.asarray(band_hz) / rate_hz)
    middle = low * high
    scaled = (high - low) * np.exp(0.75j * np.pi)
    root = np.sqrt(scaled**2 - 4.0 * middle)
    poles = 0.5 * np.array([scaled + root, scaled - root])
    turned = (1.0 + poles) / (1.0 - poles)
    # a section's numerator is (1 - q^2) c; both together have gain 1 at the middle, s = j sqrt(middle)
    gain = (high - low) / np.abs(1.0 - poles) ** 2
    nothing = np.zeros(2)
    rows = np.stack([gain, nothing, -gain, -2.0 * turned.real, np.abs(turned) ** 2], axis=1)
    return [row[None] for row in rows]


def _low_pass(hz: float | FloatArray, rate_hz: float) -> FloatArray:
    """A section y += k (x - y) with k = w / (w + 1), w = 2 pi hz / rate."""
    w = 2.0 * np.pi * np.atleast_1d(np.asarray(hz, dtype=np.float64)) / rate_hz
    k = w / (w + 1.0)
    nothing = np.zeros(len(k))
    return np.stack([k, nothing, nothing, k - 1.0, nothing], axis=1)


def _cascade(order: int, stage: Stage, rate_hz: float) -> list[FloatArray]:
    """Equal first-order filters that together have -3 dB at the stage's frequency."""
    each = np.asarray(stage.hz) / np.sqrt(2.0 ** (1.0 / order) - 1.0)
    return [_low_pass(each, rate_hz)] * order


def _biquad(stage: Stage, rate_hz: float) -> list[FloatArray]:
    """Butterworth, warped so that its -3 dB is where it should be; Q = 1 / sqrt(2)."""
    sine, cosine = _turn(stage.hz, rate_hz)
    alpha = sine / np.sqrt(2.0)
    edge = (1.0 - cosine) / 2.0
    rows = np.stack([edge, 2.0 * edge, edge, -2.0 * cosine, 1.0 - alpha], axis=1)
    return [rows / (1.0 + alpha)[:, None]]


def _notch(stage: Stage, rate_hz: float) -> list[FloatArray]:
    sine, cosine = _turn(stage.hz, rate_hz)
    alpha = sine / (2.0 * np.asarray(stage.q))
    rows = np.stack(
        [1.0 + stage.left * alpha, -2.0 * cosine, 1.0 - stage.left * alpha, -2.0 * cosine, 1.0 - alpha],
        axis=1,
    )
    return [rows / (1.0 + alpha)[:, None]]


def _turn(hz: float | FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    angle = 2.0 * np.pi * np.atleast_1d(np.asarray(hz, dtype=np.float64)) / rate_hz
    return np.sin(angle), np.cos(angle)


def _weighed(rows: FloatArray, weight: float | FloatArray) -> FloatArray:
    """The rows of w times a section plus 1 - w times its input."""
    share = np.atleast_1d(np.asarray(weight, dtype=np.float64))
    if np.all(share == 1.0):
        return rows
    past = np.stack([np.ones(len(rows)), rows[:, 3], rows[:, 4]], axis=1)
    through = share[:, None] * rows[:, :3] + (1.0 - share)[:, None] * past
    return np.concatenate([through, np.broadcast_to(rows[:, 3:], (len(through), 2))], axis=1)


_LAWS = {
    Kind.PT1: lambda stage, rate_hz: _cascade(1, stage, rate_hz),
    Kind.PT2: lambda stage, rate_hz: _cascade(2, stage, rate_hz),
    Kind.PT3: lambda stage, rate_hz: _cascade(3, stage, rate_hz),
    Kind.BIQUAD: _biquad,
    Kind.NOTCH: _notch,
}
