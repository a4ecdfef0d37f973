"""StructuredStateSpace: stability and control derivatives, by name.

A file says which entries of d x / dt = F x + G u(t - delay), y = H x + D u(t - delay) are free, fixed or tied
(`flysid.model.structured.plan_file`). All measured responses are fitted together; terms that they do not need
are dropped; what is left is sampled exactly and runs freely like any other model.

Source: Tischler & Remple (2012), Aircraft and Rotorcraft System Identification, ch. 12 to 14 (CIFER's DERIVID
and VERIFY).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError
from flysid.model.arguments import check_band
from flysid.model.detrend import Trend, check_trend, detrend
from flysid.model.frequency.rational import Hold
from flysid.model.frequency.response import measure_response, split_references
from flysid.model.linear.data import Parts
from flysid.model.linear.stability import unstable_words
from flysid.model.settings import Settings
from flysid.model.statespace import delayed_model
from flysid.model.stream import delayed_inputs
from flysid.model.structured.fitted_structured import (
    Derivative,
    FittedStructured,
    ResponseCost,
    of_state_space,
)
from flysid.model.structured.held_input import Held, held, whole_samples
from flysid.model.structured.joint_fit import (
    JointFit,
    JointProblem,
    Response,
    answers,
    coherent_responses,
    identifiable,
    starts,
)
from flysid.model.structured.plan_file import Plan, PlanLayout
from flysid.model.structured.superfluous import Dropped, without_superfluous
from flysid.model.subspace.order_search import built
from flysid.model.subspace.refinement import SystemFit
from flysid.model.subspace.triangle import Realisation
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class StructuredStateSpace(Settings):
    """Settings of a structured state-space model.

    Parameters
    ----------
    file : path of a TOML file, or a `Plan`; None: every output a state, every derivative and delay free.
    reference : inputs that drive a feedback loop from outside; those of the file when empty.
    prune : drop the terms that the responses do not need.
    band : lowest and highest frequency to fit, rad/s, of those where the coherence counts.
    hold : what inputs do between samples: "zero", "first" (they run straight) or "none" (band-limited).
    trend : "remove" takes a straight line out of every segment's signals first.
    n_init : measured samples that start a simulation; None chooses.

    Examples
    --------
    >>> model = flysid.StructuredStateSpace().fit(train)  # train: see `flysid.Dataset`
    >>> [d.name for d in model.derivatives][:2]
    ['y per y', 'y per u']
    """

    file: str | Path | Plan | None = None
    reference: Sequence[str] = ()
    prune: bool = True
    band: tuple[float, float] | None = None
    hold: Hold = "zero"
    trend: Trend = "none"
    n_init: int | None = None

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedStructured:  # noqa: ARG002
        """Measure all responses, fit, drop what is superfluous, and sample.

        Raises
        ------
        UsageError : settings or a file that cannot be; a name that the data do not have.
        DataError : no response with coherence, too many free terms, or terms that cannot be told apart.
        FitError : the starts lead nowhere.
        """
        self.check_settings()
        train = detrend(train, self.trend)
        plan = self._plan()
        reference = tuple(self.reference) or (plan.reference if plan else ())
        plant, references = split_references(train, reference)
        layout = (plan or Plan.full(plant.inputs, plant.outputs)).layout(plant.inputs, plant.outputs)
        measured = [
            measure_response(train, i, reference=reference, band=self.band) for i in range(len(train.outputs))
        ]
        responses, quiet = coherent_responses(measured)
        reached = answers(layout)
        deaf = [r for r in responses if not reached[r.output, r.source]]
        kept = tuple(r for r in responses if reached[r.output, r.source])
        if not kept:
            raise DataError("the structure lets no input reach an output", hint="check G, H and D")
        problem = JointProblem(layout, kept, train.dt_s, self.hold)
        fit, dropped = self._fit(problem)
        notes = _notes(layout, quiet, deaf)
        if dropped:
            notes = (*notes, f"Dropped: {'; '.join(f'{d.name} ({d.why})' for d in dropped)}.")
        own = [j for j in range(len(train.inputs)) if j not in references]
        model = _sample(self, Parts.of(train, None), _Sampling(problem, fit, self.hold, tuple(own)))
        return replace(model, derivatives=_derivatives(layout, fit, dropped), notes=(*notes, *model.notes))

    def _plan(self) -> Plan | None:
        return Plan.read(self.file) if isinstance(self.file, str | Path) else self.file

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be; the file is read where it is needed."""
        check_trend(self.trend, ("none", "remove"))
        check_band(self.band)
        self.at_least(1, "n_init")

    def check_settings(self) -> None:
        """Raise UsageError for a file that cannot be, whatever the data."""
        self._plan()

    def _fit(self, problem: JointProblem) -> tuple[JointFit, tuple[Dropped, ...]]:
        terms = problem.layout.terms
        free = identifiable(problem)
        unseen = [t.name for k, t in enumerate(terms) if k not in free]
        if unseen and not self.prune:
            raise DataError(
                f"no measured response shows {', '.join(unseen)}",
                hint="leave them out, excite the inputs that do, or let prune drop them",
            )
        dropped = [Dropped(name, 0.0, "no response with coherence shows it") for name in unseen]
        fit, negative = _without_negative_delays(problem, problem.fit(starts(problem, free), free))
        dropped += negative
        if self.prune:
            fit, more = without_superfluous(problem, fit)
            fit, negative = _without_negative_delays(problem, fit)
            dropped += (*more, *negative)
        return fit, tuple(dropped)


