"""What goes wrong in a flight so that its rest tells nothing of the vehicle: crash, dead motor, failsafe.

The log's own words count first. Where it states the attitude and the setpoint, ArduPilot's criterion of a
crash is looked for too: more than 30 degrees apart for 2 s while flying (ArduCopter/crash_check.cpp).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.errors import RecipeError
from flysid.flight import BOOT, TIME
from flysid.ingest.align import resample
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.align.resample import FOREVER, Span
from flysid.ingest.align.signals import Log, Samples, load_signal
from flysid.ingest.align.things import find_stream

APART_DEG = 30.0
ATTITUDES = ("ardupilot-attitude", "px4-attitude")
ERRORS = {
    5: {1: "radio failsafe"},
    6: {1: "battery failsafe", 2: "battery failsafe"},
    8: {1: "ground station failsafe"},
    12: {1: "crash into the ground", 2: "loss of control"},
    17: {1: "EKF failsafe"},
    25: {1: "loss of thrust"},
}
"""ERR.Subsys -> ERR.ECode -> what it means; code 0 ends it (AP_Logger.h, LogErrorSubsystem)."""
FOR_GOOD = (12,)
"""Subsystems whose error ends the flight whatever is logged after it."""
FAILURES = {16: "ESC failure", 128: "motor failure"}
"""Bits of vehicle_status.failure_detector_status (PX4, msg/VehicleStatus.msg). Those of roll and pitch
are left alone: an aggressive flight sets them for a moment, and is worth having."""
STATES = {5: "failsafe (CRITICAL)", 6: "emergency"}
"""HEARTBEAT.system_status (MAV_STATE)."""


@dataclass(frozen=True)
class Mishap:
    """From when to when, on the vehicle's clock of one boot, and what it was."""

    boot: int
    span: Span
    what: str


def mishaps(log: Log) -> list[Mishap]:
    """All that a log tells of, in order of boot and time."""
    found = [*_stated_errors(log), *_failsafes(log), *_attitude_lost(log)]
    return sorted(found, key=lambda m: (m.boot, m.span))


def _stated_errors(log: Log) -> Iterator[Mishap]:
    """ERR messages of DataFlash logs."""
    begun: dict[tuple[int, int], tuple[int, str]] = {}
    for boot, time_ns, subsystem, code in _rows(log, "ERR", ("Subsys", "ECode")):
        words = ERRORS.get(subsystem, {}).get(code)
        if words:
            begun.setdefault((boot, subsystem), (time_ns, words))
        elif code == 0 and subsystem not in FOR_GOOD and (boot, subsystem) in begun:
            start, words = begun.pop((boot, subsystem))
            yield Mishap(boot, (start, time_ns), words)
    for (boot, _), (start, words) in begun.items():
        yield Mishap(boot, (start, FOREVER), words)


def _failsafes(log: Log) -> Iterator[Mishap]:
    """What PX4's status and MAVLink's heartbeat say, for as long as they say it."""
    yield from _while(log, "vehicle_status", "failsafe", lambda value: "failsafe" if value else "")
    yield from _while(
        log,
        "vehicle_status",
        "failure_detector_status",
        lambda value: ", ".join(words for bit, words in FAILURES.items() if int(value) & bit),
    )
    yield from _while(log, "HEARTBEAT", "system_status", lambda value: STATES.get(int(value), ""))


def _while(log: Log, message: str, column: str, meaning: Any) -> Iterator[Mishap]:
    began: tuple[int, int, str] | None = None
    for boot, time_ns, value in _rows(log, message, (column,)):
        words = meaning(value)
        if began is not None and (boot, words) != (began[0], began[2]):
            yield Mishap(began[0], (began[1], time_ns if boot == began[0] else FOREVER), began[2])
            began = None
        if words and began is None:
            began = (boot, time_ns, words)
    if began is not None:
        yield Mishap(began[0], (began[1], FOREVER), began[2])


def _attitude_lost(log: Log, *, apart_s: float = 2.0) -> Iterator[Mishap]:
    """From where roll or pitch stays far from its setpoint, to the boot's end."""
    for name in ATTITUDES:
        recipe = load_recipe(name)
        flying = condition_spans(recipe.conditions, log).spans
        for channel in recipe.channels.values():
            pair = channel.inputs[0], channel.outputs[0]
            try:
                asked, come = (load_signal(s, recipe.signals[s], log).boots for s in pair)
            except RecipeError:
                continue  # this log does not state it
            for boot in sorted(asked.keys() & come.keys()):
                runs = _far_apart(asked[boot], come[boot])
                start = next((a for a, b in resample.intersect(runs, flying.get(boot, [(0, FOREVER)]))
                              if b - a >= apart_s * 1e9), None)  # fmt: skip
                if start is not None:
                    words = f"{pair[1]} more than {APART_DEG:.0f} deg from its setpoint for {apart_s:g} s"
                    yield Mishap(boot, (start, FOREVER), words)


def _far_apart(asked: Samples, come: Samples) -> list[Span]:
    wanted = resample.tidy(asked.t_ns, asked.x)
    series = resample.tidy(come.t_ns, come.x)
    if not (len(wanted.t_ns) and len(series.t_ns)):
        return []
    inside = (series.t_ns >= wanted.t_ns[0]) & (series.t_ns <= wanted.t_ns[-1])
    t_ns = series.t_ns[inside]
    error = series.x[inside] - resample.hold(wanted, t_ns)
    return _runs(t_ns, np.abs((error + 180.0) % 360.0 - 180.0) > APART_DEG)


def _runs(t_ns: Any, holds: Any) -> list[Span]:
    """Spans of consecutive samples for which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    return [(int(t_ns[a]), int(t_ns[b - 1]) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _rows(log: Log, message: str, columns: tuple[str, ...]) -> Iterator[tuple[Any, ...]]:
    """(boot, time, values) of the autopilot's stream of that message."""
    stream = find_stream(message, log.rows)
    if stream is None or not set(columns) <= set(log.columns(stream)):
        return
    table = log.table(stream, [BOOT, TIME, *columns])
    yield from zip(*(table[c].to_pylist() for c in (BOOT, TIME, *columns)), strict=True)
