"""Terms of a polynomial NARX model that can be named: what they are, which are tried, what they say.

A factor is a signal some samples ago, or its change since the sample before (a position's velocity), as it
is, its magnitude or its sign. Products of up to three make drag (|v| v), dry friction (sign v), a spring that
hardens (y^3), an input whose effect depends on the state (y u).

Where signals leave the range of training, a product goes on along its tangents (`continued`): a power that
was fitted inside means nothing far outside, and its slope at the edge is the last that was seen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Literal, get_args

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.narx.free_run_kernel import MOST_FACTORS, TermTable
from flysid.model.polynomials import VANISHING
from flysid.model.regressors import lagged_name
from flysid.showing import significant

Form = Literal["plain", "magnitude", "sign"]
FORMS: tuple[Form, ...] = get_args(Form)


@dataclass(frozen=True, order=True)
class Factor:
    """A signal at a lag.

    `column`: outputs first, then inputs.
    `change`: its difference to the sample before, instead of itself.
    `excess`: what it has beyond the range of training, instead of what it has inside; see `continued`.
    """

    column: int
    lag: int
    change: bool = False
    form: Form = "plain"
    excess: bool = False

    @property
    def depth(self) -> int:
        """The deepest lag that it reads."""
        return self.lag + self.change


@dataclass(frozen=True)
class Term:
    """A product of factors in the equation of an output; none: the constant 1."""

    equation: int
    factors: tuple[Factor, ...]

    @property
    def is_linear(self) -> bool:
        """One plain factor, or none."""
        return not self.factors or (len(self.factors) == 1 and self.factors[0].form == "plain")


@dataclass(frozen=True, eq=False)
class SeenRange:
    """What the signals were in training, normalised; zero, about which terms are written, is always inside.

    `values`, `changes`: (2, n) lowest and highest value, and change from sample to sample, of every signal.
    """

    values: FloatArray
    changes: FloatArray

    @classmethod
    def of(cls, runs: Sequence[FloatArray]) -> SeenRange:
        """That of runs (N, n), one at least, normalised."""
        return cls(_ends(runs), _ends([np.diff(W, axis=0) for W in runs]))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Values, then changes."""
        return self.values, self.changes

    def of_factor(self, factor: Factor) -> tuple[float, float]:
        """Lowest and highest value of the factor's signal, or of its change."""
        low, high = (self.changes if factor.change else self.values)[:, factor.column]
        return float(low), float(high)


def _ends(runs: Sequence[FloatArray]) -> FloatArray:
    """Widened by what rounding adds: numbers that are scaled there and back differ in their last digit."""
    whole = np.concatenate(runs)
    return (1.0 + VANISHING) * np.stack([whole.min(axis=0, initial=0.0), whole.max(axis=0, initial=0.0)])


def table_of(terms: Sequence[Term], seen: SeenRange | None = None) -> TermTable:
    """The terms as compiled code takes them.

    `seen`: factors of nonlinear terms are held inside; None: they are not.
    """
    shape = (len(terms), MOST_FACTORS)
    column = np.full(shape, -1, dtype=np.int64)
    lag, change, form, excess = (np.zeros(shape, dtype=np.int64) for _ in range(4))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    for t, term in enumerate(terms):
        for m, factor in enumerate(term.factors):
            column[t, m] = factor.column
            lag[t, m] = factor.lag
            change[t, m] = factor.change
            form[t, m] = FORMS.index(factor.form)
            excess[t, m] = factor.excess
            if seen is not None and not term.is_linear and factor.form != "sign":
                low[t, m], high[t, m] = seen.of_factor(factor)
    equation = np.array([t.equation for t in terms], dtype=np.int64)
    return TermTable(equation, column, lag, change, form, low, high, excess)


def continued(terms: Sequence[Term], theta: FloatArray) -> tuple[tuple[Term, ...], FloatArray]:
    """Terms and coefficients of a model whose factors are held, and of their tangents beyond.

    A product of held factors f_m, each of which its signal exceeds by d_m, goes on as

        f_1 f_2 f_3 + d_1 f_2 f_3 + f_1 d_2 f_3 + f_1 f_2 d_3

    A sign has no slope. Inside the range all d_m are zero, and the products are what they were.
    """
    further: dict[Term, float] = {}
    for term, value in zip(terms, theta.tolist(), strict=True):
        for m, factor in enumerate(term.factors):
            if term.is_linear or factor.form == "sign":
                continue
            beyond = replace(factor, excess=True)
            tangent = Term(term.equation, (*term.factors[:m], *term.factors[m + 1 :], beyond))
            further[tangent] = further.get(tangent, 0.0) + value
    return (*terms, *further), np.concatenate([theta, list(further.values())])


