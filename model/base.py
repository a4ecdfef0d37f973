"""The protocol of models and its laws.

An estimator is a frozen dataclass that stores its settings; `fit(train, validation=None)` returns a
fitted model, a new immutable value. `validation` serves choices (orders, rules, stopping); where it is
None, the estimator holds out blocks of `train` itself. Neither ever sees held-out test data.

Laws that every fitted model keeps (tests/model/test_model_contract.py tries them on all structures):

1. `predict` and `simulate` are pure and their results are always finite where defined.
2. Causality: row i of `predict(u, y, k)` depends on u[:i+1] and y[:i-k+1] only; row i of `simulate` on
   u[:i+1] and the first `n_init` rows of y only.
3. `simulate(u, y0)[:n_init] == y0`, and `predict(u, y, k)[: n_init + k - 1]` is NaN, nothing else is.
4. `simulate` never leaves `output_limits`: it saturates there, and whoever compares counts that as
   divergence (`diverged_s`).
5. `from_dict(to_dict())` predicts and simulates bit for bit the same.
6. Scaling: fitting a u, b y instead of u, y scales the predictions with b (to rounding).

The table of structures is `flysid.model.structures`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import StoreError
from flysid.foreign import read_object
from flysid.model.structures import all_structures
from flysid.version import check_version

MODEL_FORMAT = "flysid-model"
MODEL_VERSION = 1
MAX_INIT = 1_000_000
MAX_SIGNALS = 1000


@dataclass(frozen=True)
class Rule:
    """One If-Then rule as a person reads it.

    Attributes
    ----------
    label : "R1".
    condition : "v_x(k-1) is A1 'slow' (about -0.51 +- 0.2 m/s)", or "always" for a linear model.
    conclusion : "v_x(k) = 0.97 v_x(k-1) + 0.003 theta_in(k-1) + 0.01".
    dc_gain : per output and input (n_y, n_u) steady gain; NaN where the rule integrates.
    time_constant_s : slowest time constant; inf where the rule integrates.
    pole_radius : largest pole modulus (0 for a static rule).
    support : share of training samples for which this rule is the strongest, 0 to 1.
    here : of a model of several rules, what the model does for every output at the operating point where this
        rule is the strongest, and its loudest; () where that is nowhere, or not known. `dc_gain` is the
        rule's own, which a vehicle shows only where no other rule speaks.
    push : what its constant does, in words; "" where that is little.
    """

    label: str
    condition: str
    conclusion: str
    dc_gain: FloatArray
    time_constant_s: float
    pole_radius: float
    support: float
    here: tuple[OperatingPoint, ...] = ()
    push: str = ""


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """How an output answers small lasting steps of every input about one place at which the model rests.

    Attributes
    ----------
    output : number of the output that answers.
    outputs, inputs : (n_y,), (n_u,) where all signals stand.
    gain : (n_u,) final change per unit of the input.
    gain_interval : (2, n_u) 95 %; NaN where nothing is known of it.
    reached_s : (n_u,) seconds until 63 % of the final change is reached, dead time included.
    reached_interval_s : (2, n_u) as `gain_interval`.
    dead_s : (n_u,) seconds in which nothing can follow, beyond the sample that holds the input.
    overshoot, wrong_way : (n_u,) shares of the final change.
    shares : (R,) how loudly each rule speaks here; NaN: it is of another model, and has no say.
    sample_s : what lies between two samples: a shorter time is no figure; 0 in files that do not tell.
    """

    output: int
    outputs: FloatArray
    inputs: FloatArray
    gain: FloatArray
    gain_interval: FloatArray
    reached_s: FloatArray
    reached_interval_s: FloatArray
    dead_s: FloatArray
    overshoot: FloatArray
    wrong_way: FloatArray
    shares: FloatArray
    sample_s: float = 0.0


@runtime_checkable
class Fitted(Protocol):
    """A fitted model; see the module's docstring for the laws."""

    @property
    def structure(self) -> str: ...
    @property
    def dt_s(self) -> float: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    @property
    def n_init(self) -> int:
        """Measured output samples that a simulation starts from."""
        ...

    @property
    def n_parameters(self) -> int: ...
    @property
    def output_limits(self) -> FloatArray:
        """(2, n_y) lowest and highest output that `simulate` returns."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """How choices were made (orders, rules, refinement), one sentence each, for people."""
        ...

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) prediction of each sample from outputs at least k steps old."""
        ...

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first `n_init` measured outputs y0.

        When None: from rest, with inputs and outputs at zero before the first sample.
        """
        ...

    def rules(self) -> tuple[Rule, ...]:
        """The model as rules; one rule "always" for a linear model."""
        ...

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strength of every rule along measured data; rows sum to 1."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        ...

    def save(self, path: str | Path) -> None: ...


class Estimator(Protocol):
    """Settings of a model structure; `fit` learns."""

    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted: ...


def write_document(document: Mapping[str, Any], path: str | Path) -> None:
    """Write a model's JSON so that it appears whole: temporary file, fsync, rename.

    Raises
    ------
    StoreError : the folder is not there or not writable.
    """
    path = Path(path)
    scratch = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with scratch.open("w", encoding="utf-8") as stream:
            json.dump(document, stream, allow_nan=False, indent=1)
            stream.write("\n")
            stream.flush()
            os.fsync(stream.fileno())
        scratch.replace(path)
    except OSError as error:
        scratch.unlink(missing_ok=True)
        raise StoreError(f"cannot be written: {error.strerror}", path=path) from error


def load(path: str | Path) -> Fitted:
    """Read a model that `save` wrote, and try it: model files may come from others.

    Raises
    ------
    StoreError : not a model file, damaged, hostile, or of a newer version.

    Examples
    --------
    >>> model = flysid.ARX(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.save("arx.json")
    >>> flysid.load("arx.json").structure
    'arx'
    """
    path = Path(path)
    document = read_object(path, "a flysid model", "give a file that save() wrote")
    if document.get("format") != MODEL_FORMAT:
        raise StoreError("not a flysid model", path=path, hint="give a file that save() wrote")
    check_version(document.get("version"), MODEL_VERSION, "model file", path)
    structure = all_structures().get(str(document.get("structure")))
    if structure is None:
        raise StoreError(
            f"unknown model structure {document.get('structure')!r}",
            path=path,
            hint="upgrade flysid, or install the package that adds this structure",
        )
    try:
        model: Fitted = structure.from_dict(document)
        try_out(model)
    except StoreError as error:
        raise StoreError(error.message, hint=error.hint or "fit again", path=path) from error
    except Exception as error:  # whatever a forged file breaks is the file's fault
        raise StoreError(f"damaged model file: {_fault(error)}"[:300], path=path, hint="fit again") from error
    return model


def _fault(error: Exception) -> str:
    """What is wrong with a document that a model could not be made of, without Python's own words."""
    if isinstance(error, KeyError):
        return f"it has no {error}"
    return str(error) if isinstance(error, ValueError) else "a value is not of the type that it should be"


def try_out(model: Fitted, *, samples: int = 100) -> None:
    """Simulate and predict a few samples in the middle of the model's range, and have it say what it is.

    Raises
    ------
    ValueError : the shapes or the numbers are not a model's. Whatever the model raises comes through.
    """
    n_u = len(model.inputs)
    n_y = len(model.outputs)
    start = model.n_init
    if not isinstance(start, int) or not 0 <= start <= MAX_INIT or not 0 < n_y <= MAX_SIGNALS >= n_u:
        raise ValueError(f"{start!r} samples to start from, {n_u} inputs, {n_y} outputs")
    if not (isinstance(model.dt_s, float) and model.dt_s > 0.0):
        raise ValueError(f"a sample time of {model.dt_s!r} s")
    limits = np.asarray(model.output_limits, dtype=np.float64)
    if limits.shape != (2, n_y):
        raise ValueError(f"output limits of shape {limits.shape}")
    n = start + samples
    u = np.cos(np.arange(n * n_u, dtype=np.float64)).reshape(n, n_u)
    y = np.tile(limits.mean(axis=0), (n, 1)) + np.sin(np.arange(n, dtype=np.float64))[:, None]
    with np.errstate(all="ignore"):
        free = model.simulate(u, y[:start])
        ahead = model.predict(u, y)
    for name, values in (("free run", free), ("prediction", ahead[start:])):
        if values.shape[1:] != (n_y,) or not np.isfinite(values).all():
            raise ValueError(f"its {name} is not finite")
    with np.errstate(all="ignore"):
        if not (model.rules() and str(model)) or not all(isinstance(note, str) for note in model.notes):
            raise ValueError("no rules")
