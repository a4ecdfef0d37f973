"""Free-run accuracy on public benchmarks with the default settings: `make bench-accuracy`.

Everything is chosen on the training and validation parts; the test parts are only scored. Each case prints
the default TS model beside its own linear part (one rule) and the linear models, in physical units: from the
first measured samples alone, as published figures start, and in brackets as `flysid.compare` starts a run.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.accuracy_data import CASES, FOLDER, Case
from flysid.dataset import FloatArray, Segment
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.oe import OE
from flysid.model.polynarx import PolyNARX
from flysid.model.start import run_from_window, start_window
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace

Scores = dict[str, list[float]]
"""RMSE per output, by the name of the test part."""


def score(model: Fitted, case: Case) -> Scores:
    """The free run on every test part, from measured first samples."""
    found = {}
    for name, data in case.tests.items():
        segment = data.segments[0]
        run = model.simulate(segment.u, segment.y[: model.n_init])
        found[name] = rmse(run, segment, max(case.n_init, model.n_init), case)
    return found


def score_as_compared(model: Fitted, case: Case) -> Scores:
    """The free run as `flysid.compare` starts it, without the window that its start is estimated from."""
    found = {}
    for name, data in case.tests.items():
        segment = data.segments[0]
        window = start_window(model.n_init, len(segment), data.dt_s)
        found[name] = rmse(run_from_window(model, segment, window), segment, window, case)
    return found


def rmse(run: FloatArray, segment: Segment, first: int, case: Case) -> list[float]:
    """Per output, from row `first` on, in the case's unit."""
    gap = (run - segment.y)[first:]
    return [float(v) for v in case.scale * np.sqrt((gap * gap).mean(axis=0))]


def in_words(plain: Scores, compared: Scores) -> str:
    """ "test 11.4 (5.76)": both errors of every test part."""
    pairs = {
        name: ", ".join(f"{a:.4g} ({b:.4g})" for a, b in zip(errors, compared[name], strict=True))
        for name, errors in plain.items()
    }
    return "; ".join(f"{name} {said}" for name, said in pairs.items())


def line(title: str, estimator: Estimator, case: Case) -> str:
    """One row: errors, rules, parameters, seconds of CPU."""
    begin = time.process_time()
    model = estimator.fit(case.train, case.validation)
    seconds = time.process_time() - begin
    errors = in_words(score(model, case), score_as_compared(model, case))
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
        print(line("TS, 1", TS(rules=1, states=0), case), flush=True)
        print(line("TS, lags", TS(states=0), case), flush=True)
        print(line("TS, ss", TSStateSpace(), case), flush=True)
        print(line("TS", TS(), case), flush=True)
        print(line("polynarx", PolyNARX(), case), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
