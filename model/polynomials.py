"""Polynomials in the delay q⁻¹: difference coordinates, poles, stability, words.

A polynomial is its coefficients in rising powers of q⁻¹: 1 + a1 q⁻¹ + a2 q⁻² is [1, a1, a2].

Difference coordinates: at fast sampling the coefficients of a slow plant crowd around the binomials and
carry the dynamics in their last digits (all poles near 1). Written in (1 - q⁻¹)^(n-i) q⁻ⁱ, the numerator of
the delta operator (Middleton & Goodwin, 1990, Digital Control and Estimation), they do not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from math import comb
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.showing import significant

ComplexArray = npt.NDArray[np.complex128]


@cache
def monic_basis(n: int) -> tuple[FloatArray, FloatArray]:
    """Base (n,) and matrix (n, n): [a1..an] = base + matrix @ alpha for a monic polynomial of degree n."""
    base = np.array([(-1.0) ** i * comb(n, i) for i in range(1, n + 1)])
    matrix = np.zeros((n, n))
    for i in range(1, n + 1):
        for p in range(n - i + 1):
            matrix[i + p - 1, i - 1] = (-1.0) ** p * comb(n - i, p)
    return base, matrix


@cache
def free_basis(n: int) -> FloatArray:
    """(n, n) matrix: [b0..b(n-1)] = matrix @ beta, the columns (1 - q⁻¹)^(n-1-j) q⁻ʲ."""
    matrix = np.zeros((n, n))
    for j in range(n):
        for p in range(n - j):
            matrix[j + p, j] = (-1.0) ** p * comb(n - 1 - j, p)
    return matrix


def poles(a: FloatArray) -> ComplexArray:
    """Roots in z of a monic polynomial in q⁻¹, slowest first."""
    roots = np.roots(np.trim_zeros(np.asarray(a, dtype=np.float64), "b"))
    return np.asarray(roots[np.argsort(-np.abs(roots), kind="stable")])


def nearly_cancelled(pole: complex, numerators: Iterable[FloatArray], *, near_share: float = 0.1) -> bool:
    """Every input that does anything has a zero beside the pole, so that answers hardly show it.

    `numerators`: (nk + nb,) taps of every input, zeros up to its delay.
    `near_share`: of a pole's distance from one, which is that of its gain.
    """
    taps = [b for b in map(np.trim_zeros, numerators) if len(b)]
    near = [(np.abs(np.roots(b) - pole) < near_share * abs(1.0 - pole)).any() for b in taps]
    return bool(near) and all(near)


def stabilise(a: FloatArray, radius: float = 1.0) -> FloatArray:
    """The polynomial with every root outside the circle reflected into it (its spectrum keeps its shape)."""
    roots = np.roots(a)
    size = np.abs(roots)
    outside = size > radius
    if not outside.any():
        return a
    roots = np.where(outside, radius**2 * roots / np.maximum(size, 1e-300) ** 2, roots)
    inside = np.real(np.poly(roots))
    padded = np.zeros(len(a))
    padded[: len(inside)] = inside
    return padded


ROUNDING = float(np.sqrt(np.finfo(float).eps))
"""What stands for nothing beside one: a pole so near to the unit circle is on it."""
NEARLY_ONE = 0.999
"""A pole beyond it nearly integrates: the last digits of the coefficients decide gain and time constant."""
CONFIDENCE = 0.95
"""Of every interval, and of every difference that is called sure."""
Z95 = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0)
"""Standard errors either side of an interval."""
ONE_SIDED = NormalDist().inv_cdf(CONFIDENCE)
"""Standard errors beyond which a difference is sure."""
VANISHING = 1e-10
"""Share of the whole that counts as nothing: of a variance, an error's; of singular values, a direction's."""
RCOND = 1e-13
"""The same of singular values where nothing but rounding is in the way."""
DB = 20.0 / np.log(10.0)
"""Of a magnitude's natural logarithm."""


@dataclass(frozen=True)
class Mode:
    """A pole or a conjugate pair in continuous-time words.

    `pole`: in z.
    `frequency_rad_s`: natural frequency |ln z| / dt; inf for a pole at zero.
    `damping`: -cos of the angle of ln z; below 0 unstable.
    `time_constant_s`: -dt / ln |z|; inf on or outside the unit circle.
    """

    pole: complex
    frequency_rad_s: float
    damping: float
    time_constant_s: float

    def __str__(self) -> str:
        if self.frequency_rad_s == 0.0:
            return "integrator"
        if self.pole.imag:
            return f"{significant(self.frequency_rad_s, 4)} rad/s, damping {significant(self.damping)}"
        return (
            f"time constant {significant(self.time_constant_s, 4)} s"
            if self.damping > 0
            else "unstable, real"
        )


def modes_of(roots: ComplexArray, dt_s: float) -> tuple[Mode, ...]:
    """Poles in z as modes, one per conjugate pair."""
    found = []
    for pole in np.asarray(roots, dtype=complex):
        if pole.imag < 0:
            continue
        if pole == 0:
            found.append(Mode(0j, np.inf, 1.0, 0.0))
            continue
        s = np.log(pole) / dt_s
        radius = abs(pole)
        slow = -dt_s / np.log(radius) if radius < 1 else np.inf
        found.append(Mode(complex(pole), abs(s), -s.real / abs(s) if s else 1.0, float(slow)))
    return tuple(found)


def polynomial_text(coefficients: FloatArray, errors: FloatArray | None = None, *, most: int = 12) -> str:
    """ "1 - 1.5 (+- 0.04) q^-1 + 0.7 (+- 0.02) q^-2"; zero terms are left out, long ones cut short.

    `errors`: standard errors; half the width of a 95 % interval is shown, and no digits far below it.
    `most`: of a polynomial that is shown.
    """
    half = Z95 * (np.zeros(len(coefficients)) if errors is None else np.nan_to_num(errors))
    powers = [power for power, value in enumerate(coefficients) if value != 0.0]
    terms: list[str] = []
    for power in powers[:most]:
        value = coefficients[power]
        sign = ("-" if value < 0 else "") if not terms else (" - " if value < 0 else " + ")
        error = f" (+- {significant(half[power], 2)})" if half[power] > 0 else ""
        delay = f" q^-{power}" if power else ""
        terms.append(f"{sign}{_digits(abs(value), half[power])}{error}{delay}")
    more = len(powers) - most
    return ("".join(terms) or "0") + (f" + ... ({more} more, to q^-{powers[-1]})" if more > 0 else "")


def _digits(value: float, half: float) -> str:
    """Six digits, or as many as the uncertainty leaves."""
    if half > 0 and value > 0:
        places = int(np.ceil(-np.log10(half))) + 1
        if 0 <= places <= 12 and np.floor(np.log10(value)) + places < 6:
            return f"{value:.{places}f}"
    return f"{value:.6g}"
