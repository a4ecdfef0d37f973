"""A stored linear system as a fitted model: whatever MATLAB and python-control call its parts.

Only the part from inputs to outputs is taken over. Noise models stay behind; predictions carry the last
known error of the free run on. A free run starts like that of flysid's own models: from the state that fits
a window of measured samples best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.base import try_out
from flysid.model.start import lags_inside_window
from flysid.model.subspace.fitted_model import FittedStateSpace, resting
from flysid.model.subspace.kalman import gains_of
from flysid.outside.like import Like, match
from flysid.outside.sampled import (
    Block,
    Matrices,
    discrete,
    from_polynomials,
    in_falling_powers,
    side_by_side,
)
from flysid.outside.stored import CLASS
from flysid.showing import counted

NAMES: Mapping[str, tuple[str, ...]] = {
    "ts": ("ts", "dt", "dt_s"),
    "num": ("num", "numerator"),
    "den": ("den", "denominator"),
    "inputname": ("inputname", "inputs", "input_labels"),
    "outputname": ("outputname", "outputs", "output_labels"),
    "inputunit": ("inputunit", "input_units"),
    "outputunit": ("outputunit", "output_units"),
    "u0": ("u0", "inputoffset"),
    "y0": ("y0", "outputoffset"),
}
"""What a field may be called."""
SECONDS: Mapping[str, float] = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "minutes": 60.0}


@dataclass(frozen=True, eq=False)
class _Parts:
    """The fields of a file by flysid's names."""

    fields: Mapping[str, Any]

    def __contains__(self, name: str) -> bool:
        return self._value(name) is not None

    def _value(self, name: str) -> Any:
        for other in NAMES.get(name, (name,)):
            value = self.fields.get(other)
            empty = value.size == 0 if isinstance(value, np.ndarray) else str(value) in ("None", "", "[]")
            if not empty:
                return value
        return None

    def text(self, name: str, default: str = "") -> str:
        value = self._value(name)
        return default if value is None else str(np.asarray(value).item())

    def words(self, name: str) -> tuple[str, ...]:
        value = self._value(name)
        if value is None:
            return ()
        return tuple(v.strip() if isinstance(v, str) else "" for v in _flat(_plain(value)))

    def numbers(self, name: str) -> FloatArray | None:
        """Finite numbers, of any shape; None where there are none."""
        value = self._value(name)
        if value is None:
            return None
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise UsageError(f"the model's {name!r} is not an array of real numbers") from error
        if not np.isfinite(array).all():
            raise UsageError(f"the model's {name!r} holds values that are not finite")
        return array

    def per_pair(self, name: str, n_y: int) -> list[list[FloatArray]] | None:
        """Polynomials by output and input; None where there are none.

        `n_y`: outputs that are expected: files do not tell a column of cells from a row of them.
        """
        value = _plain(self._value(name))
        if value is None:
            return None
        while _depth(value) < 3:
            value = [value]
        rows = [[np.asarray(_flat(cell), dtype=np.float64) for cell in row] for row in value]
        return [[cell] for cell in rows[0]] if len(rows) == 1 and len(rows[0]) == n_y > 1 else rows


