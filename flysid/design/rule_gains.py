"""Gains for every rule from linear matrix inequalities, and among those the ones that keep the bounds.

For unknown Q > 0, M_r and g, with V = Q^-1 and K_r = -M_r V, the corners C of the certificate become

    [ d^2 Q  (C Q)'  (E Q)'  (rho D)' ]
    [ C Q     Q                       ]  > 0,   [ 1   x0' ] > 0,   [ Q    M_r'   ] > 0
    [ E Q            g I              ]         [ x0  Q   ]        [ M_r  limit^2 ]
    [ rho D                  g        ]

decay d, cost g of position, its sum and the input's changes (D = M - e Q, e picks the last input) from the
start x0, input inside its limit from there (Boyd et al., 1994; Tanaka and Wang, 2001, chapters 3 and 6).
Solved by flysid's own interior point in coordinates in which the mean rule's Riccati solution is the
identity. The weights of the cost are chosen so that every rule's gains keep the same bounds on every plant as
a PID has to, at the least cost of the worst.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from flysid.dataset import FloatArray
from flysid.design.certificate import proves
from flysid.design.drawn_plants import PlantSet
from flysid.design.gain_search import OUT_OF_BOUNDS, Bounds
from flysid.design.law import LoopParts
from flysid.design.loopfigures import Figures, figures_of_paths
from flysid.design.rule_plants import RuleLaw, RulePlant
from flysid.errors import DataError
from flysid.model.linear_matrix_inequalities import Block, cheapest, slackless, symmetric_basis, value_at

SHARE = 0.05
"""To which the cost is made least; the bounds decide, not its last digits."""
STEPS_M = (1.0, 0.3)
"""The ellipsoid of one metric for all rules holds the input far more tightly than one response needs."""


def search_rule_gains(
    plant: RulePlant,
    plants: PlantSet,
    bounds: Bounds,
    limit: float,
    decay: float = 1.0,
) -> RuleLaw:
    """The certified gains that keep the bounds on every plant and cost the worst least.

    `plants`: with a positive gain.
    `limit`: of the input, kept from an error of position as large as the bounds afford (`STEPS_M`).
    Raises DataError: no certified gains keep the bounds.
    """
    parts = LoopParts.at(plants.omega, plants.dt_s)
    best: tuple[float, RuleLaw] | None = None
    for step_m, effort, total in product(STEPS_M, np.geomspace(0.3, 10.0, 7), (0.003, 0.01, 0.03, 0.1)):
        law = certified_gains(plant, effort, total, limit, step_m, decay)
        if law is None or not law.is_stable_itself():
            continue
        cost = float(bounds.cost(law_figures(law, plants, parts)).max())
        if best is None or cost < best[0]:
            best = cost, law
    if best is None or best[0] >= OUT_OF_BOUNDS:
        raise DataError(
            "no certified gains of the rules keep Ms, peak, noise and crossover within bounds on all plants",
            hint="allow more (--ms, --noise), or --method pid",
        )
    return best[1]


def law_figures(law: RuleLaw, plants: PlantSet, parts: LoopParts) -> Figures:
    """(R, P) figures of every rule's gains on every plant."""
    seen, place = law.paths(plants.omega)
    centre = seen + place * parts.place
    return figures_of_paths(centre[:, None], place[:, None], seen[:, None], plants.responses, parts)


def certified_gains(
    plant: RulePlant, effort: float, total: float, limit: float, step_m: float, decay: float
) -> RuleLaw | None:
    """The cheapest gains for one choice of weights, proved afterwards; None where there are none.

    `effort`: weight of the input's change in a sample beside an error of 1 m.
    `total`: weight of the sum of the error.
    """
    found = _riccati(plant, effort, total)
    if found is None:
        return None
    T, first = found
    back = np.linalg.inv(T)
    a = back @ plant.a @ T
    b = plant.b @ back.T
    n = plant.order
    errors = np.zeros((2, n))
    errors[0, n - 2] = 1.0
    errors[1, n - 1] = total
    start = np.zeros((1, n))
    start[0, n - 2] = step_m
    blocks = _blocks(a, b, errors @ T, effort * T[[plant.speeds]], effort, start @ back.T, limit, decay)
    x = _inside(blocks, -first @ T, len(a), float(np.sum((back @ start[0]) ** 2)))
    if x is None:
        return None
    cost = np.zeros(len(x))
    cost[-1] = 1.0
    x = cheapest(blocks, cost, x, SHARE)
    E = symmetric_basis(n)
    Q = np.tensordot(x[: len(E)], E, 1)
    M = x[len(E) : -1].reshape(len(a), n)
    gains = -np.linalg.solve(Q, M.T).T @ back
    metric = back.T @ np.linalg.inv(Q) @ back
    metric = metric / np.abs(metric).max()
    spread = np.linalg.inv(metric)
    reach = limit / np.sqrt(np.einsum("ri,ij,rj->r", gains, spread, gains).max() * metric[n - 2, n - 2])
    if not proves(plant.a, plant.b, gains, metric, decay):
        return None
    return RuleLaw(plant, gains, metric, decay, float(reach))


