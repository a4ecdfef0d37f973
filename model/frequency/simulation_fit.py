"""A transfer function fitted to a measured frequency response.

    G_j(s) = e^(-tau_j s) N_j(s) / D(s),   one per input, the denominator common to all of one output

Start: Sanathanan & Koerner's (1963, IEEE Trans. Automatic Control 8) iterated linear least squares, for
several dead times. Then Levenberg-Marquardt on the log response, weighted as flight-test engineers do
(Tischler & Remple, 2012, eq. 11.4): 1 dB of gain counts like 7.57 degrees of phase, a point by its coherence,

    J = 20/n sum_k W_k [(gain error, dB)^2 + 0.01745 (phase error, deg)^2],  W = (1.58 (1 - e^(-g^2)))^2;

J below 100 is acceptable, below 50 nearly the data; or by the measured errors ("likelihood"). Covariance by
the sandwich formula with the measured errors and their correlation from frequency to frequency. Everything
is computed in omega / omega_0, omega_0 the middle of the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError, FitError
from flysid.model.frequency.rational import (
    Coordinates,
    Form,
    Hold,
    Rational,
    check_form,
    hold_response,
    is_determined,
)
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.frequency.sampling import sampled_response
from flysid.model.polynomials import DB, ComplexArray
from flysid.model.refine import levenberg_marquardt
from flysid.showing import counted

ACCEPTABLE = 100.0
PHASE_WEIGHT = 0.01745
FOLDING_ROUNDS = 2
SMALLEST_ERROR = 1e-4
"""Relative error below which a point gets no more weight: leakage and folding are there without noise."""

Weighting = Literal["coherence", "likelihood"]


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A transfer function fitted to a measured response.

    `covariance`: (p, p) of [denominator without its leading 1, numerators, free dead times].
    `cost`: Tischler's J per input.
    `chi2`: squared log errors in units of the measured errors, every point by what it tells alone.
    `points`: independent points (real numbers) behind it.
    `determined`: every pole is known well enough to be one; see `is_determined`.
    """

    form: Form
    rational: Rational
    covariance: FloatArray
    cost: FloatArray
    chi2: float
    points: float
    determined: bool

    @property
    def acceptable(self) -> bool:
        """Mean J below 100."""
        return float(self.cost.mean()) <= ACCEPTABLE

    @property
    def bic(self) -> float:
        """The level of the noise is not taken on trust."""
        return _bic(self.chi2, self.points, self.form.count)


