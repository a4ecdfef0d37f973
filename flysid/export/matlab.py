"""MATLAB and Octave text of a model: a plain simulation, and objects of the System Identification Toolbox."""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.export.csource import identifier, rendered
from flysid.export.fis import fis_text, why_no_fis
from flysid.export.program import Program
from flysid.model.base import Fitted
from flysid.model.capabilities import DeviationEquation, DeviationStates, HasTransferFunctions


def matlab_files(model: Fitted, program: Program, name: str) -> dict[str, str]:
    """File name -> text: `NAME_simulate.m`; `NAME_model.m` of a linear model; `NAME.fis` of static rules."""
    theta = program.theta
    m = program.memberships
    words: dict[str, Any] = {"m": literal, "theta_all": list(theta)}
    if m is not None:
        words["right"] = m.right
    files = {f"{name}_simulate.m": rendered("simulate.m.j2", program, name, words)}
    if not why_no_fis(program):
        files[f"{name}.fis"] = fis_text(program, name)
    text = _object(model)
    if text:
        files[f"{name}_model.m"] = _function(model, name, text)
    return files


def literal(values: Any) -> str:
    """A row or a matrix, digit by digit."""
    array = np.asarray(values)
    if array.ndim == 2:
        return "[" + "; ".join(", ".join(repr(float(v)) for v in row) for row in array) + "]"
    return "[" + ", ".join(repr(float(v)) for v in array.ravel()) + "]"


def _object(model: Fitted) -> str:
    """The right side of `sys = `; "" for models that the toolbox has no object for."""
    if isinstance(model, HasTransferFunctions):
        rows = [[model.transfer(i, j) for j in range(len(model.inputs))] for i in range(len(model.outputs))]
        tops = _cells([[literal(t.numerator) for t in row] for row in rows])
        bottoms = _cells([[literal(t.denominator) for t in row] for row in rows])
        dead = literal([[t.dead_time_s for t in row] for row in rows])
        return f"idtf({tops}, {bottoms}, 'IODelay', {dead})"
    if isinstance(model, DeviationStates):
        s = model.realisation
        delays = literal(np.array(model.delays or (0,) * len(model.inputs))[None])
        parts = ", ".join(literal(part) for part in (s.a, s.b, s.c, s.d, s.k))
        return f"idss({parts}, 'Ts', {model.dt_s!r}, 'InputDelay', {delays}')"
    if isinstance(model, DeviationEquation):
        return _polynomials(model)
    return ""


def _polynomials(model: DeviationEquation) -> str:
    """idpoly: with 1 / A of the noise where the model has it (ARX), else as an output-error model."""
    a = model.system.a
    b = model.system.b
    n_y, n_u = b.shape[1:]
    inputs = [[literal(b[:, i, j]) for j in range(n_u)] for i in range(n_y)]
    own = [[literal(a[:, i, j]) for j in range(n_y)] for i in range(n_y)]
    if model.noise is None or not model.system.is_diagonal:
        return f"idpoly({_cells(own)}, {_cells(inputs)}, [], [], [], [], {model.dt_s!r})"
    poles = [[literal(a[:, i, i])] * n_u for i in range(n_y)]
    return f"idpoly([], {_cells(inputs)}, [], [], {_cells(poles)}, [], {model.dt_s!r})"


def _cells(rows: list[list[str]]) -> str:
    if len(rows) == len(rows[0]) == 1:
        return rows[0][0]
    return "{" + "; ".join(", ".join(row) for row in rows) + "}"


def _function(model: Fitted, name: str, text: str) -> str:
    names = {
        key: "{" + ", ".join("'" + _quote(s.name) + "'" for s in signals) + "}"
        for key, signals in (("InputName", model.inputs), ("OutputName", model.outputs))
    }
    u0, y0, drift = _offsets(model)
    return f"""function [sys, u0, y0, c] = {name}_model ()
% The linear model as an object of the System Identification Toolbox. It describes deviations:
% y - y0 follows u - u0, and the equation has the constant c beside it:
% A(q) (y - y0) = B(q) (u - u0) + c, or C x + D (u - u0) + c in state space.
% {identifier(name)}_simulate.m has all of that in it and needs no toolbox.
  sys = {text};
  sys.InputName = {names["InputName"]};
  sys.OutputName = {names["OutputName"]};
  u0 = {literal(u0)};
  y0 = {literal(y0)};
  c = {literal(drift)};
end
"""


def _quote(text: str) -> str:
    return "".join(ch if ch.isprintable() else "_" for ch in text).replace("'", "''")


def _offsets(model: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    constant = model.realisation.level if isinstance(model, DeviationStates) else model.system.c
    return model.u_origin, model.y_origin, constant
