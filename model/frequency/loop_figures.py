"""Figures of a loop as engineers quote them, each with its interval, read off a measured response.

Of the closed loop, command to output: bandwidth (-3 dB below its gain at low frequency; and those of handling
qualities, ADS-33E-PRF 3.3.2.1: 45 degrees of phase margin, 6 dB of gain margin), phase delay, peak. Of the
broken loop L: crossover, phase and gain margin, the peak of S = 1 / (1 + L), and the bandwidth of disturbance
rejection (-3 dB of |S|: Berger et al., 2016, J. Am. Helicopter Soc. 61).

Around a frequency looked for, ln G is a parabola in ln omega, fitted to the points nearby by their errors.
Intervals are of first order (delta method) from the errors of those points and their correlation. What lies
outside the band that can be trusted is refused in words, never extrapolated. No interval reaches where the
truth cannot be: a loop that stood while it was recorded has no margin below 0, and |S| tends to 1 where the
loop's gain fades, so that its peak is no lower.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.polynomials import DB, Z95, ComplexArray

NEIGHBOURS = 5
HALF_POWER = np.log(2.0) / 2.0
COMMAND = "bandwidth_rads", "peak_db", "bandwidth_phase_rads", "bandwidth_gain_rads", "phase_delay_ms"
"""Figures of a closed loop's response from its command, in the order of `command_figures`."""
CROSSING = "crossover_rads", "phase_margin_deg"
GAIN_MARGIN = "gain_margin_db"
SENSITIVITY = "sensitivity_peak_db", "disturbance_rejection_bandwidth_rads"
LOOP = (*CROSSING, GAIN_MARGIN, *SENSITIVITY)
"""Figures of a broken loop, in the order of `loop_figures`."""
_NOT_FLAT = "the gain is not flat at the lowest frequency that can be trusted"


@dataclass(frozen=True)
class LoopFigure:
    """One figure.

    Attributes
    ----------
    name : e.g. "phase_margin_deg"; the unit is its last word.
    value, low, high : estimate and 95 % interval; None where the record cannot tell.
    why : then, why not.
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
    data: Dataset, output: int = 0, *, reference: str, at: str, points: int = 160
) -> MeasuredResponse:
    """The response of the loop cut open, L, as measured while it was closed.

    Parameters
    ----------
    reference : input of the dataset that drives the loop.
    at : where it enters. "input": it is added to what the controller gives, and the one other input is their
        sum u; then L = (r - u) / u, whatever the controller does. "setpoint": the controller sees r - y
        alone; then L = y / (r - y).

    Raises
    ------
    UsageError : no such place, or more than one input where `at` is "input".
    DataError : as `measure_response`.
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
    return [
        *_crossing(loop),
        _gain_margin(loop),
        *_sensitivity(loop),
    ]


def command_figures(measured: MeasuredResponse, source: int = 0) -> list[LoopFigure]:
    """Bandwidths, phase delay and peak of a closed loop's response from its command.

    The peak is above the gain at the band's low end, as its bandwidth is below: units cancel.
    """
    curve = _LoopCurve.of(measured, source)
    if isinstance(curve, str):
        return unknown(COMMAND, curve)
    return [_half_power(curve), _resonance(curve), *_handling(curve)]


def unknown(names: Sequence[str], why: str) -> list[LoopFigure]:
    """Figures that the record does not tell, for one reason."""
    return [LoopFigure(name, None, why=why) for name in names]


@dataclass(frozen=True, eq=False)
class _LoopCurve:
    """Trusted points: x = ln omega, ln G (its phase continuous), standard errors, their correlation."""

    x: FloatArray
    log: ComplexArray
    error: FloatArray
    correlation: FloatArray

    @classmethod
    def of(cls, measured: MeasuredResponse, source: int) -> _LoopCurve | str:
        """Or why there is none."""
        inside = np.flatnonzero(measured.trusted(source))
        if len(inside) < NEIGHBOURS:
            return "no band can be trusted"
        g = measured.response[inside, source]
        phase = np.unwrap(np.angle(g))
        # the branch in which the first point lies between -270 and 90 degrees
        phase -= 2.0 * np.pi * np.ceil((phase[0] - np.pi / 2) / (2.0 * np.pi))
        return cls(
            np.log(measured.omega[inside]),
            np.log(np.abs(g)) + 1j * phase,
            np.maximum(measured.error[inside, source], 1e-9),
            measured.correlation[source][np.ix_(inside, inside)],
        )

    def parabola(self, x: float, *, window: float = 0.12) -> tuple[ComplexArray, FloatArray]:
        """(value, slope, curvature) of ln G at x, and the (3, 3) covariance of either part.

        `window`: half width of a parabola's stretch in ln omega, at least.
        """
        near = np.abs(self.x - x) <= window
        if np.count_nonzero(near) < NEIGHBOURS:
            near = np.zeros(len(self.x), dtype=bool)
            near[np.argsort(np.abs(self.x - x))[:NEIGHBOURS]] = True
        d = self.x[near] - x
        basis = np.stack([np.ones_like(d), d, d**2 / 2.0], axis=1)
        weighted = basis / self.error[near, None] ** 2
        inverse = np.linalg.pinv(basis.T @ weighted)
        gains = inverse @ weighted.T
        spread = self.error[near, None] * self.correlation[np.ix_(near, near)] * self.error[near]
        return gains @ self.log[near], gains @ spread @ gains.T

    def crossings(self, values: FloatArray) -> list[float]:
        """Where values over x cross 0, by straight lines between points."""
        at = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
        step = values[at] / (values[at] - values[at + 1])
        return [float(v) for v in self.x[at] + step * (self.x[at + 1] - self.x[at])]

    def smooth(self) -> ComplexArray:
        """(M,) the parabolas' values at the points."""
        return np.array([self.parabola(float(v))[0][0] for v in self.x])


