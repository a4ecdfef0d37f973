"""Ways to train a TS state-space model, against the truth: `python -m bench.hidden_state [PLANT...]`.

Simulated plants with a hidden state, 1,024 samples, measurement noise of 1 and 5 % of the output's spread;
the free run on two fresh recordings is compared with the noise-free outputs. Every strategy grows up to four
rules from the same linear start of the true number of states; nothing is chosen on the fresh recordings, all
rule counts are printed.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.hidden_plants import PLANTS
from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.rules.fitted import finish
from flysid.model.rules.growth import Training, one_rule_more
from flysid.model.rules.linear_starts import coordinates
from flysid.model.rules.regressor_layout import scaling
from flysid.model.rules.search_context import SearchContext
from flysid.model.rules.stages import Stage
from flysid.model.rules.state_systems import in_coordinates, linear_systems, saturation_limits, system_stage
from flysid.model.ts import TS

SAMPLES = 1024
RULES = 4
STRATEGIES = {
    "free run at once": Training(ridge=0.01),
    "one place tried": Training(ridge=0.01, tries=1),
    "ridge 0.1": Training(ridge=0.1),
    "ridge 1": Training(ridge=1.0),
}
STATES = {"hysteresis": 3}


def gap(model: Fitted, test: Dataset, truth: list[FloatArray]) -> float:
    """Root mean square of free run less truth, in spreads of the true outputs."""
    first = 20
    gaps = [
        (model.simulate(s.u, s.y[: model.n_init])[:, 0] - y)[first:]
        for s, y in zip(test.segments, truth, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)) / np.std(np.concatenate(truth)))


def grown(context: SearchContext, start: Stage, how: Training) -> list[Stage]:
    """Models with 1 to RULES rules."""
    stages = [start]
    while len(stages) < RULES:
        found = one_rule_more(stages[-1], context.antecedents(stages[-1].layout), how)
        stages.append(found.stage if found else stages[-1])
    return stages


def main(names: list[str]) -> int:
    """Print a line per plant, noise, recording, coordinates and strategy."""
    for name in names or list(PLANTS):
        for noise in (0.01, 0.05):
            for seed in (1, 2):
                _compare(name, noise, seed)
    return 0


def _compare(name: str, noise: float, seed: int) -> None:
    train, _ = PLANTS[name].dataset((seed,), SAMPLES, noise)
    test, truth = PLANTS[name].dataset((100 + seed, 101 + seed), SAMPLES, noise)
    settings = TS(states=STATES.get(name, 2), nk=1)
    scaled = scaling(train)
    context = SearchContext(settings, train, train, *scaled, 40)
    print(f"{name}, noise {noise:.0%}, recording {seed}: ARX {gap(ARX().fit(train), test, truth):.4f}")
    system = linear_systems(settings, train, None, scaled)[0]
    linear = system_stage(system, train, 40, scaled, saturation_limits(train))
    for name in coordinates(system, 1):
        start, words = in_coordinates(linear, name)
        for title, how in STRATEGIES.items():
            begin = time.process_time()
            stages = grown(context, start, how)
            seconds = time.process_time() - begin
            errors = ", ".join(f"{gap(finish(s, train, ()), test, truth):.4f}" for s in stages)
            print(f"  {words[:24]:24s} {title:24s} {errors}  {seconds:.1f} s CPU", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
