"""Does a TS model ever run away unannounced? `python -m bench.ts_divergence [FITS]`; 24 by default.

Plants of `ts_plants` with fresh seeds, the settings in turn. Every fitted model runs 10,000 steps on random
inputs over the range of its training, with a seed unlike any used while fitting, then over fresh test records
from their measured first outputs; and two runs from the ends of the training range must come together
(`flysid.validate.diagnose.robustness`). It has diverged where more than 2 % of the samples of a run lie on
its output limits or are not finite, or where it ends in two places; announced where the fit raised an error
or said that the process integrates.
"""

from __future__ import annotations

import sys

import numpy as np

from bench.ts_experiment import Experiment
from bench.ts_plants import PLANTS
from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.model.base import Estimator, Fitted
from flysid.model.rules.judging import INTEGRATES
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace
from flysid.validate.diagnose.robustness import robustness

SETTINGS: dict[str, Estimator] = {
    "best": TS(),
    "lags": TS(states=0),
    "lags, 3 rules": TS(rules=3, states=0),
    "lags, 5 rules, 10 iterations": TS(rules=5, iterations=10, states=0),
    "hidden": TSStateSpace(),
    "hidden, 3 rules": TSStateSpace(rules=3),
}
STEPS = 10_000
MOST = 0.02  # of the samples of a run


def at_limits(model: Fitted, y: FloatArray) -> float:
    """Share of samples on the output limits or not finite."""
    low, high = model.output_limits
    return float((~np.isfinite(y) | (y <= low) | (y >= high)).any(axis=1).mean())


def wild_share(model: Fitted, train: Dataset, rng: np.random.Generator) -> float:
    """The same under random steps over the range of the training inputs."""
    u = np.vstack([s.u for s in train.segments])
    values = rng.uniform(u.min(axis=0), u.max(axis=0), size=(STEPS // 20, u.shape[1]))
    return at_limits(model, model.simulate(np.repeat(values, 20, axis=0)))


def faults(model: Fitted, experiment: Experiment, seed: int) -> list[str]:
    """What went wrong, in words; nothing where the model behaves."""
    shares = {"random inputs": wild_share(model, experiment.train, np.random.default_rng(seed))}
    for i, s in enumerate(experiment.test.segments):
        shares[f"test {i}"] = at_limits(model, model.simulate(s.u, s.y[: model.n_init]))
    found = [f"{where}: {100 * share:.1f} % at the limits" for where, share in shares.items() if share > MOST]
    if robustness(model, experiment.train, seed).forget_s is None:
        found.append("remembers its start for ever")
    return found


def main() -> None:
    """Print a line per fit and the count."""
    fits = int(sys.argv[1]) if len(sys.argv) > 1 else 24
    unannounced = announced = 0
    names = list(PLANTS)
    for seed in range(fits):
        name = names[seed % len(names)]
        title = list(SETTINGS)[(seed + seed // len(names)) % len(SETTINGS)]
        experiment = PLANTS[name](np.random.default_rng(1000 + seed))
        try:
            model = SETTINGS[title].fit(experiment.train)
        except FlysidError as error:
            announced += 1
            print(f"{seed:3d} {name:12s} {title:28s} refused: {error.message}", flush=True)
            continue
        wrong = faults(model, experiment, 5000 + seed)
        said = any(note.startswith(INTEGRATES) for note in model.notes)
        announced += bool(wrong and said)
        unannounced += bool(wrong and not said)
        words = f"DIVERGED{' (announced)' if said else ''}: {'; '.join(wrong)}" if wrong else "well"
        print(f"{seed:3d} {name:12s} {title:28s} {len(model.rules())} rules  {words}", flush=True)
    print(f"{fits} fits: {unannounced} diverged unannounced, {announced} announced or refused")


if __name__ == "__main__":
    main()
