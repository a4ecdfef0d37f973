"""Margins of `flysid gains` against loops that another hand wrote: ArduCopter's and PX4's.

`python -m bench.second_margins [VEHICLES] [FIRST SEED] [arducopter|px4]`

Vehicles, gains, filters, sticks, gusts and noise are drawn. Each vehicle flies 60 to 150 s, its firmware's
log is written, and `flysid gains LOG --json` judges roll, pitch and yaw from the file. The truth is that of
plant and law as they are stepped (`bench.second_laws`). Printed for each figure: stated of loops, truth
inside the 95 % interval, and the exact bounds of that share.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner
from scipy.stats import binomtest

from bench.second_laws import AXES
from bench.second_vehicles import draw_loops, fly_vehicle, log_bytes
from flysid.cli.gains import command

ENDINGS = {"arducopter": "bin", "px4": "ulg"}


def judged_vehicles(
    firmware: str, seeds: range, folder: Path
) -> Iterator[tuple[str, dict[str, Any], dict[str, float]]]:
    """Axis, what flysid states of it, and the truth, of every drawn vehicle."""
    for seed in seeds:
        rng = np.random.default_rng((seed, len(firmware)))
        loops = draw_loops(firmware, rng)
        flown = fly_vehicle(loops, rng.uniform(60.0, 150.0), rng)
        log = folder / f"{firmware}-{seed}.{ENDINGS[firmware]}"
        log.write_bytes(log_bytes(loops, flown, rng))
        words = [str(log), "--json", *(word for axis in AXES for word in ("--axis", axis))]
        done = CliRunner().invoke(command, words, standalone_mode=False)
        log.unlink()
        if done.exception is not None:
            raise done.exception
        for axis, loop, found in zip(AXES, loops, json.loads(done.stdout), strict=True):
            yield axis, found, loop.truth()


def main(arguments: list[str]) -> int:
    """Print the tables."""
    count, first = (int(word) for word in [*arguments, "20", "0"][:2]) if arguments else (20, 0)
    firmwares = arguments[2:] or list(ENDINGS)
    for firmware in firmwares:
        rows: dict[tuple[str, str], list[tuple[float, float]]] = {}
        refused: Counter[str] = Counter()
        loops: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as folder:
            for axis, found, true in judged_vehicles(firmware, range(first, first + count), Path(folder)):
                kind = "yaw" if axis == "yaw" else "roll, pitch"
                loops[kind] += 1
                if found["refused"]:
                    refused[f"{kind}: {found['refused']}"] += 1
                    continue
                for name, value in true.items():
                    own = found["figures"][name]
                    if own["value"] is not None and math.isfinite(value):
                        half = 0.5 * (own["high"] - own["low"])
                        rows.setdefault((kind, name), []).append((own["value"] - value, half))
        _print(firmware, loops, refused, rows)
    return 0


def _print(
    firmware: str,
    loops: Counter[str],
    refused: Counter[str],
    rows: dict[tuple[str, str], list[tuple[float, float]]],
) -> None:
    print(f"{firmware}: {', '.join(f'{n} loops of {kind}' for kind, n in loops.items())}")
    print("| axis | figure | stated | held | bounds, % | median error | median half width |")
    print("|---|---|---|---|---|---|---|")
    for (kind, name), found in sorted(rows.items()):
        error, half = np.array(found).T
        middle = f"{np.median(error):+.3g} | {np.median(half):.3g}"
        print(f"| {kind} | {name} | {_held(np.abs(error) <= half)} | {middle} |")
    for kind in loops:
        every = np.array([abs(e) <= h for own, found in rows.items() if own[0] == kind for e, h in found])
        if len(every):
            print(f"| {kind} | all | {_held(every)} | | |")
    for reason, n in refused.most_common():
        print(f"refused {n}: {reason}")


def _held(inside: Any) -> str:
    ends = binomtest(int(inside.sum()), len(inside)).proportion_ci()
    return f"{len(inside)} | {inside.sum()} | {100.0 * ends.low:.1f} to {100.0 * ends.high:.1f}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
