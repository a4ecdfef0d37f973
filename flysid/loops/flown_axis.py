"""One axis of a Betaflight flight, and the same flight with another plant or other gains, step by step.

Sticks that weigh the setpoint, the integral's windup, TPA and the limits of output and motors make the loop
nonlinear, but all of it is known. So it is stepped as the firmware does: the controller, the mixer of a quad
X, and a vehicle that turns by what the motors were given. Throttle, sticks and the other axes' outputs are
those of the log; gusts and noise are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.ingest.lake.headers import stated_numbers
from flysid.loops.axis_flight import FULL_STICK, MOVED_WITHIN_S, SIDES, fields_of, outputs_of, slower
from flysid.loops.betaflight import AXES, FULL_THROTTLE, IDLE_STICK, BetaflightLaw
from flysid.loops.blackbox_loops import even_pieces
from flysid.loops.controller import THOUSANDTHS
from flysid.loops.stages import sections
from flysid.loops.stick_response import ComplexArray, StickRecord
from flysid.spectra.running import filter_sample

MOTORS = 4


@dataclass(frozen=True)
class Turning:
    """gain / (s (lag s + 1)) e^(-delay s), from what the motors were given to the rate."""

    gain: float
    lag_s: float
    delay_s: float

    def response(self, f: FloatArray, step_s: float) -> ComplexArray:
        """(F,) as it is stepped."""
        back = np.exp(-2j * np.pi * f * step_s)
        keep = np.exp(-step_s / self.lag_s)
        whole = (1.0 - keep * back) * (1.0 - back)
        late = np.exp(-2j * np.pi * f * self.delay_s)
        return np.asarray(self.gain * step_s * back * (1.0 - keep) * late / whole)


@dataclass(frozen=True, eq=False)
class FlownAxis:
    """Roll or pitch of one flight, row by row of its log.

    `time`: (N,) s.
    `setpoint`, `stick`, `throttle`: (N,) deg/s, 0 to 1, us.
    `axis`: 0 roll, 1 pitch.
    `others`: (4, N) what the other axes add to the motors, thousandths.
    `rate`, `given`: (N,) deg/s, and what the motors were given for this axis, thousandths.
    `airmode`: the throttle gives way to the axes.
    `slower`: steps of the loop over those that the header states.
    """

    name: str
    law: BetaflightLaw
    time: FloatArray
    setpoint: FloatArray
    stick: FloatArray
    throttle: FloatArray
    axis: int
    others: FloatArray
    rate: FloatArray
    given: FloatArray
    airmode: bool
    slower: float

    @property
    def step_s(self) -> float:
        """Of the loop, as it ran."""
        return self.law.step_s * self.slower

    def record(self, rate_hz: float = 500.0) -> StickRecord:
        """Setpoint, what the motors were given, and rate on an even grid."""
        rows = (self.time, self.setpoint, self.given, self.rate)
        return StickRecord(self.name, rate_hz, even_pieces(rate_hz, self.time, *rows))

    def fly(self, plant: Turning, law: BetaflightLaw | None = None) -> FlownAxis:
        """The same flight of another vehicle, under the same gains or others."""
        law = law or self.law
        grid = np.arange(self.time[0], self.time[-1], self.step_s)

        def at(values: FloatArray) -> FloatArray:
            return np.interp(grid, self.time, values)

        moved = np.abs(at(self.throttle) - np.interp(grid - MOVED_WITHIN_S, self.time, self.throttle))
        gain, threshold = law.anti_gravity
        numbers = np.array(
            [
                law.p,
                law.i,
                law.d,
                law.step_s if law.slope_filtered else self.step_s,
                law.windup,
                law.largest_i,
                law.limits[self.axis],
                np.exp(-self.step_s / plant.lag_s),
                plant.gain * self.step_s,
                plant.delay_s / self.step_s,
            ]
        )
        rate, given = _step(
            at(self.setpoint),
            at(law.weighed(self.setpoint, self.stick)),
            at(law.kept(self.throttle)),
            np.where(moved > threshold, gain, 1.0),
            np.array([at(row) for row in self.others]),
            at(_opened(self.throttle)),
            SIDES[self.axis],
            self.airmode,
            law.slope_filtered,
            sections(law.filters, law.notch, law.step_s),
            numbers,
        )
        return replace(
            self,
            law=law,
            rate=np.interp(self.time, grid, rate),
            given=np.interp(self.time, grid, given),
        )


def flown_axis(log: Any, axis: str, settings: Mapping[str, str], *, largest_miss: float = 0.05) -> FlownAxis:
    """Roll or pitch of a log.

    `largest_miss`: of the motors that the mixer gives, root mean square, in shares of their range.
    Raises UsageError: yaw. Raises DataError: another firmware, fields or settings are missing, or the motors
    are not those of a quad X.
    """
    if axis not in ("roll", "pitch"):
        raise UsageError(f"{axis} cannot be flown again: its P is filtered", hint="roll or pitch")
    k = list(AXES).index(axis)
    law = BetaflightLaw.of(settings, axis)
    if not law.step_s:
        raise DataError(f"{log.name} does not state its looptime", hint="log with the header whole")
    if law.changes_in_flight:
        raise DataError(
            f"{log.name}: {law.title} is not stepped with its motors here",
            hint="its loop under other gains: flysid predict",
        )
    motors = [f"motor[{i}]" for i in range(MOTORS)]
    names = ["time_ns", "loopIteration", f"gyroADC[{k}]", f"rcCommand[{k}]", "rcCommand[3]"]
    values = fields_of(log, "main", [*names, *motors])
    asked = fields_of(log, "setpoint", ["time_ns", f"setpoint[{k}]"])
    time = values["time_ns"] * 1e-9
    idle, full = stated_numbers(settings, "motorOutput", least=2)[:2] or (0.0, 0.0)
    turned = (np.array([values[name] for name in motors]) - idle) / max(full - idle, 1.0)
    throttle = values["rcCommand[3]"]
    outputs = outputs_of(log, settings)
    every = [side[:, None] * output for side, output in zip(SIDES, outputs, strict=True)]
    others = np.sum([part for j, part in enumerate(every) if j != k], axis=0)
    misses = []
    for airmode in (False, True):
        told = _mixed(every[k] + others, _opened(throttle), airmode)
        misses.append(float(np.sqrt(((told - turned) ** 2).mean())))
    if min(misses) > largest_miss:
        raise DataError(
            f"{log.name}: the motors are not what a quad X makes of the PID sums: off by "
            f"{100.0 * min(misses):.0f} % of their range, {100.0 * largest_miss:.0f} % are allowed",
            hint="only a quad X with Betaflight's own mixer is known",
        )
    return FlownAxis(
        log.name,
        law,
        time,
        np.interp(time, asked["time_ns"] * 1e-9, asked[f"setpoint[{k}]"]),
        np.abs(values[f"rcCommand[{k}]"]) / FULL_STICK,
        throttle,
        k,
        others,
        values[f"gyroADC[{k}]"],
        THOUSANDTHS / MOTORS * (SIDES[k] @ turned),
        misses[1] < misses[0],
        slower(time, values["loopIteration"], law.step_s),
    )


def _opened(throttle: FloatArray) -> FloatArray:
    """(N,) throttle as a share of the motors' range."""
    return np.asarray(np.clip((throttle - IDLE_STICK) / (FULL_THROTTLE - IDLE_STICK), 0.0, 1.0))


