"""Takagi-Sugeno models against their peers, CPU time: part of `make bench-model`.

    python -m bench.bench_ts [TIMES]

Every measurement is a fresh process on one thread; the work is done once to warm up (compilers are not timed,
ours and JAX's alike), then timed. Peers run where they are installed (pyfume, sysidentpy, jax-sysid); absent
ones are named. Figures are medians of one run.
"""

from __future__ import annotations

import importlib.util
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray

ROOT = Path(__file__).resolve().parents[1]
ROWS = 10_000
STEPS = 100_000
Timed = tuple[Callable[[], Any], Callable[[Any], float]]
"""The work, and the error of what it returns (RMSE, or a NaN where there is none)."""


def no_error(_: Any) -> float:
    """For work that is only timed."""
    return float("nan")


def bend(rows: int) -> tuple[FloatArray, FloatArray]:
    """A noisy sine of one input: (N, 1) and (N,)."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-3.0, 3.0, (rows, 1))
    return x, np.sin(x[:, 0]) + 0.05 * rng.standard_normal(rows)


def against(y: FloatArray) -> Callable[[Any], float]:
    """RMSE of what the work returns against y."""
    return lambda found: float(np.sqrt(np.mean((np.asarray(found).ravel() - y.ravel()) ** 2)))


def ours_static_fit() -> Timed:
    from flysid.model.static_ts import StaticTS

    x, y = bend(ROWS)
    data = Dataset.from_arrays(x, y, 0.01)
    return lambda: StaticTS(rules=7).fit(data), lambda model: against(y)(model.simulate(x))


def ours_static_prediction() -> Timed:
    from flysid.model.static_ts import StaticTS

    x, y = bend(ROWS)
    model = StaticTS(rules=7).fit(Dataset.from_arrays(x, y, 0.01))
    return lambda: model.simulate(x), against(y)


def _pyfume(x: FloatArray, y: FloatArray) -> Any:
    from pyfume.Clustering import Clusterer
    from pyfume.EstimateAntecendentSet import AntecedentEstimator
    from pyfume.EstimateConsequentParameters import ConsequentEstimator
    from pyfume.SimpfulModelBuilder import SugenoFISBuilder

    _, grades, _ = Clusterer(x_train=x, y_train=y, nr_clus=7).cluster(method="gk")
    sets = AntecedentEstimator(x, grades).determineMF()
    consequents = ConsequentEstimator(x, y, grades).suglms()
    return SugenoFISBuilder(sets, consequents, ["x"], save_simpful_code=False).get_model()


def _pyfume_prediction(model: Any, x: FloatArray, y: FloatArray) -> Any:
    from pyfume.Tester import SugenoFISTester

    tester = SugenoFISTester(model=model, test_data=x, variable_names=["x"], golden_standard=y)
    found = tester.predict()
    return found[0] if isinstance(found, tuple) else found


def pyfume_fit() -> Timed:
    x, y = bend(ROWS)
    return lambda: _pyfume(x, y), lambda model: against(y)(_pyfume_prediction(model, x, y))


def pyfume_prediction() -> Timed:
    x, y = bend(ROWS)
    model = _pyfume(x, y)
    return lambda: _pyfume_prediction(model, x, y), against(y)


def lagged(rows: int) -> tuple[FloatArray, FloatArray]:
    """A bent plant of second order under random steps: (N, 1) each."""
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, rows // 10), 10)
    y = np.zeros(rows)
    for k in range(2, rows):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + 0.1 * u[k - 1] - 0.1 * y[k - 1] ** 3
    return u[:, None], y[:, None]


def ours_free_run() -> Timed:
    """7 rules over 8 regressors (4 outputs, 3 inputs, the constant)."""
    from flysid.model.ts import TS

    u, y = lagged(STEPS)
    settings = TS(rules=7, na=4, nb=3, nk=1, antecedents=("y(k-1)", "u(k-1)"), refine=False)
    model = settings.fit(Dataset.from_arrays(u[:3000], y[:3000], 0.05))
    return lambda: model.simulate(u, y[: model.n_init]), no_error


def sysidentpy_free_run() -> Timed:
    """A polynomial of second degree in 4 outputs and 3 inputs, 8 terms."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    u, y = lagged(STEPS)
    model = FROLS(
        order_selection=False,
        n_terms=8,
        xlag=3,
        ylag=4,
        basis_function=Polynomial(degree=2),
        estimator=LeastSquares(),
    )
    model.fit(X=u[:3000], y=y[:3000])
    return lambda: model.predict(X=u, y=y[:4]), no_error


def _silverbox() -> tuple[Dataset, Dataset]:
    from bench.accuracy_data import CASES

    case = CASES["silverbox"]()
    return case.train, next(iter(case.tests.values()))


