"""A transfer function in s as people quote it: coefficients, gain, modes, each with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.polynomials import Z95, ComplexArray
from flysid.showing import significant

Band = tuple[float, float]
"""Lowest and highest frequency, rad/s."""


@dataclass(frozen=True)
class TransferEstimate:
    """A figure and its standard error (NaN where unknown); prints with half the width of its interval.

    least, most : between these the truth lies, whatever was measured; the interval ends there, too, and is
        printed by its ends where it does.
    """

    value: float
    error: float
    least: float = -np.inf
    most: float = np.inf

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        half = Z95 * self.error
        return float(np.maximum(self.value - half, self.least)), float(
            np.minimum(self.value + half, self.most)
        )

    def __str__(self) -> str:
        if not self.error > 0:
            return significant(self.value, 4)
        low, high = self.interval
        if low <= self.least or high >= self.most:
            return f"{significant(self.value, 4)} [{significant(low, 2)}, {significant(high, 2)}]"
        return f"{significant(self.value, 4)} +- {significant(Z95 * self.error, 2)}"


@dataclass(frozen=True)
class ContinuousMode:
    """A real pole or a conjugate pair: natural frequency (rad/s), damping and, of a real pole, its time
    constant (s, negative where unstable)."""

    pole: complex
    frequency_rad_s: TransferEstimate
    damping: TransferEstimate
    time_constant_s: TransferEstimate | None

    def __str__(self) -> str:
        if self.pole.imag:
            word = "" if self.pole.real < 0 else "unstable: "
            return f"{word}{self.frequency_rad_s} rad/s, damping {self.damping}"
        if self.pole == 0:
            return "integrator"
        assert self.time_constant_s is not None
        spread = Z95 * self.time_constant_s.error * self.pole.real**2
        if spread > abs(self.pole.real):
            return f"not determined ({self.pole.real:.2g} +- {spread:.2g} rad/s)"
        if self.pole.real > 0:
            return f"unstable: doubles in {significant(np.log(2) / self.pole.real)} s"
        return f"time constant {self.time_constant_s} s"


@dataclass(frozen=True, eq=False)
class ContinuousTransfer:
    """G(s) = e^(-dead_time_s s) numerator(s) / denominator(s), one input to one output.

    Attributes
    ----------
    numerator, denominator : coefficients in falling powers of s; the denominator is monic.
    covariance : (m + n + 2, m + n + 2) of [numerator, denominator without its 1, dead time], m + 1 and n + 1
        their lengths; NaN where the model has none, 0 for what was not estimated.
    dead_time_s : delay beyond the hold's own sample.
    input, output : names.
    """

    numerator: FloatArray
    denominator: FloatArray
    covariance: FloatArray
    dead_time_s: float
    input: str
    output: str

    @property
    def errors(self) -> FloatArray:
        """Standard errors of [numerator, denominator without its 1, dead time]."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def numerator_error(self) -> FloatArray:
        """Standard errors of the numerator's coefficients."""
        return self.errors[: len(self.numerator)]

    @property
    def denominator_error(self) -> FloatArray:
        """Standard errors of the denominator's coefficients; 0 for the leading 1."""
        return np.append(0.0, self.errors[len(self.numerator) : -1])

    @property
    def dead_time(self) -> TransferEstimate:
        """Seconds."""
        return TransferEstimate(self.dead_time_s, float(self.errors[-1]), least=0.0)

    @property
    def poles(self) -> ComplexArray:
        """Roots of the denominator, rad/s."""
        return np.asarray(np.roots(self.denominator), dtype=np.complex128)

    @property
    def zeros(self) -> ComplexArray:
        """Roots of the numerator, rad/s."""
        return np.asarray(np.roots(self.numerator), dtype=np.complex128)

    @property
    def is_stable(self) -> bool:
        """Every pole lies in the left half plane."""
        return bool((self.poles.real < 0.0).all())

    @property
    def gain(self) -> TransferEstimate:
        """Steady gain G(0); NaN where the model integrates."""
        top = float(self.numerator[-1])
        bottom = float(self.denominator[-1])
        if bottom == 0.0:
            return TransferEstimate(np.nan, np.nan)
        slope = np.zeros(len(self.covariance))
        slope[len(self.numerator) - 1] += 1.0 / bottom
        if len(self.denominator) > 1:
            slope[-2] -= top / bottom**2
        return TransferEstimate(top / bottom, self._spread(slope))

    def at(self, omega: FloatArray) -> ComplexArray:
        """(F,) response at omega, rad/s."""
        s = 1j * np.asarray(omega, dtype=np.float64)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-s * self.dead_time_s))

    def error_at(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(F,) standard errors of ln |G| and of the phase in rad, first order."""
        s = 1j * np.asarray(omega, dtype=np.float64)
        m = len(self.numerator)
        n = len(self.denominator) - 1
        tops = s[:, None] ** np.arange(m - 1, -1, -1) / np.polyval(self.numerator, s)[:, None]
        bottoms = -(s[:, None] ** np.arange(n - 1, -1, -1)) / np.polyval(self.denominator, s)[:, None]
        slopes = np.hstack([tops, bottoms, -s[:, None]])
        return self._spreads(slopes.real), self._spreads(slopes.imag)

    @property
    def modes(self) -> tuple[ContinuousMode, ...]:
        """Poles, slowest first, one per conjugate pair, their figures with errors (delta method)."""
        found = [self._mode(p) for p in self.poles if p.imag >= 0.0]
        return tuple(sorted(found, key=lambda m: abs(m.pole)))

    def _mode(self, pole: complex) -> ContinuousMode:
        m = len(self.numerator)
        n = len(self.denominator) - 1
        steep = np.polyval(np.polyder(self.denominator), pole)
        slope = np.zeros(len(self.covariance), dtype=np.complex128)
        if abs(steep) > 0.0:
            slope[m : m + n] = -(pole ** np.arange(n - 1, -1, -1)) / steep
        size = abs(pole)
        if size == 0.0:
            return ContinuousMode(0j, TransferEstimate(0.0, np.nan), TransferEstimate(1.0, np.nan), None)
        along = (pole.real * slope.real + pole.imag * slope.imag) / size
        damping = -pole.real / size
        turn = -slope.real / size + pole.real * along / size**2
        real = (
            _same_sign(-1.0 / pole.real, self._spread(slope.real / pole.real**2)) if not pole.imag else None
        )
        return ContinuousMode(
            complex(pole),
            TransferEstimate(size, self._spread(along), least=0.0),
            TransferEstimate(damping, self._spread(turn) if pole.imag else 0.0, least=-1.0, most=1.0),
            real,
        )

    def _spread(self, slope: FloatArray) -> float:
        return float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))

    def _spreads(self, slopes: FloatArray) -> FloatArray:
        variance = np.einsum("fp,pq,fq->f", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def to_control(self, *, pade: int | None = None) -> Any:
        """As control.TransferFunction in s, with names.

        Parameters
        ----------
        pade : order of the Padé approximation that stands for the dead time.

        Raises
        ------
        UsageError : there is a dead time, which python-control cannot hold, and no `pade`.
        """
        import control

        plain = control.tf(self.numerator, self.denominator)
        if self.dead_time_s:
            if pade is None:
                raise UsageError(
                    f"python-control holds no dead time ({self.dead_time_s:.4g} s)",
                    hint="to_control(pade=3) approximates it; to_control() of the model, sampled, is exact",
                )
            plain = plain * control.tf(*control.pade(self.dead_time_s, pade))
        return control.tf(plain.num, plain.den, inputs=[self.input], outputs=[self.output])

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "input": self.input,
            "output": self.output,
            "numerator": self.numerator.tolist(),
            "denominator": self.denominator.tolist(),
            "dead_time_s": self.dead_time_s,
            "covariance": [[float(x) if np.isfinite(x) else None for x in row] for row in self.covariance],
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> ContinuousTransfer:
        """Rebuild; damage raises KeyError, TypeError or ValueError."""
        numerator = np.asarray(document["numerator"], dtype=np.float64)
        denominator = np.asarray(document["denominator"], dtype=np.float64)
        size = len(numerator) + len(denominator)
        covariance = np.asarray(document["covariance"], dtype=np.float64).reshape(size, size)
        names = str(document["input"]), str(document["output"])
        return cls(numerator, denominator, covariance, float(document["dead_time_s"]), *names)

    def carries_gain(self, band: Band) -> bool:
        """The steady gain is seen in a band (rad/s): no mode lies below it."""
        return all(abs(p) >= band[0] for p in self.poles)

    def carries_mode(self, mode: ContinuousMode, band: Band) -> bool:
        """A mode is seen in a band: it lies in it, or within an octave, where it bends the response still."""
        return band[0] / 2.0 <= abs(mode.pole) <= 2.0 * band[1] or mode.pole == 0

    def words_in(self, band: Band | None) -> str:
        """As `str`, without figures that a trusted band (rad/s) does not carry; None carries none."""
        if band is None:
            bare = replace(self, covariance=np.zeros_like(self.covariance))
            lines = bare._fraction()
            return "\n".join([*lines, "gain and poles: not determined, as no band can be trusted"])
        span = f"{band[0]:.3g} to {band[1]:.3g} rad/s"
        words = []
        if not np.isnan(self.gain.value):
            seen = self.carries_gain(band)
            why = f"not determined: a pole lies below the trusted band, {span}; fly longer, more slowly"
            words.append(self._gain_words() if seen else f"steady gain: {why}")
        modes = [
            str(m)
            if self.carries_mode(m, band)
            else f"not determined ({abs(m.pole):.3g} rad/s is outside it)"
            for m in self.modes
        ]
        words += [f"poles: {'; '.join(modes)}"] if modes else []
        return "\n".join([*self._fraction(), *words, *self._legend()])

    def __str__(self) -> str:
        words = [] if np.isnan(self.gain.value) else [self._gain_words()]
        words += ["poles: " + "; ".join(str(m) for m in self.modes)] if self.modes else []
        return "\n".join([*self._fraction(), *words, *self._legend()])

    def _fraction(self) -> list[str]:
        top = _text(self.numerator, self.numerator_error)
        bottom = _text(self.denominator, self.denominator_error)
        dead = f" e^(-{_exponent(self.dead_time)} s)" if self.dead_time_s else ""
        if len(self.denominator) == 1:
            return [f"{self.output} / {self.input} = {top}{dead}"]
        rule = "-" * max(len(top), len(bottom))
        return [f"{self.output} / {self.input} ={dead}", top, rule, bottom]

    def _gain_words(self) -> str:
        gain = self.gain
        known = Z95 * gain.error <= abs(gain.value) or np.isnan(gain.error)
        return f"steady gain: {gain}" if known else "steady gain: not determined"

    def _legend(self) -> list[str]:
        known = np.isfinite(self.errors).all() and self.errors.any()
        return ["(+- is half the width of a 95 % interval)"] if known else []


def _same_sign(value: float, error: float) -> TransferEstimate:
    """What is positive where stable, negative where unstable, and never 0."""
    if value > 0.0:
        return TransferEstimate(value, error, least=0.0)
    return TransferEstimate(value, error, most=0.0)


def _exponent(estimate: TransferEstimate) -> str:
    low, high = estimate.interval
    if estimate.error > 0 and low <= estimate.least:
        return f"{significant(estimate.value, 4)} [{significant(low, 2)}, {significant(high, 2)}]"
    return _spread_text(estimate.value, estimate.error)


def _spread_text(value: float, error: float) -> str:
    spread = f" (+- {significant(Z95 * error, 2)})" if error > 0 else ""
    return f"{significant(value, 4)}{spread}"


def _text(values: FloatArray, errors: FloatArray) -> str:
    terms: list[str] = []
    for position, (value, error) in enumerate(zip(values, errors, strict=True)):
        power = len(values) - 1 - position
        symbol = {0: "", 1: " s"}.get(power, f" s^{power}")
        lead = (
            symbol.strip()
            if value == 1.0 and power and not error > 0
            else f"{_spread_text(abs(value), error)}{symbol}"
        )
        sign = ("-" if value < 0 else "") if not terms else (" - " if value < 0 else " + ")
        terms.append(sign + lead)
    return "".join(terms)
