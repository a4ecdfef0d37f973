"""One axis of a blackbox flight: what its controller saw and what it gave, row by row of the log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.flightwriter import float_values
from flysid.ingest.lake.headers import stated_number
from flysid.loops.betaflight import AXES, BetaflightLaw
from flysid.loops.rebuilt import MOST_LOOPS_BETWEEN, Rows

FULL_STICK = 500.0
IDLE, RANGE = 1000.0, 1000.0
"""us of the stick's throttle at its lower end, and from there to its upper one."""
FINE = 0.1
"""Of setpoint, rate and stick in a log of high resolution."""
MOVED_WITHIN_S = 0.1
"""Within which anti-gravity looks for a movement of the throttle."""
GAP_S = 0.02
"""Between rows, from which on a piece of a record ends where rows are missing."""
SIDES = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
"""How roll, pitch and yaw enter the motors: rear right, front right, rear left, front left."""


@dataclass(frozen=True, eq=False)
class AxisFlight:
    """One axis, row by row.

    `time`: (N,) s.
    `terms`: (N,) thousandths, what the controller gave, by the letter of the term.
    `throttle`, `stick`: (N,) us, and the stick's way from its middle, 0 to 1.
    `rows`: what the controller saw.
    `breaks`: (N - 1,) whether rows are missing behind a row: a loop that was late is none.
    `slower`: steps of the loop over those that the header states.
    """

    time: FloatArray
    terms: Mapping[str, FloatArray]
    throttle: FloatArray
    stick: FloatArray
    rows: Rows
    breaks: npt.NDArray[np.bool_]
    slower: float

    @property
    def output(self) -> FloatArray:
        """(N,) the sum of the terms."""
        return np.asarray(np.sum(list(self.terms.values()), axis=0))

    @property
    def rate_hz(self) -> float:
        """Of the log's rows."""
        return float(1.0 / np.median(np.diff(self.time)))


def axis_flight(log: Any, axis: str, settings: Mapping[str, str], law: BetaflightLaw) -> AxisFlight:
    """One axis of a flight. Raises DataError: fields are missing."""
    k = list(AXES).index(axis)
    fine = FINE if stated_number(settings, "blackbox_high_resolution", otherwise=0.0) else 1.0
    fields = term_fields(law, k)
    names = ["time_ns", "loopIteration", f"gyroADC[{k}]", *fields.values(), f"rcCommand[{k}]", "rcCommand[3]"]
    mixer = ["setpoint[3]"] if law.throttle_of == "mixer" else []
    apart = "setpoint" in log.facts.streams
    asked = f"setpoint[{k}]" if apart else f"{law.setpoint_field}[{k}]"
    values = fields_of(log, "main", [*names, *mixer, *([] if apart else [asked])])
    time = values["time_ns"] * 1e-9
    if apart:
        own = fields_of(log, "setpoint", ["time_ns", asked])
        setpoint = _slew(time, np.interp(time, own["time_ns"] * 1e-9, own[asked]), law.acceleration)
    else:
        setpoint = fine * values[asked]
    throttle = fine * values["rcCommand[3]"]
    stick = np.abs(fine * values[f"rcCommand[{k}]"]) / FULL_STICK
    terms = {letter: values[name] for letter, name in fields.items()}
    loop = values["loopIteration"]
    nothing = np.zeros(len(time))
    rows = Rows(
        loop,
        setpoint,
        law.weighed(setpoint, stick),
        fine * values[f"gyroADC[{k}]"],
        values["setpoint[3]"] / RANGE if mixer else (throttle - IDLE) / RANGE,
        np.ptp(SIDES.T @ outputs_of(log, settings), axis=0) / RANGE
        if law.windup < 1.0 or law.freezes
        else nothing,
        _quicken(time, throttle, law.anti_gravity),
        carried_over(log, k, fine),
        terms["F"] / law.f if law.boost and "F" in terms else nothing,
        terms["I"],
        fine,
    )
    return AxisFlight(time, terms, throttle, stick, rows, _breaks(time, loop), slower(time, loop, law.step_s))


