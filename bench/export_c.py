"""Exported C beside the models that it comes from: `python -m bench.export_c [RUN|- [LABEL]]`.

Every model of a run (of `flysid demo`: `flysid-demo/run`; `-` is none) and nonlinear models of the public
sets (given a LABEL, those of that label alone), compiled by gcc in four ways, along a million random inputs:
the largest difference in ulp and in standard deviations of the output; CPU time of a step; flash, RAM and
instructions on an emulated Cortex-M4F, given its tools (`gcc-arm-none-eabi`, `libnewlib-arm-none-eabi`,
`qemu-system-arm`).
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.accuracy_data import CASES, FOLDER
from bench.cortex import cortex
from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.export.csource import c_files
from flysid.export.program import Program
from flysid.export.programs import program_of
from flysid.export.reference import run
from flysid.model.base import Estimator, Fitted
from flysid.model.polynarx import PolyNARX
from flysid.model.static_ts import StaticTS
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace
from flysid.validate.runs.run import models_of, open_run
from tests.flysid.export.compiled import run_in_c

ROWS = 1_000_000
WAYS = {
    "-O0": ("-O0",),
    "-O2": ("-O2",),
    "-O2 no contraction": ("-O2", "-ffp-contract=off"),
    "-O3 FMA": ("-O3", "-march=native", "-ffp-contract=fast", "-std=gnu99"),
}

ESTIMATORS: dict[str, Estimator] = {
    "ts": TS(rules=2, na=2, nb=2, nk=1, iterations=20),
    "static_ts": StaticTS(rules=3),
    "ts_ss": TSStateSpace(states=2, rules=2, iterations=10),
    "polynarx": PolyNARX(),
}
HIDDEN = ("cascaded_tanks", "emps")


def models(folder: str | None, wanted: str = "") -> Iterator[tuple[str, Fitted]]:
    """Every model of a run and of the public sets, or those of one label."""
    if folder not in (None, "-"):
        run_folder = open_run(folder)
        for channel in run_folder.channels:
            for label, model in models_of(run_folder, channel).items():
                if wanted in ("", label):
                    yield f"{channel.name} {label}", model
    if not FOLDER.is_dir():
        return
    for name in CASES:
        case = CASES[name]()
        for label, estimator in ESTIMATORS.items():
            if wanted in ("", label) and (label != "ts_ss" or name in HIDDEN):
                yield f"{name} {label}", estimator.fit(case.train)


def inputs(program: Program) -> FloatArray:
    """A million rows of levels held for 1 to 40 samples, two spreads wide."""
    rng = np.random.default_rng(1)
    n = program.n
    held = np.repeat(np.arange(ROWS), rng.integers(1, 41, ROWS))[:ROWS]
    levels = rng.uniform(-2.0, 2.0, (held[-1] + 1, len(program.inputs)))[held]
    return np.asarray(program.shift[n:] + levels * np.minimum(program.scale[n:], 1.0))


def ulps(a: FloatArray, b: FloatArray) -> float:
    """The largest difference in units of the last place of the larger number."""
    gap = np.abs(a - b)
    return float((gap / np.spacing(np.maximum(np.abs(a), np.abs(b)))).max())


def line(name: str, model: Fitted, folder: Path) -> str:
    """One row: difference from `simulate` and from the program, way by way, and the time of a step."""
    program = program_of(model)
    u = inputs(program)
    free = model.simulate(u)
    told = run(program, u)[0]
    spread = max(float(free.std(axis=0).max()), 1e-300)
    parts = [f"simulate against its program {np.abs(free - told).max() / spread:.1e} std"]
    for way, flags in WAYS.items():
        begin = time.process_time()
        found = run_in_c(program, u, folder, flags)
        seconds = time.process_time() - begin
        parts.append(f"{way}: {ulps(found, told):.0f} ulp, {np.abs(found - told).max() / spread:.1e} std")
        if way == "-O2":
            parts[-1] += f", {1e9 * seconds / ROWS:.0f} ns a step"
    single = run_in_c(program, u, folder, ("-O2",), single=True)
    parts.append(f"float32: rms {np.sqrt(np.mean((single - told) ** 2)) / spread:.1e} std")
    return f"{name:26s} {program.title:38s} " + "; ".join(parts)


def main(arguments: list[str]) -> int:
    """Print one line per model, then what an emulated Cortex-M4F needs."""
    found = list(models(arguments[0] if arguments else None, *arguments[1:2]))
    for name, model in found:
        with tempfile.TemporaryDirectory() as folder:
            try:
                print(line(name, model, Path(folder)), flush=True)
                print(f"{'':26s} Cortex-M4F, float32: {cortex(c_files(program_of(model), 'plant', 0.0))}")
            except UsageError as error:
                print(f"{name:26s} {error.message}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
