"""A rate controller in small motions, and whether it is the one that flew.

Betaflight's and INAV's come from `flysid.loops.betaflight`, PX4's and ArduPilot's from
`flysid.loops.parameter_laws`. Rates are in deg/s, outputs in thousandths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.law_parts import LARGEST_MISS, TermCheck
from flysid.loops.stages import Filters, Notches, notched, response, sampled_response
from flysid.loops.stick_response import ComplexArray, Loop

THOUSANDTHS = 1000.0


@dataclass(frozen=True)
class Controller:
    """u = reference(f) r - feedback(f) y.

    `gains`: as the firmware names them, for people.
    `p`, `i`, `d`: per unit of error, of its integral, of its derivative.
    `weight`: of the setpoint in the derivative.
    `filters`: orders and cut-offs (Hz) of what the derivative of y goes through.
    `error_filters`, `reference_filters`: of what the error goes through, and the setpoint before it.
    `forward`: from the filtered setpoint straight to the output.
    `slope_filtered`: the setpoint's derivative goes through `filters` and `notch`, too.
    `notch`: centre and cut-off (Hz) of what the derivative goes through besides; 0 for none.
    `p_filters`: of what P goes through.
    `recorded_forward`: f (Hz), and the response there of a recorded term that the setpoint alone makes.
    `i_at_rest`: of the error's integral while the sticks rest, where `i` is less on average over a flight.
    `forward_slope`: from the filtered setpoint's derivative straight to the output.
    `error_notches`, `reference_notches`: centre (Hz), quality and depth (a factor) of what they go through.
    `output_filters`: of what the whole output goes through.
    `step_s`, `slope_step_s`: in which integral and filters are computed, and the derivative with its filters;
        0 for so short a step that it does not show.
    `setpoint_steps`: the log has the setpoint this many steps before the loop uses it.
    `law`: firmware and version whose law this is, for people.
    `exact`: whether that version is described; else the nearest one stands in.
    """

    gains: Mapping[str, float]
    p: float
    i: float
    d: float
    weight: float
    filters: Filters
    error_filters: Filters = ()
    reference_filters: Filters = ()
    forward: float = 0.0
    slope_filtered: bool = False
    notch: tuple[float, float] = (0.0, 0.0)
    p_filters: Filters = ()
    recorded_forward: tuple[FloatArray, ComplexArray] | None = None
    i_at_rest: float | None = None
    forward_slope: float = 0.0
    error_notches: Notches = ()
    reference_notches: Notches = ()
    output_filters: Filters = ()
    step_s: float = 0.0
    slope_step_s: float = 0.0
    setpoint_steps: int = 0
    law: str = ""
    exact: bool = True

    def at_rest(self) -> Controller:
        """The same while the sticks rest."""
        return self if self.i_at_rest is None else replace(self, i=self.i_at_rest)

    def feedback(self, f: FloatArray) -> ComplexArray:
        """(F,) from the measured rate, its sign left out."""
        p, i = self.p * self._through(self.p_filters, f), self.i / _slope(f, self.step_s)
        inside = p + i + self.d * _slope(f, self.slope_step_s) * self._slope_through(f)
        return np.asarray(inside * self._error_through(f) * self._through(self.output_filters, f))

    def reference(self, f: FloatArray) -> ComplexArray:
        """(F,) from the setpoint."""
        s = _slope(f, self.step_s)
        slope = self.weight * self.d * _slope(f, self.slope_step_s)
        if self.slope_filtered:
            slope = slope * self._slope_through(f)
        p = self.p * self._through(self.p_filters, f)
        inside = (p + self.i / s + slope) * self._error_through(f)
        direct = self.forward + self.forward_slope * s + self._recorded_forward_at(f)
        through = self._through(self.reference_filters, f) * notched(self.reference_notches, f)
        later = np.exp(-2j * np.pi * f * self.step_s * self.setpoint_steps)
        return np.asarray((inside + direct) * through * self._through(self.output_filters, f) * later)

    def _through(self, filters: Filters, f: FloatArray) -> ComplexArray:
        """(F,) of low-passes."""
        return sampled_response(filters, f, self.step_s) if self.step_s else response(filters, f)

    def _error_through(self, f: FloatArray) -> ComplexArray:
        """(F,) of what the error goes through."""
        return np.asarray(self._through(self.error_filters, f) * notched(self.error_notches, f))

    def _recorded_forward_at(self, f: FloatArray) -> ComplexArray:
        """(F,) of the recorded term; 0 where there is none."""
        if self.recorded_forward is None:
            return np.zeros(len(f), dtype=np.complex128)
        at, values = self.recorded_forward
        return np.asarray(np.interp(f, at, values.real) + 1j * np.interp(f, at, values.imag))

    def _slope_through(self, f: FloatArray) -> ComplexArray:
        """(F,) of what the derivative goes through."""
        if self.slope_step_s:
            return sampled_response(self.filters, f, self.slope_step_s)
        return response(self.filters, f, self.notch)

    def miss(self, loop: Loop, low: float, high: float) -> float:
        """Median relative error with which it gives what the log recorded, between two frequencies (Hz)."""
        at = (loop.f >= low) & (loop.f <= high)
        s = loop.mean
        told = self.reference(loop.f) * s[0, 0] - self.feedback(loop.f) * s[0, 2]
        return float(np.median(np.abs(told - s[0, 1])[at] / np.abs(s[0, 1])[at]))


def _slope(f: FloatArray, step_s: float) -> ComplexArray:
    """(F,) of a derivative, and one over it of an integral: by differences where the step shows."""
    s = 2j * np.pi * np.maximum(f, 1e-6)
    return np.asarray(s if not step_s else (1.0 - np.exp(-s * step_s)) / step_s)


def refuse_misfit(
    controller: Controller,
    loop: Loop,
    low: float,
    high: float,
    checks: Sequence[TermCheck] = (),
    *,
    largest: float = LARGEST_MISS,
) -> float:
    """The miss of a controller; raises DataError where it is not what the log recorded.

    `low`, `high`: Hz, between which it is compared.
    `checks`: of its terms; those that miss are named. All of them must fit where the law only stands in.
    """
    miss = controller.miss(loop, low, high)
    off = "; ".join(check.complaint() for check in checks if not check.fits)
    if not controller.exact and (off or not checks):
        raise DataError(
            f"{controller.law}, and {off or 'the log records no terms to check it against'}",
            hint="update flysid, or log with a version that is described; "
            "the loop itself: flysid tf LOG -r betaflight-rate",
        )
    needed = {"P"} | ({"D"} if controller.d > 0.0 else set())
    proven = not off and needed <= {check.term for check in checks}
    if not miss <= largest and not proven:
        raise DataError(
            f"the stated gains do not give what the log recorded: {100.0 * miss:.0f} % off between "
            f"{low:.0f} and {high:.0f} Hz, {100.0 * largest:.0f} % are allowed; "
            f"{off or 'the log does not show why'}",
            hint="possible causes to look at: a term of the firmware's law that this log does not carry, "
            "another profile or mode, gains changed in flight, another unit",
        )
    return miss
