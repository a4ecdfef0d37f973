"""Rate loops of a blackbox log: setpoint, controller's output, gyro on an even grid; the header's gains."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.loops.controller import AXES
from flysid.loops.stick_response import StickRecord

LARGEST_SHARE = 0.05
"""Of the time at a limit: beyond, what is seen is the limit."""


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


def record_of(
    log: Any, axis: str, settings: Mapping[str, str], *, rate_hz: float = 500.0
) -> tuple[StickRecord, FloatArray]:
    """One axis of a flight, and the throttle (us).

    Raises
    ------
    DataError : fields are missing; the controller's output was at its limit for more than 5 % of the time.
    """
    k = list(AXES).index(axis)
    terms = [f"axis{term}[{k}]" for term in "PID" if term != "D" or axis != "yaw"]
    columns = ["time_ns", f"gyroADC[{k}]", *terms, "rcCommand[3]"]
    setpoint = f"setpoint[{k}]"
    try:
        main = log.table("main", columns)
        asked = log.table("setpoint", ["time_ns", setpoint])
    except (KeyError, DataError, UsageError) as error:
        raise DataError(
            f"{log.name} lacks a field of the {axis} loop: {error}",
            hint="log PID terms, sticks and gyro (Betaflight before 4.0)",
        ) from error
    values = {name: np.asarray(main[name], dtype=np.float64) for name in columns}
    time = values["time_ns"] * 1e-9
    output = np.sum([values[name] for name in terms], axis=0)
    limit = float(settings.get("pidsum_limit_yaw" if axis == "yaw" else "pidsum_limit") or np.inf)
    share = float((np.abs(output) >= limit - 1.0).mean())
    if share > LARGEST_SHARE:
        raise DataError(
            f"{log.name}: the {axis} controller was at its limit for {100.0 * share:.0f} % of the flight",
            hint="fly more gently: in saturation the gains have no effect",
        )
    r = np.asarray(asked[setpoint], dtype=np.float64)
    at = np.asarray(asked["time_ns"], dtype=np.float64) * 1e-9
    record = StickRecord(
        log.name, rate_hz, even_pieces(rate_hz, time, at, r, output, values[f"gyroADC[{k}]"])
    )
    return record, values["rcCommand[3]"]


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
