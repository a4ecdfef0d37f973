"""Named terms fitted to all measured responses together (Tischler & Remple, 2012, ch. 12 and 13).

Every pair of an input and an output whose coherence counts is a response; its points carry the weights of
`flysid.model.frequency.simulation_fit`: 1 dB of gain like 7.57 degrees of phase, a point by its coherence,
every response alike,

    J = 20/n sum_k W_k [(gain error, dB)^2 + 0.01745 (phase error, deg)^2],  W = (1.58 (1 - e^(-g^2)))^2.

Levenberg-Marquardt with exact derivatives, d G / d F_ij = H R e_i e_j' R G, R = (j omega - F)^-1. Terms
without a start get theirs from the equations themselves, j omega x = F x + G u, wherever the states are
measured ("equation error"). What hold and folding add to a measured response is taken out of it with the
fitted system, as for transfer functions.

The covariance is the sandwich with the measured errors of the points and their correlation over frequency;
errors of different responses are taken as independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.frequency.rational import Hold, hold_response
from flysid.model.frequency.response import MeasuredResponse
from flysid.model.frequency.simulation_fit import (
    FOLDING_ROUNDS,
    PHASE_WEIGHT,
    SMALLEST_ERROR,
    inflation,
    picked_points,
)
from flysid.model.polynomials import DB, ComplexArray
from flysid.model.refine import levenberg_marquardt
from flysid.model.structured.held_input import held, whole_samples
from flysid.model.structured.plan_file import PlanLayout

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Response:
    """The points of one input and one output.

    `omega`, `g`, `spread`, `trust`: (M,) frequency, response, standard error of its logarithm, Tischler's W.
    `correlation`: (M, M) of the errors.
    """

    output: int
    source: int
    omega: FloatArray
    g: ComplexArray
    spread: FloatArray
    trust: FloatArray
    correlation: FloatArray

    @property
    def weight(self) -> FloatArray:
        """(2M,) of the errors in ln |G| and in the phase in rad."""
        size = np.sqrt(20.0 / len(self.omega) * self.trust)
        return np.concatenate([size * DB, size * np.sqrt(PHASE_WEIGHT) * 180.0 / np.pi])


@dataclass(frozen=True, eq=False)
class JointFit:
    """Terms as they were fitted.

    `theta`: (p,) values; 0 where a term is not among `free`.
    `free`: indices of the estimated terms.
    `covariance`: (p, p), zero for the others. `insensitivity`: (p,) standard error if all others were known.
    `price`: (p,) by how much the cost rises, on average, for a superfluous term that is left out.
    `cost`: J of every response. `freedom`: of the noise.
    """

    theta: FloatArray
    free: tuple[int, ...]
    covariance: FloatArray
    insensitivity: FloatArray
    price: FloatArray
    cost: FloatArray
    freedom: float

    @property
    def total(self) -> float:
        """Sum of the costs: what is minimised."""
        return float(self.cost.sum())

    def error(self, index: int) -> float:
        """Standard error of a term."""
        return float(np.sqrt(max(self.covariance[index, index], 0.0)))


@dataclass(frozen=True, eq=False)
class JointProblem:
    """All responses to fit, and the layout of the model."""

    layout: PlanLayout
    responses: tuple[Response, ...]
    dt_s: float
    hold: Hold

    def fit(self, theta: FloatArray, free: Sequence[int], *, iterations: int = 100) -> JointFit:
        """The best values of the free terms from a start; the others are 0.

        Raises FitError: the start has no finite cost.
        """
        free = list(free)
        at = np.zeros(len(theta))
        at[free] = theta[free]
        plain = self

        def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            moved = at.copy()
            moved[free] = values
            residual, jacobian = plain.residuals(moved)
            return residual, jacobian[:, free]

        rounds = 1 if self.hold == "none" else 1 + FOLDING_ROUNDS
        for _ in range(rounds):
            plain = self.unfolded(at) if self.hold != "none" else self
            at[free] = levenberg_marquardt(evaluate, at[free], max_iterations=iterations).theta
        return plain._finish(at, free)

    def unfolded(self, theta: FloatArray) -> JointProblem:
        """The problem without what hold and folding add to the responses, by the system at theta.

        Where that system cannot tell (it overflows between samples), by the hold alone.
        """
        matrices = self.layout.matrices(theta)
        delay = np.maximum(matrices["delay"], 0.0)
        late = whole_samples(delay[0], self.dt_s)
        with np.errstate(all="ignore"):
            try:
                system = held(
                    {**matrices, "delay": delay}, self.dt_s, self.hold, tuple(range(len(late))), late
                )
            except ValueError:
                system = None
            changed = []
            for r in self.responses:
                ratio = hold_response(r.omega, self.dt_s, self.hold)
                if system is not None:
                    plain = response_of({**matrices, "delay": delay}, r.omega)[:, r.output, r.source]
                    exact = system.response(r.omega, self.dt_s)[:, r.output, r.source] / plain
                    ratio = exact if np.isfinite(exact).all() and exact.all() else ratio
                changed.append(replace(r, g=np.asarray(r.g / ratio)))
        return replace(self, responses=tuple(changed))

    def unfolded_by_hold(self) -> JointProblem:
        """The problem without what the hold adds to the responses."""
        if self.hold == "none":
            return self
        freed = [replace(r, g=r.g / hold_response(r.omega, self.dt_s, self.hold)) for r in self.responses]
        return replace(self, responses=tuple(freed))

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted errors of ln |G| and phase, response by response, and their Jacobian."""
        matrices = self.layout.matrices(theta)
        omegas, where = np.unique(np.concatenate([r.omega for r in self.responses]), return_inverse=True)
        residuals = []
        jacobians = []
        with np.errstate(all="ignore"):
            left, right = _sides(matrices, omegas)
            plain = left @ matrices["G"] + matrices["D"]
            at = 0
            for r in self.responses:
                rows = where[at : at + len(r.omega)]
                at += len(r.omega)
                value = plain[rows, r.output, r.source]
                delay = float(matrices["delay"][0, r.source])
                error = np.log(value * np.exp(-1j * r.omega * delay) / r.g)
                slopes = np.zeros((len(rows), len(theta)), dtype=np.complex128)
                for q, term in enumerate(self.layout.terms):
                    for p in term.places:
                        slopes[:, q] += p.factor * _slope(
                            p.table, (p.row, p.column), (left, right, value), (r, rows)
                        )
                weight = r.weight
                residuals.append(np.concatenate([error.real, error.imag]) * weight)
                jacobians.append(np.concatenate([slopes.real, slopes.imag]) * weight[:, None])
        return np.concatenate(residuals), np.concatenate(jacobians)

    def _finish(self, theta: FloatArray, free: Sequence[int]) -> JointFit:
        residual, jacobian = self.residuals(theta)
        free = list(free)
        jacobian = jacobian[:, free]
        size = np.sqrt(np.maximum((jacobian**2).sum(axis=0), 1e-300))
        scaled = jacobian / size
        inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
        middle = np.zeros_like(inverse)
        chi2 = 0.0
        points = 0.0
        costs = []
        at = 0
        for r in self.responses:
            weight = r.weight
            m = len(r.omega)
            alone = 1.0 / np.maximum((r.correlation**2).sum(axis=1), 1.0)
            points += 2.0 * float(alone.sum())
            costs.append(float(np.sum(residual[at : at + 2 * m] ** 2)))
            for half in (slice(0, m), slice(m, 2 * m)):
                own = slice(at + half.start, at + half.stop)
                unit = weight[half] * r.spread
                chi2 += float((residual[own] / unit) ** 2 @ alone)
                j = scaled[own] * unit[:, None]
                middle += j.T @ r.correlation @ j
            at += 2 * m
        freedom = max(points - len(free), 1.0)
        middle = middle * inflation(chi2, freedom)
        sandwich = inverse @ middle @ inverse
        found = np.zeros((len(theta), len(theta)))
        found[np.ix_(free, free)] = sandwich / np.outer(size, size)
        insensitivity = np.zeros(len(theta))
        insensitivity[free] = np.sqrt(np.diag(middle)) / size
        price = np.zeros(len(theta))
        price[free] = np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300)
        return JointFit(
            theta.copy(), tuple(free), found, insensitivity, price, np.array(costs), float(freedom)
        )


