"""Last gates: a model that fails on its own training data is not delivered.

Searches judge candidates by measures of their own: an error one step ahead, a validation part, a few rows of
a long record. The last word has the free run over all of the training data, started as `flysid.compare`
starts it. There a model is finite, errs no more than the first value held, and no more than the linear model
beside it, which knows the same data. A map without memory (a line, a static TS model) claims nothing about
time, and is compared with the first value alone.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.base import Fitted
from flysid.model.polynomials import VANISHING
from flysid.model.selection import LOST, MARGIN, FreeRunning, free_run_errors
from flysid.showing import significant

HELD = "the first value held"
LINEAR_ENOUGH = "A linear model is enough: "
"""How the notes of a linear model begin that a search for more gave up for."""
M = TypeVar("M", bound=Fitted)
P = ParamSpec("P")


@dataclass(frozen=True)
class HeldValue:
    """The first outputs, as a window of measured samples estimates them, for ever."""

    dt_s: float
    n_y: int
    n_init: int = 1

    @property
    def output_limits(self) -> FloatArray:
        """None."""
        return np.outer([-np.inf, np.inf], np.ones(self.n_y))

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """(N, n_y) the last of y0, N times."""
        return np.tile(y0[-1], (len(u), 1))


def shortfall(
    model: FreeRunning, beside: Mapping[str, FreeRunning], train: Dataset, margin: float = MARGIN
) -> str:
    """Why the free run over the training data does not stand beside others; "" where it does.

    `beside`: name for people -> a model that knows the same data. The first value held is one of them.
    `margin`: relative difference of errors that is granted.

    >>> from flysid.model.last_gates import shortfall
    >>> model = flysid.ARX(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> shortfall(model, {"a line": flysid.Line().fit(train)}, train)
    ''
    """
    others = {HELD: HeldValue(train.dt_s, len(train.outputs))} | (dict(beside) if model.n_init else {})
    try:
        errors = free_run_errors({"": model, **others}, train)
    except DataError:  # no segment is long enough: nothing was shown
        return ""
    own = float(np.sqrt(errors[""].mean()))
    if own >= LOST / len(errors[""]):
        return "free run over its training data is not finite"
    nearest = min(others, key=lambda name: float(errors[name].mean()))
    best = float(np.sqrt(errors[nearest].mean()))
    if own <= max((1.0 + margin) * best, np.sqrt(VANISHING)):
        return ""
    return (
        f"free run over its training data errs {significant(own / best)} times as much as {nearest}: "
        f"{significant(own)} against {significant(best)} standard deviations of the output"
    )


def refuse(model: M, beside: Mapping[str, FreeRunning], train: Dataset, margin: float = MARGIN) -> M:
    """The model itself; raises FitError where it falls short of others, as of `shortfall`."""
    why = shortfall(model, beside, train, margin)
    if not why:
        return model
    hint = "plot inputs and outputs: do the inputs move this output?" if f" {HELD}: " in why else ""
    raise FitError(f"the {model.structure} model's {why}", hint=hint)


def no_worse_than_held(fit: Callable[P, M]) -> Callable[P, M]:
    """`fit` of an estimator, whose model follows its training data at least as the first value held does.

    Data on disk are not gone through again.
    """
    at = list(inspect.signature(fit).parameters).index("train")

    @functools.wraps(fit)
    def gated(*args: P.args, **kwargs: P.kwargs) -> M:
        model = fit(*args, **kwargs)
        train = kwargs["train"] if "train" in kwargs else args[at]
        return refuse(model, {}, train) if isinstance(train, Dataset) else model

    return gated
