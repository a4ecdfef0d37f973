"""Does what is delivered follow its own data? `python -m bench.last_gates [PLANTS] [SEED] [LABEL...]`.

Plants are drawn at random: kind, time constants, gains, noise, excitation, number and length of flights.
Every structure is fitted as `flysid fit` does it; its free run over the training data is compared with that
of ARX. One line a plant, then the sums. The seed is drawn fresh unless it is given.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.base import Fitted, load
from flysid.model.selection import free_run_errors
from flysid.split import Split
from flysid.validate.runs.channeljob import ChannelJob
from flysid.validate.runs.fitting import MemoryJob
from flysid.validate.runs.run import ChannelRun, FitSettings

SUBSTEPS = 4
EVERY = (
    "arx",
    "oe",
    "armax",
    "bj",
    "statespace",
    "fir",
    "iv",
    "tf",
    "polynarx",
    "ts",
    "ts_lags",
    "ts_ss",
    "anfis",
    "ensemble",
)
"""Structures with a memory; a line and a static TS have none, and claim nothing about time."""
REACHES = (1.0, 1.5)
"""Of unseen flights, in excitations of the training flights."""
Rate = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Drawn:
    """A plant: dx/dt and y of x and u, its sample time, what it is driven with."""

    rate: Rate
    sense: Callable[[FloatArray], FloatArray]
    states: int
    inputs: int
    dt_s: float
    slowest_s: float
    feedback: Callable[[FloatArray], FloatArray] | None = None


def lags(rng: np.random.Generator, inputs: int, outputs: int, slow: tuple[float, float]) -> Drawn:
    """Every output a sum of first-order lags of every input: an evaporator, a furnace."""
    constants = np.exp(rng.uniform(np.log(slow[0]), np.log(slow[1]), (outputs, inputs)))
    gains = rng.normal(size=(outputs, inputs))

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        return np.asarray((u - x.reshape(outputs, inputs)) / constants).ravel()

    return Drawn(
        rate,
        lambda x: (gains * x.reshape(outputs, inputs)).sum(axis=1),
        outputs * inputs,
        inputs,
        float(constants.min() * rng.uniform(0.1, 0.4)),
        float(constants.max()),
    )


def velocity(rng: np.random.Generator, bend: float = 0.0) -> Drawn:
    """An acceleration behind a motor lag, integrated; with drag where it bends."""
    lag, drag = rng.uniform(0.1, 0.5), rng.choice([0.0, rng.uniform(0.02, 0.2)])

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        return np.array([x[1] - drag * x[0] - bend * abs(x[0]) * x[0], (u[0] - x[1]) / lag])

    return Drawn(rate, lambda x: x[:1], 2, 1, 0.05, 5.0)


def position(rng: np.random.Generator) -> Drawn:
    """A velocity with friction, integrated."""
    slow = rng.uniform(2.0, 30.0)
    return Drawn(lambda x, u: np.array([x[1], (1.5 * u[0] - x[1]) / slow]), lambda x: x[:1], 2, 1, 0.1, slow)


def unstable(rng: np.random.Generator) -> Drawn:
    """An inverted pendulum that a pilot holds; the input is what the pilot gives."""
    away, firm = rng.uniform(0.5, 2.0), rng.uniform(1.5, 3.0)

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        return np.array([x[1], away * x[0] - 1.5 * x[1] + u[0]])

    return Drawn(rate, lambda x: x[:1], 2, 1, 0.05, 3.0, lambda x: -firm * away * x[:1] - x[1:])


def backwards(rng: np.random.Generator) -> Drawn:
    """A zero in the right half plane: it begins the wrong way."""
    first, second, zero = rng.uniform(0.3, 1.5), rng.uniform(0.3, 1.5), rng.uniform(0.2, 0.8)

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        return np.array([(u[0] - x[0]) / first, (x[0] - x[1]) / second])

    return Drawn(rate, lambda x: x[1:] - zero * (x[:1] - x[1:]) / second, 2, 1, 0.1, first + second)


def arm(rng: np.random.Generator) -> Drawn:
    """A flexible arm: a rigid rotation, and a light resonance upon it."""
    speed, damping = rng.uniform(3.0, 12.0), rng.uniform(0.005, 0.05)

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        return np.array([x[1], u[0] - 0.3 * x[1], x[3], u[0] - 2 * damping * speed * x[3] - speed**2 * x[2]])

    return Drawn(rate, lambda x: x[1:2] + 2.0 * x[3:4], 4, 1, 0.3 / speed, 3.0)


def titration(rng: np.random.Generator) -> Drawn:
    """A tank behind which a steep curve bends: the acidity of a neutralisation."""
    slow, steep, at = rng.uniform(2.0, 10.0), rng.uniform(3.0, 12.0), rng.uniform(-0.3, 0.3)
    return Drawn(
        lambda x, u: (u - x) / slow,
        lambda x: 7.0 + 3.0 * np.tanh(steep * (x - at)) + 0.5 * x,
        1,
        1,
        slow / 8.0,
        slow,
    )


def rotor(rng: np.random.Generator) -> Drawn:
    """Two rotors on a beam: elevation swings like a pendulum, azimuth integrates, and they couple."""
    heavy, couple = rng.uniform(0.5, 3.0), rng.uniform(0.0, 0.5)

    def rate(x: FloatArray, u: FloatArray) -> FloatArray:
        thrust = u * np.abs(u)
        return np.array(
            [
                x[1],
                thrust[0] - heavy * np.sin(x[0]) - 0.2 * x[1],
                x[3],
                thrust[1] + couple * u[0] - 0.5 * x[3],
            ]
        )

    return Drawn(rate, lambda x: x[[0, 2]], 4, 2, 0.1, 5.0)


KINDS: Mapping[str, Callable[[np.random.Generator], Drawn]] = {
    "lag": partial(lags, inputs=1, outputs=1, slow=(0.5, 2.0)),
    "evaporator": partial(lags, inputs=3, outputs=3, slow=(1.0, 60.0)),
    "furnace": partial(lags, inputs=3, outputs=6, slow=(1.0, 20.0)),
    "velocity": velocity,
    "velocity with drag": partial(velocity, bend=0.3),
    "position": position,
    "unstable": unstable,
    "non-minimum phase": backwards,
    "flexible arm": arm,
    "titration": titration,
    "rotor rig": rotor,
}


def levels(rng: np.random.Generator, samples: int, hold: tuple[int, int], inputs: int) -> FloatArray:
    """(N, n_u) random levels, each held for a random time."""
    found = np.empty((samples, inputs))
    for j in range(inputs):
        at = 0
        while at < samples:
            length = int(rng.integers(*hold))
            found[at : at + length, j] = rng.uniform(-1.0, 1.0)
            at += length
    return found


def flown(
    plant: Drawn, rng: np.random.Generator, samples: int, reach: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """(N, n_u), (N, n_y) of one flight, without noise on the output; `reach` scales what drives it."""
    longest = max(4, min(samples // 6, round(2.0 * plant.slowest_s / plant.dt_s)))
    r = reach * levels(rng, samples, (3, longest), plant.inputs)
    x = np.zeros(plant.states)
    u = np.empty_like(r)
    y = []
    step = plant.dt_s / SUBSTEPS
    for k in range(samples):
        y.append(plant.sense(x))
        u[k] = r[k] if plant.feedback is None else r[k] + plant.feedback(x)
        for _ in range(SUBSTEPS):
            middle = x + 0.5 * step * plant.rate(x, u[k])
            x = x + step * plant.rate(middle, u[k])
    return u, np.array(y)


def drawn(
    rng: np.random.Generator, kinds: Sequence[str] = tuple(KINDS), reaches: Sequence[float] = REACHES
) -> tuple[str, Dataset, dict[float, Dataset]]:
    """One of the kinds, a record of it, and by their reach flights without noise that no model sees."""
    name = str(rng.choice(list(kinds)))
    plant = KINDS[name](rng)
    flights = int(rng.integers(1, 7))
    samples = int(rng.integers(250, 700)) if flights > 2 else int(rng.integers(600, 1500))
    records = [flown(plant, rng, samples) for _ in range(flights)]
    spread = np.vstack([y for _, y in records]).std(axis=0)
    noise = rng.choice([0.0, 0.005, 0.02, 0.05])
    wind = rng.choice([0.0, 0.3])
    segments = []
    for i, (u, y) in enumerate(records):
        measured = y + spread * (
            noise * rng.standard_normal(y.shape) + wind * rng.standard_normal(y.shape[1])
        )
        segments.append(Segment(u, measured, flight=f"f{i}"))
    inputs = tuple(Signal(f"u{j}") for j in range(plant.inputs))
    outputs = tuple(Signal(f"y{j}") for j in range(len(spread)))
    whole = partial(Dataset, plant.dt_s, inputs, outputs, name="channel")
    fresh = {
        reach: whole(segments=tuple(Segment(*flown(plant, rng, samples, reach)) for _ in range(2)))
        for reach in reaches
    }
    return (
        f"{name}, {flights} x {samples}, noise {noise:g}, wind {wind:g}",
        whole(segments=tuple(segments)),
        fresh,
    )


def fitted(
    data: Dataset, labels: tuple[str, ...], folder: Path
) -> tuple[ChannelRun | str, dict[str, Fitted]]:
    """The channel as `flysid fit` leaves it, and its models."""
    settings = FitSettings(models=labels, seed=0, rotate=False)
    job: ChannelJob[Dataset] = MemoryJob(data, folder, settings)
    found = job.run()
    if isinstance(found, str):
        return found, {}
    return found, {label: load(folder / file) for label, file in found.models.items()}


def held_value(data: Dataset) -> float:
    """Mean square of the first value held, in variances of the outputs."""
    scale = np.vstack([s.y for s in data.segments]).std(axis=0)
    return float(np.mean(np.vstack([(s.y - s.y[0]) / scale for s in data.segments]) ** 2))


def _unseen(models: Mapping[str, Fitted], fresh: Mapping[float, Dataset], baseline: str) -> str:
    """Errors of the nonlinear models on unseen flights, in those of the baseline."""
    bent = {label: m for label, m in models.items() if label in (baseline, "ts", "polynarx", "ensemble")}
    said = []
    for reach, data in fresh.items():
        errors = {label: float(e.mean()) for label, e in free_run_errors(bent, data).items()}
        own = errors.pop(baseline)
        ratios = ", ".join(f"{k} {np.sqrt(e / max(own, 1e-20)):.3g}" for k, e in errors.items())
        said.append(f"unseen x{reach:g}: {ratios}")
    return "; ".join(said)


def main(count: int, seed: int, labels: tuple[str, ...]) -> None:
    """Print every structure that errs more than ARX on its training data, and the sums."""
    print(f"seed {seed}", flush=True)
    worse: Counter[str] = Counter()
    seen: Counter[str] = Counter()
    given_up: Counter[str] = Counter()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name, data, fresh = drawn(rng)
        began = time.process_time()
        with TemporaryDirectory() as folder:
            channel, models = fitted(data, labels, Path(folder))
        if isinstance(channel, str):
            print(f"{number:3d} {name}: not fitted: {channel}", flush=True)
            continue
        train = Split.from_dict(channel.split).apply(data)[0]
        models = {k: m for k, m in models.items() if k in (*labels, channel.baseline)}
        errors = {k: float(e.mean()) for k, e in free_run_errors(models, train).items()}
        known = errors.get("arx", errors[channel.baseline])
        lost = []
        for label, error in errors.items():
            seen[label] += 1
            ratio = np.sqrt(error / max(known, 1e-20))
            if error > known * (1 + 1e-6) + 1e-16:
                worse[label] += 1
                lost.append(f"{label} {ratio:.3g}")
        given_up.update(k for k in channel.failed if k in labels)
        unseen = _unseen(models, fresh, channel.baseline)
        print(
            f"{number:3d} {name}: {len(errors)} models, {time.process_time() - began:.0f} s of CPU; "
            f"ARX {np.sqrt(known):.3g} sd; worse: {', '.join(lost) or '-'}; {unseen}",
            *(f"\n      not fitted {k}: {v}" for k, v in channel.failed.items() if k in labels),
            flush=True,
        )
    for label in seen:
        print(f"{label:12} {worse[label]} of {seen[label]} worse than ARX, {given_up[label]} not delivered")


if __name__ == "__main__":
    args = sys.argv[1:]
    main(
        int(args[0]) if args else 30,
        int(args[1]) if len(args) > 1 else int(np.random.SeedSequence().generate_state(1)[0]),
        tuple(args[2:]) or EVERY,
    )
