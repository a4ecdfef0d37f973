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
from flysid.model.threads import on_one_thread

MOST_STATES = 16
_BISECTIONS = 6  # of the decay
_NEWTON = 40  # steps at one weight of the slack
_STEPS = 400  # altogether
_STEEPER = 4.0  # the weight of the slack grows by this,
_GAP = 1e-10  # until the slack is known this closely
_CENTRED = 1e-6  # of Newton's decrement


@on_one_thread
def common_lyapunov(rules: Sequence[FloatArray]) -> tuple[FloatArray, float] | None:
    """(n, n) P > 0 and the worst factor by which sqrt(x'Px) shrinks per step; None where none was found.

    Parameters
    ----------
    rules : (n, n) matrices whose poles all lie inside the unit circle.
    """
    if len(rules[0]) > MOST_STATES:
        return None
    T = _balancing(rules)
    balanced = [np.asarray(np.linalg.solve(T, A @ T), dtype=np.float64) for A in rules]
    best = _verified(_feasible(balanced, 1.0), balanced)
    if best is None:
        return None
    low = max(float(np.abs(np.linalg.eigvals(A)).max()) for A in rules)
    for _ in range(_BISECTIONS):
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
    E = _symmetric_basis(n)
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
    worst = max(float(-np.linalg.eigvalsh(_at(block, x))[0]) for block in blocks[:-2])
    if worst < 0.0:
        return 0.5 * np.eye(n)
    x[-1] = 2.0 * worst + 1e-3
    return _slackless(blocks, x, E)


def _slackless(
    blocks: Sequence[tuple[FloatArray, FloatArray]], x: FloatArray, E: FloatArray
) -> FloatArray | None:
    """P once the slack, the last of the unknowns x, is below zero."""
    weight = 1.0 / float(x[-1])
    steps = 0
    while steps < _STEPS:
        for _ in range(_NEWTON):
            g, H = _slopes(blocks, x, weight)
            step: FloatArray = np.asarray(np.linalg.lstsq(H, -g, rcond=1e-14)[0], dtype=np.float64)
            gain = float(-g @ step)
            steps = steps + 1
            size = _size(blocks, x, step, weight, gain) if gain > _CENTRED else 0.0
            if size == 0.0:
                break
            x = x + size * step
            if x[-1] < 0.0:
                return np.asarray(np.tensordot(x[:-1], E, 1))
        gap = 2.0 * len(blocks) * len(E[0]) / weight  # twice what the slack can still fall by from the centre
        if gap < max(_GAP, float(x[-1])):
            return None
        weight *= _STEEPER
    return None


def _slopes(
    blocks: Sequence[tuple[FloatArray, FloatArray]], x: FloatArray, weight: float
) -> tuple[FloatArray, FloatArray]:
    """Gradient and Hessian of the barrier."""
    g = np.zeros(len(x))
    H = np.zeros((len(x), len(x)))
    g[-1] = weight
    for F0, F in blocks:
        inverse = np.linalg.inv(np.linalg.cholesky(_at((F0, F), x)))
        G = inverse @ F @ inverse.T
        g -= np.einsum("kii->k", G)
        rows = G.reshape(len(x), -1)
        H += rows @ rows.T
    return g, H


def _size(
    blocks: Sequence[tuple[FloatArray, FloatArray]],
    x: FloatArray,
    step: FloatArray,
    weight: float,
    gain: float,
) -> float:
    """How much of a Newton step lowers the barrier; 0 where nothing does."""
    now = _barrier(blocks, x, weight)
    size = 1.0
    while size > 1e-10:
        if _barrier(blocks, x + size * step, weight) <= now - 1e-4 * size * gain:
            return size
        size *= 0.5
    return 0.0


def _barrier(blocks: Sequence[tuple[FloatArray, FloatArray]], x: FloatArray, weight: float) -> float:
    value = weight * float(x[-1])
    for block in blocks:
        try:
            L = np.linalg.cholesky(_at(block, x))
        except np.linalg.LinAlgError:
            return float("inf")
        value -= 2.0 * float(np.log(L.diagonal()).sum())
    return value


def _at(block: tuple[FloatArray, FloatArray], x: FloatArray) -> FloatArray:
    """(n, n) value of an affine block at the unknowns."""
    return np.asarray(block[0] + np.tensordot(x, block[1], 1))


def _symmetric_basis(n: int) -> FloatArray:
    """(n (n + 1) / 2, n, n) symmetric matrices, one entry above the diagonal each."""
    rows, columns = np.triu_indices(n)
    E = np.zeros((len(rows), n, n))
    at = np.arange(len(rows))
    E[at, rows, columns] = E[at, columns, rows] = 1.0
    return E
