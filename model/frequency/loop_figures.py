"""Figures of a loop as engineers quote them, each with its interval, read off a measured response.

Of the closed loop, command to output: bandwidth (-3 dB below its gain at low frequency; and those of handling
qualities, ADS-33E-PRF 3.3.2.1: 45 degrees of phase margin, 6 dB of gain margin), phase delay, peak. Of the
broken loop L: crossover, phase and gain margin, the peak of S = 1 / (1 + L), and the bandwidth of disturbance
rejection (-3 dB of |S|: Berger et al., 2016, J. Am. Helicopter Soc. 61).

Every figure is read off a smooth curve and off draws of it, as a whole (`loop_curve`). A crossing is one that
lasts: between the last point clearly on one side and the first clearly on the other noise may cross as often
as it likes. What lies outside the band that can be trusted is refused in words, never extrapolated. No
interval reaches where the truth cannot be: a loop that stood while it was recorded has no margin below 0, and
|S| tends to 1 where the loop's gain fades, so that its peak is no lower. A figure that lies there itself was
read off something other than that loop, and is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.frequency.loop_curve import LEAST_ERROR, NEIGHBOURS, LoopCurve, Stretch, interval
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.polynomials import DB, Z95

FIGURE_POINTS = 240
"""Frequencies that figures are read off: a resonance of light damping is narrow."""
HALF_POWER = np.log(2.0) / 2.0
COMMAND = "bandwidth_rads", "peak_db", "bandwidth_phase_rads", "bandwidth_gain_rads", "phase_delay_ms"
"""Figures of a closed loop's response from its command, in the order of `command_figures`."""
CROSSING = "crossover_rads", "phase_margin_deg"
GAIN_MARGIN = "gain_margin_db"
SENSITIVITY = "sensitivity_peak_db", "disturbance_rejection_bandwidth_rads"
LOOP = (*CROSSING, GAIN_MARGIN, *SENSITIVITY)
"""Figures of a broken loop, in the order of `loop_figures`."""
STEEPEST = 0.5
"""Slope of ln |G| over ln omega at the lowest trusted frequency up to which a steady gain is near."""
INTEGRATOR = 1.0
"""And the slope of an integrator, which must be ruled out."""
VAGUEST = np.log(4.0)
"""Width of an interval of ln omega above which a frequency is no figure: two octaves."""
_NOT_FLAT = (
    "the gain is not shown to be flat at the lowest frequency that can be trusted; excite lower frequencies, "
    "or longer"
)
_LOST = "it is not in one draw of the response in twenty"
_FLEW = (
    "it comes out below 0, which no loop has that flew: the response was not measured through what enters "
    "there (another signal, a filter between, or another unit)"
)


@dataclass(frozen=True)
class LoopFigure:
    """One figure.

    `name`: e.g. "phase_margin_deg"; the unit is its last word.
    `value`, `low`, `high`: estimate and 95 % interval; None where the record cannot tell.
    `why`: then, why not.
    """

    name: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""

    def __str__(self) -> str:
        words, _, unit = self.name.rpartition("_")
        words = words.replace("_", " ")
        if self.value is None or self.low is None or self.high is None:
            return f"{words}: {self.why}"
        unit = {"rads": "rad/s", "ms": "ms", "deg": "deg", "db": "dB"}.get(unit, unit)
        return f"{words}: {self.value:.3g} {unit} [{self.low:.3g}, {self.high:.3g}]"

    def to_dict(self) -> dict[str, float | str | None]:
        """JSON types only."""
        return {"value": self.value, "low": self.low, "high": self.high} | (
            {"why": self.why} if self.why else {}
        )


def broken_loop(
    data: Dataset, output: int = 0, *, reference: str, at: str, points: int = FIGURE_POINTS
) -> MeasuredResponse:
    """The response of the loop cut open, L, as measured while it was closed.

    `reference`: input of the dataset that drives the loop.
    `at`: where it enters. "input": it is added to what the controller gives, and the one other input is their
        sum u; then L = (r - u) / u, whatever the controller does. "setpoint": the controller sees r - y
        alone; then L = y / (r - y).
    Raises UsageError: no such place, or more than one input where `at` is "input". Raises DataError: as
    `measure_response`.
    """
    names = [s.name for s in data.inputs]
    if reference not in names:
        raise UsageError(f"no input is called {reference!r}", hint=f"one of {', '.join(names)}")
    if at not in ("input", "setpoint"):
        raise UsageError(f"a reference cannot enter at {at!r}", hint="'input' or 'setpoint'")
    r = names.index(reference)
    others = [j for j in range(len(names)) if j != r]
    if at == "input" and len(others) != 1:
        raise UsageError(f"a loop is cut open at one input, not at {len(others)}")
    segments = []
    for segment in data.segments:
        added = segment.u[:, r]
        drive = segment.u[:, others[0]] if at == "input" else added - segment.y[:, output]
        back = added - drive
        segments.append(replace(segment, u=np.column_stack([drive, added]), y=back[:, None]))
    inputs = (replace(data.outputs[output], name="drive"), data.inputs[r])
    outputs = (replace(data.outputs[output], name="loop"),)
    loop = Dataset(data.dt_s, inputs, outputs, tuple(segments), data.name)
    return measure_response(loop, reference=[reference], points=points)


