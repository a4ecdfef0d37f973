"""Rate controllers as their firmware computes them, from the gains that a log states.

Betaflight's is `flysid.loops.betaflight`.

PX4 (RateControl, 1.12 on) and ArduPilot (AC_PID, 4.0 on) count in rad/s and in shares of the output, here
in deg/s and thousandths:

    PX4:        K (P (r - y) + I integral of (r - y) - D (F y)') + FF r,     F of first order
    ArduPilot:  P e + I integral of e + D (F e)' + FF (T r),                 e = E (T r - y)

with filters T, E, F of first order on target, error and derivative. PX4's F was of second order before 1.13
(pull request 18364). `refuse_misfit` compares all of it
with the log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.law_parts import LARGEST_MISS, TermCheck
from flysid.loops.stages import Filters, response
from flysid.loops.stick_response import ComplexArray, Loop

THOUSANDTHS = 1000.0
RELEASE = "ver_sw_release"
FIRST_ORDER_SINCE = 0x010D0000
"""PX4's release in a ULog, and 1.13, since which its derivative goes through a first-order filter."""
ARDUPILOT_AXES = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}


@dataclass(frozen=True)
class Controller:
    """u = reference(f) r - feedback(f) y.

    Attributes
    ----------
    gains : as the firmware names them, for people.
    p, i, d : per unit of error, of its integral, of its derivative.
    weight : of the setpoint in the derivative.
    filters : orders and cut-offs (Hz) of what the derivative of y goes through.
    error_filters, reference_filters : of what the error goes through, and the setpoint before it.
    forward : from the filtered setpoint straight to the output.
    slope_filtered : the setpoint's derivative goes through `filters` and `notch`, too.
    notch : centre and cut-off (Hz) of what the derivative goes through besides; 0 for none.
    p_filters : of what P goes through.
    recorded_forward : f (Hz), and the response there of a recorded term that the setpoint alone makes.
    i_at_rest : of the error's integral while the sticks rest, where `i` is less on average over a flight.
    law : firmware and version whose law this is, for people.
    exact : whether that version is described; else the nearest one stands in.
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
    law: str = ""
    exact: bool = True

    def at_rest(self) -> Controller:
        """The same while the sticks rest."""
        return self if self.i_at_rest is None else replace(self, i=self.i_at_rest)

    def feedback(self, f: FloatArray) -> ComplexArray:
        """(F,) from the measured rate, its sign left out."""
        s = 2j * np.pi * np.maximum(f, 1e-6)
        inside = self.p * response(self.p_filters, f) + self.i / s + self.d * s * self._slope_through(f)
        return np.asarray(inside * response(self.error_filters, f))

    def reference(self, f: FloatArray) -> ComplexArray:
        """(F,) from the setpoint."""
        s = 2j * np.pi * np.maximum(f, 1e-6)
        slope = self.weight * self.d * s
        if self.slope_filtered:
            slope = slope * self._slope_through(f)
        p = self.p * response(self.p_filters, f)
        inside = (p + self.i / s + slope) * response(self.error_filters, f)
        direct = self.forward + self._recorded_forward_at(f)
        return np.asarray((inside + direct) * response(self.reference_filters, f))

    def _recorded_forward_at(self, f: FloatArray) -> ComplexArray:
        """(F,) of the recorded term; 0 where there is none."""
        if self.recorded_forward is None:
            return np.zeros(len(f), dtype=np.complex128)
        at, values = self.recorded_forward
        return np.asarray(np.interp(f, at, values.real) + 1j * np.interp(f, at, values.imag))

    def _slope_through(self, f: FloatArray) -> ComplexArray:
        """(F,) of what the derivative goes through."""
        return response(self.filters, f, self.notch)

    def miss(self, loop: Loop, low: float, high: float) -> float:
        """Median relative error with which it gives what the log recorded, between two frequencies (Hz)."""
        at = (loop.f >= low) & (loop.f <= high)
        s = loop.mean
        told = self.reference(loop.f) * s[0, 0] - self.feedback(loop.f) * s[0, 2]
        return float(np.median(np.abs(told - s[0, 1])[at] / np.abs(s[0, 1])[at]))


def px4(stated: Mapping[str, float], axis: str) -> Controller:
    """The rate controller of PX4, from parameters and the release where the log names it.

    Raises
    ------
    DataError : parameters are missing: another version, or a log without them.
    """
    stem = f"MC_{axis.upper()}RATE_"
    k, p, i, d = _find_stated(stated, *(stem + name for name in ("K", "P", "I", "D")))
    (cut,) = _find_stated(stated, "IMU_DGYRO_CUTOFF")
    unit = np.pi / 180.0 * THOUSANDTHS
    return Controller(
        {f"{stem}K": k, "P": p, "I": i, "D": d},
        unit * k * p,
        unit * k * i,
        unit * k * d,
        0.0,
        ((px4_order(stated), cut),),
        forward=unit * stated.get(stem + "FF", 0.0),
    )


def px4_order(stated: Mapping[str, float]) -> int:
    """Of the filter of PX4's derivative."""
    return 1 if stated.get(RELEASE, FIRST_ORDER_SINCE) >= FIRST_ORDER_SINCE else 2


