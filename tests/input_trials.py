"""Trials of hostile and hopeless input: model files, data without information, models that diverge, leaks."""

from __future__ import annotations

import json
import os
import pickle
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError, FitError, FlysidError, StoreError
from flysid.model.base import Fitted, load
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.document import to_json
from soak import Outcome
from tests.released_files import released

GoesOn = Callable[[], bool]
ROWS = 80


def always() -> bool:
    return True


# --------------------------------------------------------------------------------- row 15: model files


class Executed:
    """Unpickled, it would leave a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch '{self.path}'",)


def raw_files(mark: Path) -> Iterator[tuple[str, bytes]]:
    """Files that are no models, whatever they are called."""
    yield "empty", b""
    yield "zeros", bytes(4096)
    yield "pickle", pickle.dumps(Executed(mark))
    yield "pickle, old", pickle.dumps(Executed(mark), protocol=0)
    yield "not UTF-8", b'{"format": "flysid-model\xff"}'
    yield "nested", b"[" * 100_000
    yield "a list", b"[1, 2]"
    yield "a number", b"1e999"
    yield "twice", b'{"format": "flysid-model"}{"format": "flysid-model"}'
    yield "huge number", b'{"format": "flysid-model", "version": 1' + b"0" * 5000 + b"}"
    yield "other structure", b'{"format": "flysid-model", "version": 1, "structure": "../../os"}'
    yield "no structure", b'{"format": "flysid-model", "version": 1, "structure": null}'
    yield "structure a list", b'{"format": "flysid-model", "version": 1, "structure": ["arx"]}'


WRONG: tuple[Any, ...] = (
    None, True, -1, 0, 10**9, 2**63, 1e300, "", "__import__('os')", [], {}, [[]], [None], [[1e300]], {"a": 1},
    [float(k) for k in range(1000)], "../../etc/passwd",
)  # fmt: skip


class Base:
    """A model file, and every place in it that can be broken."""

    def __init__(self, path: Path) -> None:
        self.name, self.text = path.stem, path.read_text()
        every = _spots(json.loads(self.text), ())
        self.spots = [spot for spot in every if spot[-1] not in ("format", "structure")]


def broken(base: Base, rng: random.Random) -> tuple[str, dict[str, Any]]:
    """The document with one thing in it, at any depth, replaced, removed or repeated."""
    found: dict[str, Any] = json.loads(base.text)
    spot = rng.choice(base.spots)
    inner: Any = found
    for key in spot[:-1]:
        inner = inner[key]
    how = rng.choice(["replace", "replace", "replace", "remove", "repeat", "scale"])
    value = inner[spot[-1]]
    if how == "remove":
        del inner[spot[-1]]
    elif how == "repeat" and isinstance(value, list):
        inner[spot[-1]] = value * rng.choice([0, 2, 3])
    elif how == "scale" and isinstance(value, int | float):
        inner[spot[-1]] = value * rng.choice([-1, 1e6, 1e300, 0, 1000])
    else:
        inner[spot[-1]] = rng.choice(WRONG)
    return f"{how} {'.'.join(map(str, spot))}", found


def _spots(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in pairs:
        yield (*path, key)
        yield from _spots(inner, (*path, key))


def hostile_models(folder: Path, count: int, goes_on: GoesOn = always, seed: int = 0) -> Outcome:
    """Model files that are refused, or that compute plain numbers; nothing in them is ever executed."""
    outcome = Outcome("model files")
    rng = random.Random(seed)
    mark = folder / "executed"
    path = folder / "model.json"
    bases = [Base(p) for version in released() for p in sorted((version / "models").glob("*.json"))]
    for what, raw in islice(chain(raw_files(mark), _broken_files(bases, rng)), count):
        if not goes_on():
            break
        path.write_bytes(raw)
        with outcome.trial():
            why = _try_model(path)
        outcome.raised += why == "refused"
        if why not in ("refused", "computes"):
            outcome.failures.append(f"{what}: {why}")
    if mark.exists():
        outcome.failures.append("code from a model file was executed")
    outcome.remark = f"{outcome.trials - outcome.raised - len(outcome.failures)} harmless, and computed"
    return outcome


def _broken_files(bases: list[Base], rng: random.Random) -> Iterator[tuple[str, bytes]]:
    """Without end."""
    while True:
        base = rng.choice(bases)
        what, document = broken(base, rng)
        yield f"{base.name}: {what}", json.dumps(document).encode()


def _try_model(path: Path) -> str:
    """ "refused", "computes", or what went wrong."""
    try:
        model = load(path)
    except StoreError as error:
        return "refused" if error.exit_code == 2 else f"exit code {error.exit_code}"
    except Exception as error:  # noqa: BLE001 - the campaign counts it
        return f"load raised {type(error).__name__}: {error}"
    try:
        return "computes" if _is_plain(model) else "computes what is not finite"
    except Exception as error:  # noqa: BLE001 - the campaign counts it
        return f"simulate raised {type(error).__name__}: {error}"


def _is_plain(model: Fitted) -> bool:
    """Whether free run and prediction of noise are finite where they must be."""
    rng = np.random.default_rng(0)
    n = ROWS + model.n_init
    k = model.n_init
    u = rng.normal(size=(n, len(model.inputs)))
    y = rng.normal(size=(n, len(model.outputs)))
    free = model.simulate(u, y[:k])
    ahead = model.predict(u, y)
    return bool(np.isfinite(free).all() and np.isfinite(ahead[k:]).all() and free.shape == y.shape)


# ------------------------------------------------------------------------- row 16: data without answers

N = 240


def _with_one(rng: np.random.Generator, value: float) -> FloatArray:
    """Noise (N, 1) with one value in it that is no number."""
    noise = rng.normal(size=(N, 1))
    noise[9] = value
    return noise


def _two_levels(rng: np.random.Generator) -> FloatArray:
    """(N, 1) zeros and ones."""
    return rng.integers(0, 2, (N, 1)).astype(np.float64)


SHAPES: dict[str, Callable[[np.random.Generator], tuple[FloatArray, FloatArray]]] = {
    "constant input": lambda r: (np.full((N, 1), 2.0), r.normal(size=(N, 1))),
    "constant output": lambda r: (r.normal(size=(N, 1)), np.full((N, 1), 3.0)),
    "all zero": lambda _: (np.zeros((N, 1)), np.zeros((N, 1))),
    "single sample": lambda _: (np.ones((1, 1)), np.ones((1, 1))),
    "two samples": lambda r: (r.normal(size=(2, 1)), r.normal(size=(2, 1))),
    "ten samples": lambda r: (r.normal(size=(10, 1)), r.normal(size=(10, 1))),
    "output is the input": lambda r: (u := r.normal(size=(N, 1)), u.copy()),
    "identical inputs": lambda r: (np.repeat(r.normal(size=(N, 1)), 2, axis=1), r.normal(size=(N, 1))),
    "inputs that add up": lambda r: (
        np.hstack([u := r.normal(size=(N, 2)), u.sum(axis=1, keepdims=True)]),
        r.normal(size=(N, 1)),
    ),
    "identical outputs": lambda r: (r.normal(size=(N, 1)), np.repeat(r.normal(size=(N, 1)), 2, axis=1)),
    "one step": lambda r: (np.repeat([[0.0], [1.0]], N // 2, axis=0), r.normal(size=(N, 1))),
    "one spike": lambda r: (np.eye(N, 1, -N // 2), r.normal(size=(N, 1))),
    "alternating": lambda _: (np.resize([1.0, -1.0], (N, 1)), np.resize([-1.0, 1.0], (N, 1))),
    "pure noise": lambda r: (r.normal(size=(N, 1)), r.normal(size=(N, 1))),
    "huge": lambda r: (1e150 * r.normal(size=(N, 1)), 1e150 * r.normal(size=(N, 1))),
    "tiny": lambda r: (1e-150 * r.normal(size=(N, 1)), 1e-150 * r.normal(size=(N, 1))),
    "huge offset": lambda r: (1e12 + r.normal(size=(N, 1)), 1e12 + r.normal(size=(N, 1))),
    "two levels": lambda r: (_two_levels(r), _two_levels(r)),
    "NaN": lambda r: (_with_one(r, np.nan), r.normal(size=(N, 1))),
    "infinity": lambda r: (r.normal(size=(N, 1)), _with_one(r, np.inf)),
}


def estimators() -> dict[str, Any]:
    """The structures of a run, each with settings that keep a fit short."""
    from flysid.model.arx import ARX
    from flysid.model.line import Line
    from flysid.model.static_ts import StaticTS
    from flysid.model.ts import TS

    return {
        "line": Line(),
        "arx": ARX(na=2, nb=2, nk=1),
        "static_ts": StaticTS(rules=3),
        "ts": TS(rules=2, na=2, nb=2, nk=1, iterations=5),
    }


def hopeless_data(goes_on: GoesOn = always, shapes: int = len(SHAPES)) -> Outcome:
    """Data that cannot answer: a named diagnosis, or plain numbers; never a claim where nothing varies."""
    outcome = Outcome("hopeless data")
    silent = ("constant output", "all zero", "single sample", "two samples", "ten samples")
    for what, make in list(SHAPES.items())[:shapes]:
        for label, estimator in estimators().items():
            if not goes_on():
                return outcome
            with outcome.trial():
                verdict = _verdict_on(make, estimator)
            outcome.raised += verdict.startswith("diagnosis")
            good = verdict.startswith(("diagnosis", *Verdict))
            if not good or (what in silent and verdict in (Verdict.BETTER, Verdict.WORSE)):
                outcome.failures.append(f"{what}, {label}: {verdict}")
    return outcome


def _verdict_on(make: Callable[[np.random.Generator], tuple[FloatArray, FloatArray]], estimator: Any) -> str:
    """The verdict of a model against itself with noise, or the diagnosis in its place."""
    rng = np.random.default_rng(7)
    try:
        with np.errstate(all="ignore"):
            sets = []
            for _ in range(2):
                (u, y), (u2, y2) = make(rng), make(rng)
                sets.append(Dataset.from_arrays([u, u2], [y, y2], 0.02))
            model = estimator.fit(sets[0])
            other = estimators()["line"].fit(sets[0])
            comparison = compare({"arx": other, "ts": model}, sets[1])
        text = json.dumps(to_json({"x": comparison}), allow_nan=False)
    except (DataError, FitError) as error:
        return f"diagnosis: {error.message}" if len(error.message) > 10 else f"no words: {error.message!r}"
    except Exception as error:  # noqa: BLE001 - the campaign counts it
        return f"raised {type(error).__name__}: {error}"
    entries = json.loads(text)["channels"].values()
    found = [str(entry["free_run"]["verdict"]) for entry in entries]
    return found[0] if all(v in set(Verdict) for v in found) else f"no verdict: {found}"


# ------------------------------------------------------------------- row 17: unstable, far outside, silent


def wild_models(count: int, goes_on: GoesOn = always, seed: int = 0) -> Outcome:
    """Released models made unstable or fed far outside their range: divergence is said, all is finite."""
    outcome = Outcome("wild models")
    rng = np.random.default_rng(seed)
    pick = random.Random(seed)
    bases = [p for version in released() for p in sorted((version / "models").glob("*.json"))]
    diverged = 0
    while outcome.trials < count and goes_on():
        path = pick.choice(bases)
        with outcome.trial(), np.errstate(all="ignore"):
            try:
                why, said = _try_wild(json.loads(path.read_text()), rng)
            except FlysidError as error:
                outcome.raised += 1
                why = "" if error.message else "an error without words"
                said = False
            except Exception as error:  # noqa: BLE001 - the campaign counts it
                why = f"raised {type(error).__name__}: {error}"
                said = False
        diverged += said
        if why:
            outcome.failures.append(f"{path.stem}: {why}")
    outcome.remark = f"{diverged} said to have diverged"
    return outcome


def _try_wild(document: dict[str, Any], rng: np.random.Generator) -> tuple[str, bool]:
    """(what went wrong or "", whether divergence was announced)."""
    from flysid.model.mean import Mean
    from flysid.model.structures import all_structures

    _scale_dynamics(document, float(rng.choice([1.0, 1.2, 2.0, 10.0])))
    model = all_structures()[document["structure"]].from_dict(document)
    reach = float(rng.choice([1.0, 100.0, 1e6]))
    n = 300 + model.n_init
    u = reach * rng.normal(size=(n, len(model.inputs)))
    y = reach * rng.normal(size=(n, len(model.outputs)))
    free = model.simulate(u, y[: model.n_init])[model.n_init :]
    fire = model.firing(u, y)
    low, high = model.output_limits
    if not np.isfinite(free).all() or not np.isfinite(model.predict(u, y)[model.n_init :]).all():
        return "not finite", False
    if (free < low - 1e-9 * abs(low)).any() or (free > high + 1e-9 * abs(high)).any():
        return "beyond its limits", False
    if not np.isfinite(fire).all() or not np.allclose(fire.sum(axis=1), 1.0):
        return "firing does not add up to 1", False
    data = Dataset(model.dt_s, model.inputs, model.outputs, (Segment(u, y),))
    found = compare({"arx": Mean().fit(data), "ts": model}, data)
    json.dumps(to_json({"x": found}), allow_nan=False)
    said = any(found.entry(output=s.name).models["ts"].diverged for s in model.outputs)
    touches = bool(((free[100:] <= low) | (free[100:] >= high)).any())
    return ("divergence is not said" if touches and not said else ""), said


def _scale_dynamics(document: dict[str, Any], gain: float) -> None:
    """Multiply the coefficients that past outputs have in the next one."""
    for spot in list(_spots(document, ())):
        inner: Any = document
        for key in spot[:-1]:
            inner = inner[key]
        is_lagged = (spot[0] == "a" and len(spot) > 1 and spot[1] != 0) or "theta" in spot
        if is_lagged and isinstance(inner[spot[-1]], float):
            inner[spot[-1]] *= gain


# ------------------------------------------------------------------------------------------- row 19: leaks


def leaks(count: int, goes_on: GoesOn = always, seed: int = 0) -> Outcome:
    """A copy of one flight under another name: found by content, refused or kept on one side."""
    from flysid.split import plan_split

    outcome = Outcome("copied flights")
    rng = np.random.default_rng(seed)
    while outcome.trials < count and goes_on():
        flights = []
        for k in range(4):
            u = np.cumsum(rng.normal(size=(1500, 1)), axis=0)
            flights.append(Segment(u, np.cumsum(u, axis=0), t0_ns=0, flight=f"f{k}"))
        source = int(rng.integers(4))
        cut = int(rng.integers(0, 700))
        twin = replace(flights[source].slice(cut, 1500, 0.02), flight="copy", t0_ns=int(rng.integers(10**12)))
        base = Dataset.from_arrays([f.u for f in flights], [f.y for f in flights], 0.02)
        data = replace(base, segments=(*flights, twin))
        with outcome.trial():
            try:
                split = plan_split(data, holdout=0.3, by="flight", seed=int(rng.integers(1000)))
            except DataError as error:
                outcome.raised += 1
                if "copy" not in str(error) and "same" not in str(error):
                    outcome.failures.append(f"refused without the reason: {error}")
                continue
            train, test = split.apply(data)
            sides = [{s.flight for s in part.segments} for part in (train, test)]
            if any({"copy", f"f{source}"} & side and not {"copy", f"f{source}"} <= side for side in sides):
                outcome.failures.append(f"a copy of f{source} is on both sides: {sides}")
    return outcome