def _bic(chi2: float, points: float, parameters: int) -> float:
    """n ln(chi2 / n) + p ln n."""
    n = max(points, 2.0)
    return float(n * np.log(max(chi2, 1e-300) / n) + parameters * np.log(n))


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points to fit, frequency in units of omega_0, and the weights of their two errors.

    `weight` (M, 2): of the error in ln |G| and in the phase in rad. `spread` (M,): measured standard error of
    both. `trust` (M,): Tischler's W. `where`, `source` (M,): index of the frequency and the input.
    `correlation` (M, M): of the points' errors.
    """

    x: FloatArray
    g: ComplexArray
    weight: FloatArray
    spread: FloatArray
    trust: FloatArray
    where: np.ndarray[tuple[int], np.dtype[np.int64]]
    source: np.ndarray[tuple[int], np.dtype[np.int64]]
    correlation: FloatArray
    omega_0: float
    dt_s: float
    form: Form

    @property
    def coordinates(self) -> Coordinates:
        """What the unknowns stand for."""
        return Coordinates(self.form, self.omega_0)

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(2M,) weighted errors of ln |G| and phase, and their Jacobian; NaN where the form forbids."""
        d, tops, delays = self.coordinates.split(theta)
        if not self.coordinates.allowed(theta):
            return np.full(2 * len(self.x), np.nan), np.full((2 * len(self.x), len(theta)), np.nan)
        s = 1j * self.x
        powers = s[:, None] ** np.arange(max(len(d), *(len(t) for t in tops)))
        bottom = powers[:, : len(d)] @ d
        error = np.empty(len(s), dtype=complex)
        slopes = np.zeros((len(s), len(theta)), dtype=complex)
        slopes[:, : self.form.poles] = -powers[:, : self.form.poles] / bottom[:, None]
        at = self.form.poles
        free = len(theta) - sum(t is None for t in self.form.dead_time_s)
        for j, top in enumerate(tops):
            mine = self.source == j
            value = powers[mine, : len(top)] @ top
            error[mine] = np.log(value / bottom[mine] * np.exp(-s[mine] * delays[j]) / self.g[mine])
            slopes[mine, at : at + len(top)] = powers[mine, : len(top)] / value[:, None]
            at += len(top)
            if self.form.dead_time_s[j] is None:
                slopes[mine, free] = -s[mine]
                free += 1
        residual = np.concatenate([error.real * self.weight[:, 0], error.imag * self.weight[:, 1]])
        jacobian = np.concatenate([slopes.real * self.weight[:, :1], slopes.imag * self.weight[:, 1:]])
        return residual, jacobian

    def chi2(self, errors: FloatArray) -> tuple[float, float]:
        """Squares of errors (2M,) of ln |G| and phase in units of the measured ones, every point by what it
        tells alone; and how many points (real numbers) that makes."""
        alone = 1.0 / np.maximum((self.correlation**2).sum(axis=1), 1.0)
        squares = (errors / np.tile(self.spread, 2)) ** 2
        return float(squares @ np.tile(alone, 2)), float(2.0 * alone.sum())

    def starts(self, *, dead_times: int = 7) -> list[FloatArray]:
        """Of Sanathanan & Koerner for several dead times; stable ones where the form asks for it."""
        free = [t is None for t in self.form.dead_time_s]
        longest = min(np.pi / 2, 0.5 * float(self.omega_0)) if any(free) else 0.0
        tried = np.linspace(0.0, longest, dead_times) if any(free) else [0.0]
        found = []
        for delay in tried:
            delays = np.array([delay if t is None else t * self.omega_0 for t in self.form.dead_time_s])
            d, tops = self._iterate(self.g * np.exp(1j * self.x * delays[self.source]))
            if self.form.stable:
                d = _reflect(d)
                tops = self._numerators(d, delays)
            theta = np.concatenate([d[:-1], *tops, delays[free]])
            if np.isfinite(theta).all():
                found.append(theta)
        return found

    def _iterate(self, g: ComplexArray, *, rounds: int = 8) -> tuple[FloatArray, list[FloatArray]]:
        """D and N_j minimising |N_j - g D|^2 / |g D_before|^2."""
        s = 1j * self.x
        n = self.form.poles
        zeros = self.form.zeros
        before = np.ones(len(s), dtype=complex)
        d = np.ones(1)
        tops = [np.ones(1)] * len(zeros)
        size = self.weight[:, 0]
        for _ in range(rounds):
            scale = (size / np.abs(g * before))[:, None]
            columns = [-g[:, None] * s[:, None] ** np.arange(n)]
            for j, m in enumerate(zeros):
                columns.append(np.where((self.source == j)[:, None], s[:, None] ** np.arange(m + 1), 0.0))
            matrix = np.hstack(columns) * scale
            goal = g * s**n * scale[:, 0]
            theta = np.linalg.lstsq(_stack(matrix), _stack(goal), rcond=1e-12)[0]
            d = np.append(theta[:n], 1.0)
            tops = np.split(theta[n:], np.cumsum([m + 1 for m in zeros])[:-1])
            before = np.polyval(d[::-1], s)
            before = np.where(np.abs(before) > 1e-9, before, 1e-9)
        return d, [np.asarray(t) for t in tops]

    def _numerators(self, d: FloatArray, delays: FloatArray) -> list[FloatArray]:
        s = 1j * self.x
        bottom = np.polyval(d[::-1], s)
        found = []
        for j, m in enumerate(self.form.zeros):
            mine = self.source == j
            columns = s[mine, None] ** np.arange(m + 1) / bottom[mine, None]
            columns = columns * np.exp(-s[mine] * delays[j])[:, None]
            scale = self.weight[mine, 0] / np.abs(self.g[mine])
            goal = self.g[mine] * scale
            theta = np.linalg.lstsq(_stack(columns * scale[:, None]), _stack(goal), rcond=1e-12)[0]
            found.append(np.asarray(theta, dtype=np.float64))
        return found


def _stack(values: npt.NDArray[Any]) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def _reflect(d: FloatArray) -> FloatArray:
    """The polynomial with its right-half-plane roots mirrored on the imaginary axis."""
    roots = np.roots(d[::-1])
    roots = -np.maximum(np.abs(roots.real), 1e-3) + 1j * roots.imag
    return np.asarray(np.real(np.poly(roots))[::-1]) if len(roots) else d


