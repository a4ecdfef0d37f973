"""Linear models against their peers, CPU time and memory: `make bench-model`.

Every measurement is a fresh process on one BLAS thread: data are made, the work is done once to warm up on a
tenth of it, then timed. Peers run where they are installed (sysidentpy, scikit-learn from the registry;
octave with its control package on the path); absent ones are named. Figures are medians of one run.
"""

from __future__ import annotations

import importlib.util
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.octave import ARX as OCTAVE_ARX
from bench.octave import TIMED, octave
from flysid.dataset import Dataset, FloatArray

ROOT = Path(__file__).resolve().parents[1]
ROWS = 1_000_000
A = [1.0, -1.5, 0.7, -0.1, 0.05]
B = [0.0, 1.0, 0.5, 0.2, 0.1]


def siso(rows: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """A stable fourth-order plant under white noise, equation noise added."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    u = rng.standard_normal(rows)
    drive = lfilter(B, [1.0], u) + 0.1 * rng.standard_normal(rows)
    return u, np.asarray(lfilter([1.0], A, drive))


def mimo(rows: int) -> tuple[FloatArray, FloatArray]:
    """Three such plants side by side."""
    pairs = [siso(rows, seed) for seed in range(3)]
    return np.stack([u for u, _ in pairs], axis=1), np.stack([y for _, y in pairs], axis=1)


def ours_arx(u: FloatArray, y: FloatArray) -> Any:
    from flysid.model.arx import ARX

    return ARX(na=4, nb=4, nk=1, refine=False).fit(Dataset.from_arrays(u, y, 0.01)).flat


def ours_grid(u: FloatArray, y: FloatArray) -> Any:
    """400 orders from one pass."""
    from flysid.model.gram import reduce_data
    from flysid.model.linear.data import Scaling
    from flysid.model.linear.orders import Grid, OrderChoice, best_of, grid_gram
    from flysid.model.regressors import chunks

    data = Dataset.from_arrays(u, y, 0.01)
    lags = Grid.lags(1, 1, 20, 20)
    scaling = Scaling.of(data)
    triangle = reduce_data(lambda: chunks(data, lags, transform=scaling), grid_gram(data, lags, scaling))
    grid = Grid(triangle, 1, 1, 20, 20, offset=True)
    return best_of(grid, [OrderChoice(a, (b,), (1,)) for a in range(1, 21) for b in range(1, 21)])


def numpy_qr(u: FloatArray, y: FloatArray) -> Any:
    columns = [-y[4 - i : len(y) - i] for i in range(1, 5)] + [u[4 - i : len(u) - i] for i in range(1, 5)]
    phi = np.column_stack([*columns, np.ones(len(y) - 4)])
    r = np.asarray(np.linalg.qr(np.column_stack([phi, y[4:]]), mode="r"))
    return np.linalg.solve(r[:9, :9], r[:9, 9])


def sysidentpy_arx(u: FloatArray, y: FloatArray) -> Any:
    from sklearn.linear_model import LinearRegression
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.general_estimators import NARX

    model = NARX(
        base_estimator=LinearRegression(),
        xlag=4,
        ylag=4,
        basis_function=Polynomial(degree=1),
        model_type="NARMAX",
    )
    return model.fit(X=u[:, None], y=y[:, None])


def sysidentpy_frols(u: FloatArray, y: FloatArray) -> Any:
    return _frols().fit(X=u[:, None], y=y[:, None])


def _frols() -> Any:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    return FROLS(
        order_selection=False,
        n_terms=9,
        xlag=4,
        ylag=4,
        basis_function=Polynomial(degree=1),
        estimator=LeastSquares(),
    )


def ours_free_run(u: FloatArray, y: FloatArray) -> Any:
    """1e5 steps; the fit is not timed (see `PREPARED`)."""
    from flysid.model.arx import ARX

    data = Dataset.from_arrays(u[:5000], y[:5000], 0.01)
    model = ARX(na=4, nb=4, nk=1, refine=False).fit(data)
    return lambda: model.simulate(u[:, None], y[: model.n_init, None])


def sysidentpy_free_run(u: FloatArray, y: FloatArray) -> Any:
    model = _frols()
    model.fit(X=u[:5000, None], y=y[:5000, None])
    return lambda: model.predict(X=u[:, None], y=y[:4, None])


def ours_subspace(order: int) -> Callable[[FloatArray, FloatArray], Any]:
    """B, D and K included."""

    def work(u: FloatArray, y: FloatArray) -> Any:
        from flysid.model.statespace import StateSpace

        data = Dataset.from_arrays(u, y, 0.01)
        settings = StateSpace(order=order, method="pbsid", past=max(10, 2 * order // y.ndim), refine=False)
        return settings.fit(data)

    return work


OCTAVE_WORK: dict[str, tuple[str, Callable[[int], tuple[FloatArray, FloatArray]]]] = {
    "ARX(4,4), 1e6": ("arx(d, 'na', 4, 'nb', 4)", siso),
    "3x3 ARX(4,4), 1e6": ("arx(d, 'na', 4, 'nb', 4)", mimo),
    "subspace, order 4, 1e6": ("[m, x0, info] = n4sid(d, 4)", siso),
    "3x3 subspace, order 12, 1e6": ("[m, x0, info] = n4sid(d, 12)", mimo),
}


def by_octave(work: str, times: int) -> tuple[float, float] | None:
    """Median CPU seconds and peak megabytes above the data, or None where it cannot run."""
    command, make = OCTAVE_WORK[work]
    found = [octave(TIMED.replace("{work}", command), *make(ROWS)) for _ in range(times)]
    runs = [f for f in found if f is not None]
    if not runs:
        return None
    return statistics.median(f[0] for f in runs), statistics.median(f[1] for f in runs)


def largest_differences() -> list[str]:
    """Our ARX(4,4) against the peers' that solve the same least squares, 1e5 samples."""
    from flysid.model.arx import ARX

    u, y = siso(100_000)
    model = ARX(na=4, nb=4, nk=1, offset=False, refine=False).fit(Dataset.from_arrays(u, y, 0.01))
    ours = np.concatenate([model.system.a[1:, 0, 0], model.system.b[1:, 0, 0]])
    theirs = {"Octave": octave(OCTAVE_ARX.format(na=4, nb=4), u, y)}
    if importlib.util.find_spec("sippy_unipi"):
        from sippy_unipi import system_identification

        found = system_identification(y[None], u[None], "ARX", ARX_orders=[4, 4, 0], ARX_mod="LLS")
        theirs["sippy_unipi"] = [*found.DENOMINATOR[0][0][1:5], *found.NUMERATOR[0][0][:4]]
    return [
        f"{who}: {'not installed' if it is None else f'{np.abs(ours - it).max():.1e}'}"
        for who, it in theirs.items()
    ]


def sippy_arx(u: FloatArray, y: FloatArray) -> Any:
    from sippy_unipi import system_identification

    return system_identification(y[None], u[None], "ARX", ARX_orders=[4, 4, 0], ARX_mod="LLS")


def sippy_subspace(order: int) -> Callable[[FloatArray, FloatArray], Any]:
    def work(u: FloatArray, y: FloatArray) -> Any:
        from sippy_unipi import system_identification

        rows = u.reshape(len(u), -1).T, y.reshape(len(y), -1).T
        return system_identification(
            rows[1], rows[0], "N4SID", SS_fixed_order=order, SS_f=10, SS_p=10, SS_D_required=True
        )

    return work


WORK: dict[str, tuple[Callable[[FloatArray, FloatArray], Any], Callable[[int], Any], int, str]] = {
    "ARX(4,4), 1e6: flysid": (ours_arx, siso, ROWS, ""),
    "ARX(4,4), 1e6: QR of NumPy": (numpy_qr, siso, ROWS, ""),
    "ARX(4,4), 1e6: sysidentpy + scikit-learn": (sysidentpy_arx, siso, ROWS, "sklearn"),
    "ARX(4,4), 1e6: sysidentpy FROLS": (sysidentpy_frols, siso, ROWS, "sysidentpy"),
    "ARX(4,4), 1e6: sippy_unipi": (sippy_arx, siso, ROWS, "sippy_unipi"),
    "3x3 ARX(4,4), 1e6: flysid": (ours_arx, mimo, ROWS, ""),
    "subspace, order 4, 1e6: flysid": (ours_subspace(4), siso, ROWS, ""),
    "subspace, order 4, 1e6: sippy_unipi": (sippy_subspace(4), siso, ROWS, "sippy_unipi"),
    "3x3 subspace, order 12, 1e6: flysid": (ours_subspace(12), mimo, ROWS, ""),
    "3x3 subspace, order 12, 1e6: sippy_unipi": (sippy_subspace(12), mimo, ROWS, "sippy_unipi"),
    "400 orders, 1e6: flysid": (ours_grid, siso, ROWS, ""),
    "free run, 1e5: flysid": (ours_free_run, siso, 100_000, ""),
    "free run, 1e5: sysidentpy": (sysidentpy_free_run, siso, 100_000, "sysidentpy"),
}
PREPARED = {"free run, 1e5: flysid", "free run, 1e5: sysidentpy"}


def one(name: str) -> dict[str, float]:
    """CPU seconds and peak memory above the data, in this process."""
    work, make, rows, _ = WORK[name]
    u, y = make(rows)
    tenth = rows // 10
    if name in PREPARED:
        run = work(u, y)
    else:
        work(u[:tenth], y[:tenth])
        run = lambda: work(u, y)  # noqa: E731
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    run()
    seconds = time.process_time() - began
    return {"s": seconds, "mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024}


def measured(name: str, times: int) -> tuple[float, float] | None:
    """Medians over fresh processes; None where the peer is not installed."""
    needs = WORK[name][3]
    if needs and importlib.util.find_spec(needs) is None:
        return None
    single = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-m", "bench.bench_model", "--one", name]
    runs = []
    for _ in range(times):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=single)
        if done.returncode:
            raise SystemExit(f"{name} failed:\n{done.stderr[-2000:]}")
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    return statistics.median(r["s"] for r in runs), statistics.median(r["mb"] for r in runs)


def main(times: int = 5) -> None:
    """All cases, ratios to ours of the same work."""
    base: dict[str, float] = {}
    for name in WORK:
        work, who = name.split(": ")
        found = measured(name, times)
        if found is None:
            print(f"{name:45s} not installed")
            continue
        seconds, memory = found
        base.setdefault(work, seconds)
        ratio = "" if who == "flysid" else f"  {seconds / base[work]:.1f} times ours"
        print(f"{name:45s} {1000 * seconds:9.1f} ms {memory:8.1f} MB{ratio}", flush=True)
    single = base["ARX(4,4), 1e6"]
    grid = base["400 orders, 1e6"]
    print(f"400 orders take {grid / single:.1f} times one fit")
    for work in OCTAVE_WORK:
        answer = by_octave(work, max(times // 2, 1))
        if answer is None:
            print(f"{work}: octave with its control package is not installed")
            continue
        seconds, memory = answer
        print(
            f"{work + ': Octave':45s} {1000 * seconds:9.1f} ms {memory:8.1f} MB  "
            f"{seconds / base[work]:.1f} times ours"
        )
    print("ARX(4,4), largest difference of a coefficient to ours: " + "; ".join(largest_differences()))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(one(sys.argv[2])))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