def _interval(name: str, value: float, error: float, log: bool = False) -> LoopFigure:
    if log:
        low, middle, high = np.exp([value - Z95 * error, value, value + Z95 * error])
        return LoopFigure(name, float(middle), float(low), float(high))
    return LoopFigure(name, float(value), float(value - Z95 * error), float(value + Z95 * error))


def _not_below_0(figure: LoopFigure) -> LoopFigure:
    """The interval without what is below 0; a value there is left as it is, and its interval."""
    if figure.value is None or figure.low is None or figure.value < 0.0:
        return figure
    return replace(figure, low=max(figure.low, 0.0))


def _root(curve: _LoopCurve, start: float, part: Callable[[complex], float]) -> tuple[float, float, float]:
    """(x, its error, error of the other part there) where a part of the parabola is 0."""
    x = start
    for _ in range(5):
        values, _ = curve.parabola(x)
        slope = part(values[1])
        if slope == 0.0:
            break
        x = float(np.clip(x - np.clip(part(values[0]) / slope, -0.1, 0.1), curve.x[0], curve.x[-1]))
    values, spread = curve.parabola(x)
    slope = part(values[1])
    own = float(np.sqrt(spread[0, 0]))
    return x, own / max(abs(slope), 1e-9), own


def _real(value: complex) -> float:
    return float(np.real(value))


def _imag(value: complex) -> float:
    return float(np.imag(value))


def _shift(curve: _LoopCurve, by: complex) -> _LoopCurve:
    return replace(curve, log=curve.log - by)


def _crossing(loop: MeasuredResponse) -> list[LoopFigure]:
    curve = _LoopCurve.of(loop, 0)
    if isinstance(curve, str):
        return unknown(CROSSING, curve)
    found = curve.crossings(curve.smooth().real)
    if not found:
        where = "above" if curve.smooth().real[0] > 0 else "below"
        why = f"the loop's gain stays {where} 1 in the whole trusted band"
        return unknown(CROSSING, why)
    x, error, own = _root(curve, found[-1], _real)
    values, _ = curve.parabola(x)
    margin = 180.0 + np.degrees(values[0].imag)
    # the phase's own error, and what an error of the crossover adds along the phase's slope
    spread = np.degrees(np.hypot(own, values[1].imag * error))
    return [
        _interval(CROSSING[0], x, error, log=True),
        _not_below_0(_interval(CROSSING[1], float(margin), float(spread))),
    ]


def _gain_margin(loop: MeasuredResponse) -> LoopFigure:
    curve = _LoopCurve.of(loop, 0)
    if isinstance(curve, str):
        return LoopFigure(GAIN_MARGIN, None, why=curve)
    shifted = _shift(curve, -1j * np.pi)
    found = shifted.crossings(shifted.smooth().imag)
    if not found:
        return LoopFigure(
            GAIN_MARGIN, None, why="the loop's phase does not pass -180 degrees in the trusted band"
        )
    x, error, own = _root(shifted, found[0], _imag)
    values, _ = shifted.parabola(x)
    spread = DB * float(np.hypot(own, values[1].real * error))
    return _not_below_0(_interval(GAIN_MARGIN, -DB * values[0].real, spread))


def _sensitivity(loop: MeasuredResponse) -> list[LoopFigure]:
    """Ms, disturbance-rejection bandwidth and peak from S = 1 / (1 + L)."""
    curve = _LoopCurve.of(loop, 0)
    if isinstance(curve, str):
        return unknown(SENSITIVITY, curve)
    value = np.exp(curve.log)
    s = 1.0 / (1.0 + value)
    # d ln S = -L / (1 + L) d ln L
    of_s = replace(
        curve,
        log=np.log(np.abs(s)) + 1j * np.unwrap(np.angle(s)),
        error=curve.error * np.abs(value * s),
    )
    peak = replace(_not_below_0(_peak(of_s)), name=SENSITIVITY[0])
    if peak.value is not None and peak.value < 0.0:
        peak = LoopFigure(SENSITIVITY[0], None, why="its peak lies outside the trusted band")
    crossings = _shift(of_s, -HALF_POWER).crossings(_shift(of_s, -HALF_POWER).smooth().real)
    if not crossings:
        why = "|S| does not pass -3 dB in the trusted band"
        return [peak, LoopFigure(SENSITIVITY[1], None, why=why)]
    x, error, _ = _root(_shift(of_s, -HALF_POWER), crossings[0], _real)
    return [peak, _interval(SENSITIVITY[1], x, error, log=True)]


