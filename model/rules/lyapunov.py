"""A common quadratic Lyapunov function of several matrices: found wherever one exists, but for rounding.

P > 0 with g^2 P - A_r' P A_r > 0 for every rule r is a linear matrix inequality, and convex: an
interior-point method (Boyd, El Ghaoui, Feron and Balakrishnan 1994, section 2.4) lowers the slack s of

    g^2 P - A_r' P A_r + s I > 0,    0 < P < I

by Newton steps on t s less the logarithms of the determinants, until s < 0, or until the slack cannot come
below zero any more. The decay g is then made smaller by bisection. What is found is verified by Cholesky
factors, so that nothing rests on the search. With n states and R rules a step costs about R n^6 / 4: beyond
`MOST_STATES` it is not tried.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.barrier import slackless, symmetric_basis, value_at
from flysid.model.threads import on_one_thread

MOST_STATES = 16


@on_one_thread
def common_lyapunov(rules: Sequence[FloatArray], *, bisections: int = 6) -> tuple[FloatArray, float] | None:
    """(n, n) P > 0 and the worst factor by which sqrt(x'Px) shrinks per step; None where none was found.

    Parameters
    ----------
    rules : (n, n) matrices whose poles all lie inside the unit circle.
    bisections : of the decay.
    """
    if len(rules[0]) > MOST_STATES:
        return None
    T = _balancing(rules)
    balanced = [np.asarray(np.linalg.solve(T, A @ T), dtype=np.float64) for A in rules]
    best = _verified(_feasible(balanced, 1.0), balanced)
    if best is None:
        return None
    low = max(float(np.abs(np.linalg.eigvals(A)).max()) for A in rules)
    for _ in range(bisections):
        middle = 0.5 * (low + best[1])
        found = _verified(_feasible(balanced, middle), balanced)
        if found is None or found[1] >= best[1]:
            low = middle
        else:
            best = found
    back = np.linalg.inv(T)
    return np.asarray(back.T @ best[0] @ back), best[1]


def _balancing(rules: Sequence[FloatArray]) -> FloatArray:
    """(n, n) coordinates in which the mean rule is close to normal: x = T z."""
    from scipy.linalg import solve_discrete_lyapunov

    mean = np.mean(rules, axis=0)
    radius = float(np.abs(np.linalg.eigvals(mean)).max())
    shrunk = mean if radius < 0.9999 else mean * (0.9999 / radius)
    P = solve_discrete_lyapunov(shrunk.T, np.eye(len(mean)))
    values, vectors = np.linalg.eigh(0.5 * (P + P.T))
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])))


def _verified(P: FloatArray | None, rules: Sequence[FloatArray]) -> tuple[FloatArray, float] | None:
    """P and its decay where that is below 1 beyond rounding."""
    if P is None:
        return None
    try:
        L = np.asarray(np.linalg.cholesky(P), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    decay = float(np.sqrt(max(max(_square_decay(A, P, L) for A in rules), 0.0)))
    return (P, decay) if decay < 1.0 - 1e-9 else None


def _square_decay(A: FloatArray, P: FloatArray, L: FloatArray) -> float:
    """Largest x'A'PAx / x'Px, P = L L'."""
    M = np.linalg.solve(L, np.linalg.solve(L, A.T @ P @ A).T)
    return float(np.linalg.eigvalsh(0.5 * (M + M.T))[-1])


def _feasible(rules: Sequence[FloatArray], g: float) -> FloatArray | None:
    """A P of the inequalities at decay g, scaled so that P < I; None where the slack stays above zero."""
    n = len(rules[0])
    E = symmetric_basis(n)
    blocks = [
        (
            np.zeros((n, n)),
            np.concatenate([g * g * E - A.T @ E @ A, np.eye(n)[None]]),
        )
        for A in rules
    ]
    still = np.zeros((1, n, n))
    blocks += [(np.zeros((n, n)), np.concatenate([E, still])), (np.eye(n), np.concatenate([-E, still]))]
    x = np.append(0.5 * np.einsum("kii->k", E), 0.0)
    worst = max(float(-np.linalg.eigvalsh(value_at(block, x))[0]) for block in blocks[:-2])
    if worst < 0.0:
        return 0.5 * np.eye(n)
    x[-1] = 2.0 * worst + 1e-3
    inside = slackless(blocks, x)
    return None if inside is None else np.asarray(np.tensordot(inside[:-1], E, 1))