def loop_figures(loop: MeasuredResponse) -> list[LoopFigure]:
    """Crossover, margins, sensitivity of a broken loop's response (`broken_loop`)."""
    curve = LoopCurve.of(loop, 0)
    if isinstance(curve, str):
        return unknown(LOOP, curve)
    return [*_crossing(curve), _gain_margin(curve), *_sensitivity(curve)]


def command_figures(measured: MeasuredResponse, source: int = 0) -> list[LoopFigure]:
    """Bandwidths, phase delay and peak of a closed loop's response from its command.

    The peak is above the steady gain, as its bandwidth is below: units cancel.
    """
    curve = LoopCurve.of(measured, source)
    if isinstance(curve, str):
        return unknown(COMMAND, curve)
    above = _above_steady(curve)
    if above is None:
        own = unknown(COMMAND[:2], _NOT_FLAT)
    else:
        own = [_half_power(curve, above), _resonance(curve, above)]
    return [*own, *_handling(curve)]


def unknown(names: Sequence[str], why: str) -> list[LoopFigure]:
    """Figures that the record does not tell, for one reason."""
    return [LoopFigure(name, None, why=why) for name in names]


def _figure(name: str, values: FloatArray, *, log: bool = False, lost: str) -> LoopFigure:
    """A figure of all curves; `lost`: why it is not known where too few draws have it."""
    found = interval(values)
    if found is None:
        return LoopFigure(name, None, why=lost)
    if log and found[2] - found[1] > VAGUEST:
        ratio = np.exp(found[2] - found[1])
        why = f"it is known to within a factor of {ratio:.2g} only; fly longer, with more of the input"
        return LoopFigure(name, None, why=why)
    value, low, high = np.exp(found) if log else found
    return LoopFigure(name, float(value), float(low), float(high))


def _not_below_0(figure: LoopFigure) -> LoopFigure:
    """Of a loop that flew: the interval without what is below 0; refused where all of it is."""
    if figure.value is None or figure.low is None or figure.high is None:
        return figure
    if figure.high < 0.0:
        return LoopFigure(figure.name, None, why=_FLEW)
    return replace(figure, value=max(figure.value, 0.0), low=max(figure.low, 0.0))


def _crossing(curve: LoopCurve) -> list[LoopFigure]:
    level = curve.every.real
    stretch = curve.fall(level, last=True)
    if stretch is None:
        return unknown(CROSSING, _never_one(level[0]))
    if why := _comes_back(curve, stretch, "the loop's gain falls to 1"):
        return unknown(CROSSING, why)
    x = curve.place(level, stretch)
    margin = 180.0 + np.degrees(curve.at(curve.every.imag, x))
    return [
        _figure(CROSSING[0], x, log=True, lost=_LOST),
        _not_below_0(_figure(CROSSING[1], margin, lost=_LOST)),
    ]


def _comes_back(curve: LoopCurve, stretch: Stretch, falls: str) -> str:
    """That a curve may fall once more, far beyond its first fall; else ""."""
    first, last = curve.x[stretch[0]], curve.x[stretch[1]]
    if last - first <= VAGUEST:
        return ""
    return (
        f"{falls} at {np.exp(first):.3g} rad/s, and may once more by {np.exp(last):.3g}: which is the last "
        "one is not known; fly longer, with more of the input there"
    )


def _never_one(level: FloatArray) -> str:
    if level.min() > 0.0 or level.max() < 0.0:
        return f"the loop's gain stays {'above' if level[0] > 0.0 else 'below'} 1 in the whole trusted band"
    return "the loop's gain is not clearly above 1 and then clearly below it in the trusted band"


def _gain_margin(curve: LoopCurve) -> LoopFigure:
    beyond = curve.every.imag + np.pi
    stretch = curve.fall(beyond, last=False)
    if stretch is None:
        why = "the loop's phase does not clearly pass -180 degrees in the trusted band"
        return LoopFigure(GAIN_MARGIN, None, why=why)
    x = curve.place(beyond, stretch)
    return _not_below_0(_figure(GAIN_MARGIN, -DB * curve.at(curve.every.real, x), lost=_LOST))


def _sensitivity(curve: LoopCurve) -> list[LoopFigure]:
    """Ms and disturbance-rejection bandwidth from S = 1 / (1 + L)."""
    level = np.log(np.abs(1.0 / (1.0 + np.exp(curve.every))))
    lost = "its peak lies outside the trusted band"
    peak = _not_below_0(_figure(SENSITIVITY[0], DB * curve.highest(level), lost=lost))
    below = -HALF_POWER - level
    stretch = curve.fall(below, last=False)
    if stretch is None:
        why = "|S| does not clearly pass -3 dB in the trusted band"
        return [peak, LoopFigure(SENSITIVITY[1], None, why=why)]
    return [peak, _figure(SENSITIVITY[1], curve.place(below, stretch), log=True, lost=_LOST)]