def _without_negative_delays(problem: JointProblem, fit: JointFit) -> tuple[JointFit, tuple[Dropped, ...]]:
    """The fit without delays below zero, the most negative one first, and those that went.

    Raises DataError: nothing else is free.
    """
    terms = problem.layout.terms
    dropped: list[Dropped] = []
    while negative := [k for k in fit.free if terms[k].is_delay and fit.theta[k] < 0.0]:
        worst = min(negative, key=fit.theta.item)
        why = f"it came out as {fit.theta[worst]:.2g} s: there is none"
        if len(fit.free) == 1:
            raise DataError(f"the only free term is {terms[worst].name}, and {why}", hint="free another term")
        dropped.append(Dropped(terms[worst].name, 0.0, why))
        fit = problem.fit(fit.theta, [k for k in fit.free if k != worst])
    return fit, tuple(dropped)


def _notes(layout: PlanLayout, quiet: Sequence[str], deaf: Sequence[Response]) -> tuple[str, ...]:
    notes = []
    if quiet:
        notes.append(f"Left out for want of coherence: {', '.join(quiet)}.")
    if deaf:
        words = ", ".join(
            f"{layout.outputs[r.output]} to {layout.inputs[r.source]} "
            f"({r.omega[0]:.2g} to {r.omega[-1]:.2g} rad/s)"
            for r in deaf
        )
        notes.append(f"Coherent, but without an answer in this structure: {words}.")
    return tuple(notes)


def _derivatives(layout: PlanLayout, fit: JointFit, dropped: Sequence[Dropped]) -> tuple[Derivative, ...]:
    gone = {d.name: d.why for d in dropped}
    return tuple(
        Derivative(
            name=t.name,
            value=float(fit.theta[k]),
            unit=t.unit,
            error=fit.error(k),
            insensitivity=float(fit.insensitivity[k]),
            dropped=gone.get(t.name, ""),
        )
        for k, t in enumerate(layout.terms)
    )


@dataclass(frozen=True, eq=False)
class _Sampling:
    """How a fitted continuous system is sampled; `own` are the data's inputs that are not references."""

    problem: JointProblem
    fit: JointFit
    hold: Hold
    own: tuple[int, ...]

    @cached_property
    def late(self) -> tuple[int, ...]:
        """Whole samples of delay."""
        delay = self.problem.layout.matrices(self.fit.theta)["delay"][0]
        return whole_samples(delay, self.problem.dt_s)

    @cached_property
    def registers(self) -> tuple[int, ...]:
        """Inputs that are late by more than whole samples, or by a time that is not sure."""
        layout = self.problem.layout
        parts = layout.matrices(self.fit.theta)["delay"][0] / self.problem.dt_s - self.late
        unsure = {p.column for k in self.fit.free for p in layout.terms[k].places if p.table == "delay"}
        return tuple(j for j, part in enumerate(parts) if abs(part) > 1e-9 or j in unsure)

    def system(self, theta: FloatArray) -> Held:
        """The sampled system with these values of the terms."""
        matrices = self.problem.layout.matrices(theta)
        return held(matrices, self.problem.dt_s, self.hold, self.registers, self.late)

    def among(self, columns: FloatArray, count: int) -> FloatArray:
        """(rows, count) with zeros for references."""
        out = np.zeros((len(columns), count))
        out[:, list(self.own)] = columns
        return out

    def realisation(self, theta: FloatArray, parts: Parts) -> Realisation:
        """Without noise and offsets, in physical units."""
        system = self.system(theta)
        n = len(system.a)
        n_y = len(system.c)
        n_u = len(parts.train.inputs)
        return Realisation(
            a=system.a,
            b=self.among(system.b, n_u),
            c=system.c,
            d=self.among(system.d, n_u),
            k=np.zeros((n, n_y)),
            drift=np.zeros(n),
            level=np.zeros(n_y),
            innovation=np.zeros((n_y, n_y)),
            state=np.zeros((n, n)),
        )


