"""Linear state-space starts: a fitted difference equation realised so that its outputs are states.

What the hidden states mean is a choice; the linear model is the same in all of them, but rules look along
single states. Offered are the rates ("how fast the output is about to change": C(A-I), C(A-I)^2, ...) and,
for every real pole, the mode that drives the others without being driven by them (in a cascade of tanks the
upper one, in a vehicle the actuator).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.regressor_layout import Layout, Orders

_MOST_CHOICES = 3  # of coordinates, each of which is grown from
PLAIN = "plain"
"""The coordinates that a realisation comes in; hidden states are then made uncorrelated."""
PLAIN_WORDS = "uncorrelated with the outputs and with each other"


@dataclass(frozen=True, eq=False)
class StateRealisation:
    """x(k) = A x(k-1) + sum_lag B[lag] u(k-lag) + c, y = the first n_y states; in normalised units.

    Attributes
    ----------
    law : A, one of them, B and c.
    orders : at which lags the inputs enter.
    words : what the hidden states are.
    title : what the system is.
    """

    law: Recursion
    orders: Orders
    words: str = "as the difference equation has them"
    title: str = ""

    def __len__(self) -> int:
        """States."""
        return len(self.law.c)

    def transformed(self, T: FloatArray, shift: FloatArray, words: str = "") -> StateRealisation:
        """The same system in the states T x - shift; T and shift must keep the outputs."""
        (A,), B, c = self.law
        A = T @ A @ np.linalg.inv(T)
        law = Recursion(A[None], T @ B, T @ c + A @ shift - shift)
        return replace(self, law=law, words=words or self.words)

    @classmethod
    def of(cls, layout: Layout, theta: FloatArray) -> StateRealisation:
        """The system that a consequent (n, n_x), in the order of `layout.regressors`, stands for."""
        return cls(Recursion.of(layout.lags, theta, len(layout.scale)), layout.orders)

    def consequent(self, layout: Layout) -> FloatArray:
        """(n, n_x) A, B and c in the order of `layout.regressors`."""
        (A,), B, c = self.law
        n = len(A)
        columns = [
            c if column < 0 else A[:, column] if column < n else B[lag][:, column - n]
            for column, lag in layout.regressors
        ]
        return np.stack(columns, axis=1)


def realised(fitted: FittedLinear, shift: FloatArray, scale: FloatArray) -> StateRealisation:
    """A difference equation in states (observer form), normalised by (n_y + n_u,) shift and scale.

    Delays common to all outputs become the inputs' lags. What is deeper than the order is dropped: the
    refinement that follows makes up for it.
    """
    n_y = len(fitted.outputs)
    a = fitted.system.a
    b = fitted.system.b
    rest = fitted.system.c + a.sum(axis=0) @ (fitted.y_origin - shift[:n_y])
    rest = (rest - b.sum(axis=0) @ (fitted.u_origin - shift[n_y:])) / scale[:n_y]
    order = max(len(a) - 1, 1)
    n = order * n_y
    A = np.eye(n, k=n_y)
    c = np.concatenate([rest, np.zeros(n - n_y)])
    for lag in range(1, len(a)):
        A[(lag - 1) * n_y : lag * n_y, :n_y] -= a[lag] * scale[None, :n_y] / scale[:n_y, None]
    delays = [_first_lag(b[:, :, j]) for j in range(b.shape[2])]
    orders = Orders.of_states([(0, 1) if delay == 0 else (delay,) for delay in delays])
    B = np.zeros((orders.depth + 1, n, len(delays)))
    for j, delay in enumerate(delays):
        taps = b[max(delay - 1, 0) :, :, j] * scale[n_y + j] / scale[:n_y]  # taps[1] is the delay's gain
        for lag in range(1, min(order + 1, len(taps))):
            B[max(delay, 1)][(lag - 1) * n_y : lag * n_y, j] = taps[lag]
        if delay == 0:
            B[0][:n_y, j] = taps[0]
    return StateRealisation(Recursion(A[None], B, c), orders)


def _first_lag(taps: FloatArray) -> int:
    moving = np.flatnonzero(np.abs(taps).max(axis=1) > 0)
    return int(moving[0]) if len(moving) else 1


def coordinates(plain: StateRealisation, n_y: int) -> dict[str, StateRealisation]:
    """The same system with its hidden states chosen in different ways, most readable first, by name."""
    n = len(plain)
    if n == n_y:
        return {PLAIN: plain}
    C = np.eye(n_y, n)
    rates = [C]
    while len(rates) * n_y < n:
        rates.append(rates[-1] @ (plain.law.A[0] - np.eye(n)))
    rate_rows = np.vstack(rates)[n_y:n]
    choices = [("rates", rate_rows, "rates of change of the outputs to come")]
    modes = driving_modes(plain.law.A[0], n_y)
    for i, mode in enumerate(modes):
        rows = np.vstack([mode[None], rate_rows])[: n - n_y]
        choices.append((f"mode {i + 1}", rows, "a mode of its own that drives the outputs"))
    if n - n_y >= 2 and len(modes) >= n - n_y:
        choices.append(("modes", np.stack(modes[: n - n_y]), "modes of their own that drive the outputs"))
    found: dict[str, StateRealisation] = {}
    for name, rows, words in choices:
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        T = np.vstack([C, rows / np.where(size > 0, size, 1.0)])
        if np.linalg.cond(T) < 1.0 / ROUNDING and len(found) < _MOST_CHOICES:
            found[name] = plain.transformed(T, np.zeros(n), words)
    return found or {PLAIN: plain}


def uncorrelated(covariance: FloatArray, n_y: int) -> FloatArray:
    """(n, n) T that keeps the outputs and makes the other states uncorrelated, of spread one."""
    n = len(covariance)
    T = np.eye(n)
    if n == n_y:
        return T
    seen = covariance[:n_y, :n_y]
    cross = covariance[n_y:, :n_y]
    R = np.linalg.lstsq(seen, cross.T, rcond=1e-12)[0].T
    left = covariance[n_y:, n_y:] - R @ cross.T
    size = np.sqrt(np.maximum(np.diag(covariance)[n_y:], 1e-300))
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    still = values < 1e-12  # a state that the outputs say already
    root = vectors.T / np.where(still, 1.0, np.sqrt(np.maximum(values, 1e-12)))[:, None] / size
    T[n_y:] = np.hstack([-root @ R, root])
    return T


def driving_modes(A: FloatArray, n_y: int) -> list[FloatArray]:
    """Left eigenvectors, fastest pole first: l'x(k) = p l'x(k-1) + inputs, driven by no other state.

    Of a complex pair, for which no such state exists, the real part: the state least driven by others.
    """
    values, vectors = np.linalg.eig(A.T)
    found = []
    for i in np.argsort(np.abs(values), kind="stable"):
        hidden = vectors[n_y:, i]
        largest = hidden[np.argmax(np.abs(hidden))]
        if values[i].imag >= 0 and abs(largest) > 1e-6 * np.abs(vectors[:, i]).max():
            found.append(np.ascontiguousarray((vectors[:, i] / largest).real))
    return found
