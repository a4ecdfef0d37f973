"""A program run in Python, in the order of operations and the precision of the exported code."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.export.program import Program
from flysid.model.arguments import as_columns

SHAPES = ("gaussian", "triangle", "trapezoid")
OPERATIONS = ("change", "magnitude", "sign", "product", "held")
_CONSTANTS = (0.0, 0.5, 1.0, 1.5, 2.0, -40.0, -1e30)


class _Tables(NamedTuple):
    """The numbers of a program as compiled code takes them, all floats of one precision."""

    at: npt.NDArray[np.int64]
    working: npt.NDArray[np.int64]
    ranges: npt.NDArray[Any]
    z_at: npt.NDArray[np.int64]
    z_minus: npt.NDArray[np.int64]
    newest: npt.NDArray[np.int64]
    depths: npt.NDArray[np.int64]
    theta: npt.NDArray[Any]
    centre: npt.NDArray[Any]
    left: npt.NDArray[Any]
    right: npt.NDArray[Any]
    low: npt.NDArray[Any]
    high: npt.NDArray[Any]
    limits: npt.NDArray[Any]
    shift: npt.NDArray[Any]
    scale: npt.NDArray[Any]
    output_limits: npt.NDArray[Any]
    constants: npt.NDArray[Any]


def run(
    program: Program, u: FloatArray, memory: FloatArray | None = None, *, single: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Outputs (N, n_y) along inputs u (N, n_u), and the memory (physical units) after the last row.

    Parameters
    ----------
    memory : where to start; from rest when None.
    single : in float32, as an export with float32 does.

    Raises
    ------
    UsageError : the shape of u does not fit the program.
    """
    kind = np.float32 if single else np.float64
    u = as_columns(u, len(program.inputs), "u").astype(kind)
    cells = (program.start if memory is None else program.started(memory)).astype(kind)
    y = np.empty((len(u), len(program.outputs)), dtype=kind)
    m = program.memberships
    shape = 0 if m is None else SHAPES.index(m.shape)
    least = m is not None and m.conjunction == "minimum"
    _run(u, y, cells, _tables(program, kind), shape, least)
    return y.astype(np.float64), program.remembered(cells.astype(np.float64))


def _tables(program: Program, kind: type) -> _Tables:
    lags = program.lags
    m = program.memberships
    none: npt.NDArray[Any] = np.zeros((1, 0), dtype=kind)

    def numbers(values: FloatArray) -> npt.NDArray[Any]:
        return np.ascontiguousarray(values, dtype=kind)

    def places(columns: npt.NDArray[np.int64], delays: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        found = [
            -1 if lag < 0 else program.cell(int(c), int(lag)) for c, lag in zip(columns, delays, strict=True)
        ]
        return np.array(found, dtype=np.int64)

    return _Tables(
        program.regressors,
        np.array([(OPERATIONS.index(w[0]), *w[1:4]) for w in program.working], np.int64).reshape(-1, 4),
        numbers(np.array([w[4:] for w in program.working]).reshape(-1, 2)),
        places(lags.z_column, lags.z_lag),
        places(lags.z_column, lags.z_minus),
        np.array(program.newest, dtype=np.int64),
        np.array(program.depths, dtype=np.int64),
        numbers(program.theta),
        none if m is None else numbers(m.centre),
        none if m is None else numbers(m.left),
        none if m is None else numbers(m.right),
        none[0] if m is None else numbers(m.low),
        none[0] if m is None else numbers(m.high),
        numbers(program.limits),
        numbers(program.shift),
        numbers(program.scale),
        numbers(program.output_limits),
        np.array(_CONSTANTS, dtype=kind),
    )


@njit(cache=True, error_model="numpy")
def _limit(value, low, high):  # type: ignore[no-untyped-def]
    if not value > low:
        return low
    return min(value, high)


@njit(cache=True, error_model="numpy")
def _run(u, y, v, t, shape, least):  # type: ignore[no-untyped-def]
    n_rules, n, n_x = t.theta.shape
    n_z = t.low.size
    n_u = u.shape[1]
    n_y = y.shape[1]
    zero = t.constants[0]
    half = t.constants[1]
    one = t.constants[2]
    trapezoid = t.constants[3]
    two = t.constants[4]
    least_gap = t.constants[5]
    bottom = t.constants[6]
    phi = np.empty(n_rules, v.dtype)
    after = np.empty(n, v.dtype)
    z = np.empty_like(t.low)
    for k in range(u.shape[0]):
        for j in range(n_u):
            v[t.newest[n + j]] = (u[k, j] - t.shift[n + j]) / t.scale[n + j]
        for w in range(t.working.shape[0]):
            operation, to, a, b = t.working[w]
            if operation == 0:
                v[to] = v[a] - v[b]
            elif operation == 1:
                v[to] = abs(v[a])
            elif operation == 2:
                v[to] = one if v[a] > zero else (-one if v[a] < zero else zero)
            elif operation == 3:
                v[to] = v[a] * v[b]
            else:
                v[to] = _limit(v[a], t.ranges[w, 0], t.ranges[w, 1])
        for j in range(n_z):
            value = v[t.z_at[j]]
            if t.z_minus[j] >= 0:
                value -= v[t.z_minus[j]]
            z[j] = _limit(value, t.low[j], t.high[j])
        top = bottom
        total = zero
        for r in range(n_rules):
            grade = zero if shape == 0 else one
            for j in range(n_z):
                gap = z[j] - t.centre[r, j]
                d = gap / (t.left[r, j] if gap < zero else t.right[r, j])
                if shape == 0:
                    own = -(half * d * d)
                    grade = min(grade, own) if least else grade + own
                else:
                    reach = abs(d)
                    own = one - reach / two if shape == 1 else (two - reach) / trapezoid
                    own = _limit(own, zero, one)
                    grade = min(grade, own) if least else grade * own
            phi[r] = grade
            top = max(top, grade)
        if shape == 0:
            for r in range(n_rules):
                gap = phi[r] - top
                phi[r] = math.exp(gap) if gap > least_gap else zero
        elif not top > zero:  # no rule fires: the nearest speaks
            nearest = 0
            closest = -one
            for r in range(n_rules):
                far = zero
                for j in range(n_z):
                    gap = z[j] - t.centre[r, j]
                    d = gap / (t.left[r, j] if gap < zero else t.right[r, j])
                    far += d * d
                if closest < zero or far < closest:
                    nearest = r
                    closest = far
            phi[nearest] = one
        for r in range(n_rules):
            total += phi[r]
        for i in range(n):
            value = zero
            for r in range(n_rules):
                part = zero
                for m in range(n_x):
                    part += t.theta[r, i, m] * v[t.at[m]]
                value += part if n_rules == 1 else (phi[r] / total) * part
            after[i] = _limit(value, t.limits[0, i], t.limits[1, i])
        for i in range(n_y):
            value = after[i] * t.scale[i] + t.shift[i]
            y[k, i] = _limit(value, t.output_limits[0, i], t.output_limits[1, i])
        for c in range(n + n_u):
            first = t.newest[c]
            last = first + t.depths[c] - (c < n)
            for at in range(last, first, -1):
                v[at] = v[at - 1]
            if c < n and t.depths[c] > 0:
                v[first] = after[c]
