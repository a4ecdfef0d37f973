"""One small fitted model of every structure, for the laws in test_model_contract.py.

A new structure adds a builder to EXAMPLES under its structure's name; keep each fit well below a second.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.anfis import ANFIS
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.bj import BJ
from flysid.model.ensemble import Ensemble
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.line import Line
from flysid.model.mean import Mean
from flysid.model.multirotor import Multirotor
from flysid.model.oe import OE
from flysid.model.persistence import Persistence
from flysid.model.polynarx import PolyNARX
from flysid.model.rules.search_settings import SearchSettings
from flysid.model.statespace import StateSpace
from flysid.model.static_ts import StaticTS
from flysid.model.structured.structured_state_space import StructuredStateSpace
from flysid.model.transfer_function import TF
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace


def plant(u: FloatArray, drag: float = 0.0) -> FloatArray:
    """A damped second-order plant with a delay of one sample, two inputs, two outputs; the first may bend."""
    y = np.zeros((len(u), 2))
    for k in range(2, len(u)):
        y[k, 0] = 1.5 * y[k - 1, 0] - 0.6 * y[k - 2, 0] + 0.1 * u[k - 1, 0] + 0.02 * u[k - 1, 1]
        y[k, 0] -= drag * abs(y[k - 1, 0]) * y[k - 1, 0]
        y[k, 1] = 0.8 * y[k - 1, 1] + 0.1 * y[k - 1, 0] + 0.3 * u[k - 1, 1]
    return y


@cache
def data(
    n_u: int = 1, n_y: int = 1, *, samples: int = 400, noise: float = 0.02, seed: int = 0, drag: float = 0.0
) -> Dataset:
    """Two segments of the plant under random steps, with measurement noise and offsets."""
    rng = np.random.default_rng(seed)
    us = []
    ys = []
    for _ in range(2):
        u = np.zeros((samples, 2))
        u[:, :n_u] = np.repeat(rng.uniform(-1, 1, (samples // 8 + 1, n_u)), 8, axis=0)[:samples]
        ys.append((plant(u, drag) + 0.5 + noise * rng.standard_normal((samples, 2)))[:, :n_y])
        us.append(u[:, :n_u] + 0.2)
    return Dataset.from_arrays(us, ys, 0.02)


def scaled(dataset: Dataset, a: float, b: float) -> Dataset:
    """The same experiment in other units: a u, b y."""
    return Dataset.from_arrays(
        [a * s.u for s in dataset.segments], [b * s.y for s in dataset.segments], dataset.dt_s
    )


SMALL = SearchSettings(linear_systems=1, ridges=(0.1,), lanes=1)

Builder = Callable[[Dataset], Fitted]

EXAMPLES: dict[str, tuple[Builder, Dataset]] = {
    "line": (Line().fit, data()),
    "mean": (Mean().fit, data()),
    "mean, two inputs and outputs": (Mean().fit, data(2, 2)),
    "persistence": (Persistence().fit, data(2, 2)),
    "arx": (ARX(na=2, nb=2, nk=1, refine=False).fit, data()),
    "arx, refined": (ARX(na=2, nb=2, nk=1, refine=True).fit, data()),
    "arx, refined, two inputs and outputs": (ARX(na=2, nb=2, nk=1, refine=True).fit, data(2, 2)),
    "arx, coupled outputs": (ARX(na=2, nb=2, nk=(1, 0), refine=False).fit, data(2, 2)),
    "oe": (OE(na=2, nb=2, nk=1).fit, data()),
    "static ts": (StaticTS(rules=3).fit, data()),
    "static ts, two inputs and outputs": (StaticTS(rules=3, conjunction="minimum").fit, data(2, 2)),
    "ts": (TS(rules=2, na=2, nb=2, nk=1, iterations=10).fit, data()),
    "ts, one step": (TS(rules=2, na=2, nb=2, nk=1, refine=False).fit, data()),
    "ts, anfis": (ANFIS(rules=2, epochs=10).fit, data(2, 1)),
    "ts, two inputs and outputs": (TS(rules=2, na=2, nb=1, nk=1, iterations=5).fit, data(2, 2, samples=200)),
    "ts_ss": (TSStateSpace(states=2, rules=2, nk=1, iterations=10, search=SMALL).fit, data(samples=200)),
    "ts_ss, two inputs and outputs": (
        TSStateSpace(states=2, rules=2, nk=1, iterations=5, search=SMALL).fit,
        data(2, 2, samples=200),
    ),
    "fir": (FIR(taps=12).fit, data()),
    "fir, two inputs and outputs": (FIR(taps=6, nk=(1, 0)).fit, data(2, 2)),
    "armax": (ARMAX(na=2, nb=2, nk=1, nc=2).fit, data()),
    "bj": (BJ(na=2, nb=2, nk=1, nc=1, nd=1).fit, data()),
    "bj, two inputs and outputs": (BJ(na=2, nb=2, nk=1, nc=0, nd=2).fit, data(2, 2)),
    "iv": (IV(na=2, nb=2, nk=1).fit, data()),
    "statespace": (StateSpace(order=2, method="pbsid", past=8, refine=False).fit, data()),
    "statespace, late input": (
        StateSpace(order=2, method="pbsid", past=8, refine=False, nk=3).fit,
        data(),
    ),
    "statespace, refined, two inputs and outputs": (
        StateSpace(order=3, method="moesp", refine=True).fit,
        data(2, 2),
    ),
    "ensemble": (Ensemble(ARX(na=2, nb=2, nk=1, refine=False), members=3).fit, data()),
    "ensemble of rules": (Ensemble(StaticTS(rules=2), members=2).fit, data()),
    "tf": (TF(poles=2, zeros=1, dead_time_s=0.0).fit, data()),
    "tf, two inputs and outputs": (TF(poles=2, zeros=1, dead_time_s=0.0).fit, data(2, 2, samples=200)),
    "structured": (StructuredStateSpace().fit, data()),
    "structured, two inputs and outputs": (StructuredStateSpace(hold="first").fit, data(2, 2)),
    "multirotor": (Multirotor().fit, data()),
    "multirotor, accelerations": (Multirotor(kind="acceleration").fit, data(2, 2)),
    "polynarx": (PolyNARX(na=2, nb=2, nk=1, most_terms=2).fit, data(drag=0.5, noise=0.002)),
    "polynarx, two inputs and outputs": (
        PolyNARX(na=2, nb=1, nk=1, most_terms=1).fit,
        data(2, 2, samples=200, drag=0.5, noise=0.002),
    ),
    "arx, static": (ARX(na=0, nb=1, nk=0, refine=False).fit, data()),
}


@cache
def fitted(name: str) -> Fitted:
    """The model of an example, fitted once a process."""
    build, dataset = EXAMPLES[name]
    return build(dataset)


SCALING_TOLERANCE = {"ts": 1e-5}
"""Share of the output's range, where a search ends at a tolerance; 1e-6 for the others."""
