"""Polynomial NARX models: public sets, plants whose truth is known, what their intervals hold, their time.

`python -m bench.polynarx sets [NAME...]`: free run on the test parts of `bench.accuracy`, beside ARX.
`python -m bench.polynarx plants [NAME...]`: the plants of `bench.ts_plants`, two seeds, beside ARX.
`python -m bench.polynarx many SEED...`: plants of five inputs and two outputs whose working point drifts,
under slow disturbances: linear, bent inputs, products; the second half of each record, beside ARX.
`python -m bench.polynarx beyond SEED...`: plants that bend, drawn as in `bench.last_gates`; unseen flights
up to three times as excited as the training, nonlinear terms as they are and along their tangents.
`python -m bench.polynarx coverage [runs]`: 95 % intervals of the coefficients of a speed with square drag.
`python -m bench.polynarx time`: CPU seconds of both channels of `bench.fit_seconds px4` and `ardupilot`.
Defaults everywhere; CPU seconds are those of a machine that may be busy.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.accuracy import line
from bench.accuracy_data import CASES
from bench.harness import LOGS
from bench.last_gates import drawn
from bench.ts_experiment import off
from bench.ts_plants import PLANTS
from flysid.dataset import Dataset, FloatArray, Signal
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.narx.fitted_polynomial import FittedPolyNARX
from flysid.model.polynarx import PolyNARX
from flysid.model.selection import free_run_errors
from flysid.model.start import run_from_window, start_window

MODELS: dict[str, Estimator] = {"ARX": ARX(), "polynarx": PolyNARX()}
BENT = ("titration", "velocity with drag", "rotor rig")
REACHES = (1.0, 1.5, 2.0, 3.0)
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


def wandering(rng: np.random.Generator, rows: int) -> FloatArray:
    """(N,) steps about a working point that drifts."""
    drift = np.cumsum(rng.normal(size=rows))
    steps = np.repeat(rng.normal(size=rows // 8 + 1), 8)[:rows]
    return np.asarray(0.8 * (drift - drift.mean()) / drift.std() + 0.6 * steps)


def of_many_signals(kind: str, seed: int, rows: int = 1250) -> tuple[Dataset, Dataset, FloatArray]:
    """Both halves of a record with slow disturbances of 15 % of the outputs, and the truth of the second."""
    rng = np.random.default_rng(seed)
    own = np.array([[0.55, 0.15], [-0.2, 0.7]]) + 0.1 * rng.uniform(-1, 1, (2, 2))
    older = 0.08 * rng.uniform(-1, 1, (2, 2))
    drive = rng.normal(size=(2, 5)) * np.array([1.0, 0.6, 0.3, 0.2, 0.1])
    u = np.stack([wandering(rng, 2 * rows) for _ in range(5)], axis=1)
    y = np.zeros((2 * rows, 2))
    slow = np.zeros((2 * rows, 2))
    for k in range(2, 2 * rows):
        v = np.tanh(0.8 * u[k - 1]) if kind == "bent" else u[k - 1]
        y[k] = own @ y[k - 1] + older @ y[k - 2] + drive @ v
        if kind == "products":
            y[k] += 0.15 * np.array([v[0] * v[1], v[2] * np.tanh(y[k - 1, 0])])
    for k in range(1, 2 * rows):
        slow[k] = 0.93 * slow[k - 1] + np.sqrt(1.0 - 0.93**2) * rng.normal(size=2)
    measured = y + 0.15 * y.std(axis=0) * slow
    halves = [Dataset.from_arrays(u[part], measured[part], 0.1) for part in (slice(rows), slice(rows, None))]
    return halves[0], halves[1], y[rows:]


def many(seeds: list[str]) -> None:
    """Free-run errors per output against the noise-free truth, in its spreads."""
    for kind in ("linear", "bent", "products"):
        for seed in seeds:
            train, test, truth = of_many_signals(kind, int(seed))
            cells = []
            for title, estimator in MODELS.items():
                model = estimator.fit(train)
                segment = test.segments[0]
                window = start_window(model.n_init, len(segment), test.dt_s)
                gap = (run_from_window(model, segment, window) - truth)[len(truth) // 10 :]
                off_by = np.sqrt(np.mean(gap**2, axis=0)) / truth.std(axis=0)
                cells.append(f"{title} {off_by[0]:.3f}, {off_by[1]:.3f} ({model.n_parameters})")
            print(f"{kind:8s} {seed}  {'   '.join(cells)}", flush=True)


def beyond(seeds: list[str]) -> None:
    """Free-run errors on unseen flights, in those of ARX, by the scale of the excitation; the worst."""
    worst: dict[tuple[float, str], float] = {}
    for seed in seeds:
        for number, kind in enumerate(BENT):
            name, train, fresh = drawn(np.random.default_rng([int(seed), number]), (kind,), REACHES)
            model = PolyNARX().fit(train)
            if not isinstance(model, FittedPolyNARX):
                print(f"{seed} {name}: linear", flush=True)
                continue
            models = {"as they are": replace(model, seen=None), "tangents": model}
            cells = []
            for reach, flights in fresh.items():
                errors = free_run_errors({"ARX": ARX().fit(train), **models}, flights)
                own = np.sqrt(errors.pop("ARX").mean())
                ratios = {title: float(np.sqrt(e.mean()) / own) for title, e in errors.items()}
                worst |= {(reach, t): max(r, worst.get((reach, t), 0.0)) for t, r in ratios.items()}
                cells.append(f"x{reach:g}: " + " ".join(f"{r:.2f}" for r in ratios.values()))
            print(f"{seed} {name}: {', '.join(cells)}", flush=True)
    for (reach, title), ratio in worst.items():
        print(f"worst at x{reach:g}, {title}: {ratio:.2f} times ARX")


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
        case ["many", *seeds]:
            many(seeds)
        case ["beyond", *seeds]:
            beyond(seeds)
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