def response_of(matrices: Mapping[str, FloatArray], omega: FloatArray) -> ComplexArray:
    """(M, n_y, n_u) of the continuous system with its delays."""
    left, _ = _sides(matrices, omega)
    delay = np.exp(-1j * omega[:, None] * matrices["delay"][0])
    return np.asarray((left @ matrices["G"] + matrices["D"]) * delay[:, None, :])


def _sides(matrices: Mapping[str, FloatArray], omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """H R (M, n_y, n) and R G (M, n, n_u); NaN where F has a pole just there."""
    f = matrices["F"]
    inside = 1j * omega[:, None, None] * np.eye(len(f)) - f
    try:
        middle = np.linalg.inv(inside)
    except np.linalg.LinAlgError:
        middle = np.full(inside.shape, np.nan + 0j)
    return matrices["H"] @ middle, middle @ matrices["G"]


def _slope(
    table: str,
    at: tuple[int, int],
    sides: tuple[ComplexArray, ComplexArray, ComplexArray],
    points: tuple[Response, IntArray],
) -> ComplexArray:
    """(M,) derivative of ln G at the points of a response with respect to one entry of a table."""
    left, right, value = sides
    response, rows = points
    i, j = at
    if table == "F":
        return np.asarray(left[rows, response.output, i] * right[rows, j, response.source] / value)
    if table == "H":
        mine = float(i == response.output)
        return np.asarray(mine * right[rows, j, response.source] / value)
    mine = float(j == response.source)
    if table == "G":
        return np.asarray(mine * left[rows, response.output, i] / value)
    if table == "D":
        return np.asarray(mine * float(i == response.output) / value)
    return np.asarray(-1j * mine * response.omega)


def coherent_responses(
    measured: Sequence[MeasuredResponse],
) -> tuple[tuple[Response, ...], tuple[str, ...]]:
    """The responses with frequencies enough where the coherence counts, and words on the others.

    Raises DataError: there is none.
    """
    found = []
    without: list[str] = []
    said = DataError("no response was measured")
    for i, m in enumerate(measured):
        for j, source in enumerate(m.inputs):
            try:
                picked = picked_points(m, j, None)
            except DataError as error:
                without.append(f"{m.output.name} to {source.name}")
                said = error
                continue
            found.append(
                Response(
                    output=i,
                    source=j,
                    omega=m.omega[picked],
                    g=m.response[picked, j],
                    spread=np.maximum(m.error[picked, j], SMALLEST_ERROR),
                    trust=(1.58 * (1.0 - np.exp(-m.coherence[picked, j]))) ** 2,
                    correlation=m.correlation[j][np.ix_(picked, picked)],
                )
            )
    if not found:
        raise said
    return tuple(found), tuple(without)


def answers(layout: PlanLayout) -> npt.NDArray[np.bool_]:
    """(n_y, n_u) whether the layout lets an input reach an output at all."""
    theta = _anywhere(layout)
    omega = np.array([np.pi])  # no pole of fixed numbers that anybody writes lies just there
    reached = np.abs(response_of(layout.matrices(theta), omega)[0])
    return np.asarray(reached > 0.0)


def identifiable(problem: JointProblem, *, lost_below: float = 1e-9) -> tuple[int, ...]:
    """The terms that change a fitted response, judged at a place where no term is zero.

    `lost_below`: smallest singular value of a Jacobian of unit columns that is no rounding.

    Raises DataError: terms that only show together, or more of them than the points can tell.
    """
    terms = problem.layout.terms
    points = 2 * sum(len(r.omega) for r in problem.responses)
    if len(terms) >= points:
        raise DataError(
            f"{len(terms)} free terms are too many for {points // 2} trustworthy points",
            hint="fix some, or excite a wider band",
        )
    _, jacobian = problem.residuals(_anywhere(problem.layout))
    size = np.sqrt((jacobian**2).sum(axis=0))
    seen = np.flatnonzero(size > 1e-12 * size.max(initial=0.0))
    if not len(seen):
        raise DataError("no free term changes a measured response", hint="check G and H")
    _, sigma, turn = np.linalg.svd(jacobian[:, seen] / size[seen], full_matrices=False)
    if sigma[-1] < lost_below * sigma[0]:
        lost = turn[sigma < lost_below * sigma[0]]
        together = [terms[seen[k]].name for k in np.flatnonzero((np.abs(lost) > 1e-3).any(axis=0))]
        raise DataError(
            f"the responses cannot tell {', '.join(together)} apart: only some product or sum of them shows",
            hint="fix or tie one of them; a state that is not measured needs one fixed entry",
        )
    return tuple(int(k) for k in seen)


def _anywhere(layout: PlanLayout) -> FloatArray:
    """Values of no special kind."""
    rng = np.random.default_rng(0)
    size = np.array([abs(t.start) if t.start else 1.0 for t in layout.terms])
    delays = np.array([t.is_delay for t in layout.terms])
    return np.asarray(np.where(delays, 1e-2, 1.0) * size * rng.uniform(0.5, 1.5, len(size)))


def starts(problem: JointProblem, free: Sequence[int]) -> FloatArray:
    """(p,) starts of the free terms: as given, else by equation error.

    Raises UsageError: a term has no start, and states that are not measured keep it from being found.
    """
    layout = problem.layout
    theta = np.array([t.start or 0.0 for t in layout.terms])
    sought = [k for k in free if layout.terms[k].start is None and not layout.terms[k].is_delay]
    if not sought:
        return theta
    plain = problem.unfolded_by_hold()
    measured = {k: i for i in range(len(layout.outputs)) if (k := layout.state_of(i)) is not None}
    table = {(r.output, r.source): dict(zip(r.omega.tolist(), r.g, strict=True)) for r in plain.responses}
    rows = []
    goals = []
    for state, output in measured.items():
        needed = _find_needed(layout, state)
        if not needed <= set(measured):
            continue
        for r in plain.responses:
            if r.output != output:
                continue
            states = {k: table.get((measured[k], r.source), {}) for k in needed | {state}}
            kept = [m for m, w in enumerate(r.omega.tolist()) if all(w in known for known in states.values())]
            if not kept:
                continue
            omega = r.omega[kept]
            x = {k: np.array([known[w] for w in omega.tolist()]) for k, known in states.items()}
            row, goal = _equation(layout, theta, (state, r.source), (omega, x))
            size = np.sqrt(r.trust[kept]) / np.abs(omega * x[state])
            rows.append(row[:, sought] * size[:, None])
            goals.append(goal * size)
    matrix = np.concatenate(rows) if rows else np.zeros((0, len(sought)), dtype=np.complex128)
    matrix = np.concatenate([matrix.real, matrix.imag])
    length = np.sqrt((matrix**2).sum(axis=0))
    blind = [layout.terms[k].name for k, n in zip(sought, length, strict=True) if not n > 0.0]
    if blind:
        raise UsageError(
            f"no start for {', '.join(blind)}: not all states of its equation are measured",
            hint=f'give one: {{ name = "{blind[0]}", start = ... }}',
        )
    goal = np.concatenate(goals)
    goal = np.concatenate([goal.real, goal.imag])
    theta[sought] = np.linalg.lstsq(matrix / length, goal, rcond=1e-10)[0] / length
    return theta


def _find_needed(layout: PlanLayout, state: int) -> set[int]:
    """States that the equation of a state holds."""
    fixed = {int(k) for k in np.flatnonzero(layout.fixed["F"][state])}
    return fixed | {p.column for t in layout.terms for p in t.places if p.table == "F" and p.row == state}


def _equation(
    layout: PlanLayout,
    theta: FloatArray,
    at: tuple[int, int],
    values: tuple[FloatArray, dict[int, ComplexArray]],
) -> tuple[ComplexArray, ComplexArray]:
    """j omega x = F x + G u of one state under one input: what every term multiplies, and the rest."""
    state, source = at
    omega, x = values
    matrices = layout.matrices(theta)
    sent = np.exp(-1j * omega * matrices["delay"][0, source])
    goal = 1j * omega * x[state] - matrices["G"][state, source] * sent
    for k in _find_needed(layout, state):
        goal = goal - matrices["F"][state, k] * x[k]
    row = np.zeros((len(omega), len(theta)), dtype=np.complex128)
    for q, term in enumerate(layout.terms):
        for p in term.places:
            if p.row != state:
                continue
            if p.table == "F":
                row[:, q] += p.factor * x[p.column]
            elif p.table == "G" and p.column == source:
                row[:, q] += p.factor * sent
    return row, goal
