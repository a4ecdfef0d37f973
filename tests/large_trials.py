"""Data of unusual size, plants on the edge, large offsets: every structure says why not, or gives a model."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.anfis import ANFIS
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.bj import BJ
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.line import Line
from flysid.model.mean import Mean
from flysid.model.oe import OE
from flysid.model.persistence import Persistence
from flysid.model.start import estimate_start, start_window
from flysid.model.statespace import StateSpace
from flysid.model.static_ts import StaticTS
from flysid.model.transfer_function import TF
from flysid.model.ts import TS
from flysid.model.ts_state_space import TSStateSpace
from soak import Outcome, peak_memory
from tests.input_trials import GoesOn, always

DT_S = 0.005
NOISE = 0.05
"""Of what is measured, in standard deviations of the output."""

POLES: dict[str, tuple[list[float], float]] = {
    "stable": ([1.0, -0.9], 0.0),
    "integrating": ([1.0, -1.0], 0.0),
    "marginal": ([1.0, -2.0 * np.cos(0.1), 1.0], 0.0),
    "unstable": ([1.0, -1.03], 0.4),
}
"""Denominator, and the gain of the loop that holds the plant."""


@dataclass(frozen=True)
class Size:
    """How much there is: samples in all, segments, inputs, and what all signals are off zero."""

    samples: int
    segments: int = 1
    inputs: int = 1
    offset: float = 0.0
    plant: str = "stable"

    @property
    def numbers(self) -> int:
        """Input values in all."""
        return max(self.samples, self.segments) * self.inputs

    @property
    def unusual(self) -> int:
        """How many of inputs, offset and plant are not as usual."""
        return (self.inputs > 1) + (self.offset != 0.0) + (self.plant != "stable")

    def __str__(self) -> str:
        words = f"{self.plant}, {self.samples} samples, {self.segments} segments, {self.inputs} inputs"
        return f"{words}, offset {self.offset:g}" if self.offset else words

    def data(self, seed: int = 0) -> Dataset:
        """Flights of the plant under steps of every input."""
        rng = np.random.default_rng(seed)
        rows = max(self.samples // self.segments, 1)
        flights = [self._flight(rng, rows) for _ in range(self.segments)]
        scale = float(np.std(np.concatenate([y for _, y in flights]))) or 1.0
        us = [u + self.offset for u, _ in flights]
        ys = [y + NOISE * scale * rng.normal(size=y.shape) + self.offset for _, y in flights]
        return Dataset.from_arrays(us, ys, DT_S)

    def _flight(self, rng: np.random.Generator, rows: int) -> tuple[FloatArray, FloatArray]:
        steps = rng.normal(size=(rows // 8 + 1, self.inputs))
        r = np.repeat(steps, 8, axis=0)[:rows]
        a, loop = POLES[self.plant]
        closed = np.array(a)
        closed[1] += 0.1 * loop
        drive = r[:, :1] + r[:, 1:].sum(axis=1, keepdims=True) / 10.0
        y = lfilter([0.0, 0.1], closed, drive, axis=0)
        r[:, :1] -= loop * y
        return r, y


def structures() -> dict[str, Estimator]:
    """Every structure, with orders given."""
    return {
        "mean": Mean(),
        "persistence": Persistence(),
        "line": Line(),
        "arx": ARX(na=2, nb=2, nk=1, refine=False),
        "arx, refined": ARX(na=4, nb=4, nk=1),
        "fir": FIR(taps=30),
        "oe": OE(na=2, nb=2, nk=1),
        "armax": ARMAX(na=2, nb=2, nc=1, nk=1),
        "bj": BJ(na=2, nb=2, nc=1, nd=1, nk=1),
        "iv": IV(na=2, nb=2, nk=1),
        "statespace": StateSpace(order=2),
        "tf": TF(poles=2, zeros=1, dead_time_s=0.0),
        "static ts": StaticTS(rules=2),
        "ts": TS(rules=2, na=2, nb=2, nk=1, iterations=5),
        "ts_ss": TSStateSpace(states=2, rules=2, nk=1, iterations=5),
        "anfis": ANFIS(rules=2, epochs=5),
    }


def defaults() -> dict[str, Estimator]:
    """The structures that choose for themselves."""
    every: list[Estimator] = [ARX(), OE(), IV(), FIR(), StateSpace(), TS()]
    return {f"{type(e).__name__} by default": e for e in every}


def sizes() -> list[Size]:
    """All that the soak tries: every size, plant and offset, with one input and with 50.

    All lengths of a usual log first, then with one thing unusual, the smallest first: where time ends, every
    length, plant, offset and number of inputs has had its turn before they are combined.
    """
    shapes = [(1, 1), (10, 1), (300_000, 1), (300_000, 10_000), (3_000_000, 1), (3_000_000, 10_000)]
    shapes.append((10_000, 10_000))
    crossed = itertools.product(shapes, (1, 50), (0.0, 1e9), POLES)
    found = [Size(*shape, inputs, offset, plant) for shape, inputs, offset, plant in crossed]
    return sorted(found, key=lambda size: (size.unusual, size.numbers))


def fits_of_sizes(
    label: str, estimator: Estimator, chosen: Sequence[Size], goes_on: GoesOn = always
) -> Outcome:
    """Fit a structure to data of every size."""
    outcome = Outcome(label)
    with peak_memory(outcome):
        for size in chosen:
            if not goes_on():
                outcome.remark = f"of {len(chosen)}; time was up at: {size}"
                break
            data = size.data()
            with outcome.trial():
                why = _tried(estimator, data)
            outcome.raised += why == "diagnosis"
            if why not in ("", "diagnosis"):
                outcome.failures.append(f"{size}: {why}")
    return outcome


def _tried(estimator: Estimator, data: Dataset) -> str:
    """ "" for a finite model, "diagnosis" for an error with words, else what is wrong."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            model = estimator.fit(data)
            s = max(data.segments, key=len)
            window = start_window(model.n_init, len(s), model.dt_s)
            free = model.simulate(s.u, estimate_start(model, s.u[:window], s.y[:window]))
            ahead = model.predict(s.u, s.y)[model.n_init :]
    except (DataError, FitError, UsageError) as error:
        return "diagnosis" if len(error.message) > 10 and error.hint else f"no way out: {error.message!r}"
    except Exception as error:  # noqa: BLE001 - the campaign counts it
        return f"raised {type(error).__name__}: {error}"
    if not np.isfinite(free).all() or not np.isfinite(ahead).all():
        return "its free run or its prediction is not finite"
    return ""
