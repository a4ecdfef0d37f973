"""Recorded terms of PX4's and ArduPilot's rate controllers against the law, as far as logs have them.

ArduPilot's PIDR, PIDP and PIDY hold the filtered error and what each gain made of it; PX4's rate_ctrl_status
the integrals alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter
from flysid.laws.described import parameter_law
from flysid.loops.betaflight import NO_CONDITIONS, Conditions
from flysid.loops.controller import THOUSANDTHS
from flysid.loops.law_parts import TermCheck
from flysid.loops.parameter_laws import px4_law
from flysid.loops.parameterlogs import column_of
from flysid.loops.stages import sections
from flysid.loops.term_check import compare

FASTER = 8.0
"""Of a log's rate over a derivative's cut-off, from which on its filter is computed from the log's rows."""


def ardupilot_checks(log: Any, axis: str, stated: Mapping[str, float]) -> Conditions:
    """P, I, D and FF of the log's PID message; none where it has none."""
    law = parameter_law("arducopter")
    stream = str(law.part("record")[axis])
    if stream not in log.facts.streams:
        return NO_CONDITIONS
    names = set(log.columns(stream))
    if not {"Tar", "Err", "P", "I", "D"} <= names:
        return NO_CONDITIONS
    time, error = column_of(log, stream, "Err")
    of = {name: column_of(log, stream, name)[1] for name in names & {"Tar", "P", "I", "D", "FF", "Dmod"}}
    shrunk = of.get("Dmod", np.ones(len(time)))
    shrunk = np.where(shrunk > 0.0, shrunk, 1.0)
    own = law.part("axes")[axis]
    p, i, d = (stated[law.name_of(role, axis=own)] for role in "pid")
    rebuilt = {"P": p * error * shrunk, "I": _gained(time, i * error)}
    slope_hz = stated.get(law.name_of("slope_hz", axis=own), 0.0)
    rate_hz = _rate_of(time)
    if rate_hz >= FASTER * slope_hz:
        rebuilt["D"] = d * shrunk * _slope(time, error, slope_hz, rate_hz)
    forward = stated.get(law.name_of("forward", axis=own), 0.0)
    if forward and "FF" in of:
        rebuilt["F"] = forward * of["Tar"]
    recorded = {("F" if name == "FF" else name): values for name, values in of.items()}
    return _checked({term: recorded[term] for term in rebuilt}, rebuilt, rate_hz)


def px4_checks(log: Any, axis: str, stated: Mapping[str, float]) -> Conditions:
    """The recorded integral; nothing where the log has none."""
    law = px4_law(stated)
    record = law.part("record")
    stream, name = str(record["stream"]), str(record[axis])
    if stream not in log.facts.streams or name not in log.columns(stream):
        return NO_CONDITIONS
    own = law.part("axes")[axis]
    k, i = (stated[law.name_of(role, axis=own)] for role in ("k", "i"))
    time, integral = column_of(log, stream, name)
    at, setpoint = column_of(log, "vehicle_rates_setpoint", axis)
    when, rate = column_of(log, "vehicle_angular_velocity", "xyz", list(law.part("axes")).index(axis))
    error = np.interp(when, at, setpoint) - rate
    faded = np.maximum(0.0, 1.0 - (np.degrees(error) / float(law.part("integral")["fades_at"])) ** 2)
    total = np.interp(time, when, _gained(when, k * i * faded * error))
    return _checked({"I": integral}, {"I": total}, _rate_of(time))


def _checked(
    recorded: Mapping[str, FloatArray], rebuilt: Mapping[str, FloatArray], rate_hz: float
) -> Conditions:
    """Checks of terms in shares of the output."""
    found: list[TermCheck] = []
    for term, values in rebuilt.items():
        own = THOUSANDTHS * recorded[term]
        flown = recorded["I"] != 0.0
        check = compare(term, own, THOUSANDTHS * values, flown, rate_hz, np.zeros(len(own)))
        found += [check] if check is not None else []
    return Conditions(
        NO_CONDITIONS.throttle, NO_CONDITIONS.setpoint, NO_CONDITIONS.stick, checks=tuple(found)
    )


def _gained(time: FloatArray, slope: FloatArray) -> FloatArray:
    """(N,) what a slope adds up to."""
    steps = np.diff(time, prepend=time[:1])
    return np.asarray(np.cumsum(slope * steps))


def _slope(time: FloatArray, error: FloatArray, hz: float, rate_hz: float) -> FloatArray:
    """(N,) the derivative behind a first-order low-pass."""
    steps = np.maximum(np.diff(time, prepend=time[0] - 1.0 / rate_hz), 1e-6)
    bare = np.diff(error, prepend=error[:1]) / steps
    if hz <= 0.0:
        return np.asarray(bare)
    b0, _, _, a1, _ = sections(((1, hz),), (0.0, 0.0), 1.0 / rate_hz)[0]
    return apply_filter(np.array([b0]), np.array([1.0, a1]), bare)


def _rate_of(time: FloatArray) -> float:
    return float(1.0 / np.median(np.diff(time))) if len(time) > 2 else 0.0
