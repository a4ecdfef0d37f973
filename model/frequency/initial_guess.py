"""Where the simulation-error fit of a transfer function starts: the measured frequency response, or, where
that cannot be trusted, a discrete output-error model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.detrend import Trend
from flysid.model.frequency.assemble import OneTransfer
from flysid.model.frequency.continuous_error import ContinuousError
from flysid.model.frequency.rational import Coordinates, Form, Hold, Rational, forms
from flysid.model.frequency.response import MeasuredResponse, Method, measure_response
from flysid.model.frequency.sampling import sampled_response
from flysid.model.frequency.simulation_fit import (
    ACCEPTABLE,
    ResponseFit,
    best_fit,
    fit_response,
    response_bic,
    response_cost,
)
from flysid.model.frequency.transfer import inverse_hold
from flysid.model.linear.data import Parts, records
from flysid.model.linear.output_error import find_delays, fit_output
from flysid.model.selection import STRONG
from flysid.model.simulation_error import OutputError, OutputOrders

Auto = Literal["auto"]


class GuessSettings(Protocol):
    """What a start needs to know; `TF` is such settings."""

    @property
    def poles(self) -> int | Auto: ...
    @property
    def zeros(self) -> int | Sequence[int] | Auto: ...
    @property
    def dead_time_s(self) -> float | Sequence[float | None] | Auto: ...
    @property
    def hold(self) -> Hold: ...
    @property
    def offset(self) -> bool: ...
    @property
    def nk_hint(self) -> Sequence[int]: ...
    @property
    def trend(self) -> Trend: ...
    @property
    def stable(self) -> bool: ...
    @property
    def refine(self) -> bool: ...
    @property
    def band(self) -> tuple[float, float] | None: ...
    @property
    def method(self) -> Method: ...
    @property
    def reference(self) -> Sequence[str]: ...


@dataclass(frozen=True, eq=False)
class Starts:
    """What the search for one output's transfer functions starts from.

    `measured`: the frequency response of the training data, None where it cannot be measured.
    `fits`: transfer functions fitted to it.
    `why`: the reason where there are none.
    """

    settings: GuessSettings
    parts: Parts
    candidates: tuple[Form, ...]
    measured: MeasuredResponse | None
    fits: tuple[ResponseFit, ...]
    why: DataError | FitError | None

    @classmethod
    def of(cls, settings: GuessSettings, parts: Parts, joint: Dataset) -> Starts:
        """Measure, on all training data (`joint`: with the references), and fit all orders that the settings
        leave open."""
        n_u = len(parts.train.inputs)
        candidates = tuple(forms(n_u, settings.poles, settings.zeros, settings.dead_time_s, settings.stable))
        # of all training data: half a chirp is half a band
        trend: Trend = "remove" if settings.trend == "estimate" else "none"
        fits: list[ResponseFit] = []
        why: DataError | FitError | None = None
        measured = None
        try:
            measured = measure_response(
                joint, reference=settings.reference, method=settings.method, trend=trend
            )
        except DataError as error:
            return cls(settings, parts, candidates, None, (), error)
        for form in candidates:
            try:
                fits.append(fit_response(measured, form, hold=settings.hold, bands=_bands(settings, n_u)))
            except (DataError, FitError) as error:
                why = error
        return cls(settings, parts, candidates, measured, tuple(fits), why)

    def refined(self) -> Iterator[tuple[OneTransfer, str]]:
        """One candidate per number of poles, refined on the simulation error, fewest poles first, each with
        words on where it comes from."""
        discrete = _Discrete(self.settings, self.parts)
        for n in sorted({f.poles for f in self.candidates}):
            own = sorted((f for f in self.fits if f.form.poles == n), key=lambda f: f.bic)
            start = discrete.start([c for c in self.candidates if c.poles == n])
            if own and own[0].rational.is_stable:
                found = _from_response(self.settings, self.parts, own, start)
            else:
                found = _from_output_error(self.settings, self.parts, start)
            if found is not None:
                yield found

    def unrefined(self) -> tuple[OneTransfer, str]:
        """The best fit to the measured response as it is. Raises DataError, FitError: there is none."""
        if not self.fits:
            raise self.why or FitError("no transfer function could be fitted", hint="choose other orders")
        best, words = best_fit(self.fits)
        return _keep_plain(self.settings, self.parts, best), words

    def strays(self, found: OneTransfer, *, most: float = 2.0, seen: float = 2.0) -> str:
        """Why a refined model is not to be kept: it has left the measured response; "" where it has not.

        It has where BIC on the measured response is strongly against it and the eye would see it, too.

        `most`: times the least cost J on the measured response.
        `seen`: and this much above it: 0.3 dB or 2.4 degrees over the whole band.
        """
        if self.measured is None or not self.fits:
            return ""
        bands = _bands(self.settings, len(self.measured.inputs))
        rational = found.problem.rational(found.theta)
        cost = float(response_cost(self.measured, rational, self.settings.hold, bands).mean())
        best = best_fit(self.fits)[0]
        least = float(best.cost.mean())
        if least > ACCEPTABLE or cost <= max(most * least, least + seen):
            return ""
        sampled = sampled_response(rational, self.measured.omega, self.measured.dt_s, self.settings.hold)
        if response_bic(self.measured, sampled, found.poles) <= best.bic + STRONG:
            return ""
        return (
            "; refined on the simulation error it leaves the measured response "
            f"(J {cost:.3g}, of the best fit {least:.3g}: drift, disturbances or a loop rule the free run), "
            "so that was not kept"
        )


def _bands(settings: GuessSettings, n_u: int) -> list[tuple[float, float]] | None:
    return None if settings.band is None else [settings.band] * n_u


@dataclass
class _Discrete:
    """Starts from discrete output-error models; the delays are looked for once."""

    settings: GuessSettings
    parts: Parts
    nk: tuple[int, ...] | None = None

    def start(self, candidates: Sequence[Form]) -> tuple[Form, Rational] | None:
        """The largest of some forms of equal poles with the coefficients of an output-error model; None where
        that has no counterpart in s."""
        if not self.settings.refine or not self.settings.stable:
            return None
        form = max(candidates, key=lambda f: (f.zeros, -sum(t is None for t in f.dead_time_s)))
        counts = (max(form.poles, 1),) * len(form.zeros)
        dt_s = self.parts.train.dt_s
        try:
            nk = self._delays(form)
            orders = OutputOrders(form.poles, counts, nk, self.settings.offset)
            fit = fit_output(OutputError(records(self.parts.fit, 0), orders))
            pairs = [
                inverse_hold(b, fit.transfer.a, k, dt_s) for b, k in zip(fit.transfer.b, nk, strict=True)
            ]
        except (DataError, FitError, UsageError):
            return None
        delayed = tuple((k - 1) * dt_s for k in nk)
        free = [f for f in candidates if f.zeros == form.zeros and None in f.dead_time_s]
        if any(delayed) and free:
            form = free[0]
        delays = [d if t is None else t for d, t in zip(delayed, form.dead_time_s, strict=True)]
        tops = [_cut(top, m + 1) for (top, _), m in zip(pairs, form.zeros, strict=True)]
        return form, Rational(pairs[0][1], tuple(tops), np.array(delays))

    def _delays(self, form: Form) -> tuple[int, ...]:
        """In samples, the hold's own included: as given, else by the simulation error of the start."""
        given = [t for t in form.dead_time_s if t is not None]
        if self.settings.dead_time_s != "auto" and len(given) == len(form.dead_time_s):
            return tuple(1 + round(t / self.parts.train.dt_s) for t in given)
        if self.nk is None:
            probe = min(2, form.poles)
            counts = (max(probe, 1),) * len(form.zeros)
            spoken_for = tuple(self.settings.nk_hint) or (1,) * len(counts)
            orders = OutputOrders(probe, counts, spoken_for, self.settings.offset)
            found = find_delays(self.parts.fit, 0, orders)
            self.nk = tuple(max(k, 1) for k in found)
        return self.nk


