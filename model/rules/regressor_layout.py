"""Which columns at which lags a TS model looks at, what they are called, in which units the numbers are kept.

    x(k) = sum_r phi_r(z(k)) (sum_j A_rj x(k-j) + sum_j B_rj u(k-nk-j) + c_r),   y(k) = the first n_y of x(k)

Columns are the outputs, then hidden states where there are any, then the inputs. Without hidden states
regressors are lags 1..na of every output; with them lag 1 of every column that is simulated. Then follow lags
nk..nk+nb-1 of every input and the constant 1. Antecedent variables z are one lag of one column, or the
difference of two lags. Inside, every signal is shifted and divided by its training mean and spread, hidden
states, which nothing measures, by the spread of their simulation; outside, everything is in physical units.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError, UsageError
from flysid.model.arguments import never_changes, no_samples
from flysid.model.polynomials import ROUNDING
from flysid.model.regressors import lagged_name
from flysid.model.rules.kernel import Lags

HIDDEN = "hidden"
REACH = 0.25  # of the range of an antecedent: so far beyond the training data its rules go on as they are


@dataclass(frozen=True)
class Antecedent:
    """One antecedent variable: w(k-lag), or w(k-lag) - w(k-minus) when minus >= 0.

    `column` counts outputs first, then hidden states, then inputs.
    """

    column: int
    lag: int
    minus: int = -1

    @property
    def depth(self) -> int:
        """Samples that it looks back."""
        return max(self.lag, self.minus)

    def along(self, w: FloatArray, first: int) -> FloatArray:
        """(N - first,) what it is along a record (N,) of its signal, from a row on that is deep enough."""
        value = w[first - self.lag : len(w) - self.lag]
        return value if self.minus < 0 else value - w[first - self.minus : len(w) - self.minus]

    def name(self, signals: Sequence[Signal]) -> str:
        """ "v_x(k-1)", "theta_in(k)" or "v_x(k-1)-v_x(k-2)"."""
        first = lagged_name(signals[self.column].name, self.lag)
        return first if self.minus < 0 else f"{first}-{lagged_name(signals[self.column].name, self.minus)}"


@dataclass(frozen=True)
class Orders:
    """na past values of every output or state; nb inputs from delay nk on, one pair per input."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]

    @property
    def depth(self) -> int:
        """Samples that must be known before the first one can be computed."""
        inputs = [k + b - 1 for b, k in zip(self.nb, self.nk, strict=True) if b]
        return max([1, self.na, *inputs])

    @property
    def input_lags(self) -> tuple[tuple[int, ...], ...]:
        """Per input, the lags at which it enters."""
        return tuple(tuple(range(k, k + b)) for b, k in zip(self.nb, self.nk, strict=True))

    @classmethod
    def of_states(cls, input_lags: Sequence[Sequence[int]]) -> Orders:
        """One past value of every state, and inputs at successive lags."""
        firsts = tuple(min(lags, default=0) for lags in input_lags)
        return cls(1, tuple(len(lags) for lags in input_lags), firsts)

    def __str__(self) -> str:
        pairs = {(b, k) for b, k in zip(self.nb, self.nk, strict=True)}
        if len(pairs) == 1:
            b, k = next(iter(pairs))
            return f"na = {self.na}, nb = {b}, nk = {k}"
        return f"na = {self.na}, nb = {list(self.nb)}, nk = {list(self.nk)}"


