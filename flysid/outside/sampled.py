"""Linear systems with dead times, as one discrete state space.

Behind a zero-order hold a dead time of (d + f) samples, 0 <= f < 1, is exact with one more state, the input
of a sample ago (Astrom & Wittenmark, 1997, Computer-Controlled Systems, 2.3):

    x(k+1) = e^(A T) x(k) + G0 u(k - d) + G1 u(k - d - 1)
    G0 = int_0^((1-f) T) e^(A s) ds B,      G1 = e^(A (1-f) T) int_0^(f T) e^(A s) ds B
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.control_form import with_registers

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
WHOLE = 1e-6
"""A dead time this near to a whole number of samples is one."""


@dataclass(frozen=True, eq=False)
class Block:
    """A system of some outputs and inputs.

    `matrices`: A, B, C, D; continuous where `dt_s` is 0.
    `delays`: of every input; in samples, or in seconds where `dt_s` is 0.
    """

    matrices: Matrices
    delays: tuple[float, ...]
    dt_s: float


def discrete(block: Block, dt_s: float) -> tuple[Matrices, tuple[int, ...]]:
    """(A, B, C, D) of a step of `dt_s`, and by how many samples every input enters late."""
    if block.dt_s > 0.0:
        return block.matrices, tuple(round(d) for d in block.delays)
    a, b, c, d = block.matrices
    n, n_u = b.shape
    late = [seconds / dt_s for seconds in block.delays]
    whole = [int(np.floor(samples + WHOLE)) for samples in late]
    part = [max(samples - w, 0.0) for samples, w in zip(late, whole, strict=True)]
    split = [f if f > WHOLE else 0.0 for f in part]
    now = np.zeros((n, n_u))
    before = np.zeros((n, n_u))
    for j, f in enumerate(split):
        step, now[:, j] = _held(a, b[:, j], (1.0 - f) * dt_s)
        before[:, j] = step @ _held(a, b[:, j], f * dt_s)[1]
    moved = _held(a, b[:, 0], dt_s)[0]
    kept = [j for j, f in enumerate(split) if f > 0.0]
    at_once = np.where(np.isin(np.arange(n_u), kept), 0.0, d)
    big_a = np.block([[moved, before[:, kept]], [np.zeros((len(kept), n + len(kept)))]])
    big_b = np.vstack([now, np.eye(n_u)[kept]])
    return (big_a, big_b, np.hstack([c, d[:, kept]]), at_once), tuple(whole)


def _held(a: FloatArray, b: FloatArray, seconds: float) -> tuple[FloatArray, FloatArray]:
    """e^(A t) and int_0^t e^(A s) ds b."""
    from scipy.linalg import expm

    n = len(a)
    both = np.zeros((n + 1, n + 1))
    both[:n, :n] = a * seconds
    both[:n, n] = b * seconds
    moved: FloatArray = expm(both)
    return moved[:n, :n], moved[:n, n]


def side_by_side(rows: Sequence[Sequence[Block]], dt_s: float) -> tuple[Matrices, tuple[int, ...]]:
    """One system of blocks with one input and output each, outputs outermost; and the inputs' delays."""
    parts = [[discrete(block, dt_s) for block in row] for row in rows]
    n_u = len(parts[0])
    common = tuple(min(row[j][1][0] for row in parts) for j in range(n_u))
    size = 0
    cells: list[tuple[int, int, Matrices]] = []
    for i, row in enumerate(parts):
        for j, (matrices, late) in enumerate(row):
            more = with_registers(matrices, (late[0] - common[j],))
            cells.append((i, j, more))
            size += len(more[0])
    a = np.zeros((size, size))
    b = np.zeros((size, n_u))
    c = np.zeros((len(parts), size))
    d = np.zeros((len(parts), n_u))
    at = 0
    for i, j, (own_a, own_b, own_c, own_d) in cells:
        own = slice(at, at + len(own_a))
        a[own, own] = own_a
        b[own, [j]] = own_b
        c[[i], own] = own_c
        d[i, j] = own_d[0, 0]
        at += len(own_a)
    return (a, b, c, d), common


def from_polynomials(numerator: FloatArray, denominator: FloatArray) -> Matrices:
    """(A, B, C, D) of a quotient of polynomials in falling powers of s or z.

    Raises UsageError: improper, or nothing below the line.
    """
    below = np.trim_zeros(np.asarray(denominator, dtype=np.float64).ravel(), "f")
    above = np.trim_zeros(np.asarray(numerator, dtype=np.float64).ravel(), "f")
    if not len(below):
        raise UsageError("the denominator is zero")
    if len(above) > len(below):
        raise UsageError("the transfer function is improper: it would have to know the future")
    n = len(below) - 1
    above = np.concatenate([np.zeros(len(below) - len(above)), above]) / below[0]
    below = below / below[0]
    a = np.eye(n, k=-1)
    a[:1] = -below[1:]
    return a, np.eye(n, 1), (above[1:] - above[0] * below[1:])[None], above[:1][:, None]


def in_falling_powers(above: FloatArray, below: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients in rising powers of the delay as such in falling powers of z."""
    size = max(len(above), len(below))
    return np.pad(above, (0, size - len(above))), np.pad(below, (0, size - len(below)))
