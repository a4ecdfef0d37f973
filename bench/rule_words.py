"""Do the words of rules describe the vehicle?  python -m bench.rule_words [PLANT...] [--seeds N] [--first N]

Plants whose small steps are known are flown with steps and noise, fitted with given orders, and every
operating point that the model speaks of is asked three things: is its gain, and its time to 63 %, that of the
model's own free run about that place (two simulated small steps); is it the plant's; does its interval hold
the plant's.
Beside it: what the strongest rule there says by itself, as the words did before.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from bench.hidden_plants import LINEAR, PLANTS, Plant
from flysid.dataset import Dataset, FloatArray
from flysid.model.base import OperatingPoint
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace

NOISE = 0.03  # of the output's spread
SAMPLES = 800
RECORDS = 6
_NUDGE = 1e-6
_REACHED = 1.0 - np.exp(-1.0)


@dataclass(frozen=True)
class Row:
    """One operating point of one fit.

    Attributes
    ----------
    said, own, true, rule : (2,) gain and seconds to 63 %: what the words say, what the model's free run does,
        what the plant does, what the strongest rule says by itself (its gain and slowest time constant).
    held : (2,) whether the interval holds the truth; NaN where none is given.
    """

    said: FloatArray
    own: FloatArray
    true: FloatArray
    rule: FloatArray
    held: FloatArray


def truth(plant: Plant, level: float, inputs: tuple[float, float]) -> FloatArray:
    """(2,) gain and seconds to 63 % of the plant's tangent where its output rests at a level."""
    u = float(brentq(lambda v: plant.sense(_rest(plant, v)) - level, *inputs))
    x = _rest(plant, u)
    n = len(x)
    h = _NUDGE * (1.0 + np.abs(x))
    columns = [
        (plant.rate(x + h[i] * np.eye(n)[i], u) - plant.rate(x - h[i] * np.eye(n)[i], u)) / (2 * h[i])
        for i in range(n)
    ]
    A = np.stack(columns, axis=1)
    B = (plant.rate(x, u + _NUDGE) - plant.rate(x, u - _NUDGE)) / (2 * _NUDGE)
    C = np.array(
        [
            (plant.sense(x + h[i] * np.eye(n)[i]) - plant.sense(x - h[i] * np.eye(n)[i])) / (2 * h[i])
            for i in range(n)
        ]
    )
    still = -np.linalg.solve(A, B)
    gain = float(C @ still)

    def lacks(t: float) -> float:
        return float(C @ (still - expm(A * t) @ still) / gain - _REACHED)

    late = plant.dt_s
    while lacks(late) < 0.0:
        late *= 1.5
    return np.array([gain, brentq(lacks, 0.0, late)])


def _rest(plant: Plant, u: float) -> FloatArray:
    """The state that a constant input holds, by Newton's method from rest."""
    x = np.array(plant.rest)
    for _ in range(100):
        f = plant.rate(x, u)
        n = len(x)
        h = _NUDGE * (1.0 + np.abs(x))
        J = np.stack([(plant.rate(x + h[i] * np.eye(n)[i], u) - f) / h[i] for i in range(n)], axis=1)
        step = np.linalg.solve(J, f)
        x = x - step
        if np.abs(step).max() < 1e-12:
            break
    return x


def own_answer(model: Any, point: OperatingPoint, size: float) -> FloatArray:
    """(2,) gain and seconds to 63 % of the free run: half the difference of a step up and one down."""
    rows = 3000
    u = np.tile(point.inputs, (2 * rows, 1))
    ends = []
    for way in (size, -size):
        moved = u.copy()
        moved[rows:, 0] += way
        ends.append(model.simulate(moved)[:, point.output])
    answer = (ends[0] - ends[1])[rows:] / (2 * size)
    gain = float(answer[-1])
    at = int(np.flatnonzero(answer / gain >= _REACHED)[0])
    share = answer / gain
    within = (_REACHED - share[at - 1]) / (share[at] - share[at - 1]) if at else 0.0
    return np.array([gain, model.dt_s * (at - 1 + within if at else 0.0)])


