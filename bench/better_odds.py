"""How often "smaller with p" came true: `flysid predict` against the same flight flown under the other gains.

`python -m bench.better_odds [VEHICLES] [FIRST SEED] [arducopter|px4]`

A vehicle of `bench.second_vehicles` flies 60 s; its P, I and D are then changed, by 2 to 35 %, so that there
are close calls and clear ones. `flysid predict LOG --file NEW --json` states for each axis with which
probability the error becomes smaller. The truth flies the same sticks, gusts and noise again under the new
gains. Tenths that no statement falls into are left out; of each other one the share that came true, with its
exact bounds.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from scipy.stats import binomtest

from bench.second_laws import AXES, Floats, Flown, Loop
from bench.second_margins import ENDINGS
from bench.second_vehicles import draw_loops, fly_vehicle, log_bytes, parameters
from flysid.cli.predict import command

SECONDS = 60.0
LEAST, MOST = 0.02, 0.35
"""Size of a change of gains: the scatter of their logarithms."""


def stated_and_true(firmware: str, seeds: range, folder: Path) -> Iterator[tuple[float, bool]]:
    """The probability that flysid states, and whether the error became smaller, of every axis it judges."""
    for seed in seeds:
        drawn = np.random.default_rng((seed, len(firmware)))
        loops = draw_loops(firmware, drawn)
        air = int(drawn.integers(2**31))
        flown = fly_vehicle(loops, SECONDS, np.random.default_rng(air))
        others = [_changed(loop, drawn) for loop in loops]
        log = folder / f"{firmware}-{seed}.{ENDINGS[firmware]}"
        log.write_bytes(log_bytes(loops, flown, np.random.default_rng(air)))
        new = folder / "new.params"
        old = parameters(loops)
        moved = {name: value for name, value in parameters(others).items() if value != old[name]}
        new.write_text("".join(f"{name} {value:.9g}\n" for name, value in moved.items()))
        words = [str(log), "--file", str(new), "--json", *(w for axis in AXES for w in ("--axis", axis))]
        done = CliRunner().invoke(command, words, standalone_mode=False)
        log.unlink()
        if done.exception is not None:
            raise done.exception
        again = fly_vehicle(others, SECONDS, np.random.default_rng(air))
        for found in json.loads(done.stdout)["axes"]:
            k = AXES.index(found["axis"])
            yield found["better"], bool(_error(again[k]) < _error(flown[k]))


def _changed(loop: Loop, rng: np.random.Generator) -> Loop:
    size = np.exp(rng.uniform(np.log(LEAST), np.log(MOST)))
    p, i, d = np.exp(size * rng.standard_normal(3))
    return replace(loop, p=loop.p * p, i=loop.i * i, d=loop.d * d)


def _error(flown: Flown) -> float:
    """Root mean square of setpoint less rate."""
    away: Floats = flown.target - flown.rate
    return float(np.sqrt(np.mean(away**2)))


def main(arguments: list[str]) -> int:
    """Print the table."""
    count, first = (int(word) for word in arguments[:2]) if len(arguments) > 1 else (20, 0)
    pairs: list[tuple[float, bool]] = []
    with tempfile.TemporaryDirectory() as folder:
        for firmware in arguments[2:] or list(ENDINGS):
            pairs += stated_and_true(firmware, range(first, first + count), Path(folder))
    stated, true = np.array(pairs).T
    print(f"{len(pairs)} statements; Brier score {np.mean((stated - true) ** 2):.3f}")
    print("| stated | statements | mean stated, % | came true | % | bounds, % |")
    print("|---|---|---|---|---|---|")
    for tenth in range(10):
        inside = np.minimum((10.0 * stated).astype(int), 9) == tenth
        if inside.any():
            n, k = int(inside.sum()), int(true[inside].sum())
            ends = binomtest(k, n).proportion_ci()
            bounds = f"{100.0 * ends.low:.0f} to {100.0 * ends.high:.0f}"
            shares = f"{100.0 * stated[inside].mean():.0f} | {k} | {100.0 * k / n:.0f}"
            print(f"| {10 * tenth} to {10 * tenth + 10} | {n} | {shares} | {bounds} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
