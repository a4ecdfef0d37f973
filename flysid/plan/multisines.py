"""Multisines that share no frequency between axes, with phases that keep their peaks low.

Every axis has whole multiples of one base frequency of its own, so that over a period the axes are orthogonal
and can be flown at once: Morelli, Multiple input design for real-time parameter estimation (SYSID 2003);
Grauer & Boucher on several loops. Phases start from Schroeder's rule (IEEE Trans. Inf. Theory, 1970) and
descend on ever higher norms of the signal, as Guillaume et al. (IEEE Trans. Instrum. Meas., 1991) do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.model.threads import on_one_thread

Lines = npt.NDArray[np.int64]

NORMS = (4, 16, 64, 256)
"""The largest value rules in the end."""
LOW = 1.08
"""A relative peak factor with which the search is content; 1.12 is the practice of flight tests."""


def shared_out(lines: Lines, axes: int) -> list[Lines]:
    """Lines dealt to the axes one by one, so that every axis has the whole band."""
    return [lines[axis::axes] for axis in range(axes)]


def relative_peak_factor(x: npt.ArrayLike) -> float:
    """(max - min) / (2 sqrt(2) rms): 1 for a sine, more where range is wasted (Morelli, 2003)."""
    values = np.asarray(x, dtype=np.float64)
    return float((values.max() - values.min()) / (2.0 * np.sqrt(2.0 * np.mean(values**2))))


def sum_of_lines(lines: Lines, phases_rad: FloatArray, n: int) -> FloatArray:
    """(n,) one period of unit cosines at whole multiples of the base frequency, all below n / 2."""
    spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * n * np.exp(1j * phases_rad)
    return np.asarray(np.fft.irfft(spectrum, n=n), dtype=np.float64)


def low_peak_phases(lines: Lines, seed: int = 0, *, starts: int = 24) -> FloatArray:
    """(K,) phases of equal lines with a low relative peak factor, the period beginning and ending at zero.

    `lines`: (K,) whole multiples of the base frequency, increasing.
    `seed`: of the random starts.
    `starts`: Schroeder's phases, then random ones: the descent ends in one of many valleys.

    >>> lines = np.arange(6, 120, 3)
    >>> relative_peak_factor(sum_of_lines(lines, low_peak_phases(lines), 4096)) < 1.12
    True
    """
    n = _fine(lines)
    rng = np.random.default_rng(seed)
    best = _descend(lines, -np.pi * np.arange(len(lines)) ** 2 / len(lines), n)
    low = _judge(lines, best, n)
    for _ in range(starts - 1):
        if low <= LOW:
            break
        other = _descend(lines, rng.uniform(0.0, 2.0 * np.pi, len(lines)), n)
        if _judge(lines, other, n) < low:
            best = other
            low = _judge(lines, other, n)
    return _from_zero(lines, best, 4 * n)


def _judge(lines: Lines, phases: FloatArray, n: int) -> float:
    return relative_peak_factor(sum_of_lines(lines, phases, 4 * n))


def _fine(lines: Lines, *, a_cycle: int = 8) -> int:
    """Samples of a period on which peaks show.

    `a_cycle`: of the highest line, while phases are sought; they are judged on four times as many.
    """
    return int(2 ** np.ceil(np.log2(a_cycle * lines.max())))


def _descend(lines: Lines, phases: FloatArray, n: int, *, steps: int = 60) -> FloatArray:
    """Phases of a low peak near those given: L-BFGS on the logarithm of each norm in turn.

    `steps`: of the descent on one norm; more gain little.
    """
    from scipy.optimize import minimize

    for norm in NORMS:
        way = {"maxiter": steps}
        phases = minimize(_norm_and_slope, phases, (lines, n, norm), "L-BFGS-B", jac=True, options=way).x
    return np.asarray(phases, dtype=np.float64)


def _norm_and_slope(phases: FloatArray, lines: Lines, n: int, norm: int) -> tuple[float, FloatArray]:
    """ln of the mean |x|^p to the 1/p, and its derivatives by the phases."""
    x = sum_of_lines(lines, phases, n)
    top = np.abs(x).max()
    relative = np.abs(x / top)
    weight = relative ** (norm - 1)
    total = float(np.mean(weight * relative))
    back = np.fft.rfft(np.sign(x) * weight)[lines]
    slope = np.imag(np.exp(-1j * phases) * back) / (n * top * total)
    return float(np.log(top) + np.log(total) / norm), np.asarray(slope)


def _from_zero(lines: Lines, phases: FloatArray, n: int) -> FloatArray:
    """The same signal, begun where it is nearest to zero and slowest: an aircraft is not jerked."""
    x = sum_of_lines(lines, phases, n)
    crossings = np.flatnonzero(np.signbit(x) != np.signbit(np.roll(x, -1)))
    gentlest = crossings[np.argmin(np.abs(np.roll(x, -1) - x)[crossings])]
    step = np.roll(x, -1)[gentlest] - x[gentlest]
    begin = gentlest - x[gentlest] / step
    moved = phases + lines * (2.0 * np.pi * begin / n)
    return np.asarray(np.mod(moved, 2.0 * np.pi))


def largest_correlation(columns: FloatArray) -> float:
    """Largest |correlation| between two different columns; 0 for a single one."""
    if columns.shape[1] < 2:
        return 0.0
    sizes = np.sqrt(np.sum(columns**2, axis=0))
    table = (columns.T @ columns) / np.outer(sizes, sizes)
    return float(np.abs(table - np.diag(np.diag(table))).max())


@on_one_thread
def phases_of_axes(lines: Sequence[Lines]) -> list[FloatArray]:
    """Low-peak phases for every axis."""
    return [low_peak_phases(own, seed) for seed, own in enumerate(lines)]