def _multisine_error(run: FloatArray, test: Dataset) -> float:
    """RMSE in mV of a free run of the multisine's test part, after 50 samples."""
    gap = (run - test.segments[0].y)[50:]
    return float(1000.0 * np.sqrt(np.mean(gap * gap)))


def ours_silverbox() -> Timed:
    """Three rules of the orders that both sides are given, grown and refined on the simulation error."""
    from flysid.model.ts import TS

    train, test = _silverbox()
    segment = test.segments[0]
    settings = TS(rules=3, na=2, nb=3, nk=0, antecedents=("y(k-1)",))
    return lambda: settings.fit(train), lambda m: _multisine_error(
        m.simulate(segment.u, segment.y[: m.n_init]), test
    )


def jax_silverbox() -> Timed:
    """A quasi-LPV model: two states, two scheduling variables of a small network; Adam, then L-BFGS."""
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import qLPVModel

    train, test = _silverbox()
    u = [np.asarray(s.u) for s in train.segments]
    y = [np.asarray(s.y) for s in train.segments]
    scale_u = float(np.std(u[0]))
    scale_y = float(np.std(y[0]))
    hidden = 6

    def scheduling(x: Any, _: Any, weights: Any) -> Any:
        first, second, third, fourth = weights
        return jax.nn.sigmoid(third @ jnp.tanh(first @ x + second) + fourth)

    def fit() -> Any:
        rng = np.random.default_rng(0)
        start = [
            0.1 * rng.standard_normal((hidden, 2)),
            np.zeros(hidden),
            0.1 * rng.standard_normal((2, hidden)),
            np.zeros(2),
        ]
        model = qLPVModel(2, 1, 1, 2, scheduling, start, y_in_x=False)
        model.loss(rho_x0=1e-4, rho_th=1e-6)
        model.optimization(adam_epochs=1000, lbfgs_epochs=1000, iprint=-1)
        model.fit([v / scale_y for v in y], [v / scale_u for v in u])
        return model

    def error(model: Any) -> float:
        segment = test.segments[0]
        x0 = model.learn_x0(segment.u[:500] / scale_u, segment.y[:500] / scale_y, verbosity=False)
        run, _ = model.predict(x0, segment.u / scale_u)
        return _multisine_error(np.asarray(run) * scale_y, test)

    return fit, error


WORK: dict[str, tuple[Callable[[], Timed], str]] = {
    "7 rules from 1e4 samples: flysid": (ours_static_fit, ""),
    "7 rules from 1e4 samples: pyFUME, Gustafson-Kessel": (pyfume_fit, "pyfume"),
    "1e4 predictions: flysid": (ours_static_prediction, ""),
    "1e4 predictions: pyFUME": (pyfume_prediction, "pyfume"),
    "free run, 1e5 steps: flysid, 7 rules": (ours_free_run, ""),
    "free run, 1e5 steps: sysidentpy, 8 terms": (sysidentpy_free_run, "sysidentpy"),
    "Silverbox: flysid, 3 rules": (ours_silverbox, ""),
    "Silverbox: jax-sysid, quasi-LPV": (jax_silverbox, "jax_sysid"),
}
LONG = "Silverbox"  # warmed up by its own first steps; timed once


def one(name: str) -> dict[str, float]:
    """CPU seconds and error, in this process."""
    work, error = WORK[name][0]()
    if not name.startswith(LONG):
        work()
    began = time.process_time()
    found = work()
    seconds = time.process_time() - began
    return {"s": seconds, "rmse": error(found)}


def measured(name: str, times: int) -> dict[str, float] | None:
    """Medians over fresh processes; None where the peer is not installed."""
    needs = WORK[name][1]
    if needs and importlib.util.find_spec(needs) is None:
        return None
    single = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
        "PYTHONWARNINGS": "ignore",
    }
    command = [sys.executable, "-m", "bench.bench_ts", "--one", name]
    runs = []
    for _ in range(1 if name.startswith(LONG) else times):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=single)
        if done.returncode:
            raise SystemExit(f"{name} failed:\n{done.stderr[-2000:]}")
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    return {key: statistics.median(r[key] for r in runs) for key in runs[0]}


def main(times: int = 5) -> None:
    """All cases, ratios to ours of the same work."""
    base: dict[str, float] = {}
    for name in WORK:
        work = name.split(": ")[0]
        found = measured(name, times)
        if found is None:
            print(f"{name:52s} not installed")
            continue
        base.setdefault(work, found["s"])
        ratio = found["s"] / base[work]
        error = "" if np.isnan(found["rmse"]) else f"  RMSE {found['rmse']:.4g}"
        more = "" if ratio == 1.0 else f"  {ratio:.1f} times ours"
        print(f"{name:52s} {1000 * found['s']:11.1f} ms{error}{more}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(one(sys.argv[2])))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