def _riccati(plant: RulePlant, effort: float, total: float) -> tuple[FloatArray, FloatArray] | None:
    """(n, n) coordinates x = T z in which the mean rule's Riccati solution is the identity, and its gains."""
    from scipy.linalg import LinAlgError, cholesky, solve_discrete_are

    n = plant.order
    weights = np.diag([1e-6] * (n - 2) + [1.0, total**2])
    last = np.eye(n)[plant.speeds]
    b = plant.b.mean(axis=0)
    a = plant.a.mean(axis=0) + np.outer(b, last)  # driven by changes of the input
    try:
        P = solve_discrete_are(a, b[:, None], weights, np.array([[effort**2]]))
        return np.linalg.inv(cholesky(P)), b @ P @ a / (effort**2 + b @ P @ b) - last
    except (LinAlgError, ValueError):
        return None


def _blocks(
    a: FloatArray,
    b: FloatArray,
    errors: FloatArray,
    held: FloatArray,
    effort: float,
    starts: FloatArray,
    limit: float,
    decay: float,
) -> list[Block]:
    """The inequalities over Q, M_1 ... M_R, g."""
    count, n, _ = a.shape
    E = symmetric_basis(n)
    size = len(E) + count * n + 1
    Qs = np.zeros((size, n, n))
    Qs[: len(E)] = E
    Ms = np.zeros((count, size, 1, n))
    for r in range(count):
        first = len(E) + r * n
        Ms[r, first : first + n, 0] = np.eye(n)
    found: list[Block] = []
    rows = 2 * n + len(errors) + 1
    for i in range(count):
        for j in range(i, count):
            F = np.zeros((size, rows, rows))
            moved = 0.5 * (a[i] @ Qs + b[i][:, None] * Ms[j] + a[j] @ Qs + b[j][:, None] * Ms[i])
            F[:, :n, :n] = decay**2 * Qs
            F[:, n : 2 * n, n : 2 * n] = Qs
            F[:, n : 2 * n, :n] = moved
            F[:, 2 * n : -1, :n] = errors @ Qs
            F[:, -1:, :n] = effort * 0.5 * (Ms[i] + Ms[j]) - held @ Qs
            F[-1, 2 * n :, 2 * n :] = np.eye(len(errors) + 1)
            lower = np.tril(F, -1)
            found.append((np.zeros((rows, rows)), np.tril(F) + lower.transpose(0, 2, 1)))
    for x0 in starts:
        F0 = np.zeros((n + 1, n + 1))
        F0[0, 0] = 1.0
        F0[0, 1:] = F0[1:, 0] = x0
        F = np.zeros((size, n + 1, n + 1))
        F[:, 1:, 1:] = Qs
        found.append((F0, F))
    for r in range(count):
        F0 = np.zeros((n + 1, n + 1))
        F0[0, 0] = limit**2
        F = np.zeros((size, n + 1, n + 1))
        F[:, 1:, 1:] = Qs
        F[:, :1, 1:] = Ms[r]
        F[:, 1:, :1] = Ms[r].transpose(0, 2, 1)
        found.append((F0, F))
    return found


def _inside(blocks: list[Block], first: FloatArray, count: int, size: float) -> FloatArray | None:
    """Unknowns strictly inside, by way of a slack; None where there are none.

    `first`: (n,) M of every rule where Q is the identity: the mean rule's Riccati gains.
    `size`: of the start squared, in these coordinates.
    """
    E = symmetric_basis(len(first))
    scale = 1.5 * size
    x = np.concatenate([scale * np.einsum("kii->k", E), np.tile(scale * first, count), [2.0 * scale], [0.0]])
    slack = [(F0, np.concatenate([F, np.eye(len(F0))[None]])) for F0, F in blocks]
    worst = max(float(-np.linalg.eigvalsh(value_at(block, x))[0]) for block in slack)
    if worst < 0.0:
        return x[:-1]
    x[-1] = 1.5 * worst + 1e-3 * scale
    most = 1e3 * scale  # the search stays where the start is
    size_of = np.zeros((len(x), len(first), len(first)))
    size_of[: len(E)] = -E
    dear = np.zeros((len(x), 1, 1))
    dear[-2] = -1.0
    slack += [(most * np.eye(len(first)), size_of), (most * np.eye(1), dear)]
    found = slackless(slack, x)
    return None if found is None else found[:-1]
