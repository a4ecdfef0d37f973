"""Polynomial NARX models: public sets, plants whose truth is known, what their intervals hold, their time.

`python -m bench.polynarx sets [NAME...]`: free run on the test parts of `bench.accuracy`, beside ARX.
`python -m bench.polynarx plants [NAME...]`: the plants of `bench.ts_plants`, two seeds, beside ARX.
`python -m bench.polynarx coverage [runs]`: 95 % intervals of the coefficients of a speed with square drag.
`python -m bench.polynarx time`: CPU seconds of both channels of `bench.fit_seconds px4` and `ardupilot`.
Defaults everywhere; CPU seconds are those of a machine that may be busy.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.accuracy import line
from bench.accuracy_data import CASES
from bench.harness import LOGS
from bench.ts_experiment import off
from bench.ts_plants import PLANTS
from flysid.dataset import Dataset, Signal
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.polynarx import PolyNARX

MODELS: dict[str, Estimator] = {"ARX": ARX(), "polynarx": PolyNARX()}
TRUTH = {"v(k-1)": 0.98, "u(k-1)": 0.05, "|v(k-1)| v(k-1)": -0.03}


def sets(names: list[str]) -> None:
    """Free-run errors on test parts, and the model's words."""
    for name in names or list(CASES):
        case = CASES[name]()
        for title, estimator in MODELS.items():
            print(line(title, estimator, case), flush=True)
        print(PolyNARX().fit(case.train, case.validation), flush=True)


def plants(names: list[str]) -> None:
    """Free-run errors against the noise-free truth, in per cent of its spread."""
    for name in names or list(PLANTS):
        for seed in (0, 1):
            plant = PLANTS[name](np.random.default_rng(seed))
            cells = [f"{name:12s} {seed} noise {100 * plant.noise:5.2f}"]
            for title, estimator in MODELS.items():
                begin = time.process_time()
                model = estimator.fit(plant.train)
                seconds = time.process_time() - begin
                error = off(model, plant.test)
                cells.append(f"{title} {error:6.2f} ({model.n_parameters}, {seconds:.1f} s)")
            print("   ".join(cells), flush=True)


def dragged(seed: int, rows: int = 1500, noise: float = 0.03) -> Dataset:
    """A speed that square drag brakes, under random steps, measured with white noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, rows // 25), 25)
    v = np.zeros(rows)
    for k in range(1, rows):
        v[k] = 0.98 * v[k - 1] + 0.05 * u[k - 1] - 0.03 * abs(v[k - 1]) * v[k - 1]
    return Dataset.from_arrays(
        u, v + noise * rng.normal(size=rows), 0.05, inputs=["u"], outputs=[Signal("v", "m/s")]
    )


def coverage(runs: int) -> None:
    """How often the terms are found, and their intervals hold the truth."""
    found = 0
    inside = dict.fromkeys(TRUTH, 0)
    for seed in range(runs):
        model = PolyNARX(na=1, nb=1, nk=1, most_terms=3).fit(dragged(seed))
        told = {c.regressor: c for c in model.coefficients()}
        if not set(TRUTH) <= set(told):
            continue
        found += 1
        for name, value in TRUTH.items():
            inside[name] += abs(told[name].value - value) <= told[name].half_width
    print(f"terms found in {found} of {runs}")
    for name, count in inside.items():
        print(f"{name:18s} {100 * count / max(found, 1):.1f} % of the intervals hold the truth")


def times() -> None:
    """CPU seconds a channel."""
    for name, recipe in (
        ("ulog/quad_position_76s.ulg", "px4-attitude"),
        ("dataflash/copter_437s.bin", "ardupilot-attitude"),
    ):
        with tempfile.TemporaryDirectory() as folder:
            list(ingest_logs(find_logs([LOGS / name]), Path(folder) / "data"))
            lake = open_lake(Path(folder) / "data")
            for channel in lake.channels(recipe):
                train, _ = lake.dataset(recipe, channel).split(holdout=0.3, seed=7)
                for title, estimator in MODELS.items():
                    begin = time.process_time()
                    model = estimator.fit(train)
                    seconds = time.process_time() - begin
                    print(f"{recipe} {channel}: {len(train)} samples, {title} {seconds:.2f} s, {model.notes}")


def main(words: list[str]) -> int:
    """Run one part."""
    match words:
        case ["sets", *names]:
            sets(names)
        case ["plants", *names]:
            plants(names)
        case ["coverage", *count]:
            coverage(int(count[0]) if count else 100)
        case ["time"]:
            times()
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
