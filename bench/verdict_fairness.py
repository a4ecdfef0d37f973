"""Real fits on plants whose nature is known: does the verdict find what is there, and nothing else?

`python -m bench.verdict_fairness linear 200` and `... nonlinear 200` print one line per plant, the
totals, and the row for docs/measured/verdict.md; `--jobs 2` judges two plants at a time; `--journal FILE`
lets an interrupted campaign go on, with the same code only. Both sides are what `flysid fit` makes: the best
linear model by validation, and TS (at most 3 rules, to save time) over lags or hidden states, whichever
`TS` takes; `--contender ts_lags` leaves out hidden states. On linear plants TS must be called better
in at most 5 %; on nonlinear plants, with noise such that a perfect model is 20 % better than the best linear
one, it should be found in at least 80 %, and the interval should hold the change that the same two fitted
models show on 120 fresh flights in 93 to 97 %.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import FlysidError
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try, least_delays
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.linear_choice import choose_baseline, confirm
from flysid.model.one_rule import linear_rivals
from flysid.model.shared import sharing
from flysid.model.ts import TS
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare_models import compare

DT_S = 0.05
TRAIN = 4
TEST = 8
FRESH = 120
VERDICTS = ("better", "contested", "same", "worse", "not enough data")
LENGTH = 500
CONTENDERS: dict[str, Callable[[tuple[int, ...], tuple[int, ...]], Estimator]] = {
    "ts": lambda hint, least: TS(most_rules=3, nk_hint=hint, nk_least=least),
    "ts_lags": lambda hint, least: TS(states=0, most_rules=3, nk_hint=hint, nk_least=least),
}
"""Dead times to try, and those not to go below -> what is fitted against the linear side."""


@dataclass(frozen=True)
class Plant:
    """A deterministic map from an input record (N,) to the output record (N,), and its noise."""

    name: str
    respond: Callable[[FloatArray], FloatArray]
    white: float
    coloured: float


def flights(plant: Plant, count: int, rng: np.random.Generator, prefix: str, rows: int = LENGTH) -> Dataset:
    """`count` flights of one plant: steps of random height and length, smoothed; white and coloured noise."""
    segments = []
    for i in range(count):
        u = _input(rng, rows)
        y = plant.respond(u) + plant.white * rng.normal(size=rows)
        y = y + plant.coloured * _coloured(rng, rows)
        segments.append(Segment(u[:, None], y[:, None], flight=f"{prefix}{i}"))
    return Dataset(DT_S, (Signal("u", "deg"),), (Signal("y", "m/s"),), tuple(segments), name="y")


def _input(rng: np.random.Generator, rows: int) -> FloatArray:
    lengths = rng.integers(8, 60, size=rows // 8)
    steps = np.repeat(rng.normal(size=len(lengths)), lengths)[:rows]
    return np.convolve(np.concatenate([np.full(3, steps[0]), steps]), np.full(4, 0.25), mode="valid")


def _coloured(rng: np.random.Generator, rows: int) -> FloatArray:
    """Unit variance, correlated over half a second: gusts."""
    return _filter([np.sqrt(1.0 - 0.81)], [1.0, -0.9], rng.normal(size=rows))


def _filter(b: Sequence[float] | FloatArray, a: Sequence[float] | FloatArray, u: FloatArray) -> FloatArray:
    from scipy.signal import lfilter

    y: FloatArray = lfilter(b, a, u)
    return y


def linear_dynamics(rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    """Order 1 to 3, time constants 0.15 to 2 s, damping from 0.4, delay of 1 to 3 samples, gain 1."""
    poles: list[complex] = []
    for _ in range(int(rng.integers(1, 3))):
        pole = -1.0 / np.exp(rng.uniform(np.log(0.15), np.log(2.0)))
        if rng.random() < 0.4 and len(poles) < 2:
            damping = rng.uniform(0.4, 0.9)
            swing = abs(pole) * np.sqrt(1.0 / damping**2 - 1.0)
            poles += [complex(pole, swing), complex(pole, -swing)]
        else:
            poles.append(complex(pole, 0.0))
    a = np.real(np.poly(np.exp(np.array(poles[:3]) * DT_S)))
    b = np.zeros(int(rng.integers(1, 4)) + 1)
    b[-1] = a.sum()
    return lambda u: _filter(b, a, u)


def linear_plant(rng: np.random.Generator) -> Plant:
    """Noise of 2 to 20 % of the output's size, white; in half of the plants as much again coloured."""
    level = np.exp(rng.uniform(np.log(0.02), np.log(0.2)))
    return Plant("linear", linear_dynamics(rng), level, level * float(rng.random() < 0.5))


def nonlinear_plant(rng: np.random.Generator, perfect: float = 0.8) -> Plant:
    """Saturating or dead-banded input, or drag; noise so that a perfect model has `perfect` the error."""
    kind = str(rng.choice(["saturation", "dead band", "drag"]))
    while True:
        plant = Plant(kind, nonlinear_dynamics(kind, rng), 0.0, 0.0)
        train = flights(plant, TRAIN, rng, "t")
        test = flights(plant, TEST, rng, "h")
        error = compare([ARX().fit(train)], test, horizons=[FREE_RUN]).entry().models["arx"].scores
        if error.fit_pct is not None and error.fit_pct < 97.0:
            break
    # rmse_linear^2 = bias^2 + s^2 and rmse_perfect = s = perfect rmse_linear
    return Plant(kind, plant.respond, error.rmse * perfect / float(np.sqrt(1.0 - perfect**2)), 0.0)


