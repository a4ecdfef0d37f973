"""How much of the time rate controllers and motors stand truly at their limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.ingest.lake.motors import read_motors
from flysid.loops.betaflight import AXES
from flysid.reviews.follow import Counting
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.pairs import recipe_of


@dataclass(frozen=True)
class AtLimit:
    """Share of the time in the air that a controller's output stands at its limit."""

    axis: str
    address: str
    share: float


def controller_limits(flight: LoggedFlight, counts: Counting) -> list[AtLimit]:
    """Of the rate controllers of roll, pitch and yaw, as far as a log states output and limit."""
    found = []
    for k, axis in enumerate(AXES):
        output = _output(flight, axis, k)
        if output is None:
            continue
        column, limit = output
        values = column.values[counts(column.time_s)]
        if len(values):
            found.append(
                AtLimit(axis, column.address, float(np.mean(np.abs(values) >= limit * (1.0 - 1e-6))))
            )
    return found


def resting_motors(flight: LoggedFlight, counts: Counting, *, least: float = 0.001) -> list[float]:
    """Of every motor the share of the time in the air that its command is its minimum.

    Parameters
    ----------
    least : share of the range up to which a command is the minimum.
    """
    flown = [motor.command.values[counts(motor.command.time_s)] for motor in read_motors(flight)]
    return [float(np.mean(values <= least)) for values in flown if len(values)]


def _output(flight: LoggedFlight, axis: str, place: int) -> tuple[Column, float] | None:
    """A controller's output and its limit."""
    if flight.has("main"):
        name = "pidsum_limit_yaw" if axis == "yaw" else "pidsum_limit"
        thousandths = flight.parameters.get(name)
        if thousandths is None:
            return None
        output = flight.signal(recipe_of("betaflight-rate").signals[f"{axis}_pid_sum"])
        return (output, 0.1 * thousandths) if output is not None else None
    output = flight.quantity(
        f"RATE.{axis[0].upper()}Out",
        f"vehicle_torque_setpoint.xyz[{place}]",
        f"actuator_controls_0.control[{place}]",
    )
    return (output, 1.0) if output is not None else None
