"""What the states of a TS state-space model are, what they are called, and in which units they live inside.

    x(k) = sum_r phi_r(z(k)) (A_r x(k-1) + B_r w(k) + c_r),   y(k) = the first n_y entries of x(k)

The outputs are states themselves, so that a rule says what a person can check; what remains are hidden
states, named "hidden 1", "hidden 2", ... in units of their own spread in training. w(k) holds every input
at one lag, its delay, or at lags 0 and 1 where it feeds through (a direct term is absorbed in the outputs).
Antecedents z(k) are states at k-1 or inputs at their smallest lag.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.dataset import FloatArray, Segment, Signal
from flysid.model.rules.kernel import Lags
from flysid.model.rules.regressor_layout import Antecedent, antecedent_values, lags_of, regressor_names

HIDDEN = "hidden"


@dataclass(frozen=True, eq=False)
class StateLayout:
    """Signals, states, antecedents and scaling of one model.

    Attributes
    ----------
    outputs, inputs : the signals.
    hidden : number of hidden states.
    input_lags : per input, the lags at which it enters.
    antecedents : their columns count states first, then inputs.
    shift, scale : (n + n_u,) of every state and input; physical = normalised * scale + shift.
    """

    outputs: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    hidden: int
    input_lags: tuple[tuple[int, ...], ...]
    antecedents: tuple[Antecedent, ...]
    shift: FloatArray
    scale: FloatArray

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def n(self) -> int:
        """Number of states."""
        return self.n_y + self.hidden

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Outputs, hidden states, inputs: the columns of W."""
        names = tuple(Signal(f"{HIDDEN} {i + 1}") for i in range(self.hidden))
        return (*self.outputs, *names, *self.inputs)

    @property
    def depth(self) -> int:
        """Row that the first step computes; the state before it stands in row depth - 1."""
        return max([1, *(lag for lags in self.input_lags for lag in lags)])

    @property
    def moving(self) -> int:
        """The free run hangs on one row before the first computed one: the state there."""
        return 1

    @property
    def uncompared(self) -> int:
        """First rows of a run, from before there is a state."""
        return self.depth - 1

    @property
    def reach(self) -> float:
        """Antecedents stay where the range of training ends: hidden ones have a margin in theirs."""
        return 0.0

    @property
    def regressors(self) -> list[tuple[int, int]]:
        """(column, lag) of every regressor; column -1 is the constant."""
        terms = [(i, 1) for i in range(self.n)]
        terms += [(self.n + j, lag) for j, lags in enumerate(self.input_lags) for lag in lags]
        return [*terms, (-1, 0)]

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """What the consequents multiply; the last is the constant 1."""
        return regressor_names(self.regressors, self.signals)

    @cached_property
    def lags(self) -> Lags:
        """The layout as the compiled kernels take it."""
        return lags_of(self.regressors, self.antecedents)

    def stack(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """W (N, n + n_u) of the kernels, normalised; hidden states, and outputs not given, are zero."""
        n_y = self.n_y
        n = self.n
        W = np.zeros((len(u), n + len(self.inputs)))
        W[: len(y), :n_y] = (y - self.shift[:n_y]) / self.scale[:n_y]
        W[:, n:] = (u - self.shift[n:]) / self.scale[n:]
        return W

    def outputs_of(self, W: FloatArray) -> FloatArray:
        """Physical outputs of normalised W."""
        return np.asarray(W[:, : self.n_y] * self.scale[: self.n_y] + self.shift[: self.n_y])

    def antecedent_values(self, W: FloatArray) -> FloatArray:
        """(N - depth, n_z) antecedent variables of normalised W."""
        return antecedent_values(self.antecedents, W, self.depth)

    def antecedent_scaling(self) -> tuple[FloatArray, FloatArray]:
        """Shift and scale (n_z,) that turn normalised antecedents into physical ones."""
        at_columns = [a.column for a in self.antecedents]
        return self.shift[at_columns], self.scale[at_columns]

    def candidates(self) -> tuple[Antecedent, ...]:
        """Variables that rules may look at: every state, and every input at its smallest lag."""
        states = [Antecedent(i, 1) for i in range(self.n)]
        inputs = [Antecedent(self.n + j, min(lags)) for j, lags in enumerate(self.input_lags) if lags]
        return (*states, *inputs)


def runs_of(layout: StateLayout, segments: Sequence[Segment], least: int) -> tuple[FloatArray, ...]:
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
