"""A flight plan: what is commanded on which axis, from limits, a band and a duration."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.escaping import csv_line
from flysid.ingest.formats.common.units import is_known
from flysid.ingest.synth import manoeuvres
from flysid.plan.multisines import (
    Lines,
    largest_correlation,
    phases_of_axes,
    relative_peak_factor,
    shared_out,
    sum_of_lines,
)
from flysid.showing import counted

Kind = Literal["multisine", "chirp", "doublets"]

LINES_AN_AXIS = 5
"""Each gives a gain and a phase; the largest transfer function of `flysid tf` (4 poles, 4 zeros and a dead
time for every input) has nine numbers."""
CYCLES = 2
LONGEST_S = 3600.0
"""An hour: no longer flight is proposed."""
"""Of the lowest frequency: what `flysid tf` requires of a record before it states one."""
MOST_SAMPLES = 10_000_000
_AXIS = re.compile(
    r"(?P<name>[^=\s]+)=(?P<peak>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*(?P<unit>[a-zA-Z%\u00b0].*)?"
)


@dataclass(frozen=True)
class CommandedAxis:
    """What is commanded: its name, how far from where it rests, and in what unit."""

    name: str
    peak: float
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.name} +-{self.peak:.3g}{' ' + self.unit if self.unit else ''}"


@dataclass(frozen=True, eq=False)
class FlightPlan:
    """Commands on a grid, around where each axis rests.

    `u`: (N, n) one column an axis; 0 at both ends.
    `lines`: of multisines, each axis's own multiples of 1 / seconds; () otherwise.
    """

    kind: Kind
    axes: tuple[CommandedAxis, ...]
    band_hz: tuple[float, float]
    rate_hz: float
    u: FloatArray
    lines: tuple[Lines, ...] = ()

    @property
    def seconds(self) -> float:
        """Of the whole plan."""
        return len(self.u) / self.rate_hz

    @property
    def correlation(self) -> float:
        """Largest between two axes."""
        return largest_correlation(self.u)

    @property
    def peak_factors(self) -> tuple[float, ...]:
        """Relative peak factor of every axis."""
        return tuple(relative_peak_factor(column) for column in self.u.T)

    def csv(self) -> str:
        """time_s, then one column an axis with its unit in brackets, as `flysid` and spreadsheets read it."""
        heads = [f"{a.name} [{a.unit}]" if a.unit else a.name for a in self.axes]
        rows = [csv_line(["time_s", *heads])]
        rows += [
            ",".join([f"{k / self.rate_hz:.6f}", *(f"{v:.6g}" for v in row)]) for k, row in enumerate(self.u)
        ]
        return "\n".join(rows) + "\n"


def axis_of(text: str) -> CommandedAxis:
    """An axis as written, "roll=0.15" or "theta_in=5deg".

    Raises UsageError: no such form, or an amplitude that is not above zero.
    """
    match = _AXIS.fullmatch(text.strip())
    if match is None:
        raise UsageError(
            f"no axis: {text!r}", hint="NAME=PEAK with its unit, e.g. roll=0.15 or theta_in=5deg"
        )
    peak = float(match["peak"])
    if not (math.isfinite(peak) and peak > 0.0):
        raise UsageError(f"the amplitude of {match['name']} must be above zero, not {match['peak']}")
    unit = (match["unit"] or "").strip()
    if unit and not is_known(unit):
        raise UsageError(f"unknown unit {unit!r} of {match['name']}", hint="e.g. deg, rad/s, m/s, or none")
    return CommandedAxis(match["name"], peak, unit)


def within(axes: Sequence[CommandedAxis], limits: Sequence[CommandedAxis]) -> tuple[CommandedAxis, ...]:
    """The axes, none going further than its limit.

    Raises UsageError: a limit of an axis that is not flown, or in another unit.
    """
    own = {limit.name: limit for limit in limits}
    check_limits([a.name for a in axes], limits)
    for axis in axes:
        limit = own.get(axis.name)
        if limit is not None and limit.unit and limit.unit != axis.unit:
            raise UsageError(
                f"the limit of {axis.name} is in {limit.unit!r}, the axis in {axis.unit!r}",
                hint="state both in one unit",
            )
    peaks = [min(a.peak, own[a.name].peak) if a.name in own else a.peak for a in axes]
    return tuple(CommandedAxis(a.name, peak, a.unit) for a, peak in zip(axes, peaks, strict=True))


def make_plan(
    kind: Kind, axes: Sequence[CommandedAxis], band_hz: tuple[float, float], seconds: float, rate_hz: float
) -> FlightPlan:
    """A flight that excites every axis in a band.

    Multisines are flown on all axes at once, chirps and doublets one axis after the other.

    `band_hz`: lowest and highest frequency.
    `seconds`: of the whole flight; of multisines, one period.
    `rate_hz`: rows a second.
    Raises UsageError: axes, band, rate or duration make no sense together; the hint names values that do.

    >>> axes = [CommandedAxis("roll", 0.1), CommandedAxis("pitch", 0.1)]
    >>> plan = make_plan("multisine", axes, (0.2, 5.0), 40.0, 50.0)
    >>> plan.u.shape, plan.correlation < 1e-3, max(plan.peak_factors) < 1.12
    ((2000, 2), True, True)
    """
    _check(axes, band_hz, seconds, rate_hz)
    n = round(seconds * rate_hz)
    if kind == "multisine":
        lines = _lines(len(axes), band_hz, n / rate_hz)
        u = _multisines(lines, axes, n)
        return FlightPlan(kind, tuple(axes), band_hz, rate_hz, u, tuple(lines))
    one = _chirp if kind == "chirp" else _doublets
    u = np.zeros((n, len(axes)))
    share = n // len(axes)
    for j, axis in enumerate(axes):
        u[j * share : (j + 1) * share, j] = one(np.arange(share) / rate_hz, band_hz, axis.peak, len(axes))
    return FlightPlan(kind, tuple(axes), band_hz, rate_hz, u)


def check_limits(axes: Sequence[str], limits: Sequence[CommandedAxis]) -> None:
    """Raise UsageError for a limit of an axis that is not flown."""
    strange = sorted({limit.name for limit in limits}.difference(axes))
    if strange:
        raise UsageError(
            f"a limit for {', '.join(strange)}, which the plan does not command",
            hint=f"its axes: {', '.join(axes)}",
        )


def check_flight(band_hz: tuple[float, float], seconds: float, rate_hz: float) -> None:
    """Raise UsageError where no signal can have this band, length and rate, whatever the axes."""
    low, high = band_hz
    if not all(map(math.isfinite, (low, high, seconds, rate_hz))) or not 0.0 < low < high:
        raise UsageError(f"no band: {low:g} to {high:g} Hz", hint="lowest and highest frequency, above zero")
    if seconds <= 0.0 or rate_hz <= 0.0:
        raise UsageError(f"{seconds:g} s at {rate_hz:g} Hz is not a flight")
    if high >= 0.5 * rate_hz:
        raise UsageError(
            f"the band goes to {high:g} Hz; {rate_hz:g} Hz of rows show less than {0.5 * rate_hz:g} Hz",
            hint=f"--rate {5 * high:g}, or a band that ends below {0.5 * rate_hz:g} Hz",
        )
    if seconds * rate_hz > MOST_SAMPLES:
        raise UsageError(f"{seconds:g} s at {rate_hz:g} Hz are too many rows", hint="a shorter flight")


def _check(
    axes: Sequence[CommandedAxis], band_hz: tuple[float, float], seconds: float, rate_hz: float
) -> None:
    names = [a.name for a in axes]
    if not axes:
        raise UsageError("no axis to fly", hint="--axis NAME=PEAK, e.g. --axis roll=0.15")
    if len(set(names)) < len(names):
        raise UsageError(f"an axis is named twice: {', '.join(names)}")
    check_flight(band_hz, seconds, rate_hz)


def _lines(axes: int, band_hz: tuple[float, float], seconds: float) -> list[Lines]:
    """Multiples of 1 / seconds for every axis; UsageError where there are too few."""
    low, high = band_hz
    first = math.ceil(low * seconds - 1e-9)
    lines = np.arange(first, math.floor(high * seconds + 1e-9) + 1)
    enough = max(CYCLES / low, (LINES_AN_AXIS * axes + 1) / (high - low))
    if first < CYCLES or len(lines) < LINES_AN_AXIS * axes:
        shown = lowest_hz("multisine", axes, seconds)
        upper = max(high, 1.1 * shown + (LINES_AN_AXIS * axes + 1) / seconds)
        of_axes = "1 axis" if axes == 1 else f"{axes} axes"
        raise UsageError(
            f"{seconds:g} s is too short: {len(lines)} frequencies for {of_axes} between {low:g} and "
            f"{high:g} Hz, the lowest {low * seconds:.2g} times",
            hint=_what_would_do(enough, seconds, band_hz, (shown, upper)),
        )
    return shared_out(lines, axes)


def lowest_hz(kind: str, axes: int, seconds: float) -> float:
    """The lowest frequency that a flight of so many seconds can show, with a little to spare."""
    cycles = 2 * CYCLES * axes if kind == "chirp" else CYCLES
    return 1.01 * cycles / seconds


def _what_would_do(
    enough: float, seconds: float, band_hz: tuple[float, float], shown_hz: tuple[float, float]
) -> str:
    """A longer flight where one battery lasts for it, else the band that this time can show."""
    low = band_hz[0]
    if enough <= LONGEST_S:
        return f"--seconds {math.ceil(enough)}, fewer axes at once, or a band that begins higher"
    begin = float(f"{1.05 * shown_hz[0]:.2g}")
    return (
        f"--band {begin:g} {max(shown_hz[1], 2.0 * begin):.3g}: what {seconds:g} s can show; {low:.2g} Hz "
        f"would take {enough / 3600.0:.2g} hours at one go, which no battery lasts"
    )


def _multisines(lines: Sequence[Lines], axes: Sequence[CommandedAxis], n: int) -> FloatArray:
    columns = [sum_of_lines(own, phases, n) for own, phases in zip(lines, phases_of_axes(lines), strict=True)]
    return np.column_stack([a.peak * c / np.abs(c).max() for a, c in zip(axes, columns, strict=True)])


def _chirp(time_s: FloatArray, band_hz: tuple[float, float], peak: float, axes: int) -> FloatArray:
    """A sweep that swells over its first cycle and fades over its last second's worth of cycles.

    `axes`: how many have to be flown one after another.
    """
    low, high = band_hz
    length = len(time_s) * (time_s[1] - time_s[0]) if len(time_s) > 1 else 0.0
    if length < 2 * CYCLES / low:
        seconds = axes * length
        # a row more for every axis, as rows are shared out whole
        enough = axes * (2 * CYCLES / low + 2.0 * time_s[1]) if length else math.inf
        raise UsageError(
            f"{length:g} s an axis is too short for a sweep from {low:g} Hz",
            hint=_what_would_do(enough, seconds, band_hz, (lowest_hz("chirp", axes, seconds), high)),
        )
    swell = np.minimum(1.0, time_s * low)
    fade = np.minimum(1.0, (length - time_s) * high / CYCLES)
    return np.asarray(manoeuvres.chirp(time_s, band_hz, peak) * np.minimum(swell, fade))


def _doublets(time_s: FloatArray, band_hz: tuple[float, float], peak: float, axes: int) -> FloatArray:
    """Doublets with most power in the middle of the band, a rest as long after each, by turns up and down."""
    pulse_s = 0.4 / math.sqrt(band_hz[0] * band_hz[1])
    starts = np.arange(pulse_s, time_s[-1] - 4.0 * pulse_s if len(time_s) else 0.0, 4.0 * pulse_s)
    if len(starts) < CYCLES:
        enough = axes * (4 * CYCLES + 6) * pulse_s
        seconds = axes * (time_s[-1] + time_s[1]) if len(time_s) > 1 else 0.0
        quicker = enough / seconds if seconds else math.inf
        raise UsageError(
            f"room for {counted(len(starts), 'doublet')} of {2 * pulse_s:.2g} s an axis; "
            f"{CYCLES} are the least",
            hint=_what_would_do(enough, seconds, band_hz, (quicker * band_hz[0], quicker * band_hz[1])),
        )
    shapes = [manoeuvres.doublet(time_s, s, pulse_s, peak * (-1) ** k) for k, s in enumerate(starts)]
    return np.asarray(np.sum(shapes, axis=0))