@dataclass(frozen=True, eq=False)
class Layout:
    """Signals, hidden states, orders, antecedents and scaling of one model of rules.

    Attributes
    ----------
    outputs, inputs : the signals.
    orders : of the consequents.
    antecedents : the variables of the memberships.
    shift, scale : (n + n_u,) of every simulated column and input; physical = normalised * scale + shift.
    hidden : number of hidden states.
    reach : by so much of its range in training rules go on as they are beyond it.
    """

    outputs: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    orders: Orders
    antecedents: tuple[Antecedent, ...]
    shift: FloatArray
    scale: FloatArray
    hidden: int = 0
    reach: float = REACH

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def n(self) -> int:
        """Simulated columns: the outputs, then the hidden states."""
        return self.n_y + self.hidden

    @cached_property
    def moving(self) -> int:
        """Rows before the first computed one that the free run depends on."""
        z = (a.depth for a in self.antecedents if a.column < self.n)
        return min(self.depth, max(self.orders.na, *z, 0))

    @property
    def uncompared(self) -> int:
        """First rows of a run, from before what it starts from: they agree with the data."""
        return self.depth - self.moving

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Outputs, hidden states, inputs: the columns of W."""
        names = tuple(Signal(f"{HIDDEN} {i + 1}") for i in range(self.hidden))
        return (*self.outputs, *names, *self.inputs)

    @cached_property
    def depth(self) -> int:
        """Rows that a simulation starts from."""
        return max([self.orders.depth, *(a.depth for a in self.antecedents)])

    @cached_property
    def regressors(self) -> list[tuple[int, int]]:
        """(column, lag) of every regressor; column -1 is the constant."""
        past = [(i, lag) for i in range(self.n) for lag in range(1, self.orders.na + 1)]
        past += [(self.n + j, lag) for j, lags in enumerate(self.orders.input_lags) for lag in lags]
        return [*past, (-1, 0)]

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """What the consequents multiply; the last is the constant 1."""
        return tuple("1" if c < 0 else lagged_name(self.signals[c].name, lag) for c, lag in self.regressors)

    @cached_property
    def lags(self) -> Lags:
        """The layout as the compiled kernels take it."""
        columns, delays = zip(*self.regressors, strict=True)
        z = np.array([(a.column, a.lag, a.minus) for a in self.antecedents], dtype=np.int64).reshape(-1, 3)
        return Lags(
            np.array(columns, dtype=np.int64), np.array(delays, dtype=np.int64), *np.ascontiguousarray(z.T)
        )

    def stack(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """W (N, n + n_u) of the kernels, normalised; outputs not given, and hidden states, are zero."""
        n_y = self.n_y
        W = np.zeros((len(u), self.n + len(self.inputs)))
        W[: len(y), :n_y] = (y - self.shift[:n_y]) / self.scale[:n_y]
        W[:, self.n :] = (u - self.shift[self.n :]) / self.scale[self.n :]
        return W

    def outputs_of(self, W: FloatArray) -> FloatArray:
        """Physical outputs of normalised W."""
        return np.asarray(W[:, : self.n_y] * self.scale[: self.n_y] + self.shift[: self.n_y])

    def antecedent_values(self, W: FloatArray) -> FloatArray:
        """(N - depth, n_z) antecedent variables of normalised W, from row `depth` on."""
        d = self.depth
        columns = [a.along(W[:, a.column], d) for a in self.antecedents]
        return np.stack(columns, axis=1) if columns else np.empty((max(len(W) - d, 0), 0))

    def regressor_values(self, W: FloatArray) -> FloatArray:
        """(N - depth, n_x) regressors along normalised W, from row `depth` on."""
        d = self.depth
        n = len(W)
        columns = [np.ones(max(n - d, 0)) if c < 0 else W[d - lag : n - lag, c] for c, lag in self.regressors]
        return np.stack(columns, axis=1)

    def antecedent_scaling(self) -> tuple[FloatArray, FloatArray]:
        """Shift and scale (n_z,) that turn normalised antecedents into physical ones."""
        shift = np.array([0.0 if a.minus >= 0 else self.shift[a.column] for a in self.antecedents])
        return shift, np.array([self.scale[a.column] for a in self.antecedents])


def runs_of(layout: Layout, segments: Sequence[Segment], least: int) -> tuple[FloatArray, ...]:
    """Normalised W of every segment that has at least `least` rows."""
    return tuple(layout.stack(s.u, s.y) for s in segments if len(s) >= least)


def windows(runs: Sequence[FloatArray], depth: int, rows: int) -> tuple[FloatArray, ...]:
    """The runs cut into windows that simulate about `rows` rows each, every row once.

    Windows share depth - 1 rows: the inputs that the first step looks back to.
    """
    pieces = []
    for W in runs:
        count = max(1, round((len(W) - depth + 1) / rows))
        edges = np.linspace(depth - 1, len(W), count + 1).astype(int)
        pieces += [W[a - depth + 1 : b] for a, b in itertools.pairwise(edges) if b - a > 2]
    return tuple(np.ascontiguousarray(p) for p in pieces)


def scaling(train: Dataset) -> tuple[FloatArray, FloatArray]:
    """Mean and spread (n_y + n_u,) of every signal over all segments.

    Raises
    ------
    DataError : no samples, or a signal that never moves.
    """
    if not train.segments or not len(train):
        raise no_samples()
    W = np.vstack([np.hstack([s.y, s.u]) for s in train.segments])
    for column, signal in enumerate(train.outputs + train.inputs):
        if np.ptp(W[:, column]) == 0:
            kind = "output" if column < len(train.outputs) else "input"
            raise never_changes(kind, signal.name)
    return W.mean(axis=0), W.std(axis=0)


_TERM = re.compile(r"\s*(?P<name>.+?)\s*\(\s*k\s*(?:-\s*(?P<lag>\d+)\s*)?\)\s*")


def parse_antecedent(
    text: str, outputs: Sequence[Signal], inputs: Sequence[Signal], delays: Sequence[int]
) -> Antecedent:
    """The antecedent that a person wrote: "v_x(k-1)", "theta_in(k)", "v_x(k-1)-v_x(k-2)", or just a name.

    Parameters
    ----------
    delays : (n_u,) samples after which each input acts: the lag that its bare name means.

    Raises
    ------
    UsageError : no such signal, not understood, or an output at the present sample.
    """
    signals = [s.name for s in (*outputs, *inputs)]
    if not isinstance(text, str):
        raise UsageError(
            f"the antecedent {text!r} is not the name of a signal", hint=f"write e.g. {signals[0]}(k-1)"
        )
    if text in signals:
        column = signals.index(text)
        return Antecedent(column, 1 if column < len(outputs) else delays[column - len(outputs)])
    first, minus, second = text.partition(")-")
    terms = [_TERM.fullmatch(first + (")" if minus else ""))]
    if minus:
        terms.append(_TERM.fullmatch(second))
    found = [(t["name"], int(t["lag"] or 0)) for t in terms if t]
    known = all(name in signals for name, _ in found)
    if len(found) != len(terms) or not known or len({name for name, _ in found}) != 1:
        raise UsageError(
            f"the antecedent {text!r} is not understood",
            hint=f"write e.g. {signals[0]}(k-1) or {signals[-1]}(k); the signals are {', '.join(signals)}",
        )
    column = signals.index(found[0][0])
    lags = [lag for _, lag in found]
    if column < len(outputs) and min(lags) < 1:
        raise UsageError(f"{text!r} needs an output before it is known", hint="outputs start at (k-1)")
    return Antecedent(column, lags[0], lags[1] if minus else -1)


def parse_antecedents(
    names: Sequence[str], outputs: Sequence[Signal], inputs: Sequence[Signal], delays: Sequence[int]
) -> tuple[Antecedent, ...]:
    """Several antecedents that a person wrote; see `parse_antecedent`.

    Raises
    ------
    UsageError : one is not understood, or named twice.
    """
    found = tuple(parse_antecedent(name, outputs, inputs, delays) for name in names)
    for at, antecedent in enumerate(found):
        if antecedent in found[:at]:
            raise UsageError(f"the antecedent {names[at]!r} is named twice", hint="name each one once")
    return found


def check_they_move(antecedents: Sequence[Antecedent], train: Dataset) -> None:
    """Raise DataError for an antecedent by which no rule can be told from another.

    A difference of lags that only carries rounding counts as one that stands still.
    """
    signals = (*train.outputs, *train.inputs)
    for antecedent in antecedents:
        columns = [np.hstack([s.y, s.u])[:, antecedent.column] for s in train.segments]
        values = np.concatenate([antecedent.along(w, antecedent.depth) for w in columns])
        size = max(float(np.abs(w).max(initial=0.0)) for w in columns)
        if len(values) and np.ptp(values) <= ROUNDING * size:
            raise DataError(
                f"the antecedent {antecedent.name(signals)} stays at {values[0]:g} in the training data",
                hint="no rule can be told from another by it: leave it out, or name a variable that moves",
            )
