"""Fly plants through flight plans, and turn the flights into recordings that the writers take.

Everything is fixed by the seed, times included: flights start at `EPOCH_NS`, ten minutes apart, so that the
same command writes the same bytes on every day.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.plans import GENTLE, Manoeuvre, plan_named
from flysid.ingest.plants import LOOPS, fly
from flysid.ingest.telemetry import MS_NS, SECOND_NS, Recording, Series
from flysid.ingest.write_mcap import mcap_bytes
from flysid.ingest.write_tlog import tlog_bytes

EPOCH_NS = 1_767_225_600 * SECOND_NS  # 2026-01-01T00:00:00Z
APART_NS = 600 * SECOND_NS
TAKE_OFF_NS = 12 * SECOND_NS  # vehicle time of the first sample: boot, arm, climb
PERIOD_NS = 20 * MS_NS  # 50 Hz
ATTITUDE_LAG_S = 0.12

WRITERS: Mapping[str, tuple[str, Callable[[Recording], bytes]]] = {
    "tlog": (".tlog", tlog_bytes),
    "mcap": (".mcap", mcap_bytes),
}


@dataclass(frozen=True)
class Order:
    """What is to be flown.

    Attributes
    ----------
    plant : "ardrone-linear".
    plan : a name of `plans.PLANS`.
    duration_s : of each flight.
    noise : standard deviation of the velocities' measurement noise, m/s.
    seed : fixes signals, noise and jitter.
    amplitude : multiplies the plan's amplitudes (the paper's own signals keep theirs).
    dropouts_s : (start, length) of silent stretches of the link, seconds from the first sample.
    """

    plant: str = "ardrone-linear"
    plan: str = "mixed"
    duration_s: float = 120.0
    noise: float = 0.02
    seed: int = 1
    amplitude: float = 1.0
    dropouts_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.plant not in VEHICLES:
            raise UsageError(f"no plant {self.plant!r}", hint="one of " + ", ".join(VEHICLES))
        if not 1.0 <= self.duration_s <= 86400.0:
            raise UsageError(f"a flight of {self.duration_s:g} s", hint="between 1 s and 86400 s")
        if not (0.0 <= self.noise < np.inf and 0.0 < self.amplitude < np.inf):
            raise UsageError("noise must not be negative, the amplitude must be positive")
        if self.seed < 0 or any(start < 0 or length <= 0 for start, length in self.dropouts_s):
            raise UsageError(
                "seeds and the starts of drop-outs must not be negative, lengths must be positive"
            )


def flight_names(order: Order) -> list[str]:
    """The names of the order's flights: number in the plan, manoeuvre, seed."""
    return [
        f"{i:02d}-{manoeuvre.name}-seed{order.seed}"
        for i, manoeuvre in enumerate(plan_named(order.plan), start=1)
    ]


def flights(order: Order) -> list[Recording]:
    """Fly every manoeuvre of the plan."""
    return [fly_one(order, index) for index in range(len(plan_named(order.plan)))]


def fly_one(order: Order, index: int) -> Recording:
    """Fly one manoeuvre of the plan; independent of the others, so flights can be flown in any order."""
    manoeuvre = plan_named(order.plan)[index]
    rng = np.random.default_rng([order.seed, index])
    time_s = np.arange(round(order.duration_s / (PERIOD_NS * 1e-9)), dtype=np.float64) * (PERIOD_NS * 1e-9)
    command = commands(order, manoeuvre, time_s, rng)
    truth = VEHICLES[order.plant](command, PERIOD_NS * 1e-9)
    time_ns = TAKE_OFF_NS + PERIOD_NS * np.arange(len(time_s), dtype=np.int64)
    return Recording(
        name=flight_names(order)[index],
        boot_utc_ns=EPOCH_NS + index * APART_NS,
        command=Series(time_ns, dict(zip(("theta_in", "phi_in", "vz_in"), command.T, strict=True))),
        state=Series(time_ns, measured(truth, order.noise, rng)),
        truth=Series(time_ns, truth),
        seed=order.seed * 1000 + index,
        lost=tuple(_interval_ns(start, length) for start, length in order.dropouts_s),
    )


def commands(order: Order, manoeuvre: Manoeuvre, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 3) theta_in (deg), phi_in (deg), vz_in (m/s)."""
    size = order.amplitude * manoeuvre.scale
    return manoeuvre.command(time_s, (GENTLE[0] * size, GENTLE[1] * size, GENTLE[2] * size), rng)


def fly_linear(command: FloatArray, dt_s: float) -> dict[str, FloatArray]:
    """The plants (10), (11), (12), from rest, uncoupled.

    Tilt is not part of those equations; it follows the command with a first-order lag of 0.12 s, so that the
    attitude messages have something to say. Position is the integral of velocity (trapezoidal).
    """
    truth = {loop.output: fly(loop, u, dt_s) for loop, u in zip(LOOPS.values(), command.T, strict=True)}
    keep = np.exp(-dt_s / ATTITUDE_LAG_S)
    truth |= {name: _lagged(u, keep) for name, u in zip(("theta", "phi"), command.T, strict=False)}
    truth["psi"] = np.zeros(len(command))
    for axis in "xyz":
        v = truth[f"v{axis}"]
        truth[axis] = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * dt_s / 2)])
    return truth


VEHICLES: Mapping[str, Callable[[FloatArray, float], dict[str, FloatArray]]] = {"ardrone-linear": fly_linear}


def measured(
    truth: Mapping[str, FloatArray], noise: float, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """What the sensors say: white noise on the velocities; position and tilt are taken as exact."""
    return {
        name: values + noise * rng.standard_normal(len(values)) if name in ("vx", "vy", "vz") else values
        for name, values in truth.items()
    }


def _lagged(u: FloatArray, keep: float) -> FloatArray:
    """x[k+1] = keep x[k] + (1 - keep) u[k], from rest."""
    x = np.zeros(len(u))
    for k in range(len(u) - 1):
        x[k + 1] = keep * x[k] + (1.0 - keep) * u[k]
    return x


def _interval_ns(start_s: float, length_s: float) -> tuple[int, int]:
    start = TAKE_OFF_NS + round(start_s * SECOND_NS)
    return start, start + round(length_s * SECOND_NS)