def ardupilot(stated: Mapping[str, float], axis: str) -> Controller:
    """The rate controller of ArduCopter 4.0 and later, from parameters.

    Raises
    ------
    DataError : parameters are missing (older versions have one filter), or the slope is fed forward.
    """
    stem = f"ATC_RAT_{ARDUPILOT_AXES[axis]}_"
    if stem + "FILT" in stated and stem + "FLTT" not in stated:
        raise DataError(
            f"these are gains of ArduCopter before 4.0, with a single filter ({stem}FILT): not known here",
            hint="fly ArduCopter 4.0 or later; the response to the command: flysid tf LOG -r ardupilot-rate",
        )
    p, i, d, target, error, slope = _find_stated(
        stated, *(stem + name for name in ("P", "I", "D", "FLTT", "FLTE", "FLTD"))
    )
    if stated.get(stem + "D_FF", 0.0):
        raise DataError(f"{stem}D_FF is not known here", hint="set it to 0 for the flight")
    unit = np.pi / 180.0 * THOUSANDTHS
    return Controller(
        {f"{stem}P": p, "I": i, "D": d},
        unit * p,
        unit * i,
        unit * d,
        1.0,
        ((1, slope),),
        ((1, error),),
        ((1, target),),
        unit * stated.get(stem + "FF", 0.0),
        slope_filtered=True,
    )


def _find_stated(stated: Mapping[str, float], *names: str) -> tuple[float, ...]:
    missing = [name for name in names if name not in stated]
    if missing:
        raise DataError(
            f"the log does not state {', '.join(missing)}",
            hint="log the parameters; known are PX4 1.12 on and ArduCopter 4.0 on",
        )
    return tuple(stated[name] for name in names)


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

    Parameters
    ----------
    low, high : Hz, between which it is compared.
    checks : of its terms; those that miss are named. All of them must fit where the law only stands in.
    """
    miss = controller.miss(loop, low, high)
    off = "; ".join(check.complaint() for check in checks if not check.fits)
    if not controller.exact and (off or not checks):
        raise DataError(
            f"{controller.law}, and {off or 'the log records no terms to check it against'}",
            hint="update flysid, or log with a version that is described; "
            "the loop itself: flysid tf LOG -r betaflight-rate",
        )
    proven = bool(checks) and not off
    if not miss <= largest and not proven:
        raise DataError(
            f"the stated gains do not give what the log recorded: {100.0 * miss:.0f} % off between "
            f"{low:.0f} and {high:.0f} Hz, {100.0 * largest:.0f} % are allowed; "
            f"{off or 'the log does not show why'}",
            hint="possible causes to look at: a term of the firmware's law that this log does not carry, "
            "another profile or mode, gains changed in flight, another unit",
        )
    return miss
