"""A fitted linear model in words: equations, polynomials with standard errors, poles, choices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flysid.model.polynomials import modes_of, polynomial_text
from flysid.model.regressors import lagged_name

if TYPE_CHECKING:
    from flysid.model.linear.model import FittedLinear


def conclusion(model: FittedLinear) -> str:
    """ "v_x(k) = 0.97 v_x(k-1) + 0.003 theta_in(k-1) + 0.01", one equation per output, "; " between."""
    a, b = model.system.a, model.system.b
    constant = model.system.c + a.sum(axis=0) @ model.y_origin - b.sum(axis=0) @ model.u_origin
    equations = []
    for i, output in enumerate(model.outputs):
        terms = [
            (-a[lag, i, j], lagged_name(model.outputs[j].name, lag))
            for lag in range(1, len(a))
            for j in range(a.shape[2])
        ]
        terms += [
            (b[lag, i, j], lagged_name(model.inputs[j].name, lag))
            for lag in range(len(b))
            for j in range(b.shape[2])
        ]
        text = _sum([t for t in terms if t[0] != 0.0], float(constant[i]))
        equations.append(f"{output.name}(k) = {text}")
    return "; ".join(equations)


def _sum(terms: list[tuple[float, str]], constant: float) -> str:
    parts = [(value, f"{abs(value):.5g} {name}") for value, name in terms]
    if constant != 0.0 or not parts:
        parts.append((constant, f"{abs(constant):.4g}"))
    text = ""
    for position, (value, words) in enumerate(parts):
        sign = "-" if value < 0 else ("+" if position else "")
        text += f" {sign} {words}" if position else f"{sign}{words}"
    return text


def describe(model: FittedLinear) -> str:
    """Several lines: polynomials with standard errors, poles, figures, choices."""
    lines = [
        f"{model.structure.upper()} model, {model.n_parameters} parameters, sample time {model.dt_s:g} s"
    ]
    lines += _polynomials(model)
    modes = modes_of(model.poles, model.dt_s)
    if modes:
        lines.append("poles: " + "; ".join(str(m) for m in modes))
    gains = [
        f"{i.name} -> {o.name} {gain_text(model.dc_gain[r, c])}"
        for r, o in enumerate(model.outputs)
        for c, i in enumerate(model.inputs)
    ]
    lines.append("steady gain: " + "; ".join(gains))
    lines += [f"{name}: {value:.4g}" for name, value in model.scores.items()]
    lines += [f"- {note}" for note in model.notes]
    return "\n".join(lines)


def gain_text(value: float) -> str:
    """A steady gain, which what integrates has not."""
    return "none, it integrates" if np.isnan(value) else f"{value:.4g}"


def _polynomials(model: FittedLinear) -> list[str]:
    s = model.system
    errors = model.standard_errors
    a_size, b_size = s.a[1:].size, s.b.size
    a_err = np.concatenate([np.zeros((1, *s.a.shape[1:])), errors[:a_size].reshape(s.a[1:].shape)])
    b_err = errors[a_size : a_size + b_size].reshape(s.b.shape)
    lines = []
    for i, output in enumerate(model.outputs):
        for j, other in enumerate(model.outputs):
            if i == j or s.a[:, i, j].any():
                text = polynomial_text(s.a[:, i, j], a_err[:, i, j])
                lines.append(f"A[{output.name}, {other.name}] = {text}")
        for j, source in enumerate(model.inputs):
            lines.append(f"B[{output.name}, {source.name}] = {polynomial_text(s.b[:, i, j], b_err[:, i, j])}")
        if model.ma is not None:
            lines.append(f"C[{output.name}] = {polynomial_text(model.ma[:, i])}")
        if model.noise is not None and len(model.noise) > 1:
            lines.append(f"D[{output.name}] = {polynomial_text(model.noise[:, i])} (of the noise)")
    return lines
