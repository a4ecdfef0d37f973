"""A proof, in whole fractions, that a blend of rules under a blend of gains contracts in one metric.

    x(k+1) = sum_i w_i (A_i x + B_i u),      u = - sum_j w_j K_j x,      w >= 0, sum w = 1

is a convex blend of the corners  G_ii = A_i - B_i K_i  and  H_ij = (G_ij + G_ji) / 2, G_ij = A_i - B_i K_j
(Wang, Tanaka and Griffin, 1996). Where P > 0 and g^2 P - C' P C > 0 of every corner C, sqrt(x'Px) shrinks by
the factor g at least, a norm being convex. Definiteness is read off the pivots of elimination in `Fraction`:
floating-point numbers are fractions, so nothing is rounded. Nothing here knows how the numbers were found.

What it proves is a loop of the model at premises that are known, without limits of the input and without the
rules' constants; it proves nothing of the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

Matrix = list[list[Fraction]]


def proves(a: Any, b: Any, gains: Any, metric: Any, decay: float) -> bool:
    """Whether the numbers prove what stands above.

    `a`, `b`, `gains`: (R, n, n), (R, n), (R, n) as exported.
    `metric`: (n, n) P; its lower triangle counts.
    `decay`: g, at most 1.
    """
    if not 0.0 < decay <= 1.0:
        return False
    rules = [_exact(one) for one in a]
    pushes = [[Fraction(float(v)) for v in one] for one in b]
    laws = [[Fraction(float(v)) for v in one] for one in gains]
    lower = _exact(metric)
    size = len(lower)
    P = [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]
    square = Fraction(float(decay)) ** 2
    if not _positive(P):
        return False
    for i in range(len(rules)):
        for j in range(i, len(rules)):
            corner = _half(_close(rules[i], pushes[i], laws[j]), _close(rules[j], pushes[j], laws[i]))
            moved = _times(_transpose(corner), _times(P, corner))
            if not _positive(
                [[square * p - m for p, m in zip(*rows, strict=True)] for rows in zip(P, moved, strict=True)]
            ):
                return False
    return True


def _exact(rows: Any) -> Matrix:
    return [[Fraction(float(v)) for v in row] for row in rows]


def _close(a: Matrix, b: Sequence[Fraction], k: Sequence[Fraction]) -> Matrix:
    return [[v - push * gain for v, gain in zip(row, k, strict=True)] for row, push in zip(a, b, strict=True)]


def _half(one: Matrix, other: Matrix) -> Matrix:
    return [[(x + y) / 2 for x, y in zip(*rows, strict=True)] for rows in zip(one, other, strict=True)]


def _transpose(matrix: Matrix) -> Matrix:
    return [list(column) for column in zip(*matrix, strict=True)]


def _times(one: Matrix, other: Matrix) -> Matrix:
    columns = _transpose(other)
    return [[sum((x * y for x, y in zip(row, c, strict=True)), Fraction(0)) for c in columns] for row in one]


def _positive(matrix: Matrix) -> bool:
    """Whether every pivot of a symmetric matrix is positive."""
    rows = [list(row) for row in matrix]
    for k, pivot in enumerate(rows):
        if pivot[k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            share = rows[i][k] / pivot[k]
            for j in range(k, len(rows)):
                rows[i][j] -= share * pivot[j]
    return True