def _peak(curve: _LoopCurve) -> LoopFigure:
    name = "peak_db"
    level = curve.smooth().real
    top = int(np.argmax(level))
    if top in (0, len(level) - 1):
        return LoopFigure(name, None, why="its peak lies at the edge of the trusted band")
    values, spread = curve.parabola(float(curve.x[top]))
    apex = values[0].real - values[1].real ** 2 / min(2.0 * values[2].real, -1e-9)
    return _interval(name, DB * float(apex), DB * float(np.sqrt(spread[0, 0])))


def _low_end(curve: _LoopCurve) -> tuple[float, float] | None:
    """ln |G| at the band's low end and its error; None where it is not flat there."""
    values, spread = curve.parabola(float(curve.x[0]))
    if abs(values[1].real) > 0.5:
        return None
    return values[0].real, float(np.sqrt(spread[0, 0]))


def _resonance(curve: _LoopCurve) -> LoopFigure:
    """The peak above the gain at the band's low end."""
    low = _low_end(curve)
    if low is None:
        return LoopFigure("peak_db", None, why=_NOT_FLAT)
    found = _peak(_shift(curve, low[0]))
    if found.value is None or found.high is None:
        return found
    own = (found.high - found.value) / Z95
    return _interval(found.name, found.value, float(np.hypot(own, DB * low[1])))


def _half_power(curve: _LoopCurve) -> LoopFigure:
    """-3 dB below the gain at the band's low end, which must be flat there."""
    name = "bandwidth_rads"
    low = _low_end(curve)
    if low is None:
        return LoopFigure(name, None, why=_NOT_FLAT)
    start = low[1]
    shifted = _shift(curve, low[0] - HALF_POWER)
    found = shifted.crossings(shifted.smooth().real)
    if not found:
        return LoopFigure(name, None, why="the gain does not fall by 3 dB in the trusted band")
    x, error, own = _root(shifted, found[0], _real)
    return _interval(name, x, error * float(np.hypot(1.0, start / max(own, 1e-12))), log=True)


def _handling(curve: _LoopCurve) -> list[LoopFigure]:
    """ADS-33: bandwidth by phase, bandwidth by gain, phase delay."""
    names = ("bandwidth_phase_rads", "bandwidth_gain_rads", "phase_delay_ms")
    figures: list[LoopFigure] = []
    at_135 = _shift(curve, -0.75j * np.pi)
    found = at_135.crossings(at_135.smooth().imag)
    if found:
        x, error, _ = _root(at_135, found[0], _imag)
        figures.append(_interval(names[0], x, error, log=True))
    else:
        figures.append(
            LoopFigure(names[0], None, why="the phase does not pass -135 degrees in the trusted band")
        )
    at_180 = _shift(curve, -1j * np.pi)
    turned = at_180.crossings(at_180.smooth().imag)
    if not turned:
        why = "the phase does not pass -180 degrees in the trusted band"
        return [*figures, *(LoopFigure(n, None, why=why) for n in names[1:])]
    x180, error180, own180 = _root(at_180, turned[0], _imag)
    level = curve.parabola(x180)[0]
    raised = _shift(curve, level[0].real + np.log(10.0) * 6.0 / 20.0)
    six = [v for v in raised.crossings(raised.smooth().real) if v < x180]
    if six:
        x, error, own = _root(raised, six[-1], _real)
        there = float(np.hypot(own180, level[1].real * error180))
        wider = error * float(np.hypot(1.0, there / max(own, 1e-12)))
        figures.append(_interval(names[1], x, wider, log=True))
    else:
        figures.append(LoopFigure(names[1], None, why="the gain is not 6 dB higher in the trusted band"))
    twice = x180 + np.log(2.0)
    if twice > curve.x[-1]:
        why = "twice the frequency of -180 degrees lies outside the trusted band"
        return [*figures, LoopFigure(names[2], None, why=why)]
    values, spread = curve.parabola(twice)
    omega = np.exp(x180)
    fall = -np.pi - values[0].imag
    slope = abs(values[1].imag) * error180 + fall * error180
    delay = fall / (2.0 * omega)
    error = float(np.hypot(np.sqrt(spread[0, 0]), slope) / (2.0 * omega))
    return [*figures, _interval(names[2], 1e3 * float(delay), 1e3 * error)]