def depth_of(terms: Sequence[Term], columns: int | None = None) -> int:
    """The deepest lag that is read of the first `columns` columns, or of all."""
    factors = [f for t in terms for f in t.factors if columns is None or f.column < columns]
    return max((f.depth for f in factors), default=0)


def candidates(signals: Sequence[Factor], n_y: int) -> Iterator[Term]:
    """Nonlinear terms of plain signals, for every output's equation.

    With s and t of the signals: s t and s^2, s^2 t and s^3, |s|, sign(s), |s| s and |s| t.
    """
    kinds: dict[tuple[Factor, ...], None] = {}
    for s in signals:
        size = Factor(s.column, s.lag, s.change, "magnitude")
        kinds[(size,)] = None
        kinds[(Factor(s.column, s.lag, s.change, "sign"),)] = None
        for t in signals:
            kinds[(size, t)] = None
            kinds[tuple(sorted((s, s, t)))] = None
    for pair in combinations_with_replacement(sorted(signals), 2):
        kinds[pair] = None
    for equation in range(n_y):
        yield from (Term(equation, factors) for factors in kinds)


# -- words -----------------------------------------------------------------------------------------------


def factor_name(factor: Factor, signals: Sequence[Signal], origin: FloatArray) -> str:
    """ "v_x(k-1)", "|v_x(k-1)|", "sign(p(k-1) - p(k-2))", "(h(k-1) - 5.2)"."""
    name = signals[factor.column].name
    text = lagged_name(name, factor.lag)
    about = float(origin[factor.column])
    if factor.change:
        text = f"{text} - {lagged_name(name, factor.lag + 1)}"
    elif about:
        text = f"{text} {'-' if about > 0 else '+'} {significant(abs(about))}"
    if factor.form == "magnitude":
        return f"|{text}|"
    if factor.form == "sign":
        return f"sign({text})"
    return f"({text})" if " " in text else text


def term_name(term: Term, signals: Sequence[Signal], origin: FloatArray) -> str:
    """ "|v_x(k-1)| v_x(k-1)", "y(k-1)^3"; "1" for the constant."""
    counted = Counter(term.factors)
    ordered = sorted(counted, key=lambda f: (f.form == "plain", f))
    names = (factor_name(f, signals, origin) + (f"^{counted[f]}" if counted[f] > 1 else "") for f in ordered)
    return " ".join(names) or "1"


def meaning(term: Term, coefficient: float, signals: Sequence[Signal]) -> str:
    """What a nonlinear term does, in an engineer's words."""
    bases = sorted({(f.column, f.change) for f in term.factors}, reverse=True)
    first, *others = (_quantity(column, change, signals) for column, change in bases)
    if others:
        return f"the effect of {first} depends on {' and '.join(others)}"
    forms = {f.form for f in term.factors}
    degree = len(term.factors)
    if forms == {"sign"}:
        kind, grows = (
            _kind(term, coefficient, signals, ("dry friction", "a constant pull back")),
            "by the sign",
        )
    elif forms == {"magnitude"} or (forms == {"plain"} and degree == 2):
        kind, grows = "the same on both sides", f"growing with the {'square' if degree == 2 else 'size'}"
    else:
        kind = _kind(term, coefficient, signals, ("drag", "a pull back, as of a spring that hardens"))
        grows = f"growing with the {'square' if degree == 2 else 'cube'}"
    return f"{kind}, {grows} of {first}"


def _kind(term: Term, coefficient: float, signals: Sequence[Signal], against: tuple[str, str]) -> str:
    """`against` a speed, or against a place, where an output brakes itself; a push elsewhere."""
    (base,) = {(f.column, f.change) for f in term.factors}
    if base[0] != term.equation or coefficient > 0.0:
        return "a push"
    speed = base[1] or signals[base[0]].unit.endswith("/s")
    return against[0] if speed else against[1]


def _quantity(column: int, change: bool, signals: Sequence[Signal]) -> str:
    name = signals[column].name
    return f"the change of {name}" if change else name
