"""The search for terms: one at a time, by the free run, from a linear model.

Forward: what every candidate would gain is computed to first order (`TermFit.gains`). The few best
are tried: all coefficients are refined on the free run and judged by the free run over held-out blocks of the
training data. The best stays if it is clearly better there (`model.selection`). Backward: the terms that say
least leave, as long as the held-out free run does not become clearly worse; then those that chance may have
picked among so many. Piroddi & Spinelli (2003), Int. J. Control 76; Billings (2013), Nonlinear System
Identification, chapter 3.

A term that lets the free run reach its limits under training inputs in random order, begun after random ones,
is not kept where the linear model does not reach them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import FitError
from flysid.model.linear.data import Parts, guard_s
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.narx.fitted_polynomial import FittedPolyNARX, Units
from flysid.model.narx.free_run_kernel import free_run
from flysid.model.narx.polynomial_terms import Factor, Term, candidates, depth_of, table_of, term_name
from flysid.model.narx.simulation_fit import TermFit
from flysid.model.rules.boundedness import PUSHES, probe_run
from flysid.model.selection import block_means, clearly_better
from flysid.model.start import MAX_SHARE, estimate_start, run_from_window, start_window
from flysid.progress import tell
from flysid.showing import significant

SEARCH_ROWS = 6_000
"""Samples, spread over the training data, that terms are searched on."""
TRIED = 4
"""Terms that are tried at a time."""
AHEAD = 2
"""Terms that are added before they have to be worth it together."""
CHANCE = 0.05
"""That any term is kept where none bends."""
_ITERATIONS = 5
_LAST_ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class RefinedTerms:
    """Terms, refined in every fold.

    `unknowns`: of every fold, coefficients and starts.
    `errors`: mean squared free-run errors of blocks of all held-out parts, in variances of the outputs.
    """

    terms: tuple[Term, ...]
    unknowns: tuple[FloatArray, ...]
    errors: FloatArray

    @property
    def rmse(self) -> str:
        """Held-out free-run error in standard deviations of the output."""
        return significant(float(np.sqrt(self.errors.mean())))


@dataclass(frozen=True, eq=False)
class TermSearch:
    """The data of a search, and what it starts from.

    `parts`: training data, and what judges.
    `start`, `theta`: terms and coefficients of the linear model.
    `depth`: rows that start every run of the search, at least the deepest lag.
    """

    parts: Parts
    units: Units
    start: tuple[Term, ...]
    theta: FloatArray
    depth: int

    @cached_property
    def folds(self) -> tuple[tuple[Dataset, Dataset], ...]:
        """What terms are fitted to, and what judges them; few enough rows."""
        least = round(self.depth / MAX_SHARE)
        return tuple(
            (spread(p.fitted, SEARCH_ROWS, least), spread(p.check, SEARCH_ROWS, least))
            for p in self.parts.folds
        )

    @cached_property
    def memory(self) -> int:
        """Rows of outputs that the linear model looks back at; no term looks back farther."""
        return depth_of(self.start, self.units.n_y)

    @cached_property
    def block(self) -> int:
        """Rows over which errors are alike: as long as an output remembers itself."""
        train = self.parts.train
        return max(round(guard_s(train) / train.dt_s), 1)

    @cached_property
    def limits(self) -> FloatArray:
        """(2, n_y) normalised output limits."""
        return self.units.limits(self.parts.limits)

    @cached_property
    def probe(self) -> FloatArray:
        """W of random inputs in the training range, then of shuffled training inputs."""
        whole = [self.units.joined(s.u, s.y) for s in self.parts.train.segments]
        return probe_run(whole, self.units.n_y, PUSHES, seed=0)

    @cached_property
    def base(self) -> tuple[Factor, ...]:
        """Signals that terms are made of: each newest output, its change, and each input as it first acts."""
        n_y = self.units.n_y
        found = [Factor(i, 1, change) for i in range(n_y) for change in (False, True)[: self.memory]]
        first: dict[int, int] = {}
        for factor in (f for t in self.start for f in t.factors if f.column >= n_y):
            first[factor.column] = min(factor.lag, first.get(factor.column, factor.lag))
        return (*found, *(Factor(column, lag) for column, lag in sorted(first.items())))

    def usable(self, data: Dataset) -> list[Segment]:
        """Segments that tell more than their own start; the same for all searches, which are compared."""
        return [s for s in data.segments if len(s) > 3 * self.depth]

    def problem(self, data: Dataset, terms: Sequence[Term]) -> TermFit:
        """The simulation error of terms on the segments that are long enough."""
        usable = self.usable(data)
        if not usable:
            raise FitError("no segment is long enough for a free run", hint="give smaller orders or delays")
        runs = tuple(self.units.joined(s.u, s.y) for s in usable)
        return TermFit(runs, table_of(terms), self.limits, self.depth, self.memory)

    def model(self, terms: tuple[Term, ...], theta: FloatArray) -> FittedPolyNARX:
        """A model of terms, without notes and intervals."""
        train = self.parts.train
        return FittedPolyNARX(
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            output_limits=self.parts.limits,
            terms=terms,
            theta=theta,
            covariance=np.full((len(terms), len(terms)), np.nan),
            units=self.units,
        )

    def begun(self, data: Dataset, terms: tuple[Term, ...], theta: FloatArray) -> FloatArray:
        """Coefficients, and the start that follows the beginning of every segment best."""
        model = self.model(terms, theta)
        starts = []
        for s in self.usable(data):
            skip = self.depth - model.n_init
            window = start_window(self.depth, len(s), data.dt_s)
            y = s.y[: self.depth].copy()
            seen = slice(skip, skip + window)
            y[skip:] = estimate_start(model, s.u[seen], s.y[seen])
            W = self.units.joined(s.u[: self.depth], y)
            starts.append(W[self.depth - self.memory :, : self.units.n_y].ravel())
        return np.concatenate([theta, *starts])

    def refined(self, terms: tuple[Term, ...], unknowns: Sequence[FloatArray]) -> RefinedTerms | None:
        """The terms refined and judged in every fold; None where a run is held at a limit."""
        found = []
        errors = []
        for (fit, check), begin in zip(self.folds, unknowns, strict=True):
            p, cost = self.problem(fit, terms).descend(begin, _ITERATIONS)
            if not np.isfinite(cost) or not self.is_calm(terms, p[: len(terms)]):
                return None
            judged = self.judged(self.model(terms, p[: len(terms)]), check)
            if judged is None:
                return None
            found.append(p)
            errors.append(judged)
        return RefinedTerms(terms, tuple(found), np.concatenate(errors))

    def judged(self, model: FittedPolyNARX, check: Dataset) -> FloatArray | None:
        """Mean squared free-run errors of blocks; None where a run reaches a limit."""
        low, high = model.output_limits
        squares = []
        for s in check.segments:
            window = start_window(self.depth, len(s), check.dt_s)
            if len(s) <= 2 * window:
                continue
            run = run_from_window(model, s, window)[window:]
            if ((run <= low) | (run >= high)).any():
                return None
            squares.append(np.mean(((run - s.y[window:]) / self.parts.scaling.y_scale) ** 2, axis=1))
        return block_means(squares) if squares else None

    def held(self, terms: Sequence[Term], theta: FloatArray) -> int:
        """Samples of the shuffled half of the probe that are held at a limit."""
        W = self.probe.copy()
        free_run(W[:PUSHES], self.depth, table_of(terms), theta, self.limits)
        return free_run(W, PUSHES, table_of(terms), theta, self.limits)

    @cached_property
    def held_at_first(self) -> int:
        """Of the linear model."""
        return self.held(self.start, self.theta)

    def is_calm(self, terms: Sequence[Term], theta: FloatArray) -> bool:
        """The free run keeps off its limits, where the linear model's does."""
        return self.held_at_first > 0 or self.held(terms, theta) == 0

    def first(self) -> RefinedTerms | None:
        """The linear model refined as a polynomial one is."""
        return self.refined(self.start, [self.begun(fit, self.start, self.theta) for fit, _ in self.folds])


