"""What a step of the search for rules earns: fits with it and with the step left out.

`python -m bench.ablations STEP[,STEP...] SEED [PLANT...]`: plants as `bench.starts` names them,
`inputs: NAME` of `bench.ts_inputs`, and `public: NAME` of `bench.accuracy_data`, of which the first 16,000
samples of the training part alone are used, the last quarter of these as fresh data. Free-run errors from
estimated starts in per cent of the spread, defaults, with and without; then the geometric mean of the ratios,
and CPU seconds.
`states: ...` and `lags: ...` are rules over two states, and over two lags, of any of these: a tenth of the
time, where a step is one of theirs.

A STEP is one of `STEPS`, or a number of the search and what it is multiplied by: `rules.stages.HOLD*0.5`.
"""

from __future__ import annotations

import importlib
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from unittest.mock import patch

import numpy as np

from bench import starts, ts_inputs
from bench.accuracy_data import CASES
from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Estimator
from flysid.model.rules import edits, growth, learning, search, search_context
from flysid.model.selection import simplest
from flysid.model.ts import TS


def nowhere(data: Dataset) -> FloatArray:
    """(2, n_y) limits of outputs that end nowhere."""
    return np.array([[-np.inf], [np.inf]]) * np.ones(len(data.outputs))


def half_spread(chosen: FloatArray, *_: object) -> float:
    """The width of a new rule's set, whatever it is of the range."""
    return 0.5 * float(np.std(chosen))


Step = Callable[[], AbstractContextManager[object]]
linear_starts = growth._linear_starts
STEPS: Mapping[str, Step] = {
    "own places": lambda: patch.object(search, "_AS_MUCH", -np.inf),
    "further places": lambda: patch.object(growth, "_FIRST_PLACES", growth._PLACES),
    "same places": lambda: patch.object(growth, "_PLACES", growth._FIRST_PLACES),
    "lower orders": lambda: patch.object(search_context, "embedded_start", lambda *_: ()),
    "instruments": lambda: patch.object(
        growth, "_linear_starts", lambda problem: itertools.islice(linear_starts(problem), 1)
    ),
    "linear side": lambda: patch.object(search_context.SearchContext, "_linear_side", lambda *_: []),
    "idle inputs": lambda: patch.object(search_context.SearchContext, "_needless", lambda *_: ()),
    "integrator": lambda: patch.object(
        search_context.SearchContext, "_settle", lambda _, stage, *__: (stage,)
    ),
    "fewer orders": lambda: patch.object(search_context, "simplest", lambda errors, _: simplest(errors)),
    "short records": lambda: patch.object(learning, "_HIGHEST_LINEAR", learning._DEEPEST_DELAY),
    "ends of travel": lambda: patch.object(learning, "saturation_limits", nowhere),
    "different starts": lambda: patch.object(search, "different", list),
    "dry friction": lambda: patch.object(search, "rubbing", lambda *_: []),
    "first width": lambda: patch.object(growth, "first_width", half_spread),
    "merge and split": lambda: patch.object(edits, "merge_and_split", lambda _, models, at: models[at]),
}
MODELS: Mapping[str, Estimator] = {"states": TS(states=2), "lags": TS(na=2, nb=2, nk=1)}
MOST_ROWS = 16_000
"""Of a public set."""
PLANTS = (
    *("saturated", "tanks", "drone", "stiff", "hammerstein", "wiener", "propeller", "arm", "roll", "few"),
    *("linear", "linear modes", "linear noisy", "two tanks with overflow", "hysteresis"),
    *("public: tanks", "public: robot-arm", "public: dryer", "public: gas-furnace", "public: winding"),
    "public: silverbox",
)


@contextmanager
def scaled(word: str) -> Iterator[None]:
    """A number of `flysid.model`, `rules.stages.HOLD*0.5`, multiplied wherever it is known by its name."""
    place, _, factor = word.partition("*")
    room, _, name = place.rpartition(".")
    home = importlib.import_module(f"flysid.model.{room}")
    known = getattr(home, name)
    other = tuple(times(v, factor) for v in known) if isinstance(known, tuple) else times(known, factor)
    with ExitStack() as patches:
        for module in [m for m in sys.modules.values() if m.__name__.startswith("flysid.model")]:
            if getattr(module, name, None) is known:
                patches.enter_context(patch.object(module, name, other))
        for value in vars(home).values():
            asked = vars(value).get("__init__") if isinstance(value, type) else value
            given = getattr(asked, "__defaults__", None) or ()
            if any(v is known for v in given):
                changed = tuple(other if v is known else v for v in given)
                patches.enter_context(patch.object(asked, "__defaults__", changed))
        yield


def times(number: float, factor: str) -> float:
    """The number so many times; a whole one stays whole."""
    found = float(factor) * number
    return round(found) if isinstance(number, int) else found


def step_of(word: str) -> AbstractContextManager[object]:
    """The search without a step, or with another number."""
    return scaled(word) if "*" in word else STEPS[word]()


def records(name: str, seed: int) -> starts.Records:
    """What is learned from, what runs start from, and what they are compared with."""
    kind, _, own = data_of(name).rpartition(": ")
    if kind == "public":
        data = CASES[own]().train
        segment = data.segments[0]
        rows = min(len(segment), MOST_ROWS)
        cut = 3 * rows // 4
        parts = [segment.slice(0, cut, data.dt_s), segment.slice(cut, rows, data.dt_s)]
        return data.with_segments(parts[:1]), data.with_segments(parts[1:]), [parts[1].y]
    if kind == "inputs":
        rng = np.random.default_rng(seed)
        train = ts_inputs.records(own, 4, 0.02, rng)
        fresh = ts_inputs.records(own, 8, 0.0, rng)
        return train, fresh, [s.y for s in fresh.segments]
    return starts.records(own, seed)


def data_of(name: str) -> str:
    """The plant or set, without the model that is asked for."""
    model, _, own = name.partition(": ")
    return own if model in MODELS else name


def fitted(name: str, known: starts.Records) -> tuple[float, str, float]:
    """Error, what the model is, and CPU seconds."""
    train, test, truth = known
    begin = time.process_time()
    model = MODELS.get(name.partition(": ")[0], TS()).fit(train)
    seconds = time.process_time() - begin
    error = starts.error(model, test, truth, first_samples=False)
    return error, f"{model.structure}, {len(model.rules())} rules", seconds


def main(words: list[str]) -> int:
    """Print a line per plant and step, and the mean of every step."""
    steps, seed = words[0].split(","), int(words[1])
    ratios: dict[str, list[float]] = {step: [] for step in steps}
    spent: dict[str, float] = dict.fromkeys(steps, 0.0)
    usual = 0.0
    for name in words[2:] or PLANTS:
        known = records(name, seed)
        whole, model, seconds = fitted(name, known)
        usual += seconds
        for step in steps:
            with step_of(step):
                without, other, less = fitted(name, known)
            spent[step] += less
            ratios[step].append(without / whole)
            print(
                f"{step:28s} {name:36s} {seed} {whole:8.4g} -> {without:8.4g} ({without / whole:.3f})  "
                f"{model} -> {other}",
                flush=True,
            )
    for step in steps:
        mean = np.exp(np.mean(np.log(ratios[step])))
        print(
            f"without {step}: {mean:.3f} of the error ({min(ratios[step]):.2f} to {max(ratios[step]):.2f}, "
            f"{len(ratios[step])}), {usual:.0f} -> {spent[step]:.0f} s of CPU"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
