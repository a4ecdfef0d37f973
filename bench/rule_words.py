"""Do the words of rules describe the vehicle?  python -m bench.rule_words [PLANT...] [--seeds N] [--first N]

Plants whose small steps are known, the simulated quadrotor among them, are flown with noise and fitted: by
the search that `flysid fit` makes, or, "given", with orders and antecedent. Every operating point that the
model speaks of is asked three things: is its gain, and its time to 63 %, that of the model's own free run
about that place (two simulated small steps); is it the plant's; does its interval hold the plant's.
Beside it: what the strongest rule there says by itself, as the words did before. Of several inputs each is
asked.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from bench.hidden_plants import LINEAR, PLANTS, Plant
from bench.vehicle import PERIOD_S
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.ingest.synth.plans import BOLD, GENTLE, MULTISINE, PILOT, STEPS
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.rigid_body import ALL, SimulatedVehicle, fly_vehicle
from flysid.ingest.synth.vehicles import disperse
from flysid.model.base import OperatingPoint
from flysid.model.rules.phrases import answer_alike, meanings
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace

NOISE = 0.03  # of the output's spread
SAMPLES = 800
RECORDS = 6
FLIGHTS = (STEPS, PILOT, MULTISINE, STEPS, PILOT, MULTISINE)
TRAINED = 4
FLIGHT_S = 60.0
SPEED_NOISE = 0.02  # m/s
SETTLED_S = 40.0
TWO_DT = 0.05
_NUDGE = 1e-6
_REACHED = 1.0 - np.exp(-1.0)


@dataclass(frozen=True)
class Row:
    """One input at one operating point of one fit.

    Attributes
    ----------
    said, own, true, rule : (2,) gain and seconds to 63 %: what the words say, what the model's free run does,
        what the plant does, what the strongest rule says by itself (its gain and slowest time constant).
    held : (2,) whether the interval holds the truth; NaN where none is given.
    wide : (2,) half the interval, in logarithms.
    """

    said: FloatArray
    own: FloatArray
    true: FloatArray
    rule: FloatArray
    held: FloatArray
    wide: FloatArray


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


def own_answer(model: Any, point: OperatingPoint, size: float, signal: int = 0) -> FloatArray:
    """(2,) gain and seconds to 63 % of the free run: half the difference of a step up and one down."""
    rows = 3000
    u = np.tile(point.inputs, (2 * rows, 1))
    ends = []
    for way in (size, -size):
        moved = u.copy()
        moved[rows:, signal] += way
        ends.append(model.simulate(moved)[:, point.output])
    return reached((ends[0] - ends[1])[rows:] / (2 * size), model.dt_s)


Truth = Callable[[float, int], FloatArray]
"""An output's level, and an input -> (2,) gain and seconds to 63 % of the plant's tangent there."""


@dataclass(frozen=True)
class Flown:
    """A plant as it is flown and fitted.

    Attributes
    ----------
    record : seed -> what it flew, and what is true of it.
    estimator : how it is fitted.
    small : a small step of an input.
    """

    record: Callable[[int], tuple[Dataset, Truth]]
    estimator: Callable[[], Any]
    small: float


def of_plant(plant: Plant, inputs: tuple[float, float], estimator: Callable[[], Any]) -> Flown:
    """A bench plant that rests between two inputs."""

    def record(seed: int) -> tuple[Dataset, Truth]:
        seeds = tuple(1000 * seed + i for i in range(RECORDS))
        return plant.dataset(seeds, SAMPLES, NOISE)[0], lambda level, _: truth(plant, level, inputs)

    return Flown(record, estimator, 1e-4 * (inputs[1] - inputs[0]))


def of_vehicle(loop: str, estimator: Callable[[], Any]) -> Flown:
    """One axis of the simulated quadrotor, another specimen of it for every seed."""
    column = list(LOOPS).index(loop)
    most = BOLD[column] * GENTLE[column]

    def record(seed: int) -> tuple[Dataset, Truth]:
        vehicle = specimen(seed)
        data = vehicle_flights(vehicle, loop, seed, range(TRAINED))
        return data, lambda level, _: vehicle_truth(vehicle, column, level)

    return Flown(record, estimator, 1e-3 * most)


def of_two_inputs(estimator: Callable[[], Any]) -> Flown:
    """A vehicle with quadratic drag that a tilt and a fan push, the fan behind a lag of its own.

    Another specimen for every seed.
    """

    def record(seed: int) -> tuple[Dataset, Truth]:
        rng = np.random.default_rng([seed, 2])
        push = rng.uniform([0.03, 0.8], [0.06, 1.6])  # m/s^2 per deg, and per unit of the fan
        friction, drag, lag = rng.uniform([0.3, 0.3, 0.2], [0.5, 0.7, 0.5])
        fine = 10
        segments = []
        for i in range(RECORDS):
            rng = np.random.default_rng([seed, 2, i])
            holds = rng.uniform(-1.0, 1.0, (2, SAMPLES // 15 + 1))
            u = np.repeat(holds * [[20.0], [1.0]], 15, axis=1).T[:SAMPLES]
            v = np.zeros(SAMPLES)
            speed = blown = 0.0
            for k in range(1, SAMPLES):
                for _ in range(fine):
                    rate = push @ [u[k - 1, 0], blown] - friction * speed - drag * abs(speed) * speed
                    blown += TWO_DT / fine * (u[k - 1, 1] - blown) / lag
                    speed += TWO_DT / fine * rate
                v[k] = speed
            noisy = v + NOISE * v.std() * rng.standard_normal(SAMPLES)
            segments.append(Segment(u, noisy[:, None], flight=str(i)))

        def true_at(level: float, signal: int) -> FloatArray:
            pole = friction + 2.0 * drag * abs(level)
            t = np.linspace(0.0, 20.0, 200_001)
            left = np.exp(-pole * t)
            if signal == 1:
                left = (left / pole - lag * np.exp(-t / lag)) / (1.0 / pole - lag)
            return np.array([push[signal] / pole, t[np.argmax(left <= 1.0 - _REACHED)]])

        signals = (Signal("tilt", "deg"), Signal("fan"))
        return Dataset(TWO_DT, signals, (Signal("v_x", "m/s"),), tuple(segments)), true_at

    return Flown(record, estimator, 1e-4)


def specimen(seed: int) -> SimulatedVehicle:
    """Another vehicle of the type for every seed."""
    return disperse(SimulatedVehicle(), np.random.default_rng([seed, 1, 2]))


def vehicle_flights(vehicle: SimulatedVehicle, loop: str, seed: int, flights: Iterable[int]) -> Dataset:
    """Some of the flights of a seed, one axis commanded, its speed measured with noise."""
    column = list(LOOPS).index(loop)
    output = LOOPS[loop].output
    peaks = (BOLD[0] * GENTLE[0], BOLD[1] * GENTLE[1], BOLD[2] * GENTLE[2])
    time_s = np.arange(round(FLIGHT_S / PERIOD_S), dtype=np.float64) * PERIOD_S
    segments = []
    for i in flights:
        rng = np.random.default_rng([seed, i])
        u = FLIGHTS[i].command(time_s, peaks, rng)
        u = np.where(np.arange(u.shape[1]) == column, u, 0.0)
        y = fly_vehicle(vehicle, u).series()[output] + SPEED_NOISE * rng.standard_normal(len(u))
        segments.append(Segment(u[:, [column]], y[:, None], flight=str(i)))
    return Dataset(PERIOD_S, (Signal("u"),), (Signal(output, "m/s"),), tuple(segments))


def vehicle_truth(vehicle: SimulatedVehicle, column: int, level: float) -> FloatArray:
    """(2,) gain and seconds to 63 % of small steps where the vehicle flies at a constant speed."""
    fresh = replace(vehicle, effects=replace(ALL, battery_sag=False))
    output = list(LOOPS.values())[column].output
    half = round(SETTLED_S / PERIOD_S)
    most = 1.1 * BOLD[column] * GENTLE[column]

    def speed(u: FloatArray) -> FloatArray:
        commands = np.zeros((len(u), 3))
        commands[:, column] = u
        return np.asarray(fly_vehicle(fresh, commands).series()[output])

    u = float(brentq(lambda v: speed(np.full(half, v))[-1] - level, -most, most, xtol=1e-6))
    size = 1e-3 * most
    up, down = (speed(np.concatenate([np.full(half, u), np.full(half, u + s)]))[half:] for s in (size, -size))
    return reached((up - down) / (2 * size), PERIOD_S)


def reached(answer: FloatArray, dt_s: float) -> FloatArray:
    """(2,) gain and seconds to 63 % of a settled answer to a unit step."""
    gain = float(answer[-1])
    share = answer / gain
    at = int(np.flatnonzero(share >= _REACHED)[0])
    within = (_REACHED - share[at - 1]) / (share[at] - share[at - 1]) if at else 0.0
    return np.array([gain, dt_s * (at - 1 + within if at else 0.0)])


def rows_of(model: Any, true_at: Truth, small: float) -> Iterator[Row]:
    """Every operating point of a model, beside the truth."""
    rules = model.rules()
    for p in getattr(model, "operating_points", ()):
        for j in range(len(model.inputs)):
            true = true_at(float(p.outputs[0]), j)
            said = np.array([p.gain[j], p.reached_s[j]])
            ends = np.array([p.gain_interval[:, j], p.reached_interval_s[:, j]])
            held = np.where(
                np.isfinite(ends).all(axis=1), (ends[:, 0] <= true) & (true <= ends[:, 1]), np.nan
            )
            wide = 0.5 * np.log(ends.max(axis=1) / ends.min(axis=1))
            loudest = rules[int(p.shares.argmax())]
            rule = np.array([float(loudest.dc_gain[0, j]), loudest.time_constant_s])
            yield Row(said, own_answer(model, p, small, j), true, rule, held, np.abs(wide))


DRAG = PLANTS["vehicle with drag and a lagging actuator"]
LINEAR_VEHICLE = LINEAR["linear vehicle"]
LAGS = partial(TS, na=2, nb=2, nk=1, most_rules=4)
STATES = partial(TSStateSpace, states=2, nk=1, ridge=0.1, antecedents=["y(k-1)"], most_rules=3)
OVER_OUTPUT = partial(LAGS, antecedents=["y(k-1)"])
OVER_INPUT = partial(LAGS, antecedents=["u"])
FLOWN: dict[str, Flown] = {
    **{loop: of_vehicle(loop, TS) for loop in LOOPS},
    "drag": of_plant(DRAG, (-2.0, 2.0), TS),
    "Hammerstein": of_plant(PLANTS["Hammerstein"], (-5.0, 5.0), TS),
    "Wiener": of_plant(PLANTS["Wiener"], (-5.0, 5.0), TS),
    "drag, given": of_plant(DRAG, (-2.0, 2.0), OVER_OUTPUT),
    "Hammerstein, given": of_plant(PLANTS["Hammerstein"], (-5.0, 5.0), OVER_INPUT),
    "Wiener, given": of_plant(PLANTS["Wiener"], (-5.0, 5.0), OVER_OUTPUT),
    "linear, given": of_plant(LINEAR_VEHICLE, (-5.0, 5.0), OVER_OUTPUT),
    "drag, hidden": of_plant(DRAG, (-2.0, 2.0), STATES),
    "Wiener, hidden": of_plant(PLANTS["Wiener"], (-5.0, 5.0), STATES),
    "two inputs": of_two_inputs(TS),
    "two inputs, given": of_two_inputs(partial(LAGS, antecedents=["v_x(k-1)"])),
}


@dataclass(frozen=True)
class Told:
    """One fitted model: its points and rules.

    Attributes
    ----------
    labels, words, alike : pairs of rules with one label, of which the same is said, that answer alike.
    """

    rows: tuple[Row, ...]
    rules: int
    labels: int
    words: int
    alike: int


def told(flown: Flown, seed: int) -> Told:
    """One seed flown and fitted."""
    data, true_at = flown.record(seed)
    model = flown.estimator().fit(data)
    rules = model.rules()
    pairs = list(combinations(rules, 2))
    signals = (data.outputs, data.inputs)
    words = [means.partition("; ")[2] for means in meanings(rules, signals)]
    return Told(
        tuple(rows_of(model, true_at, flown.small)),
        len(rules),
        sum(a.condition == b.condition for a, b in pairs),
        sum(a == b for a, b in combinations(words, 2)),
        sum(answer_alike(a, b) for a, b in pairs),
    )


def line(name: str, models: list[Told]) -> str:
    """One line of the table."""
    rows = [row for model in models for row in model.rows]
    if not rows:
        return f"{name}: no operating points"

    def off(of: str, against: str) -> str:
        gap = np.abs([getattr(r, of) / getattr(r, against) - 1.0 for r in rows])
        return " ".join(
            f"{100 * np.nanquantile(gap, q, axis=0)[i]:.0f}" for i in (0, 1) for q in (0.5, 0.9, 1)
        )

    held = np.array([r.held for r in rows])
    given = np.isfinite(held)
    shares = " ".join(f"{np.nansum(held[:, i]):.0f}/{given[:, i].sum()}" for i in (0, 1))
    wide = 100.0 * np.nanmedian([r.wide for r in rows], axis=0)
    rules = np.mean([model.rules for model in models])
    return (
        f"{name:18s} {len(models):2d} seeds {len(rows):4d} points {rules:.1f} rules | "
        f"own {off('said', 'own')} | truth {off('said', 'true')} | before {off('rule', 'true')} | "
        f"held {shares} | half widths {wide[0]:.1f} {wide[1]:.1f} | "
        f"same labels {sum(m.labels for m in models)} words {sum(m.words for m in models)} "
        f"alike {sum(m.alike for m in models)}"
    )


def main() -> None:
    """Print a line per fit, then one per plant.

    Gain, then time: median, 90 % quantile and worst, in per cent.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plants", nargs="*", default=list(FLOWN))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    asked = parser.parse_args()
    found: dict[str, list[Told]] = {name: [] for name in asked.plants}
    for seed in range(asked.first, asked.first + asked.seeds):
        for name, models in found.items():
            models.append(told(FLOWN[name], seed))
            print(f"  {seed} " + line(name, models[-1:]), flush=True)
    for name, models in found.items():
        print(line(name, models), flush=True)


if __name__ == "__main__":
    main()
