"""What the one-rule models among the candidates do for the linear baseline.

`python -m bench.baseline_rivals [plants [seed]]`: the baseline chosen with and without them on the training
part of every public set there is, and on simulated heaters: two or three slow time constants in a row, a
sensor of coarse steps, a record of a few time constants. Errors are free-run RMSE on parts that the choice
never saw, in standard deviations of the output; and CPU time of the choice.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.signal import lfilter

from bench import accuracy_data
from flysid.dataset import Dataset
from flysid.model.base import Estimator
from flysid.model.linear_choice import best_linear
from flysid.model.one_rule import OneRule, linear_rivals
from flysid.model.selection import free_run_errors
from flysid.model.shared import sharing

SETS = ("cascaded_tanks", "dryer", "gas_furnace", "robot_arm", "winding", "emps")
FRESH = 10


def heater(rng: np.random.Generator, records: int, chain: tuple[float, ...], rows: int) -> Dataset:
    """Records of a chain of lags, time constants in samples, read in steps of a hundredth of their spread."""
    arrays = []
    for _ in range(records):
        u = np.repeat(rng.uniform(0.0, 1.0, rows // 40 + 1), 40)[:rows]
        y = u - 0.5
        for t in chain:
            pole = float(np.exp(-1.0 / t))
            y = lfilter([0.0, 1.0 - pole], [1.0, -pole], y)
        step = 0.01 * float(y.std())
        noisy = y + 0.02 * float(y.std()) * rng.normal(size=rows)
        arrays.append((u[:, None], (step * np.round(noisy / step))[:, None]))
    return Dataset.from_arrays([u for u, _ in arrays], [y for _, y in arrays], 1.0)


def judged(candidates: Mapping[str, Estimator], train: Dataset, test: Dataset) -> tuple[str, float, float]:
    """The label chosen, its error on the test part, and the CPU time of the choice."""
    started = time.process_time()
    with sharing():
        choice, model = best_linear(train, None, candidates)
    seconds = time.process_time() - started
    error = free_run_errors({"": model}, test)[""]
    return choice.label, float(np.sqrt(error.mean())), seconds


def cases(plants: int, seed: int) -> Iterator[tuple[str, Dataset, Dataset]]:
    """Names, training and test parts."""
    if accuracy_data.FOLDER.is_dir():
        for name in SETS:
            case = getattr(accuracy_data, name)()
            for part, test in case.tests.items():
                yield f"{name} {part}", case.train, test
    for i in range(plants):
        rng = np.random.default_rng((seed, i))
        chain = tuple(float(t) for t in rng.uniform(5.0, 120.0, int(rng.integers(2, 4))))
        yield f"heater {i}", heater(rng, 1, chain, 400), heater(rng, FRESH, chain, 400)


def main() -> None:
    """Print a line per case, and the geometric mean of the ratios."""
    plants = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 4242
    ratios = []
    seconds = np.zeros(2)
    for name, train, test in cases(plants, seed):
        structures = {label: m for label, m in linear_rivals().items() if not isinstance(m, OneRule)}
        before = judged(structures, train, test)
        after = judged(linear_rivals(), train, test)
        ratios.append(after[1] / before[1])
        seconds += before[2], after[2]
        print(f"{name}: {before[0]} {before[1]:.4f} -> {after[0]} {after[1]:.4f}", flush=True)
    typical = float(np.exp(np.mean(np.log(ratios))))
    print(
        f"{len(ratios)} cases, seed {seed}: error times {typical:.3f} (mean), least {min(ratios):.2f}, "
        f"most {max(ratios):.2f}; CPU {seconds[0]:.0f} -> {seconds[1]:.0f} s"
    )


if __name__ == "__main__":
    main()
