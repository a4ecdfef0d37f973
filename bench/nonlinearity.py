"""`python -m bench.nonlinearity [PLANTS] [SEED]`: how nonlinear is it, asked where the answer is known.

Linear and nonlinear plants of `bench.verdict_fairness` (four flights of 25 s): how often a linear plant is
called nonlinear, how often a nonlinear one is found, and the share found beside the true one. Then the
simulated vehicle of docs/vehicle.md, noise of 0.02 m/s, all axes moved at once and one alone: the share
beside the error that the best linear model leaves on the same flights without noise.

`python -m bench.nonlinearity table [SETS] [SEED]`: flights as those of the table in docs/vehicle.md, flown
anew: the error that the table states, of a linear model on a pilot's flight that it has not seen, over the
share that is stated of all four flights, and of the pilot's by the model of the others, with the noise. A
set is steps, two multisines and a pilot.

`python -m bench.nonlinearity verdict [PLANTS] [SEED]`: half as many plants of either kind, fitted and judged
as `flysid fit` does it: whether the answer, from the training flights alone, foretells that rules are better.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

import flysid
from bench.vehicle import PERIOD_S, STARTED, flight, linear_floor, table_flights
from bench.verdict_fairness import (
    TRAIN,
    Outcome,
    Plant,
    Task,
    flights,
    judge_task,
    linear_plant,
    nonlinear_plant,
)
from bench.verdict_fairness import share as counted
from flysid.dataset import Dataset, FloatArray
from flysid.ingest.synth.plants import LOOPS
from flysid.model.base import Fitted
from flysid.model.nonlinearity import Nonlinearity, nonlinearity

PERFECT = 0.8
"""Error of a perfect model of a nonlinear plant, over that of the best linear one."""
NOISE_M_S = 0.02
SHARES = (0.25, 0.5, 1.0)
FLOWN = ((0, 11), (1, 12), (1, 13), (2, 14))


def asked(data: Dataset) -> tuple[Fitted, Nonlinearity]:
    """The output-error model of training data, and the answer."""
    model = flysid.OE().fit(data)
    return model, nonlinearity(model, data)[0]


def left(model: Fitted, data: Dataset) -> float:
    """What the free run leaves, over the output's standard deviation."""
    errors = [
        (model.simulate(s.u, s.y[: model.n_init]) - s.y)[max(STARTED, model.n_init) :] for s in data.segments
    ]
    return float(np.concatenate(errors).std() / np.concatenate([s.y for s in data.segments]).std())


def plants(draw: Callable[[np.random.Generator], Plant], count: int, seed: int) -> None:
    """How often something is found, and the true share over the one that is stated."""
    found = 0
    ratios = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        plant = draw(rng)
        model, answer = asked(data := flights(plant, TRAIN, rng, "a"))
        found += answer.found
        if answer.found and plant.name != "linear":
            ratios.append(left(model, data) * np.sqrt(1.0 - PERFECT**2) / answer.share)
    kind = "linear" if plant.name == "linear" else "nonlinear"
    print(f"{count} {kind} plants: found on {found} ({100 * found / count:.1f} %)")
    if ratios:
        low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
        print(f"true share over stated: median {middle:.2f}, 5 to 95 % {low:.2f} to {high:.2f}")


def vehicle(axis_alone: bool) -> None:
    """A row for each loop and size of the commands."""
    moved = "one axis" if axis_alone else "all axes"
    print(f"\n| {moved} | commands | true | stated at least |\n|---|---|---|---|")
    for column, (loop, plant) in enumerate(LOOPS.items()):
        for share in SHARES:
            flown = [flight(share, c, s, column if axis_alone else None) for c, s in FLOWN]
            us = [u[:, column] for u, _ in flown]
            ys: list[FloatArray] = [y[plant.output] for _, y in flown]
            rng = np.random.default_rng(1)
            noisy = [y + NOISE_M_S * rng.standard_normal(len(y)) for y in ys]
            model, answer = asked(Dataset.from_arrays(us, noisy, PERIOD_S))
            true = left(model, Dataset.from_arrays(us, ys, PERIOD_S))
            said = (
                f"{100 * answer.share:.1f} %"
                if answer.found
                else f"none, below {100 * answer.smallest:.1f} %"
            )
            print(f"| {loop} | {100 * share:g} % | {100 * true:.1f} % | {said} |", flush=True)