def rows_of(model: Any, plant: Plant, inputs: tuple[float, float]) -> Iterator[Row]:
    """Every operating point of a model, beside the truth."""
    rules = model.rules()
    for p in model.operating_points:
        true = truth(plant, float(p.outputs[0]), inputs)
        said = np.array([p.gain[0], p.reached_s[0]])
        ends = np.array([p.gain_interval[:, 0], p.reached_interval_s[:, 0]])
        held = np.where(np.isfinite(ends).all(axis=1), (ends[:, 0] <= true) & (true <= ends[:, 1]), np.nan)
        loudest = rules[int(p.shares.argmax())]
        rule = np.array([float(loudest.dc_gain[0, 0]), loudest.time_constant_s])
        yield Row(said, own_answer(model, p, 1e-4 * (inputs[1] - inputs[0])), true, rule, held)


LAGS = partial(TS, na=2, nb=2, nk=1, most_rules=4)
STATES = partial(TSStateSpace, states=2, nk=1, ridge=0.1, antecedents=["y(k-1)"], most_rules=3)
DRAG = PLANTS["vehicle with drag and a lagging actuator"]
FLOWN: dict[str, tuple[Plant, Callable[[], Any], tuple[float, float]]] = {
    "drag": (DRAG, partial(LAGS, antecedents=["y(k-1)"]), (-2.0, 2.0)),
    "Hammerstein": (PLANTS["Hammerstein"], partial(LAGS, antecedents=["u"]), (-5.0, 5.0)),
    "Wiener": (PLANTS["Wiener"], partial(LAGS, antecedents=["y(k-1)"]), (-5.0, 5.0)),
    "linear": (LINEAR["linear vehicle"], partial(LAGS, antecedents=["y(k-1)"]), (-5.0, 5.0)),
    "drag, hidden": (DRAG, STATES, (-2.0, 2.0)),
    "Wiener, hidden": (PLANTS["Wiener"], STATES, (-5.0, 5.0)),
}
"""Plant, how it is fitted (orders and antecedent given, rules chosen), inputs between which it rests."""


def record(plant: Plant, seed: int) -> Dataset:
    """What one seed flies."""
    return plant.dataset(tuple(1000 * seed + i for i in range(RECORDS)), SAMPLES, NOISE)[0]


def told(name: str, seeds: range) -> str:
    """One line of the table."""
    plant, estimator, inputs = FLOWN[name]
    rows = []
    rules = []
    alike = 0
    for seed in seeds:
        model = estimator().fit(record(plant, seed))
        rows += list(rows_of(model, plant, inputs))
        rules.append(len(model.rules()))
        conditions = [rule.condition for rule in model.rules()]
        alike += len(conditions) - len(set(conditions))

    def off(of: str, against: str) -> str:
        gap = np.abs([getattr(r, of) / getattr(r, against) - 1.0 for r in rows])
        return " ".join(
            f"{100 * v:4.0f}" for v in (*np.nanmedian(gap, axis=0), *np.nanquantile(gap, 0.9, axis=0))
        )

    held = np.array([r.held for r in rows])
    given = np.isfinite(held).mean(axis=0)
    share = np.nanmean(held, axis=0)
    return (
        f"{name:15s} {len(rows):4d} points, {np.mean(rules):.1f} rules | own {off('said', 'own')} | "
        f"truth {off('said', 'true')} | before {off('rule', 'true')} | "
        f"held {100 * share[0]:.1f} {100 * share[1]:.1f} of {100 * given[0]:.0f} {100 * given[1]:.0f} % | "
        f"same labels {alike}"
    )


def main() -> None:
    """Print a line per plant: medians of gain and time, then 90 % quantiles, in per cent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plants", nargs="*", default=list(FLOWN))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    asked = parser.parse_args()
    for name in asked.plants:
        print(told(name, range(asked.first, asked.first + asked.seeds)), flush=True)


if __name__ == "__main__":
    main()
