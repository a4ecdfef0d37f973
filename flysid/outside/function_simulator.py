"""A Python function as a simulator.

    def simulate(u, dt_s, start):
        '''u (N, n_u) inputs, start (n,) what the run starts from -> (N, n_y) outputs.'''

    simulate.start = [0.0, 0.0]            # its size; without it: the outputs at the first sample
    simulate.inputs = {"theta_in": "deg"}  # names and units; without them: those of the data, in their order
    simulate.outputs = {"v_x": "m/s"}
    simulate.dt_s = 0.02                   # where it runs at one sample time only

It is imported because the user has named it, and for no other reason.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.outside.like import Like, match
from flysid.outside.simulator import Simulated, running


@dataclass(frozen=True, eq=False)
class FunctionSimulator:
    """A function that takes inputs, the sample time and a start."""

    name: str
    function: Callable[..., Any]
    dt_s: float
    start: FloatArray
    starts_at_outputs: bool
    u_order: list[int]
    y_order: list[int]

    @property
    def words(self) -> str:
        """ "the function sim:simulate"."""
        return f"the function {self.name}"

    def run(self, u: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n_y) outputs, in the order of the data.

        Raises UsageError: the function fails, or returns something else.
        """
        given = np.empty_like(u)
        given[:, self.u_order] = u
        begin = np.array(start)
        if self.starts_at_outputs:
            begin[self.y_order] = start
        with running(self.words), np.errstate(all="ignore"):
            found = np.asarray(self.function(given, self.dt_s, begin), dtype=np.float64)
        if found.ndim == 1:
            found = found[:, None]
        wanted = (len(u), len(self.y_order))
        if found.shape != wanted:
            raise UsageError(f"{self.words} returns shape {found.shape}, not {wanted}")
        return found[:, self.y_order]


def function_model(name: str, like: Like) -> Simulated:
    """Import `module:function`, from the working folder too, and try it.

    Raises UsageError: it is not there, has other signals, units or sample time, fails, looks ahead, or gives
    another answer the second time.
    """
    function = _found(name)
    dt_s = getattr(function, "dt_s", None)
    if dt_s is not None and abs(float(dt_s) - like.dt_s) > 1e-6 * like.dt_s:
        raise UsageError(f"{name} has sample time {float(dt_s):g} s, the data {like.dt_s:g} s")
    sides = []
    for side, ours in (("input", like.inputs), ("output", like.outputs)):
        stated = getattr(function, f"{side}s", None) or {}
        units = stated if isinstance(stated, dict) else dict.fromkeys(stated, "")
        if units and len(units) != len(ours):
            raise UsageError(f"{name} has {side}s {', '.join(units)}, the data {like.words}")
        sides.append(match(ours, tuple(units), tuple(units.values()), side))
    ins, outs = sides
    start = getattr(function, "start", None)
    own = FunctionSimulator(
        name=name,
        function=function,
        dt_s=like.dt_s,
        start=np.zeros(len(like.outputs)) if start is None else np.atleast_1d(np.asarray(start, float)),
        starts_at_outputs=start is None,
        u_order=ins.order,
        y_order=outs.order,
    )
    _check(own, len(like.inputs))
    return Simulated(
        dt_s=like.dt_s,
        inputs=like.inputs,
        outputs=like.outputs,
        simulator=own,
        u_factors=ins.factors,
        y_factors=outs.factors,
        notes=(f"{own.words[0].upper()}{own.words[1:]}; nothing was estimated.", *ins.notes, *outs.notes),
    )


def _found(name: str) -> Callable[..., Any]:
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # somebody else's code
        raise UsageError(
            f"{name} cannot be imported: {type(error).__name__}: {error}"[:300],
            hint=f"module:function of an installed module, or of {module.split('.')[0]}.py in this folder",
        ) from error
    finally:
        sys.path.remove(here)
    if not callable(found):
        raise UsageError(f"{name} is a {type(found).__name__}, not a function")
    return found  # type: ignore[no-any-return]


def _check(own: FunctionSimulator, n_u: int, *, samples: int = 60) -> None:
    """A simulator answers alike each time, and does not know the inputs to come.

    `samples`: samples of the first trial.
    """
    u = np.cos(np.arange(samples * n_u, dtype=np.float64)).reshape(samples, n_u)
    half = samples // 2
    whole = own.run(u, own.start)
    if not np.array_equal(whole, own.run(u, own.start), equal_nan=True):
        raise UsageError(
            f"{own.words} gives another answer the second time", hint="draw no random numbers in it"
        )
    if not np.allclose(whole[:half], own.run(u[:half], own.start), rtol=1e-6, atol=1e-9, equal_nan=True):
        raise UsageError(f"{own.words} uses inputs that are still to come", hint="filter forwards only")