def table(sets: int, seed: int) -> None:
    """The longitudinal loop: the table's error over the stated shares."""
    output = LOOPS["longitudinal"].output
    for share in SHARES:
        rows = []
        for k in range(seed, seed + sets):
            flights = table_flights(share, 4 * k + 1)
            rmse, spread = linear_floor(flights, 0, output)
            rng = np.random.default_rng(k)
            us = [u[:, 0] for u, _ in flights]
            noisy: list[FloatArray] = [
                y[output] + NOISE_M_S * rng.standard_normal(len(u)) for u, y in flights
            ]
            together = asked(Dataset.from_arrays(us, noisy, PERIOD_S))[1]
            model = flysid.OE().fit(Dataset.from_arrays(us[:3], noisy[:3], PERIOD_S))
            held_out = nonlinearity(model, Dataset.from_arrays(us[3:], noisy[3:], PERIOD_S))[0]
            rows.append((rmse / spread, together.share, held_out.share))
            print(f"{share:g}, set {k}: " + ", ".join(f"{v:.3f}" for v in rows[-1]), flush=True)
        error, *stated = np.array(rows).T
        print(f"{100 * share:g} %: table {_percents(error)}")
        for words, values in zip(("of all four", "of the pilot's, model of the others"), stated, strict=True):
            ratio = error / np.maximum(values, 1e-9)
            near = np.sum(np.abs(np.log(ratio)) <= np.log(1.5))
            print(
                f"  stated {words}: {_percents(values)}; table over it {np.median(ratio):.2f} "
                f"({ratio.min():.2f} to {ratio.max():.2f}), within 1.5 in {near} of {sets}"
            )


def _percents(values: FloatArray) -> str:
    low, middle, high = 100.0 * np.quantile(values, [0.0, 0.5, 1.0])
    return f"{middle:.1f} % ({low:.1f} to {high:.1f})"


def foretold(kind: str, seed: int) -> tuple[bool, Outcome | str]:
    """Whether a plant's training flights look nonlinear, and what is then said of it."""
    rng = np.random.default_rng(seed)
    plant = linear_plant(rng) if kind == "linear" else nonlinear_plant(rng)
    return asked(flights(plant, TRAIN, rng, "t"))[1].found, judge_task(Task(kind, seed))


def verdicts(count: int, seed: int) -> None:
    """A line per plant, then how often the verdict was foretold."""
    right = judged = 0
    for at in range(seed, seed + count // 2):
        for kind in ("linear", "nonlinear"):
            found, outcome = foretold(kind, at)
            print(f"{kind:9s} {'found' if found else 'none '} {outcome}", flush=True)
            if isinstance(outcome, Outcome):
                judged += 1
                right += found == (outcome.verdict in ("better", "contested"))
    print(counted("the verdict foretold", right, judged))


def main() -> None:
    """Print everything."""
    part = sys.argv[1] if sys.argv[1:2] and not sys.argv[1].isdigit() else ""
    given = [int(a) for a in sys.argv[1 + bool(part) :]]
    usual = {"verdict": [60, 3000], "table": [20, 100], "": [200, 700]}[part]
    count, seed = (given + usual[len(given) :])[:2]
    if part:
        {"verdict": verdicts, "table": table}[part](count, seed)
        return
    plants(linear_plant, count, seed)
    plants(nonlinear_plant, count, seed + 1)
    for alone in (False, True):
        vehicle(alone)


if __name__ == "__main__":
    main()
