"""Constants of flights: found where there are some, and not where there are none?

`python -m bench.flight_offsets [COUNT]` draws COUNT data sets of each kind with fresh seeds: plants in wind,
with drag, under a controller that holds against the wind, integrators with a biased input; and where nothing
must be found: still air, drag alone, flights at other speeds, integrators alone. It prints how often there
were some (exact 95 % bounds), and for ARX with and without them the error of the slowest time constant.
"""

from __future__ import annotations

import secrets
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.verdict_fairness import share
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import FlysidError
from flysid.model.arx import ARX
from flysid.model.flight_offsets import find_offsets

DT_S = 0.05
ROWS = 600
GAIN = 2.0


@dataclass(frozen=True)
class Drawn:
    """A data set, and the time constant that the plant settles with; None where it has none."""

    data: Dataset
    lag_s: float | None


def as_dataset(flights: list[tuple[FloatArray, FloatArray]]) -> Dataset:
    """One segment a flight, each with a name of its own."""
    segments = tuple(
        Segment(u[:, None], y[:, None], flight=f"flight {k}") for k, (u, y) in enumerate(flights)
    )
    return Dataset(DT_S, (Signal("u", "deg"),), (Signal("y", "m/s"),), segments)


def steps(rng: np.random.Generator, rows: int = ROWS, held: int = 25) -> FloatArray:
    """Random heights, each held for a while."""
    return np.repeat(rng.normal(size=rows // held + 1), held)[:rows]


def lag(rng: np.random.Generator, *, wind: float, drag: float = 0.0, spread: float = 0.0) -> Drawn:
    """A lag, with drag where that is asked for, in wind of that spread; flights about levels of `spread`."""
    lag_s = float(rng.uniform(0.3, 4.0))
    noise = float(rng.uniform(0.01, 0.1))
    flights = []
    for _ in range(int(rng.integers(3, 9))):
        u = spread * rng.uniform(-1.0, 1.0) + (0.5 if spread else 1.0) * steps(rng)
        air = wind * rng.normal()
        y = np.full(ROWS, air)
        for k in range(ROWS - 1):
            v = y[k] - air
            y[k + 1] = y[k] + DT_S * ((GAIN * u[k] - v) / lag_s - drag * v * abs(v))
        flights.append((u, y + noise * rng.normal(size=ROWS)))
    return Drawn(as_dataset(flights), None if drag else lag_s)


def hover(rng: np.random.Generator) -> Drawn:
    """A lag under a controller of its speed, which holds against the wind."""
    lag_s = float(rng.uniform(1.0, 4.0))
    flights = []
    for _ in range(int(rng.integers(3, 9))):
        air = rng.uniform(0.5, 2.0) * rng.normal()
        wanted = steps(rng, held=40)
        u = np.zeros(ROWS)
        y = np.zeros(ROWS)
        held = -air / GAIN
        for k in range(ROWS):
            miss = wanted[k] - y[k] - 0.03 * rng.normal()
            held += DT_S * 0.3 * miss
            u[k] = 0.8 * miss + held + 0.3 * rng.normal()
            if k + 1 < ROWS:
                y[k + 1] = y[k] + DT_S * (GAIN * u[k] - (y[k] - air)) / lag_s
        flights.append((u, y + 0.03 * rng.normal(size=ROWS)))
    return Drawn(as_dataset(flights), lag_s)


def integrator(rng: np.random.Generator, *, bias: float) -> Drawn:
    """Acceleration to speed, in half of the cases behind a lag, with a bias of that spread."""
    lag_s = float(rng.uniform(0.5, 3.0)) if rng.random() < 0.5 else None
    flights = []
    for _ in range(int(rng.integers(3, 9))):
        u = steps(rng, held=10)
        own = bias * rng.normal()
        y = np.full(ROWS, rng.normal())
        inner = 0.0
        for k in range(ROWS - 1):
            inner = u[k] if lag_s is None else inner + DT_S * (GAIN * u[k] - inner) / lag_s
            y[k + 1] = y[k] + DT_S * (inner + own)
        flights.append((u, y + 0.03 * rng.normal(size=ROWS)))
    return Drawn(as_dataset(flights), lag_s)


KINDS: dict[str, tuple[bool, Callable[[np.random.Generator], Drawn]]] = {
    "lag in wind": (True, lambda rng: lag(rng, wind=rng.uniform(0.3, 2.0))),
    "lag in wind, with drag": (True, lambda rng: lag(rng, wind=1.0, drag=rng.uniform(0.05, 0.5))),
    "speed held in wind": (True, hover),
    "integrator with a bias": (True, lambda rng: integrator(rng, bias=rng.uniform(0.05, 0.3))),
    "lag in still air": (False, lambda rng: lag(rng, wind=0.0)),
    "drag in still air": (False, lambda rng: lag(rng, wind=0.0, drag=rng.uniform(0.05, 1.0))),
    "drag, flights at other speeds": (
        False,
        lambda rng: lag(rng, wind=0.0, drag=rng.uniform(0.05, 0.5), spread=4.0),
    ),
    "integrator": (False, lambda rng: integrator(rng, bias=0.0)),
}
"""Whether flights have constants of their own, and how a data set is drawn."""


def slowest_s(model: ARX, data: Dataset, *, integrates: bool) -> float:
    """The slowest time constant that ARX finds, besides a pole at one where the plant has it; NaN: none."""
    try:
        poles = np.sort(np.abs(model.fit(data).poles))[::-1][int(integrates) :]
    except FlysidError:
        return np.nan
    with np.errstate(divide="ignore"):
        return float(-DT_S / np.log(poles[0])) if len(poles) else np.nan


def main(count: int) -> int:
    """Print a line a kind."""
    for kind, (there, draw) in KINDS.items():
        found = 0
        misses: dict[str, list[float]] = {"auto": [], "never": []}
        for _ in range(count):
            drawn = draw(np.random.default_rng(secrets.randbits(32)))
            found += find_offsets(drawn.data) is not None
            if drawn.lag_s is None or not there:
                continue
            for name, model in (("auto", ARX()), ("never", ARX(flight_offsets=False))):
                lag_s = slowest_s(model, drawn.data, integrates=kind.startswith("integrator"))
                misses[name].append(abs(lag_s / drawn.lag_s - 1.0) if np.isfinite(lag_s) else np.inf)
        said = share(kind, found, count)
        if misses["auto"]:
            off = {name: 100.0 * float(np.median(each)) for name, each in misses.items()}
            said += f"; ARX's slowest lag is off by {off['auto']:.1f} % (without: {off['never']:.3g} %)"
        print(said, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
