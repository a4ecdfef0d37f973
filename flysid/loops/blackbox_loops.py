"""Rate loops of a blackbox log: setpoint, controller's output, gyro; the header's settings."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.formats.blackbox.codes import EventKind
from flysid.ingest.lake.headers import WHOLE, header_of
from flysid.laws.described import blackbox_law
from flysid.loops.axis_flight import GAP_S, AxisFlight, axis_flight, fields_of
from flysid.loops.betaflight import AXES, BetaflightLaw, Conditions
from flysid.loops.law_parts import TermCheck
from flysid.loops.stick_response import Loop, StickRecord, output
from flysid.loops.term_check import check_terms

LARGEST_SHARE = 0.05
"""Of the time at a limit: beyond, what is seen is the limit."""


def settings_of(log: Any) -> dict[str, str]:
    """A header's settings by name. Raises DataError: the log is no blackbox log."""
    settings = header_of(log)
    if not settings or "main" not in log.rows:
        raise DataError(
            f"{log.name} records no rate loop: it has neither vehicle_rates_setpoint (PX4) nor RATE "
            "(ArduPilot) nor a blackbox header (Betaflight)",
            hint="take the log that the vehicle wrote itself: .ulg, .bin with RATE, or blackbox",
        )
    return settings


def record_of(
    log: Any, axis: str, settings: Mapping[str, str], *, rate_hz: float = 500.0
) -> tuple[StickRecord, Conditions]:
    """One axis of a flight on an even grid, and what its gains depended on.

    Raises DataError: fields are missing; the controller's output was at its limit for more than 5 % of the
    time; parts of the law move with the flight, and the header does not state how long a loop takes.
    """
    law = BetaflightLaw.of(settings, axis)
    if law.changes_in_flight and not law.step_s:
        raise DataError("the log's header does not state looptime: no term can be compared", hint=WHOLE)
    flight = axis_flight(log, axis, settings, law)
    limit = law.limits[list(AXES).index(axis)]
    share = float((np.abs(flight.output) >= limit - 1.0).mean())
    if share > LARGEST_SHARE:
        raise DataError(
            f"{log.name}: the {axis} controller was at its limit for {100.0 * share:.0f} % of the flight",
            hint="fly more gently: in saturation the gains have no effect",
        )
    rows = flight.rows
    record = _even(log.name, rate_hz, flight, flight.output, rows.rate)
    checks, means = check_terms(law, rows, flight.terms, law.step_s * flight.slower, flight.rate_hz)
    checks = tuple(check if check.fits else _name_adjustment(check, log, axis, settings) for check in checks)
    forward = None
    if "F" in flight.terms:
        alone = Loop.of([_even(log.name, rate_hz, flight, flight.terms["F"], flight.terms["F"])])
        forward = (alone.f, output(alone.mean))
    flown = Conditions(
        flight.throttle,
        rows.setpoint,
        flight.stick,
        flight.slower,
        means if law.changes_in_flight else None,
        forward,
        checks,
        law.f,
        limit,
    )
    return record, flown


def _name_adjustment(check: TermCheck, log: Any, axis: str, settings: Mapping[str, str]) -> TermCheck:
    """A term that misses, with the change of its gain that the log itself states, where it states one."""
    numbers = blackbox_law(settings["Firmware revision"]).part("adjusted").get(axis, {}).get(check.term, [])
    if "events" not in log.facts.streams or not numbers:
        return check
    events = fields_of(log, "events", ["time_ns", "event", "value", "other"])
    at = (events["event"] == EventKind.ADJUSTMENT) & np.isin(events["other"], numbers)
    if not at.any():
        return check
    begin = fields_of(log, "main", ["time_ns"])["time_ns"][0]
    time, value = (1e-9 * (events["time_ns"][at][0] - begin), events["value"][at][0])
    return replace(check, cause=f"an adjustment in flight set its gain to {value:g} at {time:.0f} s")


def _even(name: str, rate_hz: float, flight: AxisFlight, u: FloatArray, y: FloatArray) -> StickRecord:
    """Setpoint and two signals of a flight on an even grid."""
    time = flight.time
    return StickRecord(
        name, rate_hz, even_pieces(rate_hz, time, time, flight.rows.setpoint, u, y, breaks=flight.breaks)
    )


def even_pieces(
    rate_hz: float,
    time: FloatArray,
    asked_at: FloatArray,
    r: FloatArray,
    u: FloatArray,
    y: FloatArray,
    outside: tuple[FloatArray, FloatArray] | None = None,
    *,
    breaks: npt.NDArray[np.bool_] | None = None,
) -> tuple[FloatArray, ...]:
    """Stretches without a gap, on an even grid: setpoint, output, rate, and times and values from outside.

    `breaks`: (N - 1,) behind which rows a stretch ends; None: before long steps of the time.
    """
    if breaks is None:
        breaks = np.diff(time) > max(GAP_S, 3.0 / rate_hz)
    edges = [0, *(np.flatnonzero(breaks) + 1), len(time)]
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