def _plain(value: Any) -> Any:
    """Nested lists of numbers; a cell that holds one number is a list of one."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.ravel().tolist() if value.ndim == 2 and value.shape[0] == 1 else value.tolist()
    if not isinstance(value, np.ndarray | list | tuple):
        return value
    cells = isinstance(value, np.ndarray)
    return [[p] if (cells or isinstance(v, np.ndarray)) and _depth(p) == 0 else p for v, p in _both(value)]


def _both(values: Any) -> list[tuple[Any, Any]]:
    """Elements as they are and as plain lists."""
    return [(v, _plain(v)) for v in values]


def _depth(value: Any) -> int:
    """How many lists are around the first number."""
    return 1 + (_depth(value[0]) if value else 0) if isinstance(value, list) else 0


def _flat(value: Any) -> list[Any]:
    return [x for v in value for x in _flat(v)] if isinstance(value, list) else [value]


def linear_model(fields: Mapping[str, Any], like: Like, source: str) -> FittedStateSpace:
    """The system as a model of `like`'s signals and sample time.

    `fields`: as `stored.read_stored` gives them.
    `source`: where it came from, for people.
    Raises UsageError: no system, other signals or units, another sample time, or improper.
    """
    parts = _Parts(fields)
    step = _sample_time(parts, like.dt_s)
    matrices, delays = _system(parts, step, like)
    _, b, c, d = matrices
    if (b.shape[1], len(c)) != (len(like.inputs), len(like.outputs)):
        raise UsageError(
            f"the model has {counted(b.shape[1], 'input')} and {counted(len(c), 'output')}, "
            f"the data {like.words}",
            hint="name the channel that it is a model of: CHANNEL/LABEL=FILE",
        )
    ins = match(like.inputs, parts.words("inputname"), parts.words("inputunit"), "input")
    outs = match(like.outputs, parts.words("outputname"), parts.words("outputunit"), "output")
    late = tuple(delays[j] for j in ins.order)
    matrices = (
        matrices[0],
        b[:, ins.order] * ins.factors,
        c[outs.order] / outs.factors[:, None],
        d[np.ix_(outs.order, ins.order)] * ins.factors / outs.factors[:, None],
    )
    u0 = _offsets(parts, "u0", len(ins.order))[ins.order] / ins.factors
    y0 = (_offsets(parts, "y0", len(outs.order)) + _constant(parts, len(c)))[outs.order] / outs.factors
    notes = (f"Taken over from {source}; nothing was estimated.", *ins.notes, *outs.notes)
    return start_from(replace(_balance(matrices, like), delays=late, u_origin=u0, y_origin=y0, notes=notes))


def start_from(model: FittedStateSpace, *, diffuse: float = 1e10) -> FittedStateSpace:
    """The model with a start that is estimated from measured samples, without a belief about the state.

    As many samples as a fifth of the window that estimates the start of a free run, or as it has states.

    `diffuse`: variance of the state that a start is estimated from, in variances of the outputs' noise.
    """
    system = model.realisation
    most = lags_inside_window(model.dt_s, system.order + max(model.delays, default=0))
    n_y = len(model.outputs)
    unsure = replace(system, state=diffuse * np.eye(system.order), innovation=np.eye(n_y))
    noise = np.array([np.ones(n_y), -np.ones(n_y)])
    found = replace(model, gains=gains_of(unsure, most), noise=noise)
    try:
        try_out(found)
    except ValueError as error:
        raise UsageError(f"the model cannot be run: {error}") from error
    return found


def _balance(matrices: Matrices, like: Like) -> FittedStateSpace:
    """Rest, in coordinates of like sizes."""
    from scipy.linalg import matrix_balance

    a, b, c, d = matrices
    if len(a):
        _, (scale, _) = matrix_balance(a, permute=False, separate=True)
        a = a * scale[None, :] / scale[:, None]
        b = b / scale[:, None]
        c = c * scale[None, :]
    return resting((a, b, c, d), like.dt_s, (like.inputs, like.outputs))


def _sample_time(parts: _Parts, dt_s: float) -> float:
    """0 for a continuous system, else that of the data.

    Raises UsageError: another sample time, or none is stated.
    """
    unit = parts.text("timeunit", "seconds")
    if unit not in SECONDS:
        raise UsageError(f"times in {unit!r} are not understood", hint="set sys.TimeUnit = 'seconds'")
    if SECONDS[unit] != 1.0:
        raise UsageError(f"its times are in {unit}", hint="chgTimeUnit(sys, 'seconds')")
    stated = parts.numbers("ts")
    kind = parts.text(CLASS)
    if stated is None and kind in ("idpoly", "idss", "filt"):
        raise UsageError("no sample time is stated", hint="give it: 'Ts', in seconds")
    step = 0.0 if stated is None else float(np.asarray(stated).ravel()[0])
    if step < 0.0 or (step == 1.0 and isinstance(parts.fields.get("dt"), bool)):
        raise UsageError("no sample time is stated", hint="set Ts, in seconds; 0 for a continuous model")
    if step and abs(step - dt_s) > 1e-6 * dt_s:
        raise UsageError(
            f"the model has sample time {step:g} s, the data {dt_s:g} s",
            hint=f"resample it, in MATLAB by d2d(sys, {dt_s:g}); or give it continuous",
        )
    return step


def _system(parts: _Parts, step: float, like: Like) -> tuple[Matrices, tuple[int, ...]]:
    kind = parts.text(CLASS)
    if "num" in parts or kind in ("tf", "idtf", "filt"):
        rows = _quotients(parts, step, kind, len(like.outputs))
    elif kind == "idpoly" or "f" in parts or ("a" in parts and "c" not in parts and "b" in parts):
        rows = _of_polynomials(parts, len(like.outputs))
    elif "a" in parts and "c" in parts:
        return _states(parts, step, like)
    else:
        raise UsageError(
            "no linear system was found",
            hint="A, B, C, D of a state space, or num and den of a quotient; and Ts (or dt), 0 if continuous",
        )
    dead = _dead_times(parts, len(rows), len(rows[0]))
    blocks = [
        [Block(from_polynomials(*pair), (float(dead[i, j]),), step) for j, pair in enumerate(row)]
        for i, row in enumerate(rows)
    ]
    return side_by_side(blocks, like.dt_s)


def _quotients(parts: _Parts, step: float, kind: str, n_y: int) -> list[list[tuple[FloatArray, FloatArray]]]:
    """Numerator and denominator in falling powers, by output and input."""
    above = parts.per_pair("num", n_y)
    below = parts.per_pair("den", n_y)
    if above is None or below is None:
        raise UsageError("a transfer function has num and den")
    if len(below) == len(below[0]) == 1:
        below = [[below[0][0]] * len(above[0])] * len(above)
    if [len(r) for r in above] != [len(r) for r in below]:
        raise UsageError("num and den are of different numbers of inputs and outputs")
    variable = parts.text("variable", "z^-1" if step and kind in ("idtf", "filt") else "z")
    rising = step > 0.0 and variable in ("z^-1", "q^-1")
    return [
        [in_falling_powers(n, m) if rising else (n, m) for n, m in zip(ns, ms, strict=True)]
        for ns, ms in zip(above, below, strict=True)
    ]


def _of_polynomials(parts: _Parts, n_y: int) -> list[list[tuple[FloatArray, FloatArray]]]:
    """B / (A F) of an idpoly whose outputs do not feed each other."""
    above = parts.per_pair("b", n_y)
    if above is None:
        raise UsageError("the model has no B: no input acts")
    if parts.text("variable", "z^-1") in ("s", "p"):
        raise UsageError("a continuous idpoly", hint="save it as idtf(sys) or idss(sys)")
    own = parts.per_pair("a", n_y) or [[np.ones(1)]]
    if len(own) != len(above):
        raise UsageError(f"A is of {len(own)} outputs, B of {len(above)}")
    if any(np.any(own[i][j]) for i in range(len(own)) for j in range(len(own[i])) if i != j):
        raise UsageError("its outputs feed each other", hint="save it as idss(sys)")
    poles = parts.per_pair("f", n_y)
    rows = []
    for i, row in enumerate(above):
        below = [np.convolve(own[i][i], poles[i][j] if poles else np.ones(1)) for j in range(len(row))]
        rows.append([in_falling_powers(b, f) for b, f in zip(row, below, strict=True)])
    return rows


def _states(parts: _Parts, step: float, like: Like) -> tuple[Matrices, tuple[int, ...]]:
    a = parts.numbers("a")
    b = parts.numbers("b")
    c = parts.numbers("c")
    if a is None or b is None or c is None:
        raise UsageError("a state space has A, B and C")
    n = round(np.sqrt(a.size))
    n_y = len(c) if c.ndim == 2 and c.shape[1] == n else c.size // max(n, 1)
    n_u = b.shape[1] if b.ndim == 2 and len(b) == n else b.size // max(n, 1)
    if n * n != a.size or n * n_u != b.size or n * n_y != c.size:
        raise UsageError(f"A of shape {a.shape}, B {b.shape} and C {c.shape} do not fit each other")
    d = parts.numbers("d")
    d = np.zeros((n_y, n_u)) if d is None else d
    if d.size != n_y * n_u:
        raise UsageError(f"D has shape {d.shape}, not ({n_y}, {n_u})")
    dead = _dead_times(parts, n_y, n_u)
    if np.ptp(dead, axis=0).any():
        raise UsageError("its outputs are late by different times", hint="absorbDelay(sys), or save it as tf")
    matrices = (a.reshape(n, n), b.reshape(n, n_u), c.reshape(n_y, n), d.reshape(n_y, n_u))
    return discrete(Block(matrices, tuple(map(float, dead[0])), step), like.dt_s)


def _dead_times(parts: _Parts, n_y: int, n_u: int) -> FloatArray:
    """(n_y, n_u) seconds, or samples of a discrete system."""
    dead = np.zeros((n_y, n_u))
    shapes: Sequence[tuple[str, tuple[int, int]]] = (
        ("inputdelay", (1, n_u)),
        ("outputdelay", (n_y, 1)),
        ("iodelay", (n_y, n_u)),
    )
    for name, shape in shapes:
        value = parts.numbers(name)
        if value is None:
            continue
        if value.size not in (1, shape[0] * shape[1]):
            raise UsageError(f"{name} has shape {value.shape}")
        dead = dead + (value.reshape(shape) if value.size > 1 else value.item())
    if (dead < 0.0).any():
        raise UsageError("a dead time is negative")
    return dead


def _offsets(parts: _Parts, name: str, count: int) -> FloatArray:
    value = parts.numbers(name)
    if value is None:
        return np.zeros(count)
    if value.size != count:
        raise UsageError(f"{name} has {counted(value.size, 'number')}, not {count}")
    return value.reshape(count)


def _constant(parts: _Parts, n_y: int) -> FloatArray:
    """What the constant of flysid's own MATLAB files adds to the outputs."""
    constant = parts.numbers("constant")
    if constant is None or not constant.any():
        return np.zeros(n_y)
    if parts.text(CLASS) != "idpoly":
        return constant.reshape(n_y)
    below = [row[0][1] for row in _of_polynomials(parts, n_y)]
    sums = np.array([polynomial.sum() for polynomial in below])
    if (np.abs(sums) < 1e-12).any():
        raise UsageError("a constant enters an integrator, which rests nowhere")
    shift: FloatArray = constant.reshape(n_y) / sums
    return shift