def nonlinear_dynamics(kind: str, rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    dynamics = linear_dynamics(rng)
    size = rng.uniform(0.3, 0.8)
    if kind == "saturation":
        return lambda u: dynamics(np.tanh(u / size))
    if kind == "dead band":
        return lambda u: dynamics(np.sign(u) * np.maximum(np.abs(u) - size, 0.0))
    drag = rng.uniform(1.0, 3.0)
    return lambda u: fly_with_drag(u, drag)


def fly_with_drag(u: FloatArray, drag: float) -> FloatArray:
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = y[k - 1] + DT_S * (3.0 * u[k - 1] - 0.3 * y[k - 1] - drag * y[k - 1] * abs(y[k - 1]))
    return y


@dataclass(frozen=True)
class Outcome:
    """One plant: what was said, and what the same two models show on fresh flights.

    Attributes
    ----------
    verdict : "contested": better than the baseline, not shown against ARX beside it.
    rules : of the TS model; with one it is a linear model.
    baseline : the linear structure that validation chose.
    change, low, high, truth : percent; None where there is no such number.
    seconds : CPU time.
    """

    seed: int
    plant: str
    verdict: str
    rules: int
    baseline: str
    change: float | None
    low: float | None
    high: float | None
    truth: float | None
    seconds: float

    @property
    def covered(self) -> bool | None:
        """Whether the interval holds the truth; None where either is missing."""
        if self.low is None or self.high is None or self.truth is None:
            return None
        return self.low <= self.truth <= self.high

    def __str__(self) -> str:
        numbers = [np.nan if x is None else x for x in (self.change, self.low, self.high, self.truth)]
        change, low, high, truth = numbers
        return (
            f"{self.seed:4d} {self.plant:10s} {self.rules} rules, {self.baseline:10s} {change:+7.1f} % "
            f"[{low:+6.1f}, {high:+6.1f}] true {truth:+6.1f} % {self.verdict:16s} {self.seconds:5.1f} s"
        )


def judged(plant: Plant, rng: np.random.Generator, seed: int, contender: str = "ts") -> Outcome:
    """Defaults fitted to the plant as `flysid fit` does it, judged, and tried on fresh flights."""
    began = time.process_time()
    train = flights(plant, TRAIN, rng, "t")
    test = flights(plant, TEST, rng, "h")
    models, base = fit_as_flysid(train, contender=contender)
    pair = compare(models, test, horizons=[FREE_RUN], baseline=base).verdict["y"]
    many = flights(plant, FRESH, rng, "f")
    fresh = compare(models, many, horizons=[FREE_RUN], baseline=base).verdict["y"]
    low, high = pair.ci95 or (None, None)
    rules = len(models["ts"].rules())
    seconds = time.process_time() - began
    return Outcome(
        seed,
        plant.name,
        "contested" if pair.contested else str(pair.verdict),
        rules,
        base,
        pair.change_pct,
        low,
        high,
        fresh.change_pct,
        seconds,
    )


def fit_as_flysid(
    train: Dataset, base: str | None = None, contender: str = "ts"
) -> tuple[dict[str, Fitted], str]:
    """ARX, the best linear model or that of a label, and TS, as `flysid fit` makes them; the baseline."""
    late = dead_times(train)
    delays = delays_to_try(late, 1), least_delays(late, 1)
    linear = linear_rivals(*delays)
    with sharing():
        choice = choose_baseline(train, linear)
        labels = dict.fromkeys(("arx", base or choice.label))
        models: dict[str, Fitted] = {n: linear[n].fit(train) for n in labels}
        base = base or confirm(choice, models, train).label
        models["ts"] = CONTENDERS[contender](*delays).fit(train)
    return models, base


def exact_interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share in percent (Clopper and Pearson, 1934)."""
    from scipy.stats import beta

    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(0.975, count + 1, of - count))
    return 100.0 * low, 100.0 * high


def share(name: str, count: int, of: int) -> str:
    """ "TS better: 3 of 200 (1.5 %, 95 % interval 0.3 to 4.3 %)"."""
    if not of:
        return f"{name}: none"
    low, high = exact_interval(count, of)
    return f"{name}: {count} of {of} ({100 * count / of:.1f} %, 95 % interval {low:.1f} to {high:.1f} %)"


def totals(kind: str, outcomes: Sequence[Outcome], failed: Mapping[str, int]) -> str:
    """The table that `make soak` prints."""
    n = len(outcomes)
    verdicts = Counter(o.verdict for o in outcomes)
    covered = [o.covered for o in outcomes if o.covered is not None]
    lines = [f"{kind} plants: {n}"]
    lines += [share(f"  {v}", verdicts[v], n) for v in VERDICTS]
    fuzzy = sum(o.verdict == "better" and o.rules > 1 for o in outcomes)
    lines.append(share("  better, with more than one rule", fuzzy, n))
    lines.append(share("  the interval holds the truth", sum(covered), len(covered)))
    lines += [f"  failed, {count}: {why}" for why, count in failed.items()]
    return "\n".join(lines)


def row(kind: str, outcomes: Sequence[Outcome], seeds: range) -> str:
    """The line of the table in docs/measured/verdict.md."""
    n = len(outcomes)
    count = Counter(o.verdict for o in outcomes)
    covered = [o.covered for o in outcomes if o.covered is not None]
    better = exact_interval(count["better"], n)
    held = exact_interval(sum(covered), len(covered))
    one_rule = sum(o.verdict == "better" and o.rules == 1 for o in outcomes)
    contested = count["contested"]
    cells = (
        f"{kind}, seeds {seeds.start} to {seeds.stop - 1}",
        f"{n}",
        f"{count['better']} ({better[0]:.0f} to {better[1]:.0f} %)"
        + (f", of them {one_rule} with one rule" if one_rule else "")
        + (f"; {contested} more, but not against ARX" if contested else ""),
        f"{count['same']}",
        f"{count['worse']}",
        f"{count['not enough data']}",
        f"{sum(covered)} of {len(covered)} ({held[0]:.0f} to {held[1]:.0f} %)",
    )
    return f"| {' | '.join(cells)} |"


@dataclass(frozen=True)
class Task:
    """One plant to judge, in a process of its own or not."""

    kind: str
    seed: int
    contender: str = "ts"


def judge_task(task: Task) -> Outcome | str:
    """The outcome; or the reason why there is none."""
    rng = np.random.default_rng(task.seed)
    try:
        plant = linear_plant(rng) if task.kind == "linear" else nonlinear_plant(rng)
        return judged(plant, rng, task.seed, task.contender)
    except FlysidError as error:
        return error.message[:60]


@dataclass
class Journal:
    """What a campaign has found, a JSON line each; the first line says of which plants and by which code."""

    kind: str
    path: Path | None = None
    found: dict[int, Outcome | str] = field(default_factory=dict)
    contender: str = "ts"

    def read(self) -> None:
        """Take up what is there.

        Raises
        ------
        SystemExit : the journal is of other plants, of another contender or of other code.
        """
        head = {"kind": self.kind, "contender": self.contender, "code": code_hash()}
        if self.path is None:
            return
        if not self.path.is_file() or not self.path.stat().st_size:
            self._append(head)
            return
        first, *lines = [json.loads(line) for line in self.path.read_text("utf-8").splitlines()]
        if first != head:
            raise SystemExit(
                f"{self.path} is of {first.get('kind')} plants, of another contender or of other code:"
                " name a new file"
            )
        for line in lines:
            self.found[line["seed"]] = line["failed"] if "failed" in line else Outcome(**line)

    def add(self, seed: int, what: Outcome | str) -> None:
        """Keep one outcome, on disk too."""
        self.found[seed] = what
        self._append({"seed": seed, "failed": what} if isinstance(what, str) else asdict(what))

    def _append(self, line: Mapping[str, object]) -> None:
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


def code_hash() -> str:
    """SHA-256 of every Python file that a verdict may hang on, and of this one."""
    root = Path(__file__).parents[1]
    files = sorted(
        f for part in ("flysid", "ingest", "model", "validate") for f in root.glob(f"{part}/**/*.py")
    )
    digest = hashlib.sha256()
    for file in [*files, Path(__file__)]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def judge_all(tasks: Sequence[Task], jobs: int) -> Iterator[tuple[int, Outcome | str]]:
    """(seed, outcome) of every task, in the order in which they are done."""
    if jobs <= 1:
        yield from ((task.seed, judge_task(task)) for task in tasks)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(judge_task, task): task.seed for task in tasks}
        for future in as_completed(waiting):
            yield waiting[future], future.result()


def main() -> None:
    """Print a line per plant, the totals, and the row of the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=["linear", "nonlinear"])
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=1, help="plants judged at a time")
    parser.add_argument("--journal", type=Path, help="append outcomes to this file, and skip those in it")
    parser.add_argument(
        "--contender", choices=list(CONTENDERS), default="ts", help="with hidden states, or without"
    )
    order = parser.parse_args()
    seeds = range(order.first, order.first + order.count)
    journal = Journal(order.kind, order.journal, contender=order.contender)
    journal.read()
    tasks = [Task(order.kind, seed, order.contender) for seed in seeds if seed not in journal.found]
    for seed, what in judge_all(tasks, order.jobs):
        journal.add(seed, what)
        print(f"{seed:4d} failed: {what}" if isinstance(what, str) else what, flush=True)
    found = [journal.found[seed] for seed in seeds]
    outcomes = [o for o in found if isinstance(o, Outcome)]
    print(totals(order.kind, outcomes, Counter(o for o in found if isinstance(o, str))))
    print(row(order.kind, outcomes, seeds))


if __name__ == "__main__":
    main()