def term_fields(law: BetaflightLaw, axis: int) -> dict[str, str]:
    """Fields of an axis whose sum is the controller's output, by the letter of the term."""
    letters = "PI" + ("D" if law.d > 0.0 else "") + ("F" if law.has_forward else "")
    return {letter: f"axis{letter}[{axis}]" for letter in letters}


def outputs_of(log: Any, settings: Mapping[str, str]) -> FloatArray:
    """(3, N) what roll, pitch and yaw give to the mixer, thousandths, inside their limits.

    Raises DataError: fields or gains are missing.
    """
    found = []
    for axis, name in enumerate(AXES):
        law = BetaflightLaw.of(settings, name)
        values = fields_of(log, "main", term_fields(law, axis).values())
        found.append(np.clip(np.sum(list(values.values()), axis=0), -law.limits[axis], law.limits[axis]))
    return np.array(found)


def carried_over(log: Any, axis: int, fine: float) -> FloatArray:
    """(N,) thousandths a second that an axis' integral gets from the others' as the body turns."""
    one, other = (axis + 1) % len(AXES), (axis + 2) % len(AXES)
    names = [f"{field}[{k}]" for k in (one, other) for field in ("axisI", "gyroADC")]
    first, about_first, second, about_second = fields_of(log, "main", names).values()
    return np.asarray(fine * np.radians(about_second * first - about_first * second))


def _quicken(time: FloatArray, throttle: FloatArray, steps: tuple[float, float]) -> FloatArray:
    """(N,) factor of the integral by the older anti-gravity: factor, and threshold of the throttle, us."""
    factor, threshold = steps
    if factor == 1.0:
        return np.ones(len(time))
    moved = np.abs(throttle - np.interp(time - MOVED_WITHIN_S, time, throttle))
    return np.where(moved > threshold, factor, 1.0)


def _breaks(
    time: FloatArray, loop: FloatArray, *, gap_s: float = GAP_S, longest_s: float = 0.25
) -> npt.NDArray[np.bool_]:
    """(N - 1,) where rows are missing or the loop stood still for longer than `longest_s`.

    A processor that others share is late by tens of milliseconds at times; the loop's numbers go on.
    """
    passed, gone = np.diff(time), np.diff(loop)
    missing = (gone <= 0.0) | (gone > 2.0 * np.median(gone))
    return np.asarray((missing & (passed > gap_s)) | (passed > longest_s))


@njit(cache=True)
def _slew(time: Any, values: Any, limit: Any) -> Any:
    """(N,) values that change by no more than a limit (per second) from row to row; all of them for 0."""
    found = values.copy()
    if limit > 0.0:
        for k in range(1, values.size):
            most = limit * max(time[k] - time[k - 1], 0.0)
            found[k] = min(max(values[k], found[k - 1] - most), found[k - 1] + most)
    return found


def slower(time: FloatArray, loops: FloatArray, stated: float) -> float:
    """Steps of the loop over those that the header states; 1 where it states none.

    `time`, `loops`: (N,) s, and numbers of the loop that a row is of; gaps and restarts do not count.
    `stated`: s.
    """
    gone, passed = np.diff(loops), np.diff(time)
    inside = (gone > 0.0) & (gone <= MOST_LOOPS_BETWEEN)
    return float(passed[inside].sum() / gone[inside].sum() / stated) if stated and inside.any() else 1.0


def fields_of(log: Any, stream: str, names: Iterable[str]) -> dict[str, FloatArray]:
    """(N,) each. Raises DataError: one is missing."""
    wanted = list(names)
    try:
        table = log.table(stream, wanted)
    except (KeyError, UsageError) as error:
        raise DataError(
            f"{log.name} lacks a field of the rate loop: {error}",
            hint="log PID terms, sticks, setpoint and gyro: blackbox_disable_pids, _setpoint, _gyro OFF",
        ) from error
    return {name: float_values(table[name]) for name in wanted}
