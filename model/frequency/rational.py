"""Transfer functions in s with dead time: their orders, their response, and the hold before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.polynomials import ComplexArray
from flysid.showing import counted

Hold = Literal["zero", "first", "none"]


@dataclass(frozen=True)
class Form:
    """Orders of one output: poles, zeros of every input, which dead times are free and their fixed values.

    `dead_time_s`: per input; None is estimated.
    `stable`: poles must lie in the left half plane.
    """

    poles: int
    zeros: tuple[int, ...]
    dead_time_s: tuple[float | None, ...]
    stable: bool = True

    @property
    def count(self) -> int:
        """Number of free coefficients and dead times."""
        return self.poles + sum(m + 1 for m in self.zeros) + sum(t is None for t in self.dead_time_s)

    def __str__(self) -> str:
        zeros = " and ".join(map(str, dict.fromkeys(self.zeros)))
        plural = "" if self.zeros and set(self.zeros) == {1} else "s"
        return f"{self.poles} pole{'' if self.poles == 1 else 's'}, {zeros or 'no'} zero{plural}"


@dataclass(frozen=True, eq=False)
class Rational:
    """N_j(s) / D(s) with dead times: coefficients in falling powers of s, D monic."""

    denominator: FloatArray
    numerators: tuple[FloatArray, ...]
    dead_time_s: FloatArray

    def at(self, omega: FloatArray) -> ComplexArray:
        """(F, n_u) response."""
        s = 1j * omega
        bottom = np.polyval(self.denominator, s)
        tops = [
            np.polyval(n, s) / bottom * np.exp(-s * t)
            for n, t in zip(self.numerators, self.dead_time_s, strict=True)
        ]
        return np.stack(tops, axis=1)

    @property
    def is_stable(self) -> bool:
        """Every pole lies in the left half plane."""
        return bool((np.roots(self.denominator).real < 0.0).all())


@dataclass(frozen=True)
class Coordinates:
    """Parameters of a form as numbers of size one: s in units of omega_0, powers rising.

    theta is [d_0 .. d_(n-1), numerators, free dead times], D = s^n + d_(n-1) s^(n-1) + ...
    """

    form: Form
    omega_0: float

    def split(self, theta: FloatArray) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        """D (monic, rising powers), numerators (rising), dead times in units of 1 / omega_0."""
        n = self.form.poles
        d = np.append(theta[:n], 1.0)
        tops = []
        at = n
        for m in self.form.zeros:
            tops.append(theta[at : at + m + 1])
            at += m + 1
        delays = np.zeros(len(tops))
        for j, fixed in enumerate(self.form.dead_time_s):
            delays[j] = theta[at] if fixed is None else fixed * self.omega_0
            at += fixed is None
        return d, tops, delays

    @property
    def units(self) -> FloatArray:
        """(p,) physical value of a one in theta."""
        n = self.form.poles
        parts = [self.omega_0 ** (n - np.arange(n, dtype=np.float64))]
        parts += [self.omega_0 ** (n - np.arange(m + 1, dtype=np.float64)) for m in self.form.zeros]
        parts.append(np.full(sum(t is None for t in self.form.dead_time_s), 1.0 / self.omega_0))
        return np.concatenate(parts)

    @property
    def falling(self) -> list[int]:
        """Where [denominator, numerators, dead times] in falling powers stand in theta."""
        order = list(range(self.form.poles))[::-1]
        at = self.form.poles
        for m in self.form.zeros:
            order += list(range(at, at + m + 1))[::-1]
            at += m + 1
        return order + list(range(at, self.form.count))

    def rational(self, theta: FloatArray) -> Rational:
        """In physical units."""
        physical = Coordinates(self.form, 1.0).split(theta * self.units)
        return Rational(physical[0][::-1], tuple(t[::-1] for t in physical[1]), physical[2])

    def theta(self, rational: Rational) -> FloatArray:
        """The coordinates of a transfer function of this form."""
        free = [
            t for t, fixed in zip(rational.dead_time_s, self.form.dead_time_s, strict=True) if fixed is None
        ]
        parts = [rational.denominator[1:][::-1], *(n[::-1] for n in rational.numerators), np.array(free)]
        return np.asarray(np.concatenate(parts) / self.units)

    def allowed(self, theta: FloatArray) -> bool:
        """No dead time below 0, and poles in the left half plane where the form asks for it."""
        d, _, delays = self.split(theta)
        stable = len(d) == 1 or not self.form.stable or bool((np.roots(d[::-1]).real < 0.0).all())
        return stable and not (delays < 0.0).any()


def is_determined(rational: Rational, covariance: FloatArray, seen: tuple[float, float]) -> bool:
    """Every pole is known to within half its size, is slow enough for the samples to show, and has no zero
    within its error that cancels it.

    A pole slower than the lowest frequency seen counts as an integrator and needs to be known to half of that
    only.

    `seen`: lowest and highest frequency that the data show, rad/s.
    `covariance`: (n, n) of the denominator's coefficients in falling powers, without the leading 1.
    """
    poles = np.roots(rational.denominator)
    n = len(poles)
    zeros = [np.roots(top) for top in rational.numerators]
    for pole in poles:
        steep = np.polyval(np.polyder(rational.denominator), pole)
        if abs(steep) == 0.0:
            return False
        slope = -(pole ** np.arange(n - 1, -1, -1)) / steep
        spread = float(np.sqrt(max((slope @ covariance @ np.conj(slope)).real, 0.0)))
        if not spread <= 0.5 * max(abs(pole), seen[0]) or abs(pole) > seen[1]:
            return False
        if all(len(z) and np.abs(z - pole).min() <= spread for z in zeros):
            return False
    return True


def check_form(form: Form, n_u: int) -> None:
    """Raise UsageError for orders that cannot be."""
    if form.poles < 0:
        raise UsageError(f"poles must be a whole number of at least 0, not {form.poles}")
    if len(form.zeros) != n_u or len(form.dead_time_s) != n_u:
        raise UsageError(
            f"{form} for {counted(n_u, 'input')}", hint="zeros and dead times: one number per input"
        )
    if any(not 0 <= m <= form.poles for m in form.zeros):
        raise UsageError(
            f"{form}: a transfer function has no more zeros than poles",
            hint="choose zeros between 0 and the number of poles",
        )
    if any(t is not None and not 0.0 <= t < np.inf for t in form.dead_time_s):
        raise UsageError("a dead time is at least 0 s")


def forms(
    n_u: int,
    poles: int | Literal["auto"] = "auto",
    zeros: int | Sequence[int] | Literal["auto"] = "auto",
    dead_time_s: float | Sequence[float | None] | Literal["auto"] = "auto",
    stable: bool = True,
    *,
    most_poles: int = 4,
) -> list[Form]:
    """All orders that settings leave open, fewest parameters first.

    Free zeros are fewer than the poles; a free dead time is tried as none and as estimated.
    Raises UsageError: orders that cannot be.
    """
    delays: list[tuple[float | None, ...]]
    if dead_time_s == "auto":
        delays = [(0.0,) * n_u, (None,) * n_u]
    elif isinstance(dead_time_s, (int, float)):
        delays = [(float(dead_time_s),) * n_u]
    else:
        delays = [tuple(None if t is None else float(t) for t in dead_time_s)]
    found = []
    for n in range(most_poles + 1) if poles == "auto" else [int(poles)]:
        for d in delays:
            if zeros == "auto":
                found += [Form(n, (m,) * n_u, d, stable) for m in range(max(n, 1))]
            else:
                fixed = (int(zeros),) * n_u if isinstance(zeros, int) else tuple(int(m) for m in zeros)
                found.append(Form(n, fixed, d, stable))
    if poles == "auto" and zeros != "auto":
        found = [f for f in found if max(f.zeros) <= f.poles]
    for form in found:
        check_form(form, n_u)
    return sorted(found, key=lambda f: (f.count, f.poles))


def hold_response(omega: FloatArray, dt_s: float, hold: Hold) -> ComplexArray:
    """(F,) what a hold between samples does to the measured response of the plant behind it.

    "zero": the input is constant between samples; "first": it runs straight; "none": band-limited.
    """
    half = omega * dt_s / 2.0
    shape = np.sinc(half / np.pi)
    if hold == "zero":
        return np.asarray(shape * np.exp(-1j * half))
    return np.asarray(shape**2 + 0j) if hold == "first" else np.ones(len(omega), dtype=complex)
