"""A static Takagi-Sugeno model as the Fuzzy Logic Toolbox keeps it: a Sugeno system in a .fis file.

The file has no place for three things: antecedents are held inside the range of the
training data, outputs inside theirs, and where no rule fires the nearest one speaks. Inside the ranges the
file is the model. What remembers (lags, hidden states) is no fuzzy inference system; its rules stand in
`<name>_simulate.m`.
"""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.export.program import Memberships, Program

WIDTHS = {"triangle": (2.0,), "trapezoid": (2.0, 0.5)}
"""Of a set, in widths from its centre: where it ends, and where its top begins."""


def why_no_fis(program: Program) -> str:
    """Why a .fis cannot hold the model; "" where it can."""
    if program.memberships is None:
        return "it is one rule: a linear model"
    if program.memory:
        return "it remembers past samples, which a fuzzy inference system does not"
    return ""


def fis_text(program: Program, name: str) -> str:
    """The file of a static model, in physical units, digit by digit.

    `program`: one of which `why_no_fis` says "".
    """
    m = program.memberships
    assert m is not None
    count = len(m.centre)
    n = program.n
    u_scale = program.scale[n:]
    u_shift = program.shift[n:]
    consequents = _consequents(program)
    lines = [
        "[System]",
        f"Name='{name}'",
        "Type='sugeno'",
        "Version=2.0",
        f"NumInputs={len(program.inputs)}",
        f"NumOutputs={len(program.outputs)}",
        f"NumRules={count}",
        f"AndMethod='{'min' if m.conjunction == 'minimum' else 'prod'}'",
        "OrMethod='probor'",
        "ImpMethod='prod'",
        "AggMethod='sum'",
        "DefuzzMethod='wtaver'",
        "",
    ]
    for j, signal in enumerate(program.inputs):
        ends = (float(m.low[j] * u_scale[j] + u_shift[j]), float(m.high[j] * u_scale[j] + u_shift[j]))
        lines += _head("Input", j, signal, ends, count)
        for r in range(count):
            lines.append(f"MF{r + 1}='R{r + 1}':{_set(m, r, j, u_scale[j], u_shift[j])}")
        lines.append("")
    for i, signal in enumerate(program.outputs):
        lines += _head("Output", i, signal, (program.output_limits[0, i], program.output_limits[1, i]), count)
        for r in range(count):
            lines.append(f"MF{r + 1}='R{r + 1}':'linear',{_row(consequents[r, i])}")
        lines.append("")
    lines.append("[Rules]")
    for r in range(1, count + 1):
        given = " ".join([str(r)] * len(program.inputs))
        then = " ".join([str(r)] * len(program.outputs))
        lines.append(f"{given}, {then} (1) : 1")
    return "\n".join([*lines, ""])


def _head(side: str, at: int, signal: Signal, ends: tuple[float, float], count: int) -> list[str]:
    name = "".join(c if c.isprintable() else "_" for c in signal.name).replace("'", "_")
    return [f"[{side}{at + 1}]", f"Name='{name}'", f"Range={_row(np.array(ends))}", f"NumMFs={count}"]


def _set(m: Memberships, r: int, j: int, scale: float, shift: float) -> str:
    """One set of one antecedent."""
    centre = m.centre[r, j] * scale + shift
    left = m.left[r, j] * scale
    right = m.right[r, j] * scale
    if m.shape == "gaussian" and left == right:
        return f"'gaussmf',{_row(np.array([left, centre]))}"
    if m.shape == "gaussian":
        return f"'gauss2mf',{_row(np.array([left, centre, right, centre]))}"
    reach = WIDTHS[m.shape]
    edges = [centre - w * left for w in reach] + [centre + w * right for w in reversed(reach)]
    if m.shape == "triangle":
        edges.insert(1, centre)
    return f"'{'trimf' if m.shape == 'triangle' else 'trapmf'}',{_row(np.array(edges))}"


def _consequents(program: Program) -> FloatArray:
    """(R, n_y, n_u + 1) per unit of every input, the constant last, in physical units."""
    n = program.n
    n_y = len(program.outputs)
    out = np.zeros((len(program.theta), n_y, len(program.inputs) + 1))
    for place, column in enumerate(program.lags.column):
        theta = program.theta[:, :n_y, place] * program.scale[:n_y]
        if column < 0:
            out[:, :, -1] += theta
        else:
            slope = theta / program.scale[column]
            out[:, :, column - n] += slope
            out[:, :, -1] -= slope * program.shift[column]
    out[:, :, -1] += program.shift[:n_y]
    return out


def _row(values: FloatArray) -> str:
    return "[" + " ".join(repr(float(v)) for v in values) + "]"
