"""Free-run accuracy on public benchmarks with the default settings: `make bench-accuracy`.

Everything is chosen on the training and validation parts; the test parts are only scored. Each case prints
the default TS model beside its own linear part (one rule) and the linear models, in physical units.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.accuracy_data import CASES, FOLDER, Case
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.oe import OE
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS
from flysid.model.ts_best import BestTS
from flysid.model.ts_state_space import TSStateSpace


def score(model: Fitted, case: Case) -> dict[str, list[float]]:
    """RMSE per output of the free run on every test part, from measured first samples."""
    found = {}
    for name, data in case.tests.items():
        segment = data.segments[0]
        first = max(case.n_init, model.n_init)
        run = model.simulate(segment.u, segment.y[: model.n_init])
        gap = (run - segment.y)[first:]
        found[name] = [float(v) for v in case.scale * np.sqrt((gap * gap).mean(axis=0))]
    return found


def line(title: str, estimator: Estimator, case: Case) -> str:
    """One row: errors, rules, parameters, seconds of CPU."""
    begin = time.process_time()
    model = estimator.fit(case.train, case.validation)
    seconds = time.process_time() - begin
    errors = "; ".join(
        f"{name} {', '.join(f'{v:.4g}' for v in values)}" for name, values in score(model, case).items()
    )
    return (
        f"{case.name:14s} {title:8s} {errors} {case.unit}  rules {len(model.rules())}, "
        f"parameters {model.n_parameters}, {seconds:.1f} s CPU"
    )


def main(names: list[str]) -> int:
    """Print all cases, or the named ones."""
    if not FOLDER.is_dir():
        print(f"no benchmark data in {FOLDER}", file=sys.stderr)
        return 1
    for name in names or list(CASES):
        case = CASES[name]()
        print(line("ARX", ARX(), case), flush=True)
        print(line("OE", OE(), case), flush=True)
        print(line("SS", StateSpace(), case), flush=True)
        print(line("TS, 1", TS(rules=1), case), flush=True)
        print(line("TS", TS(), case), flush=True)
        print(line("TS, ss", TSStateSpace(), case), flush=True)
        print(line("TS, best", BestTS(), case), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
