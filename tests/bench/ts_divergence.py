"""Does a TS model ever run away unannounced? `python -m tests.bench.ts_divergence [FITS]`; 24 by default.

Plants of `ts_plants` with fresh seeds, the settings in turn (defaults, three rules, five rules with little
refinement). Every fitted model runs 10,000 steps on random inputs over the range of its training, with a
seed unlike any used while fitting, then over fresh test records. It has diverged where more than 2 % of the
samples of either lie on its output limits or are not finite; announced where the fit raised an error or
said that the process integrates.
"""

from __future__ import annotations

import sys

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.base import Fitted
from flysid.model.ts import TS
from tests.bench.ts_plants import PLANTS

SETTINGS = {"default": TS(), "3 rules": TS(rules=3), "5 rules, 10 iterations": TS(rules=5, iterations=10)}
STEPS = 10_000


def at_limits(model: Fitted, y: FloatArray) -> float:
    """Share of samples on the output limits or not finite."""
    low, high = model.output_limits
    return float((~np.isfinite(y) | (y <= low) | (y >= high)).any(axis=1).mean())


def wild_share(model: Fitted, train: Dataset, rng: np.random.Generator) -> float:
    """The same under random steps over the range of the training inputs."""
    u = np.vstack([s.u for s in train.segments])
    values = rng.uniform(u.min(axis=0), u.max(axis=0), size=(STEPS // 20, u.shape[1]))
    return at_limits(model, model.simulate(np.repeat(values, 20, axis=0)))


def main() -> None:
    """Print a line per fit and the count."""
    fits = int(sys.argv[1]) if len(sys.argv) > 1 else 24
    unannounced = announced = 0
    names = list(PLANTS)
    for seed in range(fits):
        name, title = names[seed % len(names)], list(SETTINGS)[seed % len(SETTINGS)]
        experiment = PLANTS[name](np.random.default_rng(1000 + seed))
        try:
            model = SETTINGS[title].fit(experiment.train)
        except FlysidError as error:
            announced += 1
            print(f"{seed:3d} {name:10s} {title:24s} refused: {error.message}", flush=True)
            continue
        shares = [wild_share(model, experiment.train, np.random.default_rng(5000 + seed))]
        shares += [
            at_limits(model, model.simulate(s.u, s.y[: model.n_init])) for s in experiment.test.segments
        ]
        diverged = max(shares) > 0.02
        said = any("integrates" in note for note in model.notes)
        announced += diverged and said
        unannounced += diverged and not said
        print(
            f"{seed:3d} {name:10s} {title:24s} {len(model.rules())} rules, largest share at the limits "
            f"{100 * max(shares):.2f} %{' DIVERGED' if diverged else ''}{' (announced)' if said else ''}",
            flush=True,
        )
    print(f"{fits} fits: {unannounced} diverged unannounced, {announced} announced or refused")


if __name__ == "__main__":
    main()
