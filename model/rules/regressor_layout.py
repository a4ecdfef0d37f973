"""Which lags a TS model looks at, what they are called, and in which units the numbers live inside.

Inside, every signal is shifted and divided by its training mean and spread; outside, everything is in
physical units. Regressors are y lags 1..na of every output, then u lags nk..nk+nb-1 of every input, then
the constant 1. Antecedent variables are one lag of one signal, or the difference of two lags.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.model.regressors import lagged_name
from flysid.model.rules.kernel import Lags

REACH = 0.25  # of the range of an antecedent: so far beyond the training data its rules go on as they are
_STILL = 1e-9  # of the signal: what a sum of rounding errors may move an antecedent by


@dataclass(frozen=True)
class Antecedent:
    """One antecedent variable: w(k-lag), or w(k-lag) - w(k-minus) when minus >= 0.

    `column` counts outputs first, then inputs.
    """

    column: int
    lag: int
    minus: int = -1

    def name(self, signals: Sequence[Signal]) -> str:
        """ "v_x(k-1)", "theta_in(k)" or "v_x(k-1)-v_x(k-2)"."""
        first = lagged_name(signals[self.column].name, self.lag)
        return first if self.minus < 0 else f"{first}-{lagged_name(signals[self.column].name, self.minus)}"


@dataclass(frozen=True)
class Orders:
    """na past outputs (of every output); nb inputs from delay nk on, one pair per input."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]

    @property
    def depth(self) -> int:
        """Samples that must be known before the first one can be computed."""
        inputs = [k + b - 1 for b, k in zip(self.nb, self.nk, strict=True) if b]
        return max([1, self.na, *inputs])

    def __str__(self) -> str:
        pairs = {(b, k) for b, k in zip(self.nb, self.nk, strict=True)}
        if len(pairs) == 1:
            b, k = next(iter(pairs))
            return f"na = {self.na}, nb = {b}, nk = {k}"
        return f"na = {self.na}, nb = {list(self.nb)}, nk = {list(self.nk)}"


def regressor_names(regressors: Sequence[tuple[int, int]], signals: Sequence[Signal]) -> tuple[str, ...]:
    """What people call regressors (column of `signals`, lag); "1" for the constant."""
    return tuple("1" if c < 0 else lagged_name(signals[c].name, lag) for c, lag in regressors)


def lags_of(regressors: Sequence[tuple[int, int]], antecedents: Sequence[Antecedent]) -> Lags:
    """Regressors and antecedents as the compiled kernels take them."""
    columns, delays = zip(*regressors, strict=True)
    return Lags(
        np.array(columns, dtype=np.int64),
        np.array(delays, dtype=np.int64),
        np.array([a.column for a in antecedents], dtype=np.int64),
        np.array([a.lag for a in antecedents], dtype=np.int64),
        np.array([a.minus for a in antecedents], dtype=np.int64),
    )


def antecedent_values(antecedents: Sequence[Antecedent], W: FloatArray, depth: int) -> FloatArray:
    """(N - depth, n_z) antecedents along W (N, signals), from row `depth` on."""
    n = len(W)
    columns = []
    for a in antecedents:
        z = W[depth - a.lag : n - a.lag, a.column]
        columns.append(z if a.minus < 0 else z - W[depth - a.minus : n - a.minus, a.column])
    return np.stack(columns, axis=1) if columns else np.empty((max(n - depth, 0), 0))


