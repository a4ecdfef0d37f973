"""C99 of a program: header, code, self-test, CMake, README. No allocation, no stdio, fixed memory."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

import jinja2
import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.escaping import markdown
from flysid.export.program import Program
from flysid.export.reference import run
from flysid.export.wording import name_with_unit, states_with_units
from flysid.version import __version__


def identifier(text: str, *, longest: int = 20) -> str:
    """A beginning of names that C, Modelica and MATLAB take, made of a channel's name.

    `longest`: C99 tells names apart by their first 31 characters.
    """
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:longest].strip("_")
    return name if name[:1].isalpha() else f"model_{name}".rstrip("_")


def c_files(program: Program, name: str, single: float | None = None) -> dict[str, str]:
    """File name -> text.

    `name`: of the functions and files, as `identifier` makes it.
    `single`: write float32; how far it strays from double, as a share of the free run's RMSE
        (`flysid.export.single`). None writes double.
    """
    values = _values(program, name, single) | _check(program, single)
    names = {
        f"{name}.h": "model.h.j2",
        f"{name}.c": "model.c.j2",
        "check.c": "check.c.j2",
        "CMakeLists.txt": "CMakeLists.txt.j2",
        "README.md": "README.md.j2",
    }
    environment = _environment(single is not None)
    return {file: environment.get_template(template).render(values) for file, template in names.items()}


def rendered(template: str, program: Program, name: str, words: Mapping[str, Any]) -> str:
    """A template of other code around the C of a program in double."""
    return render({**values_of(program, name), **words}, template)


def render(values: Mapping[str, Any], template: str) -> str:
    """A template of code in double with these values."""
    return _environment(False).get_template(template).render(values)


def values_of(program: Program, name: str) -> dict[str, Any]:
    """What templates name of the C of a program in double."""
    return _values(program, name, None)


def _values(program: Program, name: str, single: float | None) -> dict[str, Any]:
    m = program.memberships
    n = program.n
    n_y = len(program.outputs)
    columns = range(len(program.signals))
    deep = [c for c in columns if program.depths[c] > (1 if c < n else 0)]
    fed = [c for c in range(n) if program.depths[c]]
    real = "double" if single is None else "float"
    least = min((lag for c, lag in program.asked() if c >= n), default=1)
    theta = program.theta if len(program.theta) > 1 else program.theta[0]
    memory = program.memory
    at = [c for c, _ in memory]
    none: Mapping[str, Any] = {"rules": 1, "shape": ""}
    return {
        "name": name,
        "NAME": name.upper(),
        "title": program.title,
        "made": f"Written by flysid {__version__}.",
        "dt": f"{program.dt_s:.9g}",
        "rate": f"{1.0 / program.dt_s:.6g}",
        "real": real,
        "exp": "exp" if single is None else "expf",
        "zero": _number("0.0", single is not None),
        "one": _number("1.0", single is not None),
        "zeros": ", ".join([_number("0.0", single is not None)] * len(program.inputs)),
        "single": None if single is None else f"{100.0 * single:.2g} % of the free run's RMSE",
        "inputs": [name_with_unit(s) for s in program.inputs],
        "outputs": [
            {"name": name_with_unit(s), "low": f"{low:.6g}", "high": f"{high:.6g}"}
            for s, low, high in zip(program.outputs, *program.output_limits, strict=True)
        ],
        "through": least == 0,
        "least": least,
        "balanced": m is None and n > n_y,
        "memory": states_with_units(program),
        "memory_at": [program.cell(c, lag) for c, lag in memory],
        "memory_shift": program.shift[at],
        "memory_scale": program.scale[at],
        "cells": program.cells,
        "bytes": (program.cells + n) * (8 if single is None else 4),
        "n": n,
        "start": program.start,
        "inputs_at": program.newest[n:],
        "u_shift": program.shift[n:],
        "u_scale": program.scale[n:],
        "y_shift": program.shift[:n_y],
        "y_scale": program.scale[:n_y],
        "y_low": program.output_limits[0],
        "y_high": program.output_limits[1],
        "x_at": program.regressors,
        "working": program.working,
        "theta": theta,
        "limits_low": program.limits[0],
        "limits_high": program.limits[1],
        "deep": deep,
        "deep_newest": [program.newest[c] for c in deep],
        "deep_oldest": [program.newest[c] + program.depths[c] - (c < n) for c in deep],
        "fed": fed,
        "fed_at": [program.newest[c] for c in fed],
        **(none if m is None else _fuzzy(program)),
    }


def _fuzzy(program: Program) -> dict[str, Any]:
    m = program.memberships
    lags = program.lags
    assert m is not None
    minus = _cells(program, lags.z_column, np.maximum(lags.z_minus, 0)) * (lags.z_minus >= 0)
    return {
        "rules": len(m.centre),
        "shape": m.shape,
        "conjunction": m.conjunction,
        "two_sided": m.two_sided,
        "z_at": _cells(program, lags.z_column, lags.z_lag),
        "z_minus": minus,
        "z_minus_any": bool(minus.any()),
        "low": m.low,
        "high": m.high,
        "centre": m.centre,
        "width": m.left,
        "right": m.right,
    }


def _cells(program: Program, columns: Any, delays: Any) -> Any:
    found = [program.cell(int(c), int(lag)) for c, lag in zip(columns, delays, strict=True)]
    return np.array(found, dtype=np.int64)


# -- the self-test ---------------------------------------------------------------------------------------


def excitation(program: Program, steps: int) -> FloatArray:
    """(steps, n_u) levels held for 8 samples about the inputs' mean, always the same.

    Two standard deviations wide where the model knows them, less where outputs would stop at their limits.
    """
    n = program.n
    draws = np.random.default_rng(0).uniform(-2.0, 2.0, (-(-steps // 8), len(program.inputs)))
    held = np.repeat(draws, 8, axis=0)[:steps] * program.scale[n:]
    for size in 2.0 ** -np.arange(60):
        u = program.shift[n:] + size * held
        y = run(program, u)[0]
        if ((y > program.output_limits[0]) & (y < program.output_limits[1])).all():
            return np.asarray(u)
    return np.asarray(program.shift[n:] + held)


def _check(program: Program, single: float | None, *, steps: int = 200) -> dict[str, Any]:
    """Inputs, outputs from rest and from a memory, and by how much a right build may differ.

    Another mathematics library rounds exp otherwise: 1e-9 of the outputs' size in double; in float32 ten
    times what is lost here, beside 1e-5 of their size.
    """
    u = excitation(program, steps)
    y, memory = run(program, u)
    y_from, _ = run(program, u, memory)
    tolerance = 1e-9 * (np.ptp(y, axis=0) + np.abs(y).max(axis=0)) + 1e-12
    if single is not None:
        lost = np.abs(run(program, u, single=True)[0] - y).max(axis=0)
        tolerance = 10.0 * lost + 1e4 * tolerance
    return {"u": u, "y": y, "x": memory, "y_from": y_from, "tolerance": tolerance}


# -- text ------------------------------------------------------------------------------------------------


@cache
def _environment(single: bool) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("flysid.export"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # C is no HTML
    )
    environment.filters["number"] = lambda text: _number(text, single)
    environment.filters["markdown"] = markdown
    environment.globals["table"] = lambda kind, name, values: _table(kind, name, values)
    return environment


def _table(kind: str, name: str, values: Any) -> str:
    """A constant table of any number of dimensions."""
    values = np.asarray(values)
    sizes = "".join(f"[{size}]" for size in values.shape)
    return f"static const {kind} {name}{sizes} = {_braces(values, kind)};"


def _braces(values: Any, kind: str) -> str:
    if values.ndim == 1:
        return "{" + ", ".join(_literal(v, kind) for v in values) + "}"
    inner = ",\n        ".join(_braces(v, kind) for v in values)
    return f"{{\n        {inner}\n    }}"


def _literal(value: Any, kind: str) -> str:
    if kind == "uint16_t":
        if not 0 <= int(value) < 65536:
            raise UsageError("the model has too many lags to be exported", hint="fit a lower order")
        return f"{int(value)}U"
    if kind == "float":
        return _number(str(np.float32(value)), True)
    return _number(repr(float(value)), False)


def _number(text: str, single: bool) -> str:
    if not any(c in text for c in ".en"):
        text += ".0"
    return f"{text}f" if single else text