def _cut(top: FloatArray, size: int) -> FloatArray:
    """A numerator in falling powers without its highest, or with zeros for them."""
    return top[-size:] if len(top) >= size else np.append(np.zeros(size - len(top)), top)


def _from_response(
    settings: GuessSettings,
    parts: Parts,
    fits: Sequence[ResponseFit],
    discrete: tuple[Form, Rational] | None,
) -> tuple[OneTransfer, str] | None:
    """Fits to the response refined: that of lowest BIC and its twin with the dead time the other way; and,
    where it explains far more, one with all zeros from a discrete model."""
    best = fits[0]
    words = (
        f"{best.form} by BIC on the measured frequency response "
        f"(cost J {best.cost.mean():.3g}{'' if best.acceptable else ', above 100: a poor description'})"
    )
    twin = next((f for f in fits if f.form.zeros == best.form.zeros and f is not best), None)
    found = [r for r in (_refine(settings, parts, f.form, f.rational) for f in (best, twin) if f) if r]
    other = _refine(settings, parts, *discrete) if discrete else None
    if other is not None and (not found or _bic(other) < min(map(_bic, found)) - STRONG):
        form = other.problem.coordinates.form
        instead = "" if form.zeros == best.form.zeros else f"; {form} by BIC on the simulation error"
        return other, f"{words}{instead}, refined on the simulation error{_delay_words(other)}"
    if not found:
        return None
    kept = _prune(settings, parts, min(found, key=_bic))
    form = kept.problem.coordinates.form
    if form.zeros != best.form.zeros:
        words += f", {form} by BIC on the simulation error"
    return kept, f"{words}, refined on the simulation error{_delay_words(kept)}"


