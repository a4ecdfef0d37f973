"""A fitted polynomial NARX model: its laws, its words, its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.model import own_constants
from flysid.model.arguments import as_columns, as_record, check_start
from flysid.model.base import Rule, write_document
from flysid.model.capabilities import Coefficient
from flysid.model.documents import array_of, head_of, signals_of, with_null
from flysid.model.freerun import Difference
from flysid.model.narx.free_run_kernel import MOST_FACTORS, TermTable, free_run, steps_ahead
from flysid.model.narx.polynomial_terms import (
    FORMS,
    Factor,
    SeenRange,
    Term,
    continued,
    depth_of,
    meaning,
    table_of,
    term_name,
)
from flysid.model.own_constants import OwnConstants
from flysid.model.polynomials import Z95
from flysid.model.rules.recursion import companion
from flysid.model.start import OneRule
from flysid.showing import counted, significant

MOST_LAG = 100_000


@dataclass(frozen=True, eq=False)
class Units:
    """Normalised = (physical - origin) / scale, outputs first; `n_y` of the columns are outputs."""

    origin: FloatArray
    scale: FloatArray
    n_y: int

    @classmethod
    def of(cls, data: Dataset) -> Units:
        """Origin 0 where a signal takes both signs, else its mean; root mean squares about it.

        A sign and a magnitude mean something about a zero that the signal crosses.
        """
        columns = np.concatenate([np.hstack([s.y, s.u]) for s in data.segments])
        crosses = (columns.min(axis=0) < 0.0) & (columns.max(axis=0) > 0.0)
        origin = np.where(crosses, 0.0, columns.mean(axis=0))
        scale = np.sqrt(np.mean((columns - origin) ** 2, axis=0))
        return cls(origin, scale, len(data.outputs))

    def joined(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y + n_u) normalised W; outputs that are missing at the end are zero."""
        W = np.zeros((len(u), len(self.scale)))
        W[: len(y), : self.n_y] = (y - self.origin[: self.n_y]) / self.scale[: self.n_y]
        W[:, self.n_y :] = (u - self.origin[self.n_y :]) / self.scale[self.n_y :]
        return W

    def outputs(self, W: FloatArray) -> FloatArray:
        """The physical outputs of W."""
        return np.asarray(W[:, : self.n_y] * self.scale[: self.n_y] + self.origin[: self.n_y])

    def limits(self, physical: FloatArray) -> FloatArray:
        """(2, n_y) normalised."""
        return np.asarray((physical - self.origin[: self.n_y]) / self.scale[: self.n_y])

    def coefficient(self, term: Term) -> float:
        """What one unit of a normalised coefficient is in physical ones."""
        sizes = [self.scale[f.column] for f in term.factors if f.form != "sign"]
        return float(self.scale[term.equation] / np.prod(sizes))