def _above_steady(curve: LoopCurve) -> FloatArray | None:
    """(K, M) ln |G| above the steady gain; None where the band does not show one.

    Towards frequency 0 the gain of what does not integrate is even in omega: a + b omega^2 over the lowest
    octave, every point by how well it is known. The second curve takes their mean for steady, so that the
    interval holds either.
    """
    level = curve.every.real
    octave = max(int(np.searchsorted(curve.x, curve.x[0] + np.log(2.0))), NEIGHBOURS)
    rising = np.exp(2.0 * (curve.x[:octave] - curve.x[0]))
    sure = 1.0 / np.maximum(level[2:, :octave].std(axis=0), LEAST_ERROR)
    basis = np.column_stack([np.ones(octave), rising]) * sure[:, None]
    steady, bend = np.linalg.lstsq(basis, (level[:, :octave] * sure).T, rcond=None)[0]
    slope = 2.0 * bend  # of ln |G| over ln omega, at the lowest point
    turn = curve.every[:, 0].imag / (0.5 * np.pi)
    off = turn - 2.0 * np.round(turn[0] / 2.0)  # gain and phase say the same slope (Bode)
    if any(abs(v[0]) > STEEPEST or abs(v[0]) + Z95 * v[2:].std() > INTEGRATOR for v in (slope, off)):
        return None
    steady[1] = level[1, :octave] @ sure**2 / np.sum(sure**2)
    return np.asarray(level - steady[:, None])


def _resonance(curve: LoopCurve, above: FloatArray) -> LoopFigure:
    """The peak above the steady gain."""
    lost = "no peak stands out of the trusted band's edges"
    return _not_below_0(_figure(COMMAND[1], DB * curve.highest(above), lost=lost))


def _half_power(curve: LoopCurve, above: FloatArray) -> LoopFigure:
    """Where the gain falls to -3 dB below the steady one for good."""
    stretch = curve.fall(above + HALF_POWER, last=True)
    if stretch is None:
        why = "the gain does not clearly fall by 3 dB in the trusted band"
        return LoopFigure(COMMAND[0], None, why=why)
    if why := _comes_back(curve, stretch, "the gain falls by 3 dB"):
        return LoopFigure(COMMAND[0], None, why=why)
    return _figure(COMMAND[0], curve.place(above + HALF_POWER, stretch), log=True, lost=_LOST)


def _handling(curve: LoopCurve) -> list[LoopFigure]:
    """ADS-33: bandwidth by phase, bandwidth by gain, phase delay."""
    level, phase = curve.every.real, curve.every.imag
    by_phase = phase + 0.75 * np.pi
    stretch = curve.fall(by_phase, last=False)
    if stretch is None:
        why = "the phase does not clearly pass -135 degrees in the trusted band"
        first = LoopFigure(COMMAND[2], None, why=why)
    else:
        first = _figure(COMMAND[2], curve.place(by_phase, stretch), log=True, lost=_LOST)
    turned = curve.fall(phase + np.pi, last=False)
    if turned is None:
        return [
            first,
            *unknown(COMMAND[3:], "the phase does not clearly pass -180 degrees in the trusted band"),
        ]
    x180 = curve.place(phase + np.pi, turned)
    six = level - curve.at(level, x180)[:, None] - np.log(10.0) * 6.0 / 20.0
    return [first, _gain_bandwidth(curve, six, turned), _phase_delay(curve, x180)]


def _gain_bandwidth(curve: LoopCurve, six: FloatArray, turned: Stretch) -> LoopFigure:
    """6 dB above the gain at -180 degrees, below that frequency."""
    reach = slice(turned[1] + 1)
    lower = replace(curve, x=curve.x[reach], every=curve.every[:, reach])
    stretch = lower.fall(six[:, reach], last=True)
    if stretch is None:
        return LoopFigure(COMMAND[3], None, why="the gain is not clearly 6 dB higher in the trusted band")
    return _figure(COMMAND[3], lower.place(six[:, reach], stretch), log=True, lost=_LOST)


def _phase_delay(curve: LoopCurve, x180: FloatArray) -> LoopFigure:
    """From the phase at twice the frequency of -180 degrees."""
    twice = x180 + np.log(2.0)
    if twice[0] > curve.x[-1]:
        why = "twice the frequency of -180 degrees lies outside the trusted band"
        return LoopFigure(COMMAND[4], None, why=why)
    fall = -np.pi - curve.at(curve.every.imag, np.minimum(twice, curve.x[-1]))
    return _figure(COMMAND[4], 1e3 * fall / (2.0 * np.exp(x180)), lost=_LOST)