def fit_response(
    measured: MeasuredResponse,
    form: Form,
    *,
    weighting: Weighting = "coherence",
    hold: Hold = "zero",
    bands: Sequence[tuple[float, float]] | None = None,
    most_starts: int = 2,
) -> ResponseFit:
    """Fit a transfer function of given orders to the trustworthy points of a measured response.

    `bands`: per input, lowest and highest frequency to fit, rad/s; default: where the coherence counts.
    `hold`: what the input does between samples.
    Raises UsageError: orders that cannot be. Raises DataError: an input without trustworthy frequencies, or
    fewer points than parameters. Raises FitError: no start led anywhere.
    """
    check_form(form, len(measured.inputs))
    problem = _problem(measured, form, (weighting, hold, bands))
    if 2 * len(problem.x) <= form.count:
        raise DataError(
            f"trustworthy frequencies: {len(problem.x)}, too few for {counted(form.count, 'parameter')}",
            hint="choose lower orders, or excite a wider band",
        )
    starts = [(float(np.sum(problem.residuals(t)[0] ** 2)), t) for t in problem.starts()]
    starts = sorted((s for s in starts if np.isfinite(s[0])), key=lambda s: s[0])
    best = None
    for _, theta in starts[:most_starts]:
        found = levenberg_marquardt(problem.residuals, theta, max_iterations=60)
        if best is None or found.cost < best.cost:
            best = found
    if best is None:
        raise FitError(
            f"no transfer function with {form} fits the measured response",
            hint="choose other orders, or stable=False where the plant is unstable",
        )
    for _ in range(FOLDING_ROUNDS if hold != "none" else 0):
        problem = replace(problem, g=_unfold(measured, problem, best.theta, hold))
        best = levenberg_marquardt(problem.residuals, best.theta, max_iterations=30)
    return _finish(problem, best.theta, len(measured.inputs))


def _unfold(measured: MeasuredResponse, problem: _Problem, theta: FloatArray, hold: Hold) -> ComplexArray:
    """(M,) the measured response without what hold and folding (at the Nyquist frequency) add to it."""
    rational = problem.coordinates.rational(theta)
    omega = problem.x * problem.omega_0
    ratio = sampled_response(rational, omega, measured.dt_s, hold) / rational.at(omega)
    seen = measured.response[problem.where, problem.source]
    return np.asarray(seen / ratio[np.arange(len(omega)), problem.source])


def response_cost(
    measured: MeasuredResponse,
    rational: Rational,
    hold: Hold,
    bands: Sequence[tuple[float, float]] | None = None,
) -> FloatArray:
    """(n_u,) Tischler's J of any transfer function, over the points that `fit_response` would fit."""
    n_u = len(measured.inputs)
    form = Form(0, (0,) * n_u, (0.0,) * n_u)
    problem = _problem(measured, form, ("coherence", "none", bands))
    omega = problem.x * problem.omega_0
    model = sampled_response(rational, omega, measured.dt_s, hold)[np.arange(len(omega)), problem.source]
    error = np.log(model / problem.g)
    return _tischler(problem, np.concatenate([error.real, error.imag]), n_u)


def response_bic(measured: MeasuredResponse, response: ComplexArray, parameters: int) -> float:
    """BIC of a response (F, n_u) with so many parameters on the trustworthy points of a measured one.

    Raises DataError: an input without trustworthy frequencies.
    """
    n_u = len(measured.inputs)
    problem = _problem(measured, Form(0, (0,) * n_u, (0.0,) * n_u), ("coherence", "none", None))
    error = np.log(response[problem.where, problem.source] / problem.g)
    chi2, points = problem.chi2(np.concatenate([error.real, error.imag]))
    return _bic(chi2, points, parameters)


def _problem(
    measured: MeasuredResponse,
    form: Form,
    how: tuple[Weighting, Hold, Sequence[tuple[float, float]] | None],
) -> _Problem:
    weighting, hold, bands = how
    picked = [
        picked_points(measured, j, None if bands is None else bands[j]) for j in range(len(measured.inputs))
    ]
    source = np.concatenate([np.full(len(p), j) for j, p in enumerate(picked)])
    where = np.concatenate(picked)
    omega = measured.omega[where]
    spread = np.maximum(measured.error[where, source], SMALLEST_ERROR)
    trust = (1.58 * (1.0 - np.exp(-measured.coherence[where, source]))) ** 2
    if weighting == "coherence":
        count = np.array([len(p) for p in picked])[source]
        size = np.sqrt(20.0 / count * trust)
        weight = np.column_stack([size * DB, size * np.sqrt(PHASE_WEIGHT) * 180.0 / np.pi])
    else:
        weight = np.repeat(1.0 / spread[:, None], 2, axis=1)
    correlation = np.zeros((len(where), len(where)))
    for j, p in enumerate(picked):
        mine = np.flatnonzero(source == j)
        correlation[np.ix_(mine, mine)] = measured.correlation[j][np.ix_(p, p)]
    omega_0 = float(np.exp(np.mean(np.log(omega))))
    return _Problem(
        x=omega / omega_0,
        g=measured.response[where, source] / hold_response(omega, measured.dt_s, hold),
        weight=weight,
        spread=spread,
        trust=trust,
        where=where,
        source=source,
        correlation=correlation,
        omega_0=omega_0,
        dt_s=measured.dt_s,
        form=form,
    )