@dataclass(frozen=True, eq=False, repr=False)
class FittedPolyNARX(OneRule):
    """A polynomial NARX model; the laws of `flysid.model.base` hold.

    Attributes
    ----------
    terms : of all outputs' equations.
    theta : (T,) coefficients in normalised units.
    covariance : (T, T) of them; NaN where unknown.
    units : origin and scale of every signal.
    n_init : the deepest lag.
    output_limits : the training range, widened by its width on both sides; the recursion is held there.
    flight_offsets : what flights had beside the model in training; None where all had the same.
    seen : range of all signals in training; nonlinear terms go on straight beyond it. None: as they are.
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    output_limits: FloatArray
    terms: tuple[Term, ...]
    theta: FloatArray
    covariance: FloatArray
    units: Units
    notes: tuple[str, ...] = ()
    flight_offsets: OwnConstants | None = None
    seen: SeenRange | None = None

    structure = "polynarx"

    @cached_property
    def n_init(self) -> int:
        """The deepest lag: measured samples that a simulation starts from."""
        return depth_of(self.terms)

    @property
    def n_parameters(self) -> int:
        """One coefficient a term."""
        return len(self.terms)

    @cached_property
    def everywhere(self) -> tuple[tuple[Term, ...], FloatArray]:
        """Terms and coefficients, and those that act beyond the range of training alone."""
        return (self.terms, self.theta) if self.seen is None else continued(self.terms, self.theta)

    @cached_property
    def table(self) -> TermTable:
        """The terms of `everywhere` as compiled code takes them."""
        return table_of(self.everywhere[0], self.seen)

    @cached_property
    def limits(self) -> FloatArray:
        """(2, n_y) normalised output limits."""
        return self.units.limits(self.output_limits)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Outputs, then inputs, as the terms' columns count them."""
        return (*self.outputs, *self.inputs)

    # -- the laws ----------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first `n_init` measured outputs; from zero inputs and outputs when None.

        Raises
        ------
        UsageError : shapes do not fit the model, or fewer than `n_init` outputs are given.
        """
        u = as_columns(u, len(self.inputs), "u")
        n = self.n_init
        if y0 is None:
            u = np.concatenate([np.zeros((n, u.shape[1])), u])
            return self._run(u, np.zeros((n, len(self.outputs))))[n:]
        y0 = as_columns(y0, len(self.outputs), "y0")
        check_start(len(y0), min(n, len(u)))
        return self._run(u, y0[: min(n, len(u))])

    def _run(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        W = self.units.joined(u, y0)
        free_run(W, self.n_init, self.table, self.everywhere[1], self.limits)
        out = np.clip(self.units.outputs(W), *self.output_limits)
        out[: len(y0)] = y0
        return out

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) prediction from outputs at least k steps old; the first n_init + k - 1 rows are NaN.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        W = self.units.joined(u, y)
        W[:, : len(self.outputs)] = steps_ahead(
            W, self.n_init, k, self.table, self.everywhere[1], self.limits
        )
        return np.clip(self.units.outputs(W), *self.output_limits)

    def held_to(self, train: Dataset) -> FittedPolyNARX:
        """The model whose nonlinear terms go on straight beyond what it and its training data ever were.

        Its free runs over these data stay as they are, to the bit.
        """
        usable = [s for s in train.segments if len(s) > self.n_init]
        runs = [self.units.joined(s.u, y) for s in usable for y in (s.y, self.free_run(s))]
        return replace(self, seen=SeenRange.of(runs)) if runs else self

    def rules(self) -> tuple[Rule, ...]:
        """One rule that always holds; gain and slowest time constant are those of small signals.

        They are of the linearisation at the origin of the terms: zero, or a signal's mean.
        """
        linear = self.linearised
        found = np.abs(np.linalg.eigvals(companion(-linear.a[1:]))).max(initial=0.0) if self.n_init else 0.0
        slow = -self.dt_s / np.log(found) if 0.0 < found < 1.0 else (0.0 if found == 0.0 else np.inf)
        a_sum = linear.a.sum(axis=0)
        if np.isfinite(slow) and np.linalg.cond(a_sum) < 1e12:
            gain = np.linalg.solve(a_sum, linear.b.sum(axis=0))
        else:
            gain = np.full(linear.b.shape[1:], np.nan)
        words = "; ".join(self.equation(i) for i in range(len(self.outputs)))
        return (Rule("R1", "always", words, gain, float(slow), float(found), 1.0),)

    # -- what an engineer asks of it ---------------------------------------------------------------------

    @cached_property
    def coefficient_scale(self) -> FloatArray:
        """(T,) physical units of the normalised coefficients."""
        return np.array([self.units.coefficient(t) for t in self.terms])

    @property
    def linearised(self) -> Difference:
        """The terms of one plain factor, physical units: what small signals about the origin meet."""
        lags = range(self.n_init + 1)
        n_y = len(self.outputs)
        taps = np.zeros((len(lags), n_y, len(self.signals)))
        for term, value in zip(self.terms, self.theta * self.coefficient_scale, strict=True):
            if term.factors and term.is_linear:
                (factor,) = term.factors
                taps[factor.lag, term.equation, factor.column] += value
                if factor.change:
                    taps[factor.lag + 1, term.equation, factor.column] -= value
        a = -taps[:, :, :n_y]
        a[0] = np.eye(n_y)
        return Difference(a, taps[:, :, n_y:], np.zeros(n_y))

    def coefficients(self) -> list[Coefficient]:
        """Every term's; none where the model carries no covariance."""
        if not np.isfinite(self.covariance).all():
            return []
        values = self.theta * self.coefficient_scale
        half = Z95 * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) * np.abs(self.coefficient_scale)
        return [
            Coefficient("", self.outputs[t.equation].name, self.name(t), float(value), float(width))
            for t, value, width in zip(self.terms, values, half, strict=True)
        ]

    def name(self, term: Term) -> str:
        """What a coefficient multiplies."""
        origin = self.units.origin
        if not term.factors and origin.any():
            return "1, around the means"
        return term_name(term, self.signals, np.zeros_like(origin) if term.is_linear else origin)

    def equation(self, output: int) -> str:
        """ "v(k) = 0.97 v(k-1) - 0.12 |v(k-1)| v(k-1) + 0.01"; linear terms of signals as they are."""
        origin = self.units.origin
        constant = float(origin[output])
        text = f"{self.outputs[output].name}(k) ="
        for term, value in zip(self.terms, self.theta * self.coefficient_scale, strict=True):
            if term.equation != output:
                continue
            if not term.factors:
                constant += float(value)
                continue
            if term.is_linear:
                (factor,) = term.factors
                constant -= 0.0 if factor.change else float(value * origin[factor.column])
            text += f" {'-' if value < 0.0 else '+'} {significant(abs(float(value)), 5)} {self.name(term)}"
        if constant or text.endswith("="):
            text += f" {'-' if constant < 0.0 else '+'} {significant(abs(constant), 4)}"
        return text.replace("= + ", "= ", 1).replace("= - ", "= -", 1)

    def meanings(self) -> list[str]:
        """What every nonlinear term does: "v: adds -0.12 |v(k-1)| v(k-1): drag that grows with ..."."""
        values = self.theta * self.coefficient_scale
        return [
            f"{self.outputs[term.equation].name}: adds {significant(float(value), 4)} "
            f"{self.name(term)}: {meaning(term, float(value), self.signals)}"
            for term, value in zip(self.terms, values, strict=True)
            if not term.is_linear
        ]

    def __str__(self) -> str:
        count = sum(t.is_linear for t in self.terms)
        lines = [
            f"polynomial NARX model, {count} linear and "
            f"{counted(len(self.terms) - count, 'nonlinear term')}, sample time {self.dt_s:g} s",
            "",
            *(self.equation(i) for i in range(len(self.outputs))),
        ]
        told = self.coefficients()
        if told:
            lines += ["", "coefficients, 95 %"]
            lines += [
                f"  {c.output}, {c.regressor}: {significant(c.value, 4)} +- {significant(c.half_width, 2)}"
                for c in told
            ]
        return "\n".join([*lines, "", *self.notes])

    # -- storage -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **head_of(self),
            "output_limits": self.output_limits.tolist(),
            "terms": [
                {"equation": t.equation, "factors": [[f.column, f.lag, f.change, f.form] for f in t.factors]}
                for t in self.terms
            ],
            "theta": self.theta.tolist(),
            "covariance": with_null(self.covariance),
            "origin": self.units.origin.tolist(),
            "scale": self.units.scale.tolist(),
            "notes": list(self.notes),
            **({} if self.seen is None else {"seen": np.array(self.seen.ends).tolist()}),
            **own_constants.as_document(self.flight_offsets),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON; `flysid.load` reads it."""
        write_document(self.to_dict(), path)


def from_dict(document: Mapping[str, Any]) -> FittedPolyNARX:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError."""
    inputs = signals_of(document, "inputs")
    outputs = signals_of(document, "outputs")
    terms = tuple(_term(row, len(outputs), len(inputs)) for row in document["terms"])
    if not terms:
        raise ValueError("no terms")
    scale = array_of(document, "scale", len(outputs) + len(inputs))
    if not (scale > 0.0).all():
        raise ValueError("a scale that is not positive")
    covariance = np.array(document["covariance"], dtype=np.float64)
    if covariance.shape != (len(terms), len(terms)):
        raise ValueError("covariance is not of the terms")
    return FittedPolyNARX(
        dt_s=float(document["dt_s"]),
        inputs=inputs,
        outputs=outputs,
        output_limits=array_of(document, "output_limits", 2, len(outputs)),
        terms=terms,
        theta=array_of(document, "theta", len(terms)),
        covariance=covariance,
        units=Units(array_of(document, "origin", len(scale)), scale, len(outputs)),
        notes=tuple(str(note) for note in document["notes"]),
        flight_offsets=own_constants.from_document(document, len(outputs)),
        seen=_seen(document, len(scale)),
    )


def _seen(document: Mapping[str, Any], signals: int) -> SeenRange | None:
    """None of a file that is older than these ranges. Raises ValueError: a range that zero is not in."""
    if "seen" not in document:
        return None
    values, changes = array_of(document, "seen", 2, 2, signals)
    if (np.stack([values[0], changes[0]]) > 0.0).any() or (np.stack([values[1], changes[1]]) < 0.0).any():
        raise ValueError("a range of training without zero")
    return SeenRange(values, changes)


def _term(row: Mapping[str, Any], n_y: int, n_u: int) -> Term:
    """A term whose factors can be read before the row that they help to compute.

    Raises ValueError: a factor cannot be read, or there is no such equation.
    """
    factors = tuple(Factor(int(c), int(lag), bool(change), form) for c, lag, change, form in row["factors"])
    for f in factors:
        if not (0 <= f.column < n_y + n_u and f.form in FORMS and (f.column < n_y) <= f.lag <= MOST_LAG):
            raise ValueError(f"an impossible factor: {f}")
    if not 0 <= int(row["equation"]) < n_y or len(factors) > MOST_FACTORS:
        raise ValueError("a term of no output, or of too many factors")
    return Term(int(row["equation"]), factors)