@dataclass(frozen=True, eq=False)
class Layout:
    """Signals, orders, antecedents and scaling of one TS model.

    Attributes
    ----------
    outputs, inputs : the signals.
    orders : of the consequents.
    antecedents : the variables of the memberships.
    shift, scale : (n_y + n_u,) mean and spread of every signal in training.
    """

    outputs: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    orders: Orders
    antecedents: tuple[Antecedent, ...]
    shift: FloatArray
    scale: FloatArray

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def n(self) -> int:
        """Simulated columns: the outputs."""
        return len(self.outputs)

    @property
    def moving(self) -> int:
        """Past outputs that the free run depends on: so many rows before the first computed one."""
        z = (max(a.lag, a.minus) for a in self.antecedents if a.column < self.n_y)
        return min(self.depth, max(self.orders.na, *z, 0))

    @property
    def uncompared(self) -> int:
        """First rows of a run that count for nothing: those before the unknown ones agree with the data."""
        return 0

    @property
    def reach(self) -> float:
        """Of its range in training, by which rules go on as they are beyond it."""
        return REACH

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Outputs, then inputs."""
        return self.outputs + self.inputs

    @cached_property
    def depth(self) -> int:
        """Rows that a simulation starts from."""
        return max([self.orders.depth, *(max(a.lag, a.minus) for a in self.antecedents)])

    @property
    def regressors(self) -> list[tuple[int, int]]:
        """(column, lag) of every regressor; column -1 is the constant."""
        past = [(i, lag) for i in range(self.n_y) for lag in range(1, self.orders.na + 1)]
        for j, (nb, nk) in enumerate(zip(self.orders.nb, self.orders.nk, strict=True)):
            past += [(self.n_y + j, lag) for lag in range(nk, nk + nb)]
        return [*past, (-1, 0)]

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """What the consequents multiply; the last is the constant 1."""
        return regressor_names(self.regressors, self.signals)

    @cached_property
    def lags(self) -> Lags:
        """The layout as the compiled kernels take it."""
        return lags_of(self.regressors, self.antecedents)

    def stack(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """W (N, n_y + n_u) of the kernels, normalised; always a new array."""
        W = np.empty((len(u), len(self.signals)))
        W[: len(y), : self.n_y] = y
        W[len(y) :, : self.n_y] = self.shift[: self.n_y]
        W[:, self.n_y :] = u
        return np.ascontiguousarray((W - self.shift) / self.scale)

    def outputs_of(self, W: FloatArray) -> FloatArray:
        """Physical outputs of normalised W."""
        return np.asarray(W[:, : self.n_y] * self.scale[: self.n_y] + self.shift[: self.n_y])

    def antecedent_values(self, W: FloatArray) -> FloatArray:
        """(N - depth, n_z) antecedent variables of normalised W."""
        return antecedent_values(self.antecedents, W, self.depth)

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


def scaling(train: Dataset) -> tuple[FloatArray, FloatArray]:
    """Mean and spread (n_y + n_u,) of every signal over all segments.

    Raises
    ------
    DataError : no samples, or a signal that never moves.
    """
    if not train.segments or not len(train):
        raise DataError("there are no samples to fit", hint="record longer, or loosen the recipe's cuts")
    W = np.vstack([np.hstack([s.y, s.u]) for s in train.segments])
    for column, signal in enumerate(train.outputs + train.inputs):
        if np.ptp(W[:, column]) == 0:
            kind = "output" if column < len(train.outputs) else "input"
            raise DataError(
                f"the {kind} {signal.name} never moves: nothing can be learned from it",
                hint="excite it in flight, or take it out of the recipe",
            )
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
        raise UsageError(f"the antecedent {text!r} is no name", hint=f"write e.g. {signals[0]}(k-1)")
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
        values = np.concatenate([_lagged(antecedent, w) for w in columns])
        size = max(float(np.abs(w).max(initial=0.0)) for w in columns)
        if len(values) and np.ptp(values) <= _STILL * size:
            raise DataError(
                f"the antecedent {antecedent.name(signals)} stays at {values[0]:g} in the training data",
                hint="no rule can be told from another by it: leave it out, or name a variable that moves",
            )


def _lagged(antecedent: Antecedent, w: FloatArray) -> FloatArray:
    """What an antecedent is along one record (N,) of its signal, from where all its lags are known."""
    deepest = max(antecedent.lag, antecedent.minus)
    first = w[deepest - antecedent.lag : len(w) - antecedent.lag]
    if antecedent.minus < 0:
        return first
    return first - w[deepest - antecedent.minus : len(w) - antecedent.minus]
