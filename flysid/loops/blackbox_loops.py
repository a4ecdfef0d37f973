"""Rate loops of a blackbox log: setpoint, controller's output, gyro; the header's settings."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.flightwriter import float_values
from flysid.loops.betaflight import AXES, Conditions
from flysid.loops.stick_response import StickRecord

LARGEST_SHARE = 0.05
"""Of the time at a limit: beyond, what is seen is the limit."""
FULL_STICK = 500.0


def settings_of(log: Any) -> dict[str, str]:
    """A header's settings by name.

    Raises
    ------
    DataError : the log is no blackbox log.
    """
    if "parameters" not in log.facts.streams or "main" not in log.facts.streams:
        raise DataError(
            f"{log.name} records no rate loop: it has neither vehicle_rates_setpoint (PX4) nor RATE "
            "(ArduPilot) nor a blackbox header (Betaflight)",
            hint="take the log that the vehicle wrote itself: .ulg, .bin with RATE, or blackbox",
        )
    table = log.table("parameters", ["name", "text"]).to_pydict()
    return dict(zip(table["name"], table["text"], strict=True))


def terms_of(axis: int) -> list[str]:
    """Fields of an axis whose sum is the controller's output."""
    return [f"axis{term}[{axis}]" for term in "PID" if term != "D" or axis < 2]


def fields_of(log: Any, stream: str, names: Iterable[str]) -> dict[str, FloatArray]:
    """(N,) each.

    Raises
    ------
    DataError : one is missing.
    """
    wanted = list(names)
    try:
        table = log.table(stream, wanted)
    except (KeyError, UsageError) as error:
        raise DataError(
            f"{log.name} lacks a field of the rate loop: {error}",
            hint="log PID terms, sticks and gyro (Betaflight before 4.0)",
        ) from error
    return {name: float_values(table[name]) for name in wanted}


def record_of(
    log: Any, axis: str, settings: Mapping[str, str], *, rate_hz: float = 500.0
) -> tuple[StickRecord, Conditions]:
    """One axis of a flight on an even grid, and what its gains depended on.

    Raises
    ------
    DataError : fields are missing; the controller's output was at its limit for more than 5 % of the time.
    """
    k = list(AXES).index(axis)
    terms = terms_of(k)
    names = ["time_ns", "loopIteration", f"gyroADC[{k}]", *terms, f"rcCommand[{k}]", "rcCommand[3]"]
    values = fields_of(log, "main", names)
    asked = fields_of(log, "setpoint", ["time_ns", f"setpoint[{k}]"])
    time = values["time_ns"] * 1e-9
    output = np.sum([values[name] for name in terms], axis=0)
    limit = float(settings.get("pidsum_limit_yaw" if axis == "yaw" else "pidsum_limit") or np.inf)
    share = float((np.abs(output) >= limit - 1.0).mean())
    if share > LARGEST_SHARE:
        raise DataError(
            f"{log.name}: the {axis} controller was at its limit for {100.0 * share:.0f} % of the flight",
            hint="fly more gently: in saturation the gains have no effect",
        )
    r = asked[f"setpoint[{k}]"]
    at = asked["time_ns"] * 1e-9
    record = StickRecord(
        log.name, rate_hz, even_pieces(rate_hz, time, at, r, output, values[f"gyroADC[{k}]"])
    )
    stick = np.abs(values[f"rcCommand[{k}]"]) / FULL_STICK
    flown = Conditions(
        values["rcCommand[3]"],
        np.interp(time, at, r),
        stick,
        slower(time, values["loopIteration"], settings),
    )
    return record, flown


def slower(time: FloatArray, loops: FloatArray, settings: Mapping[str, str]) -> float:
    """Steps of the loop over those that the header states; 1 where it states none.

    Parameters
    ----------
    time, loops : (N,) s, and numbers of the loop that a row is of. Where rows are lost, or the vehicle was
        started again, the steps differ from most others: those count for nothing.
    """
    stated = 1e-6 * float(settings.get("looptime") or 0.0) * float(settings.get("pid_process_denom") or 1.0)
    steps = np.diff(loops)
    usual = steps == np.median(steps) if len(steps) else np.zeros(0, dtype=bool)
    gone = float(steps[usual].sum())
    return float(np.diff(time)[usual].sum() / gone / stated) if stated and gone > 0.0 else 1.0


def even_pieces(
    rate_hz: float,
    time: FloatArray,
    asked_at: FloatArray,
    r: FloatArray,
    u: FloatArray,
    y: FloatArray,
    outside: tuple[FloatArray, FloatArray] | None = None,
    *,
    gap_s: float = 0.02,
) -> tuple[FloatArray, ...]:
    """Stretches without a gap, on an even grid: setpoint, output, rate, and times and values from outside."""
    edges = [0, *(np.flatnonzero(np.diff(time) > max(gap_s, 3.0 / rate_hz)) + 1), len(time)]
    found = []
    for begin, end in itertools.pairwise(edges):
        if end - begin < 2:
            continue
        grid = np.arange(time[begin], time[end - 1], 1.0 / rate_hz)
        own = slice(begin, end)
        rows = [
            np.interp(grid, asked_at, r),
            np.interp(grid, time[own], u[own]),
            np.interp(grid, time[own], y[own]),
        ]
        found.append(np.stack(rows + ([np.interp(grid, *outside)] if outside is not None else [])))
    return tuple(found)