def _sample(settings: StructuredStateSpace, parts: Parts, sampling: _Sampling) -> FittedStructured:
    """The sampled model with offsets, start and noise from the training flights."""
    problem = sampling.problem
    fit = sampling.fit
    n_u = len(parts.train.inputs)
    late = tuple(int(k) for k in sampling.among(np.array([sampling.late]), n_u)[0])
    delayed = replace(parts, train=delayed_inputs(parts.train, late))
    scale = parts.scaling
    inverse = replace(scale, u_scale=1.0 / scale.u_scale, y_scale=1.0 / scale.y_scale)
    start = sampling.realisation(fit.theta, parts).in_units(inverse)
    radius = float(np.abs(np.linalg.eigvals(start.a)).max())
    errors = SystemFit(_pieces(delayed.whole.segments, radius), start, True)
    states = len(problem.layout.states)
    errors = replace(errors, start=_with_offsets(errors, states))
    plain = replace(
        built(delayed, errors.settled(errors.theta0), settings.n_init),
        free=len(fit.free),
        noise=errors.noise(errors.theta0),
        covariance=_sampled_covariance(sampling, parts),
    )
    if not plain.is_stable:
        plain = replace(plain, notes=(unstable_words(radius, parts.train.dt_s),))
    matrices = problem.layout.matrices(fit.theta)
    return of_state_space(
        delayed_model(plain, late),
        state_names=problem.layout.states,
        continuous={
            "F": matrices["F"],
            "H": matrices["H"],
            **{name: sampling.among(matrices[name], n_u) for name in ("G", "D", "delay")},
        },
        eigenvalue_errors=_eigenvalue_errors(problem.layout, fit),
        costs=tuple(
            ResponseCost(
                output=problem.layout.outputs[r.output],
                input=problem.layout.inputs[r.source],
                cost=float(cost),
                lowest_rad_s=float(r.omega[0]),
                highest_rad_s=float(r.omega[-1]),
            )
            for r, cost in zip(problem.responses, fit.cost, strict=True)
        ),
    )


def _pieces(segments: Sequence[Segment], radius: float, *, growth: float = 3.0) -> list[Segment]:
    """Segments; of an unstable system, pieces so short that their first states still count at their ends.

    `growth`: e-folds of an unstable system after which a run says nothing of its offsets any more.
    """
    if radius <= 1.0 + 1e-9:
        return list(segments)
    rows = max(round(growth / np.log(radius)), 8)
    return [s.slice(at, min(at + rows, len(s)), 1.0) for s in segments for at in range(0, len(s), rows)]


def _with_offsets(problem: SystemFit, states: int) -> Realisation:
    """The system with the drift of its states and the level of its outputs that fit best.

    The run is linear in them: one Gauss-Newton step is exact.
    """
    system = problem.start
    drift_at = system.a.size + system.b.size + system.c.size
    level_at = drift_at + system.order
    places = [*range(drift_at, drift_at + states), *range(level_at, level_at + len(system.c))]
    _, jtj, jtr = problem.normal_equations(problem.theta0)
    assert isinstance(jtj, np.ndarray)
    part = jtj[np.ix_(places, places)]
    size = np.sqrt(np.maximum(np.diag(part), np.finfo(float).tiny))
    inverse = np.linalg.pinv(part / np.outer(size, size), rcond=1e-9, hermitian=True)
    step = -(inverse @ (jtr[places] / size)) / size
    drift = system.drift.copy()
    drift[:states] = step[:states]
    return replace(system, drift=drift, level=step[states:])


def _sampled_covariance(sampling: _Sampling, parts: Parts, *, relative_step: float = 1e-3) -> FloatArray:
    """Of A, B, C, drift, level and D, from that of the terms; offsets count as known.

    `relative_step`: of a term's standard error, for derivatives of the sampled matrices.
    """

    def numbers(theta: FloatArray) -> FloatArray:
        r = sampling.realisation(theta, parts)
        return np.concatenate([m.ravel() for m in (r.a, r.b, r.c, r.drift, r.level, r.d)])

    fit = sampling.fit
    at = numbers(fit.theta)
    slopes = []
    for k in fit.free:
        step = relative_step * max(fit.error(k), 1e-9 * abs(float(fit.theta[k])))
        moved = fit.theta.copy()
        moved[k] += step
        slopes.append((numbers(moved) - at) / step)
    inner = np.stack(slopes, axis=1)
    covariance = fit.covariance[np.ix_(fit.free, fit.free)]
    return np.asarray(inner @ covariance @ inner.T)


def _eigenvalue_errors(layout: PlanLayout, fit: JointFit) -> FloatArray:
    """(n,) standard errors of F's eigenvalues in the complex plane, slowest first; NaN where two coincide."""
    from scipy.linalg import eig

    values, left, right = eig(layout.matrices(fit.theta)["F"], left=True)
    slopes = np.zeros((len(values), len(fit.theta)), dtype=np.complex128)
    for k in fit.free:
        for p in layout.terms[k].places:
            if p.table == "F":
                slopes[:, k] += p.factor * left[p.row].conj() * right[p.column]
    with np.errstate(all="ignore"):
        slopes /= np.einsum("ij,ij->j", left.conj(), right)[:, None]
        variance = np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes.conj()).real
    distance = np.abs(values[:, None] - values) + np.where(np.eye(len(values)) > 0.0, np.inf, 0.0)
    apart = distance.min(axis=1, initial=np.inf) > 1e-6 * np.abs(values)
    errors = np.where(apart, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    return np.asarray(errors[np.argsort(np.abs(values), kind="stable")])
