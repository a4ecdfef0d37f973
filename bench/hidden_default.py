"""Should rules over hidden states compete by default? `python -m bench.hidden_default [PLANT...]`.

Simulated plants with and without a hidden nonlinear state: errors and CPU seconds of `TS(states=0)`, and of
`TS()`, which tries hidden states where they are hinted at, and what it took. Errors are free runs on a fresh
recording against the noise-free outputs, in spreads of the output.
"""

from __future__ import annotations

import sys
import time

from bench.hidden_plants import LINEAR, PLANTS
from bench.hidden_rules import SETTINGS, error
from flysid.model.ts import TS
from flysid.model.ts_choice import contest
from flysid.model.ts_state_space import TSStateSpace

SEED = 21


def main(names: list[str]) -> int:
    """Print a line per plant and recording."""
    plants = PLANTS | LINEAR
    for name in names or list(plants):
        for samples, noise in SETTINGS:
            train, _ = plants[name].dataset((SEED,), samples, noise)
            test, truth = plants[name].dataset((1000 + SEED,), 1024, noise)
            begin = time.process_time()
            found = contest(TS(), train)
            both = time.process_time() - begin
            taken = "hidden state" if found.taken is found.states else "lags"
            tried = "not tried" if found.states is None else f"{error(found.states.bare, test, truth):.4f}"
            lags = error(found.lags.bare, test, truth)
            print(
                f"{name}, {samples} samples, noise {noise:.0%}: lags {lags:.4f},"
                f" hidden {tried}, taken: {taken}; {both:.1f} s CPU in all",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    TSStateSpace(states=1, rules=1).fit(LINEAR["motor"].dataset((1,), 100, 0.01)[0])  # compiled beforehand
    sys.exit(main(sys.argv[1:]))
