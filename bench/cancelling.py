"""Linear fits reduced where poles and zeros nearly cancel: python -m bench.cancelling [--plants N]

Linear plants of `bench.verdict_fairness` (order 1 to 3, noise of 2 to 20 %), four flights of 25 s each. A
line per plant whose output-error fit a reduction changes: the order before and after, and the free-run errors
of both on twenty fresh flights without noise, in per cent of the output's spread.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from bench.verdict_fairness import TRAIN, flights, linear_plant
from flysid.dataset import Dataset
from flysid.model.linear import output_error
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.oe import OE
from flysid.model.polynomials import nearly_cancelled

FRESH = 20


def has_cancelling(model: FittedLinear) -> bool:
    """Some pole has a zero beside it."""
    return any(nearly_cancelled(pole, model.system.b[:, 0].T) for pole in model.poles)


def unreduced(train: Dataset) -> FittedLinear:
    """The fit whose order is not reduced."""
    with patch.object(output_error, "_reduce", lambda tried, _: tried[-1]):
        return OE().fit(train)


def error(model: FittedLinear, flown: Dataset) -> float:
    """Root mean square of the free runs, in per cent of the output's spread."""
    n = model.n_init
    gaps = [model.simulate(s.u, s.y[:n])[n:] - s.y[n:] for s in flown.segments]
    spread = np.std(np.concatenate([s.y for s in flown.segments]))
    return 100.0 * float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)) / spread)


def main() -> None:
    """Print the plants that a reduction changes, then how many had cancelling pairs before and after."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--first", type=int, default=5000)
    asked = parser.parse_args()
    pairs = np.zeros(2, dtype=int)
    for seed in range(asked.first, asked.first + asked.plants):
        rng = np.random.default_rng(seed)
        plant = linear_plant(rng)
        train = flights(plant, TRAIN, rng, "t")
        fresh = flights(replace(plant, white=0.0, coloured=0.0), FRESH, rng, "f")
        before, after = unreduced(train), OE().fit(train)
        pairs += [has_cancelling(before), has_cancelling(after)]
        orders = [len(m.system.a) - 1 for m in (before, after)]
        if orders[0] != orders[1]:
            print(
                f"{seed}: order {orders[0]} -> {orders[1]},"
                f" {error(before, fresh):.3f} -> {error(after, fresh):.3f} %",
                flush=True,
            )
    print(f"{asked.plants} plants: {pairs[0]} with cancelling pairs before, {pairs[1]} after")


if __name__ == "__main__":
    main()
