"""The verdict on the nonlinear simulated vehicle against what the truth leaves to be gained.

`python -m bench.verdict_vehicle [share...] [--one-axis]`: six flights train, six judge, at a share of
the firmware's limits, with white noise of 0.02 m/s on the measured velocities and no wind. No model can be
better than that noise, so the baseline's own error says how much rules could gain at most. Where that is less
than 5 % the verdict must not be "better"; where it is more than 10 % it should be; and no model may beat the
noise.

All axes are flown at once, so that a model of one axis also meets what the others do to it (tilt takes lift,
drag grows with speed in any direction); with `--one-axis` the other commands stay at zero.
"""

from __future__ import annotations

import argparse

import numpy as np

from bench.vehicle import PERIOD_S, flight
from flysid.dataset import Dataset, Segment, Signal
from flysid.ingest.synth.plants import LOOPS
from flysid.model.base import Fitted
from flysid.model.linear_choice import choose_baseline, confirm
from flysid.model.one_rule import linear_rivals
from flysid.model.ts import TS
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare_models import compare

NOISE = 0.02
FLIGHTS = 6
MUST_NOT_PCT = -5.0
SHOULD_PCT = -10.0


def flights(share: float, column: int, first_seed: int, kinds: tuple[int, ...], *, alone: bool) -> Dataset:
    """`FLIGHTS` flights of one loop at a share of full command, measured with noise."""
    output = list(LOOPS.values())[column].output
    segments = []
    for i in range(FLIGHTS):
        u, truth = flight(share, kinds[i % len(kinds)], first_seed + i, column if alone else None)
        rng = np.random.default_rng(1000 + first_seed + i)
        y = truth[output] + NOISE * rng.normal(size=len(u))
        segments.append(Segment(u[:, [column]], y[:, None], flight=f"{first_seed + i}"))
    return Dataset(PERIOD_S, (Signal("u"),), (Signal(output, "m/s"),), tuple(segments), name=output)


def judged(share: float, column: int, *, alone: bool) -> str:
    """One line of the table."""
    train = flights(share, column, 1, (0, 1), alone=alone)
    test = flights(share, column, 50, (1, 2), alone=alone)
    linear = linear_rivals()
    choice = choose_baseline(train, linear)
    models: dict[str, Fitted] = {n: linear[n].fit(train) for n in dict.fromkeys(("arx", choice.label))}
    base = confirm(choice, models, train).label
    models["ts"] = TS().fit(train)
    c = compare(models, test, horizons=[FREE_RUN], baseline=base)
    (pair,) = c.verdict.values()
    low, high = pair.ci95 or (np.nan, np.nan)
    possible = 100.0 * (NOISE / pair.evidence.rmse_baseline - 1.0)
    wrong = pair.evidence.rmse_model < 0.98 * NOISE
    wrong |= possible > MUST_NOT_PCT and pair.earned
    missed = possible < SHOULD_PCT and not pair.earned
    return (
        f"| {100 * share:g} % | {test.name} | {base} {1000 * pair.evidence.rmse_baseline:.1f} | "
        f"{c.models['ts'].n_rules} rules {1000 * pair.evidence.rmse_model:.1f} | {possible:+.1f} % | "
        f"{pair.change_pct or 0.0:+.1f} % [{low:+.1f}, {high:+.1f}] | {pair.verdict} | "
        f"{'WRONG' if wrong else 'missed' if missed else 'agrees'} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shares", nargs="*", type=float, default=[0.1, 0.5, 1.0])
    parser.add_argument("--one-axis", action="store_true", help="the other commands stay at zero")
    order = parser.parse_args()
    print("| commands | output | linear, mm/s | TS, mm/s | at most | change | verdict | |")
    print("|---|---|---|---|---|---|---|---|")
    for share in order.shares:
        for column in range(len(LOOPS)):
            print(judged(share, column, alone=order.one_axis), flush=True)


if __name__ == "__main__":
    main()
