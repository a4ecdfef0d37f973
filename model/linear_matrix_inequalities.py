"""Linear matrix inequalities F0 + x_1 F_1 + ... > 0 by an interior-point method.

A linear cost c'x less the logarithms of the determinants is minimised by Newton steps, the cost weighing more
and more (Boyd, El Ghaoui, Feron and Balakrishnan, 1994, section 2.4). What is found is to be verified by the
caller: nothing may rest on the search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flysid.dataset import FloatArray

Block = tuple[FloatArray, FloatArray]
"""F0 (m, m), and F (k, m, m) of the k unknowns."""
_STEPS = 400  # of Newton's
_STEEPER = 4.0  # the weight of the cost grows by this,
_CLOSE = float(np.sqrt(np.finfo(float).eps))  # until a slack is known this closely, and of Newton's decrement


def slackless(blocks: Sequence[Block], x: FloatArray) -> FloatArray | None:
    """(k,) unknowns once the slack, the last of them, is below zero; None where it stays above.

    `x`: strictly inside all blocks.
    """
    cost = np.eye(len(x))[-1]

    def known(gap: float, x: FloatArray) -> bool:
        return gap < max(_CLOSE, float(x[-1]))

    found = _follow(blocks, cost, x, 1.0 / float(x[-1]), known, lambda x: bool(x[-1] < 0.0))
    return found if found[-1] < 0.0 else None


def cheapest(blocks: Sequence[Block], cost: FloatArray, x: FloatArray, share: float) -> FloatArray:
    """(k,) unknowns whose cost is within a share of the least; strictly inside all blocks.

    `x`: strictly inside all blocks.
    """

    def known(gap: float, x: FloatArray) -> bool:
        return gap < share * abs(float(cost @ x))

    return _follow(blocks, cost, x, 1.0 / max(abs(float(cost @ x)), 1e-12), known, lambda _: False)


def _follow(
    blocks: Sequence[Block],
    cost: FloatArray,
    x: FloatArray,
    weight: float,
    known: Callable[[float, FloatArray], bool],
    enough: Callable[[FloatArray], bool],
) -> FloatArray:
    """Where the central path is left: the gap is known closely enough, or what was found is enough."""
    rows = sum(len(F0) for F0, _ in blocks)
    stacks = _stack(blocks)
    for _ in range(_STEPS):
        try:
            whitened = [_whiten(stack, x) for stack in stacks]
        except np.linalg.LinAlgError:  # at the edge, but for rounding
            return x
        g, H = _slopes(whitened, weight * cost)
        size_of = np.sqrt(np.diag(H))  # unknowns differ in size by far more than rounding bears
        scaled = np.linalg.lstsq(H / np.outer(size_of, size_of), -g / size_of, rcond=1e-14)[0]
        step: FloatArray = np.asarray(scaled / size_of, dtype=np.float64)
        gain = float(-g @ step)
        size = _size(whitened, step, weight * float(cost @ step), gain) if gain > _CLOSE else 0.0
        x = x + size * step
        if size == 0.0:
            if known(2.0 * rows / weight, x):  # twice what the cost can still fall by from the centre
                return x
            weight *= _STEEPER
        elif enough(x):
            return x
    return x


def _stack(blocks: Sequence[Block]) -> list[Block]:
    """F0 (b, m, m) and F (b, k, m, m) of the blocks of a size: one call for all of them."""
    sizes = dict.fromkeys(len(F0) for F0, _ in blocks)
    alike = [[block for block in blocks if len(block[0]) == size] for size in sizes]
    return [(np.stack([F0 for F0, _ in some]), np.stack([F for _, F in some])) for some in alike]


def _whiten(stack: Block, x: FloatArray) -> FloatArray:
    """(b, k, m, m) of blocks whose value at x is L L': inverse(L) F inverse(L)'."""
    inverse = np.linalg.inv(np.linalg.cholesky(stack[0] + np.einsum("k,bkij->bij", x, stack[1])))[:, None]
    return np.asarray(inverse @ stack[1] @ inverse.transpose(0, 1, 3, 2))


def _slopes(whitened: Sequence[FloatArray], cost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradient and Hessian of the barrier."""
    g = np.array(cost)
    H = np.zeros((len(g), len(g)))
    for G in whitened:
        g -= np.einsum("bkii->k", G)
        rows = G.transpose(1, 0, 2, 3).reshape(len(g), -1)
        H += rows @ rows.T
    return g, H


def _size(whitened: Sequence[FloatArray], step: FloatArray, slope: float, gain: float) -> float:
    """How much of a Newton step, along which the cost has this slope, lowers the barrier; 0: none of it."""
    values = [np.linalg.eigvalsh(np.einsum("k,bkij->bij", step, G)).ravel() for G in whitened]
    growth = np.concatenate(values)  # of the determinants: the product of 1 + size * growth
    size = 1.0
    while size > 1e-10:
        left = 1.0 + size * growth
        if left.min() > 0.0 and size * slope - float(np.log(left).sum()) <= -1e-4 * size * gain:
            return size
        size *= 0.5
    return 0.0


def value_at(block: Block, x: FloatArray) -> FloatArray:
    """(m, m) value of a block at the unknowns."""
    return np.asarray(block[0] + np.tensordot(x, block[1], 1))


def symmetric_basis(n: int) -> FloatArray:
    """(n (n + 1) / 2, n, n) symmetric matrices, one entry above the diagonal each."""
    rows, columns = np.triu_indices(n)
    E = np.zeros((len(rows), n, n))
    at = np.arange(len(rows))
    E[at, rows, columns] = E[at, columns, rows] = 1.0
    return E
