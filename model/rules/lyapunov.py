"""A common quadratic Lyapunov function of all rules: found wherever one exists, but for rounding.

It proves that outputs stay bounded under bounded inputs for any blend of rules, and that a run forgets its
start under any one sequence of firing strengths (Tanaka and Sugeno 1992). Where conditions speak of outputs,
two runs on the same inputs fire differently: runs show that these come together too
(`flysid.model.rules.boundedness`). Its absence proves nothing.

P > 0 with g^2 P - A_r' P A_r > 0 for every rule r is a linear matrix inequality, and convex: an
interior-point method (Boyd, El Ghaoui, Feron and Balakrishnan 1994, section 2.4) lowers the slack s of

    g^2 P - A_r' P A_r + s I > 0,    0 < P < I

by Newton steps on t s less the logarithms of the determinants, until s < 0, or until the slack cannot come
below zero any more. The decay g is then made smaller by bisection. What is found is verified by Cholesky
factors, so that nothing rests on the search. With n states and R rules a step costs about R n^6 / 4: beyond
`MOST_STATES` it is not tried.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.linear_matrix_inequalities import slackless, symmetric_basis, value_at
from flysid.model.polynomials import ROUNDING
from flysid.model.threads import on_one_thread

MOST_STATES = 16
CLOSEST = 1.0 - ROUNDING
"""Pole radius from which on no decay can be told from one, see `_verify`."""


@dataclass(frozen=True, eq=False)
class StabilityCertificate:
    """What could be proved about stability.

    Attributes
    ----------
    proved : a common quadratic Lyapunov function was found, and checked.
    P : (n, n) its matrix, symmetric positive definite; zeros where none was found.
    decay : the worst factor by which sqrt(x'Px) shrinks per step; at least 1 where nothing is proved.
    reason : in words.
    """

    proved: bool
    P: FloatArray
    decay: float
    reason: str


def certificate_of(rules: Sequence[FloatArray]) -> StabilityCertificate:
    """A P > 0 with A_r' P A_r - P < 0 for the (n, n) matrices of all rules, where one is found."""
    n = len(rules[0])
    nothing = np.zeros((n, n))
    if n == 0:
        return StabilityCertificate(True, nothing, 0.0, "The model has no memory of its outputs.")
    radii = _radii(rules)
    worst = int(np.argmax(radii))
    if max(radii) >= 1.0:
        return StabilityCertificate(
            False,
            nothing,
            max(radii),
            f"R{worst + 1} by itself is not stable (pole radius {radii[worst]:.4f}), so no common quadratic "
            "Lyapunov function of all rules exists; the blend may still be stable.",
        )
    if max(radii) >= CLOSEST:
        return StabilityCertificate(
            False,
            nothing,
            1.0,
            f"R{worst + 1} by itself is on the border of stability (its pole radius lacks "
            f"{1.0 - radii[worst]:.0e} to 1), so no proof can be given; the blend may still be stable.",
        )
    found = common_lyapunov(rules)
    if found is None:
        reason = "Every rule is stable, but no common quadratic Lyapunov function was found."
        return StabilityCertificate(False, nothing, 1.0, reason)
    P, decay = found
    shown = np.ceil(decay * 1e5) / 1e5
    reason = (
        f"A common quadratic Lyapunov function proves it: the norm of the state falls to {shown:.5f} of "
        "itself or less per step, for any blend of rules; bounded inputs give bounded outputs."
    )
    return StabilityCertificate(True, P, decay, reason)


@on_one_thread
def common_lyapunov(rules: Sequence[FloatArray], *, bisections: int = 6) -> tuple[FloatArray, float] | None:
    """(n, n) P > 0 and the worst factor by which sqrt(x'Px) shrinks per step; None where none was found.

    None, too, where the search breaks down: rules so near the border that rounding decides on them.

    Parameters
    ----------
    rules : (n, n) matrices whose poles all lie inside the unit circle.
    bisections : of the decay.
    """
    if len(rules[0]) > MOST_STATES or max(_radii(rules)) >= CLOSEST:
        return None
    try:
        return _search(rules, bisections)
    except np.linalg.LinAlgError:
        return None


def _search(rules: Sequence[FloatArray], bisections: int) -> tuple[FloatArray, float] | None:
    low = max(_radii(rules))
    T = _balancing(rules, low)
    balanced = [np.asarray(np.linalg.solve(T, A @ T), dtype=np.float64) for A in rules]
    best = _verify(_feasible(balanced, 1.0), balanced)
    if best is None:
        return None
    for _ in range(bisections):
        middle = 0.5 * (low + best[1])
        found = _verify(_feasible(balanced, middle), balanced)
        if found is None or found[1] >= best[1]:
            low = middle
        else:
            best = found
    back = np.linalg.inv(T)
    return np.asarray(back.T @ best[0] @ back), best[1]


def _radii(rules: Sequence[FloatArray]) -> list[float]:
    return [float(np.abs(np.linalg.eigvals(A)).max()) for A in rules]


def _balancing(rules: Sequence[FloatArray], radius: float) -> FloatArray:
    """(n, n) coordinates in which the mean rule, at most of this radius, is close to normal: x = T z.

    The present ones where rounding leaves no others: what is found is verified, whatever the coordinates.
    """
    from scipy.linalg import LinAlgWarning, solve_discrete_lyapunov

    mean = np.mean(rules, axis=0)
    (own,) = _radii([mean])
    mean = mean * (radius / own if own > radius else 1.0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            P = solve_discrete_lyapunov(mean.T, np.eye(len(mean)))
        return np.asarray(np.linalg.inv(np.linalg.cholesky(0.5 * (P + P.T))).T)
    except np.linalg.LinAlgError:
        return np.eye(len(mean))


def _verify(P: FloatArray | None, rules: Sequence[FloatArray]) -> tuple[FloatArray, float] | None:
    """P and its decay, the largest sqrt(x'A'PAx / x'Px), where that is below 1 beyond rounding."""
    from scipy.linalg import eigh

    if P is None:
        return None
    try:
        worst = max(float(eigh(A.T @ P @ A, P, eigvals_only=True)[-1]) for A in rules)
    except np.linalg.LinAlgError:  # not positive definite
        return None
    decay = float(np.sqrt(max(worst, 0.0))) + ROUNDING
    return (P, decay) if decay < 1.0 else None


def _feasible(rules: Sequence[FloatArray], g: float) -> FloatArray | None:
    """A P of the inequalities at decay g, scaled so that P < I; None where the slack stays above zero."""
    n = len(rules[0])
    E = symmetric_basis(n)
    nothing = np.zeros((n, n))
    blocks = [(nothing, np.concatenate([g * g * E - A.T @ E @ A, np.eye(n)[None]])) for A in rules]
    blocks += [
        (F0, np.concatenate([way * E, nothing[None]])) for F0, way in ((nothing, 1.0), (np.eye(n), -1.0))
    ]
    x = np.append(0.5 * np.einsum("kii->k", E), 0.0)
    worst = max(float(-np.linalg.eigvalsh(value_at(block, x))[0]) for block in blocks[:-2])
    if worst < 0.0:
        return 0.5 * np.eye(n)
    x[-1] = worst + 1.0
    inside = slackless(blocks, x)
    return None if inside is None else np.asarray(np.tensordot(inside[:-1], E, 1))
