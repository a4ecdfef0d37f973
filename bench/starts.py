"""Free runs from an estimated start and from first measured samples alone, on plants whose truth is known.

`python -m bench.starts MODEL SEED [PLANT...]`: MODEL of ARX, ss, ts1, ts, polynarx; of `bench.ts_plants`,
`bench.ts_unknown_plants` and `bench.hidden_plants` (1,024 samples, 3 % of noise, in the starts, too) the
plants named, or all. Errors against the noise-free truth in per cent of its spread, the first tenth of each
record left out, defaults everywhere; then what the model is, and CPU seconds.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench import hidden_plants, ts_plants, ts_unknown_plants
from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.polynarx import PolyNARX
from flysid.model.start import run_from_window, start_window
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS

MODELS: dict[str, Estimator] = {
    "ARX": ARX(),
    "ss": StateSpace(),
    "ts1": TS(rules=1, states=0),
    "ts": TS(),
    "polynarx": PolyNARX(),
}
SEEN = {**ts_plants.PLANTS, **ts_unknown_plants.PLANTS}
HIDDEN = {**hidden_plants.PLANTS, **hidden_plants.LINEAR}
Records = tuple[Dataset, Dataset, list[FloatArray]]


def records(name: str, seed: int) -> Records:
    """What is learned from, what runs start from, and the truth of that."""
    if name in HIDDEN:
        train, _ = HIDDEN[name].dataset((seed,), 1024, 0.03)
        test, truth = HIDDEN[name].dataset((1000 + seed,), 1024, 0.03)
        return train, test, [y.reshape(len(y), -1) for y in truth]
    made = SEEN[name](np.random.default_rng(seed))
    return made.train, made.test, [s.y for s in made.test.segments]


def error(model: Fitted, test: Dataset, truth: list[FloatArray], *, first_samples: bool) -> float:
    """Per cent of the truth's spread."""
    gaps = []
    for s, y in zip(test.segments, truth, strict=True):
        window = start_window(max(model.n_init, 4), len(s), test.dt_s)
        plain = model.simulate(s.u, s.y[: model.n_init]) if first_samples else None
        run = run_from_window(model, s, window) if plain is None else plain
        gaps.append((run - y)[len(s) // 10 + 1 :])
    spread = np.concatenate(truth).std(axis=0)
    return float(100 * np.sqrt(np.mean((np.concatenate(gaps) / spread) ** 2)))


def main(words: list[str]) -> int:
    """Print a line per plant."""
    label, seed = words[0], int(words[1])
    for name in words[2:] or [*SEEN, *HIDDEN]:
        train, test, truth = records(name, seed)
        begin = time.process_time()
        model = MODELS[label].fit(train)
        seconds = time.process_time() - begin
        window, plain = (error(model, test, truth, first_samples=plain) for plain in (False, True))
        print(
            f"{name:40s} {seed} {label:8s} {window:8.4g} {plain:8.4g}  {model.structure}, "
            f"{len(model.rules())} rules, from {model.n_init} samples, {seconds:.1f} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