def picked_points(
    measured: MeasuredResponse, source: int, band: tuple[float, float] | None
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Indices of the points of one input to fit."""
    if band is not None:
        inside = (measured.omega >= band[0]) & (measured.omega <= band[1])
    else:
        inside = measured.trusted(source) > 0.0
    inside = inside & np.isfinite(measured.error[:, source]) & (np.abs(measured.response[:, source]) > 0.0)
    if np.count_nonzero(inside) < 3:
        if band is not None:
            low, high = measured.omega[[0, -1]]
            raise DataError(
                f"fewer than three frequencies were measured from {band[0]:.3g} to {band[1]:.3g} rad/s",
                hint=f"another band, or none; these data reach from {low:.3g} to {high:.3g} rad/s",
            )
        best = int(np.argmax(measured.coherence[:, source]))
        raise DataError(
            f"input {measured.inputs[source].name!r} explains {measured.output.name!r} at too few "
            "frequencies: "
            f"its coherence is at most {measured.coherence[best, source]:.2f}, "
            f"at {measured.omega[best]:.3g} rad/s (0.6 counts)",
            hint="excite this input more (a sweep or doublets), or leave it out of the recipe",
        )
    return np.flatnonzero(inside)


def _finish(problem: _Problem, theta: FloatArray, n_u: int) -> ResponseFit:
    residual, jacobian = problem.residuals(theta)
    m = len(problem.x)
    coordinates = problem.coordinates
    errors = np.concatenate([residual[:m] / problem.weight[:, 0], residual[m:] / problem.weight[:, 1]])
    chi2, points = problem.chi2(errors)
    covariance = _sandwich(problem, jacobian) * np.outer(coordinates.units, coordinates.units)
    covariance = covariance * inflation(chi2, points - len(theta))
    rational = coordinates.rational(theta)
    n = problem.form.poles
    falling = covariance[np.ix_(coordinates.falling, coordinates.falling)]
    seen = float(problem.x.min()) * problem.omega_0, np.pi / problem.dt_s
    return ResponseFit(
        form=problem.form,
        rational=rational,
        covariance=falling,
        cost=_tischler(problem, errors, n_u),
        chi2=chi2,
        points=points,
        determined=is_determined(rational, falling[:n, :n], seen),
    )


def inflation(chi2: float, freedom: float) -> float:
    """Where the form misses the points by more than chance (5 %), its parameters are as unsure as that says
    (Birge, 1932, Physical Review 40)."""
    from scipy.special import chdtri

    return max(1.0, chi2 / float(chdtri(max(freedom, 1.0), 0.05)))


def _sandwich(problem: _Problem, jacobian: FloatArray) -> FloatArray:
    """(JᵀJ)⁻¹ Jᵀ S J (JᵀJ)⁻¹, S the covariance of the weighted errors; NaN where J has lost a rank."""
    m = len(problem.x)
    size = np.sqrt(np.maximum((jacobian**2).sum(axis=0), 1e-300))
    j = jacobian / size
    try:
        inverse = np.linalg.inv(j.T @ j)
    except np.linalg.LinAlgError:
        return np.full((len(size), len(size)), np.nan)
    total = np.zeros_like(inverse)
    for half in (0, 1):
        scaled = j[half * m : (half + 1) * m] * (problem.weight[:, half] * problem.spread)[:, None]
        total += scaled.T @ problem.correlation @ scaled
    return np.asarray(inverse @ total @ inverse / np.outer(size, size))


def _tischler(problem: _Problem, errors: FloatArray, n_u: int) -> FloatArray:
    """(n_u,) J per input, from errors in ln |G| and rad."""
    m = len(problem.x)
    db = DB * errors[:m]
    deg = np.degrees(errors[m:])
    each = problem.trust * (db**2 + PHASE_WEIGHT * deg**2)
    return np.array([20.0 * float(np.mean(each[problem.source == j])) for j in range(n_u)])


def best_fit(fits: Sequence[ResponseFit]) -> tuple[ResponseFit, str]:
    """That of lowest BIC among those whose poles the data determine, and why; where they determine none, the
    one with the fewest parameters."""
    determined = sorted((f for f in fits if f.determined), key=lambda f: f.bic)
    if not determined:
        least = min(f.form.count for f in fits)
        determined = sorted((f for f in fits if f.form.count == least), key=lambda f: f.bic)
    best, *others = determined
    if not others:
        words = f"{best.form} on the measured response, cost J {best.cost.mean():.3g}"
    else:
        words = f"{best.form}: lowest BIC of {len(determined)} orders that the measured response determines, "
        words += f"cost J {best.cost.mean():.3g} (next "
        words += ", ".join(f"{f.form}: J {f.cost.mean():.3g}" for f in others[:2]) + ")"
    if not best.acceptable:
        words += "; above 100: no such transfer function describes these data well"
    return best, words
