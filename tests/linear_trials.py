"""Data without answers for every linear structure: a named diagnosis, or a model that stays finite."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError, FitError, UsageError
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.bj import BJ
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.line import Line
from flysid.model.oe import OE
from flysid.model.statespace import StateSpace
from flysid.model.transfer_function import TF
from soak import Outcome
from tests.input_trials import SHAPES, GoesOn, always

Make = Callable[[np.random.Generator], tuple[FloatArray, FloatArray]]


def _plant(u: FloatArray, pole: float = 0.8) -> FloatArray:
    """(N, 1) first-order response to the first input."""
    y = np.zeros((len(u), 1))
    for k in range(1, len(u)):
        y[k] = pole * y[k - 1] + 0.5 * u[k - 1, 0]
    return y


def _flown(rng: np.random.Generator, gain: float = 1.0, pole: float = 0.8) -> tuple[FloatArray, FloatArray]:
    u = rng.normal(size=(240, 1))
    return gain * u, gain * (_plant(u, pole) + 0.1 * rng.normal(size=(240, 1)))


MORE: dict[str, Make] = {
    "no input": lambda r: (np.zeros((240, 0)), r.normal(size=(240, 1))),
    "scale 1e12": lambda r: _flown(r, 1e12),
    "scale 1e-12": lambda r: _flown(r, 1e-12),
    "inputs of unlike scale": lambda r: (
        np.hstack([(u := r.normal(size=(240, 1))), 1e-12 * r.normal(size=(240, 1))]),
        1e12 * (_plant(u) + 0.1 * r.normal(size=(240, 1))),
    ),
    "unexcited input": lambda r: (
        np.hstack([(u := r.normal(size=(240, 1))), np.zeros((240, 1))]),
        _plant(u) + 0.1 * r.normal(size=(240, 1)),
    ),
    "unstable plant": lambda r: _flown(r, 1.0, 1.03),
    "integrator": lambda r: _flown(r, 1.0, 1.0),
    "exact": lambda r: (u := r.normal(size=(240, 1)), _plant(u)),
    "output is the input before": lambda r: (u := r.normal(size=(240, 1)), np.roll(u, 1, axis=0)),
    "one sine": lambda _: (u := np.sin(0.3 * np.arange(240.0))[:, None], 0.5 * np.roll(u, 2, axis=0)),
    "feedback without a reference": lambda r: ((u := -0.5 * (y := r.normal(size=(240, 1)))), y + 0.0 * u),
}
"""Beside those of `tests.input_trials`."""


def given() -> dict[str, Estimator]:
    """Every linear structure with orders as given."""
    small: dict[str, Any] = {"na": 2, "nb": 2, "nk": 1}
    return {
        "line": Line(),
        "arx": ARX(**small, refine=False),
        "arx, refined": ARX(**small, refine=True),
        "arx, stable": ARX(**small, refine=False, stable=True, trend="remove"),
        "fir": FIR(taps=10),
        "oe": OE(**small),
        "oe, drift": OE(**small, trend="estimate"),
        "armax": ARMAX(**small, nc=1),
        "bj": BJ(**small, nc=1, nd=1),
        "iv": IV(**small, stable=True),
        "statespace": StateSpace(order=2, method="pbsid", past=5, refine=False),
        "statespace, moesp": StateSpace(order=2, method="moesp", past=5, refine=False, stable=True),
        "statespace, refined": StateSpace(order=2, method="cva", past=5, refine=True, nk=1),
        "tf": TF(poles=1, zeros=0, dead_time_s=0.0),
        "tf, response": TF(poles=1, zeros=0, dead_time_s=0.0, refine=False),
        "far too high": ARX(na=100, nb=100, nk=1, refine=False),
        "far too high, oe": OE(na=60, nb=60, nk=1),
        "far too high, iv": IV(na=100, nb=100, nk=1),
        "far too high, statespace": StateSpace(order=90, method="pbsid", past=95, refine=False),
        "delay beyond the data": OE(na=1, nb=1, nk=500),
    }


def chosen() -> dict[str, Estimator]:
    """Every linear structure by default."""
    every: list[Estimator] = [ARX(), OE(), ARMAX(), BJ(), IV(), FIR(), StateSpace(), TF()]
    return {f"{type(e).__name__} by default": e for e in every}


def shapes() -> Iterator[tuple[str, Make]]:
    """All of them; `short_segments` has those that are too short."""
    yield from SHAPES.items()
    yield from MORE.items()


def hopeless_fits(estimators: dict[str, Estimator], goes_on: GoesOn = always, every: int = 1) -> Outcome:
    """Fit everything to everything, or only one pair of `every`."""
    outcome = Outcome("hopeless linear fits")
    pairs = itertools.product(shapes(), estimators.items())
    for (what, make), (label, estimator) in itertools.islice(pairs, 0, None, every):
        if not goes_on():
            return outcome
        with outcome.trial():
            why = _tried(make, estimator)
        outcome.raised += why == "diagnosis"
        if why not in ("", "diagnosis"):
            outcome.failures.append(f"{what}, {label}: {why}")
    return outcome


def _tried(make: Make, estimator: Estimator) -> str:
    """ "" for a model that stays finite, "diagnosis" for an error with words, else what is wrong."""
    rng = np.random.default_rng(7)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            u, y = make(rng)
            data = Dataset.from_arrays([u], [y], 0.02)
            model = estimator.fit(data)
            wrong = _wrong(model, data)
        except (DataError, FitError, UsageError) as error:
            good = len(error.message) > 10 and error.hint
            return "diagnosis" if good else f"no way out named: {error.message!r}"
        except Exception as error:  # noqa: BLE001 - the campaign counts it
            return f"raised {type(error).__name__}: {error}"
    if warned:
        return f"warned: {warned[0].message}"
    return wrong


def _wrong(model: Fitted, data: Dataset) -> str:
    """What a model says that is not finite, or ""."""
    s: Segment = data.segments[0]
    with np.errstate(all="ignore"):
        free = model.simulate(s.u, s.y[: model.n_init])
        ahead = model.predict(s.u, s.y)
    if not np.isfinite(free).all() or not np.isfinite(ahead[model.n_init :]).all():
        return "its free run or its prediction is not finite"
    text = str(model).lower()
    if "nan" in text or "inf " in text:
        return "says nan: " + next(line for line in text.splitlines() if "nan" in line or "inf " in line)
    return ""


def short_segments() -> list[Dataset]:
    """Segments of one to seven samples; many of three; one long and one of a single sample."""
    rng = np.random.default_rng(0)
    u, y = _flown(rng)
    cuts = [[(0, k)] for k in (1, 2, 3, 5, 7)] + [
        [(i, i + 3) for i in range(0, 240, 3)],
        [(0, 239), (239, 240)],
    ]
    found = []
    for cut in cuts:
        data = Dataset.from_arrays([u[a:b] for a, b in cut], [y[a:b] for a, b in cut], 0.02)
        found.append(replace(data, name=f"{len(cut)} segments of {cut[0][1] - cut[0][0]}"))
    return found


def fits_of_short_segments(estimators: dict[str, Estimator]) -> Outcome:
    """Fit everything to segments that are too short."""
    outcome = Outcome("linear fits of short segments")
    for data in short_segments():
        for label, estimator in estimators.items():
            with outcome.trial():
                why = _of_segments(estimator, data)
            outcome.raised += why == "diagnosis"
            if why not in ("", "diagnosis"):
                outcome.failures.append(f"{data.name}, {label}: {why}")
    return outcome


def _of_segments(estimator: Estimator, data: Dataset) -> str:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return _wrong(estimator.fit(data), data)
    except (DataError, FitError, UsageError) as error:
        return "diagnosis" if len(error.message) > 10 and error.hint else f"no way out: {error.message!r}"
    except Exception as error:  # noqa: BLE001 - the campaign counts it
        return f"raised {type(error).__name__}: {error}"