def spread(data: Dataset, rows: int, least: int) -> Dataset:
    """About so many rows in pieces from everywhere, about `least` long at least; all if there are no more."""
    every = -(-len(data) // rows)
    if every == 1:
        return data
    piece = max(rows // 8, least)
    pieces = [
        s.slice(first, min(first + piece, len(s)), data.dt_s)
        for s in data.segments
        for first in range(0, max(len(s) - piece // 2, 1), piece)
    ]
    return data.with_segments(pieces[::every])


def grown(search: TermSearch, first: RefinedTerms, most: int, notes: list[str]) -> RefinedTerms:
    """Up to `most` terms more, each the best of those tried, as long as held-out blocks get clearly better.

    Of two terms that only help together, the first does not: up to `AHEAD` are added before it has to show.
    """
    best = now = first
    everything = list(candidates(search.base, search.units.n_y))
    for number in range(most):
        further = [term for term in everything if term not in now.terms]
        tried = [_with_term(search, now, term) for term in _most_promising(search, now, further)]
        found = min((c for c in tried if c is not None), key=lambda c: float(c.errors.mean()), default=None)
        if found is None:
            break
        now = found
        if clearly_better(now.errors, best.errors):
            added = " and ".join(name_of(search, t) for t in now.terms[len(best.terms) :])
            notes.append(f"Added {added}: held-out free-run RMSE {best.rmse} to {now.rmse}.")
            best = now
        elif len(now.terms) - len(best.terms) == AHEAD:
            break
        error = float(np.sqrt(best.errors.mean()))
        tell("term added", model="polynarx", validation=error, share=(number + 1) / most)
    return best


def name_of(search: TermSearch, term: Term) -> str:
    """A term by its name; of several outputs, with whose equation it stands in."""
    train = search.parts.train
    name = term_name(term, (*train.outputs, *train.inputs), search.units.origin)
    return f"{name} to {train.outputs[term.equation].name}" if len(train.outputs) > 1 else name


def _most_promising(search: TermSearch, now: RefinedTerms, further: Sequence[Term]) -> list[Term]:
    """The terms that lower the simulation error of all folds most, to first order."""
    total = np.zeros(len(further))
    count = len(now.terms)
    for (fit, _), p in zip(search.folds, now.unknowns, strict=True):
        both = np.concatenate([p[:count], np.zeros(len(further)), p[count:]])
        total += search.problem(fit, (*now.terms, *further)).gains(both, count)
    order = np.argsort(-total, kind="stable")[:TRIED]
    return [further[i] for i in order if total[i] > 0.0]


def _with_term(search: TermSearch, now: RefinedTerms, term: Term) -> RefinedTerms | None:
    count = len(now.terms)
    return search.refined((*now.terms, term), [np.insert(p, count, 0.0) for p in now.unknowns])


def prune(search: TermSearch, grown: RefinedTerms, notes: list[str]) -> RefinedTerms:
    """Without the terms that the held-out free run does not miss."""
    now = grown
    while True:
        tried = [(t, _without_term(search, now, t)) for t in _least_telling(search, now)]
        kept = [(t, c) for t, c in tried if c is not None]
        place, best = min(kept, key=lambda tc: float(tc[1].errors.mean()), default=(0, None))
        if best is None or clearly_better(now.errors, best.errors):
            return now
        notes.append(f"Left out {name_of(search, now.terms[place])}: RMSE {now.rmse} to {best.rmse}.")
        now = best


def proven(search: TermSearch, chosen: RefinedTerms, notes: list[str]) -> RefinedTerms:
    """Without the nonlinear terms that chance may have picked among as many as were on offer.

    Slow disturbances of a record are alike in neighbouring blocks, so that held-out ones may speak for a term
    that follows them. Its coefficient must be so many standard errors from zero as the largest of so many
    useless ones is by `CHANCE` (Bonferroni); what else bends is in the model by now, and not in its error.
    """
    offered = len(list(candidates(search.base, search.units.n_y)))
    now = chosen
    while any(not t.is_linear for t in now.terms):
        sure = np.zeros(len(now.terms))
        fewest = len(search.parts.train)
        for (fit, _), p in zip(search.folds, now.unknowns, strict=True):
            own, blocks = search.problem(fit, now.terms).certainty(p, search.block)
            sure += own / len(search.folds)
            fewest = min(fewest, blocks)
        bends = [i for i, t in enumerate(now.terms) if not t.is_linear]
        least = min(bends, key=lambda i: float(sure[i]))
        if sure[least] > stdtrit(max(fewest - 1, 1), 1.0 - CHANCE / (2 * offered)):
            break
        without = _without_term(search, now, least)
        if without is None:
            break
        name = name_of(search, now.terms[least])
        notes.append(f"Left out {name}: one of {offered} terms may look as useful by chance.")
        now = without
    return now


def _least_telling(search: TermSearch, now: RefinedTerms) -> list[int]:
    """Places of the terms whose coefficient 0 would cost least, to second order; one stays in an equation."""
    count = len(now.terms)
    cost = np.zeros(count)
    for (fit, _), p in zip(search.folds, now.unknowns, strict=True):
        inverse = search.problem(fit, now.terms).inverse_curvature(p)
        cost += p[:count] ** 2 / np.maximum(np.diag(inverse), np.finfo(float).tiny)
    alone = [t for t in range(count) if sum(o.equation == now.terms[t].equation for o in now.terms) == 1]
    cost[alone] = np.inf
    return [int(t) for t in np.argsort(cost, kind="stable")[:TRIED] if np.isfinite(cost[t])]


def _without_term(search: TermSearch, now: RefinedTerms, place: int) -> RefinedTerms | None:
    terms = now.terms[:place] + now.terms[place + 1 :]
    return search.refined(terms, [np.delete(p, place) for p in now.unknowns])


def finish(search: TermSearch, chosen: RefinedTerms) -> FittedPolyNARX | None:
    """The terms refined on all of the training data.

    None where a free run is held at a limit, under the probe too.
    """
    count = len(chosen.terms)
    problem = search.problem(search.parts.train, chosen.terms)
    begins = [search.begun(search.parts.train, chosen.terms, p[:count]) for p in chosen.unknowns]
    p, cost = problem.descend(min(begins, key=problem.cost), _LAST_ITERATIONS)
    if not np.isfinite(cost) or not search.is_calm(chosen.terms, p[:count]):
        return None
    return _with_intervals(search, problem, chosen.terms, p)


def _with_intervals(
    search: TermSearch, problem: TermFit, terms: tuple[Term, ...], p: FloatArray
) -> FittedPolyNARX:
    """A model of terms; errors count as alike over as long as an output remembers itself."""
    covariance = problem.covariance(p, search.block)
    return replace(search.model(terms, p[: len(terms)]), covariance=covariance)


def linear_terms(model: FittedLinear, units: Units) -> tuple[tuple[Term, ...], FloatArray]:
    """A linear model as terms: every signal as it first acts and its changes, and a constant.

    Changes instead of lags keep the numbers apart that crowd together at fast sampling.
    """
    n_y = len(model.outputs)
    s = model.system
    terms: list[Term] = []
    theta: list[float] = []
    constant = s.c + s.a.sum(axis=0) @ (model.y_origin - units.origin[:n_y])
    constant = constant - s.b.sum(axis=0) @ (model.u_origin - units.origin[n_y:])
    past = -s.a
    past[0] = 0.0
    for i in range(n_y):
        columns = [*past[:, i].T, *s.b[:, i].T]
        for column, taps in enumerate(columns):
            lags = np.flatnonzero(taps)
            if not len(lags):
                continue
            size = units.scale[column] / units.scale[i]
            first = int(lags[0])
            terms.append(Term(i, (Factor(column, first),)))
            theta.append(float(taps.sum() * size))
            for lag in range(first, int(lags[-1])):
                terms.append(Term(i, (Factor(column, lag, change=True),)))
                theta.append(float(-taps[lag + 1 :].sum() * size))
        terms.append(Term(i, ()))
        theta.append(float(constant[i] / units.scale[i]))
    return tuple(terms), np.array(theta)
