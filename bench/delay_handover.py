"""Does handing the estimated dead time to the models help? `python -m bench.delay_handover [SEEDS]`.

Four second-order plants behind dead times of 0, 80 and 150 ms, 60 s at 50 Hz, measurement noise of 0, 5 and
30 % of the output's spread; ARX and TS by themselves and with the delay that the training data speak for.
Printed: free-run error on a fresh flight against the noise-free truth, in % of its spread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS

DT_S = 0.02
SAMPLES = 3000
FINE = 10
PLANTS: Mapping[str, tuple[list[float], list[float]]] = {
    "lag": ([1.0], [0.3, 1.0]),
    "attitude": ([40.0], [1.0, 9.0, 40.0]),
    "tilt to velocity": ([9.81], [0.05, 1.0, 0.3]),
    "slow": ([0.5], [1.0, 0.8, 1.0]),
}
STRUCTURES: Mapping[str, type[ARX] | type[TS]] = {"ARX": ARX, "TS": TS}
LEVEL = 1e-4  # of the truth's spread: errors below count as none


def fly(plant: str, delay_s: float, noise: float, seed: int) -> Segment:
    """Steps held for half a second; the truth is made at a tenth of the sample time."""
    from scipy.signal import cont2discrete, lfilter

    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=SAMPLES // 25), 25)
    fine = np.repeat(u, FINE)
    late = np.concatenate([np.zeros(round(delay_s * FINE / DT_S)), fine])[: len(fine)]
    b, a, _ = cont2discrete(PLANTS[plant], DT_S / FINE)
    y = lfilter(b.ravel(), a, late)[::FINE]
    return Segment(u, y + noise * y.std() * rng.normal(size=SAMPLES), flight=str(seed))


def dataset(segment: Segment) -> Dataset:
    return Dataset(DT_S, (Signal("u", "deg"),), (Signal("y", "m/s"),), (segment,), name="c")


def error_pct(model: Fitted, truth: Segment) -> float:
    first = max(model.n_init, 50)
    run: FloatArray = model.simulate(truth.u, truth.y[: model.n_init])
    return float(100 * np.sqrt(np.mean((run - truth.y)[first:] ** 2)) / truth.y.std())


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    totals: dict[str, list[tuple[float, float]]] = {name: [] for name in STRUCTURES}
    seconds = {f"{name}, {kind}": 0.0 for name in STRUCTURES for kind in ("own", "handed")}
    print("| plant | noise | dead time | handed nk | " + " | ".join(f"{s}, {s} handed" for s in STRUCTURES))
    cases = [(p, n, d) for p in PLANTS for n in (0.0, 0.05, 0.3) for d in (0.0, 0.08, 0.15)]
    for plant, noise, delay_s in cases:
        errors: dict[str, list[tuple[float, float]]] = {name: [] for name in STRUCTURES}
        hints: list[tuple[int, ...]] = []
        for seed in range(seeds):
            train = dataset(fly(plant, delay_s, noise, 100 * seed + 1))
            truth = fly(plant, delay_s, 0.0, 100 * seed + 2)
            hints.append(delays_to_try(dead_times(train), 1))
            for name, structure in STRUCTURES.items():
                pair = []
                for kind, hint in (("own", ()), ("handed", hints[-1])):
                    started = time.process_time()
                    pair.append(error_pct(structure(nk_hint=hint).fit(train), truth))
                    seconds[f"{name}, {kind}"] += time.process_time() - started
                errors[name].append((pair[0], pair[1]))
        cells = []
        for name, pairs in errors.items():
            totals[name] += pairs
            own, handed = np.median(np.array(pairs), axis=0)
            cells.append(f"{own:.2g}, {handed:.2g}")
        tried = " ".join(str(h[0]) if h else "-" for h in hints)
        print(
            f"| {plant} | {noise:.0%} | {1e3 * delay_s:.0f} ms | {tried} | {' | '.join(cells)} |", flush=True
        )
    for name, pairs in totals.items():
        own, handed = np.maximum(np.array(pairs), 100 * LEVEL).T
        better = int((handed < 0.95 * own).sum())
        worse = int((handed > 1.05 * own).sum())
        print(f"{name}: better in {better}, worse in {worse} of {len(pairs)} by more than 5 % of the error")
    print("CPU seconds:", ", ".join(f"{k} {v:.0f}" for k, v in seconds.items()))


if __name__ == "__main__":
    main()