def _prune(settings: GuessSettings, parts: Parts, fit: OneTransfer) -> OneTransfer:
    """With fewer zeros as long as BIC on the simulation error agrees."""
    while settings.zeros == "auto" and max(fit.problem.coordinates.form.zeros, default=0) > 0:
        form = fit.problem.coordinates.form
        rational = fit.problem.rational(fit.theta)
        less = replace(form, zeros=tuple(max(m - 1, 0) for m in form.zeros))
        tops = tuple(n[-(m + 1) :] for n, m in zip(rational.numerators, less.zeros, strict=True))
        other = _refine(settings, parts, less, replace(rational, numerators=tops))
        if other is None or _bic(other) >= _bic(fit):
            return fit
        fit = other
    return fit


def _delay_words(kept: OneTransfer) -> str:
    free = any(t is None for t in kept.problem.coordinates.form.dead_time_s)
    return ", dead time estimated" if free else ""


def _bic(fit: OneTransfer) -> float:
    n = max(fit.problem.samples, 2)
    return float(n * np.log(max(fit.problem.cost(fit.theta), 1e-300) / n) + fit.count * np.log(n))


def _problem(
    settings: GuessSettings, parts: Parts, form: Form, rational: Rational, *, margin: float = 1.5
) -> ContinuousError:
    """`margin`: a dead time may grow by this factor while it is refined."""
    size = np.abs(np.roots(rational.denominator))
    omega_0 = float(np.exp(np.mean(np.log(np.maximum(size, 1e-3))))) if len(size) else 1.0
    dt_s = parts.train.dt_s
    skip = int(np.ceil(margin * float(rational.dead_time_s.max(initial=0.0)) / dt_s)) + form.poles + 4
    return ContinuousError(
        records=records(parts.fit, 0),
        coordinates=Coordinates(form, omega_0),
        dt_s=dt_s,
        hold=settings.hold,
        offset=settings.offset,
        trend=settings.trend,
        skip=skip,
    )


def _refine(
    settings: GuessSettings,
    parts: Parts,
    form: Form,
    rational: Rational,
    *,
    no_delay: float = 0.02,
    trial_steps: int = 15,
) -> OneTransfer | None:
    """From a start to the minimum; None where there is no way down or no segment is long enough.

    `no_delay`: of a sample: a dead time below is none.
    """
    problem = _problem(settings, parts, form, rational)
    theta = problem.coordinates.theta(rational)
    theta = np.append(theta, 0.0) if problem.has_offset else theta
    if not any(True for _ in problem.usable()) or not np.isfinite(problem.cost(theta)):
        return None
    try:
        found = problem.refine(theta, max_iterations=trial_steps)
    except FitError:
        return None
    ended = problem.rational(found.theta)
    none = tuple(
        0.0 if t is None and d < no_delay * problem.dt_s else t
        for t, d in zip(form.dead_time_s, ended.dead_time_s, strict=True)
    )
    if form.poles == 0 and settings.hold == "zero":  # a held gain tells a dead time to the sample only
        dt_s = problem.dt_s
        ended = replace(ended, dead_time_s=dt_s * np.ceil(ended.dead_time_s / dt_s - no_delay))
        none = tuple(float(d) for d in ended.dead_time_s)
    if none != form.dead_time_s:  # at its bound a dead time has no interval, and bends those of the others
        kept = [d if t is None else t for t, d in zip(none, ended.dead_time_s, strict=True)]
        ended = replace(ended, dead_time_s=np.array(kept))
        return _refine(settings, parts, replace(form, dead_time_s=none), ended)
    return OneTransfer(problem, found.theta)


def _keep_plain(settings: GuessSettings, parts: Parts, fit: ResponseFit) -> OneTransfer:
    """The fit to the frequency response as it is, its covariance in the coordinates of the problem."""
    problem = _problem(settings, parts, fit.form, fit.rational)
    coordinates = problem.coordinates
    theta = coordinates.theta(fit.rational)
    units = coordinates.units
    order = coordinates.falling
    covariance = np.zeros((problem.count, problem.count))
    covariance[np.ix_(order, order)] = fit.covariance / np.outer(units[order], units[order])
    if problem.has_offset:
        theta = np.append(theta, _best_offset(problem, theta))
    return OneTransfer(problem, theta, covariance)


def _best_offset(problem: ContinuousError, theta: FloatArray) -> float:
    """The offset of lowest simulation error; 0 for an unstable model."""
    errors = problem.errors(np.append(theta, 0.0))
    if errors is None:
        return 0.0
    ones = problem.errors(np.append(theta, 1.0))
    assert ones is not None
    slope = np.concatenate(ones) - np.concatenate(errors)
    return float(-(slope @ np.concatenate(errors)) / max(float(slope @ slope), 1e-300))


def _from_output_error(
    settings: GuessSettings, parts: Parts, discrete: tuple[Form, Rational] | None
) -> tuple[OneTransfer, str] | None:
    found = _refine(settings, parts, *discrete) if discrete else None
    if found is None:
        return None
    form = found.problem.coordinates.form
    return found, f"{form} from a discrete output-error model (no frequency could be trusted), refined"