@njit(cache=True)
def _mix(wanted, throttle, airmode, motors):  # type: ignore[no-untyped-def]
    """The motors (4,) for (4,) thousandths of the axes; what share of the range the axes ask for."""
    low = wanted.min() / 1000.0
    high = wanted.max() / 1000.0
    asked = high - low
    shrunk = max(asked, 1.0)
    if asked > 1.0 and airmode:
        throttle = 0.5
    if airmode or (asked <= 1.0 and throttle > 0.5):
        throttle = min(max(throttle, -low / shrunk), 1.0 - high / shrunk)
    for i in range(wanted.size):
        motors[i] = min(max(wanted[i] / 1000.0 / shrunk + throttle, 0.0), 1.0)
    return asked


@njit(cache=True)
def _mixed(wanted, throttle, airmode):  # type: ignore[no-untyped-def]
    """(4, N) motors."""
    motors = np.empty(wanted.shape)
    one = np.empty(wanted.shape[0])
    for k in range(wanted.shape[1]):
        _mix(wanted[:, k].copy(), throttle[k], airmode, one)
        motors[:, k] = one
    return motors


@njit(cache=True)
def _step(setpoint, weighed, kept, faster, others, throttle, side, airmode, whole, sections, numbers):  # type: ignore[no-untyped-def]
    """(N,) rate and what the motors are given; `whole`: all of the derivative is filtered, and freely
    integrated."""
    p, i, d, dt, windup, largest_i, limit, keep, turn, late = numbers
    n = setpoint.size
    rate = np.zeros(n)
    given = np.zeros(n)
    states = np.zeros((sections.shape[0], 2))
    motors = np.empty(side.size)
    wanted = np.empty(side.size)
    total = 0.0
    asked = 0.0
    torque = 0.0
    now = 0.0
    before = weighed[0]
    for k in range(n):
        rate[k] = now
        error = setpoint[k] - now
        free = min(max((1.0 - asked) / max(1.0 - windup, 1e-9), 0.0), 1.0)
        more = total + i * error * dt * faster[k] * free
        more = min(max(more, -largest_i), largest_i)
        if whole or asked < 1.0 or abs(more) < abs(total):
            total = more
        seen = weighed[k] - (now if whole else filter_sample(now, sections, states))
        slope = (seen - before) / dt
        before = seen
        if whole:
            slope = filter_sample(slope, sections, states)
        output = kept[k] * (p * error + d * slope) + total
        output = min(max(output, -limit), limit)
        for m in range(side.size):
            wanted[m] = side[m] * output + others[m, k]
        asked = _mix(wanted, throttle[k], airmode, motors)
        for m in range(side.size):
            given[k] += side[m] * motors[m] * 1000.0 / side.size
        back = k - int(np.floor(late))
        share = late - np.floor(late)
        drive = (1.0 - share) * given[back] if back >= 0 else 0.0
        if back >= 1:
            drive += share * given[back - 1]
        torque = keep * torque + (1.0 - keep) * drive
        now += turn * torque
    return rate, given
