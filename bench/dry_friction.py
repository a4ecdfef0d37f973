"""Positions with dry friction under a controller: python -m bench.dry_friction [FIRST [PLANTS]] [--smooth]

A servo, a gimbal or a carriage sticks where its speed is zero. Of every drawn plant: free-run error of
`flysid.TS()` on three fresh noise-free flights, in per cent of their spread, number of rules and CPU seconds,
without the candidates for dry friction and with them. `--smooth` leaves the friction out and gives every
flight a mean wind: what is drawn is linear then, and one rule is right. Its errors hold the wind of fresh
flights, which nothing tells.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext

import numpy as np

from bench.ablations import step_of
from bench.ts_experiment import Experiment, experiment, off
from flysid.dataset import FloatArray
from flysid.errors import FlysidError
from flysid.model.ts import TS

DT_S = 0.02
FINER = 10
"""Steps of the simulation in a sample."""


def moved(
    push: float, thin: float, dry: float, samples: int, wind: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(u, y) of one flight: a force in proportion to the input, linear and dry friction, a controller.

    Parameters
    ----------
    push, thin, dry, wind : forces in m/s^2 of an input of one, of a speed of one, of friction, of the wind.
    """
    stiff, damped = rng.uniform(1.0, 4.0), rng.uniform(0.4, 1.0)
    place = speed = 0.0
    held = 0
    rows = []
    for _ in range(samples):
        if held == 0:
            target, held = rng.uniform(-1.0, 1.0), int(rng.integers(40, 120))
        held -= 1
        u = float(np.clip(stiff * (target - place) - damped * speed, -3.0, 3.0))
        rows.append((u, place))
        for _ in range(FINER):
            force = push * u - thin * speed + wind
            against = np.sign(speed) if speed else np.clip(force / dry, -1.0, 1.0) if dry else 0.0
            faster = speed + DT_S / FINER * (force - dry * against)
            speed = 0.0 if speed * faster < 0.0 and dry else faster  # it stops before it turns
            place += DT_S / FINER * speed
    u, y = np.array(rows).T
    return u, y


def drawn(seed: int, *, smooth: bool = False) -> Experiment:
    """Two to four noisy flights of a drawn plant, and three without noise that nothing is learned from."""
    rng = np.random.default_rng(seed)
    push, thin, dry = rng.uniform(2.0, 6.0), rng.uniform(0.3, 2.0), rng.uniform(0.3, 1.5)
    flights, samples = int(rng.integers(2, 5)), int(rng.integers(500, 900))
    noise = float(np.exp(rng.uniform(*np.log((0.005, 0.03)))))
    winds = rng.normal(0.0, 0.5, flights + 3) if smooth else np.zeros(flights + 3)
    flown = [moved(push, thin, 0.0 if smooth else dry, samples, wind, rng) for wind in winds]
    return experiment(flown[:flights], flown[flights:], DT_S, noise, rng)


def lines(first: int, plants: int, *, smooth: bool) -> Iterator[str]:
    """One row per plant; the last one is the geometric mean of the ratios of errors."""
    ratios = []
    for seed in range(first, first + plants):
        plant = drawn(seed, smooth=smooth)
        errors = []
        row = f"{seed}"
        for step in (step_of("dry friction"), nullcontext()):
            begin = time.process_time()
            try:
                with step:
                    model = TS().fit(plant.train)
            except FlysidError as error:
                row += f"  refused: {error.message}"
                continue
            errors.append(off(model, plant.test))
            seconds = time.process_time() - begin
            row += f"  {errors[-1]:8.2f} % {model.structure} {len(model.rules())} {seconds:5.1f} s"
        if len(errors) == 2:
            ratios.append(errors[1] / errors[0])
        yield row
    if ratios:
        yield f"geometric mean of the ratios {np.exp(np.mean(np.log(ratios))):.3f}"


def main() -> int:
    """Print the rows as they come."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=int, nargs="?", default=140_000)
    parser.add_argument("plants", type=int, nargs="?", default=8)
    parser.add_argument("--smooth", action="store_true")
    options = parser.parse_args()
    for row in lines(options.first, options.plants, smooth=options.smooth):
        print(row, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
