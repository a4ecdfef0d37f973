"""A fitted linear model in words: equations, polynomials with intervals, poles, choices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.linear.uncertainty import DifferenceModel, response_of
from flysid.model.polynomials import Z95, ComplexArray, modes_of, nearly_cancelled, polynomial_text
from flysid.model.regressors import lagged_name
from flysid.showing import counted


class LinearText(DifferenceModel, Protocol):
    """What the words are made of; see `flysid.model.linear.difference_equation.FittedLinear`."""

    @property
    def structure(self) -> str: ...
    @property
    def n_parameters(self) -> int: ...
    @property
    def u_origin(self) -> FloatArray: ...
    @property
    def y_origin(self) -> FloatArray: ...
    @property
    def noise(self) -> FloatArray | None: ...
    @property
    def ma(self) -> FloatArray | None: ...
    @property
    def poles(self) -> ComplexArray: ...
    @property
    def dc_gain(self) -> FloatArray: ...
    @property
    def scores(self) -> Mapping[str, float]: ...
    @property
    def notes(self) -> tuple[str, ...]: ...


def conclusion(model: LinearText) -> str:
    """ "v_x(k) = 0.97 v_x(k-1) + 0.003 theta_in(k-1) + 0.01", one equation per output, "; " between."""
    a = model.system.a
    b = model.system.b
    constant = constants(model)
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


def constants(model: LinearText) -> FloatArray:
    """(n_y,) constants of the equations of the signals themselves, not of their deviations."""
    s = model.system
    found: FloatArray = s.c + s.a.sum(axis=0) @ model.y_origin - s.b.sum(axis=0) @ model.u_origin
    return found


def _sum(terms: list[tuple[float, str]], constant: float) -> str:
    parts = [(value, f"{abs(value):.5g} {name}") for value, name in terms]
    if constant != 0.0 or not parts:
        parts.append((constant, f"{abs(constant):.4g}"))
    text = ""
    for position, (value, words) in enumerate(parts):
        sign = "-" if value < 0 else ("+" if position else "")
        text += f" {sign} {words}" if position else f"{sign}{words}"
    return text


EQUATIONS = {
    "arx": "A(q) y = B(q) u + c + e",
    "armax": "A(q) y = B(q) u + c + C(q) e",
    "bj": "A(q) x = B(q) u + c, y = x + C(q) / D(q) e",
    "oe": "A(q) x = B(q) u + c, y = x + v",
    "iv": "A(q) y = B(q) u + c + v",
    "fir": "y = B(q) u + c + v",
    "line": "y = B u + c + v",
}
"""How a structure's polynomials are meant; e is white, v any noise."""


def describe(model: LinearText) -> str:
    """Several lines: polynomials with intervals, poles, figures, choices."""
    lines = [
        f"{model.structure.upper()} model, {counted(model.n_parameters, 'parameter')}, "
        f"sample time {model.dt_s:g} s"
    ]
    meant = "oe" if model.structure == "arx" and model.noise is not None else model.structure  # refined
    if meant in EQUATIONS:
        lines.append(f"{EQUATIONS[meant]}; q^-1 is a delay of one sample")
    lines += _polynomials(model)
    modes = modes_of(model.poles, model.dt_s)
    if modes:
        lines.append("poles: " + "; ".join(f"{m}{_seen(model, m.pole)}" for m in modes))
    lines.append("steady gain: " + "; ".join(gains_text(model, _gain_errors(model))))
    if (model.standard_errors > 0).any():
        lines.append("(+- is half the width of a 95 % interval)")
    lines += [f"{name}: {value:.4g}" for name, value in model.scores.items()]
    lines += [f"- {note}" for note in model.notes]
    return "\n".join(lines)


def _seen(model: LinearText, pole: complex) -> str:
    """A word on a pole of a model of one output beside which every input has a zero: answers hardly show it.

    Its time constant is no more than what the data did not tell from none.
    """
    seen = len(model.outputs) > 1 or not nearly_cancelled(pole, model.system.b[:, 0].T)
    return "" if seen else " (a zero nearly cancels it)"


class WithGain(Protocol):
    """A model with a steady gain."""

    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    @property
    def dc_gain(self) -> FloatArray: ...


def gains_text(model: WithGain, errors: FloatArray) -> list[str]:
    """ "u -> y 2.5 +- 0.1" for every input and output; (n_y, n_u) standard errors, NaN where unknown."""
    return [
        f"{i.name} -> {o.name} {gain_text(model.dc_gain[r, c])}"
        + (f" +- {Z95 * errors[r, c]:.2g}" if errors[r, c] > 0 and np.isfinite(model.dc_gain[r, c]) else "")
        for r, o in enumerate(model.outputs)
        for c, i in enumerate(model.inputs)
    ]


def _gain_errors(model: LinearText) -> FloatArray:
    """(n_y, n_u) standard errors of the steady gain; NaN where they are unknown."""
    if not np.isfinite(model.dc_gain).all():
        return np.full(model.dc_gain.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # a gain of zero has no direction
        found: FloatArray = response_of(model, np.zeros(1)).magnitude_error[0]
    return found


def gain_text(value: float) -> str:
    """A steady gain, which what integrates has not."""
    return "none, it integrates" if np.isnan(value) else f"{value:.4g}"


def _polynomials(model: LinearText) -> list[str]:
    s = model.system
    errors = model.standard_errors
    a_size = s.a[1:].size
    b_size = s.b.size
    a_err = np.concatenate([np.zeros((1, *s.a.shape[1:])), errors[:a_size].reshape(s.a[1:].shape)])
    b_err = errors[a_size : a_size + b_size].reshape(s.b.shape)
    constant = constants(model)
    lines = []
    for i, output in enumerate(model.outputs):
        for j, other in enumerate(model.outputs):
            if s.a[1:, i, j].any():
                text = polynomial_text(s.a[:, i, j], a_err[:, i, j])
                lines.append(f"A[{output.name}, {other.name}] = {text}")
        for j, source in enumerate(model.inputs):
            lines.append(f"B[{output.name}, {source.name}] = {polynomial_text(s.b[:, i, j], b_err[:, i, j])}")
        if constant[i]:
            lines.append(f"c[{output.name}] = {constant[i]:.6g}")
        if model.ma is not None:
            lines.append(f"C[{output.name}] = {polynomial_text(model.ma[:, i])}")
        if model.noise is not None and len(model.noise) > 1:
            lines.append(f"D[{output.name}] = {polynomial_text(model.noise[:, i])} (of the noise)")
    return lines
