"""ANFIS: memberships by gradient descent, consequents by least squares, in turn (Jang 1993, hybrid learning).

The classic way to train Takagi-Sugeno models, on the error one step ahead, here with the regressors of a
dynamic model. It is offered to be compared with: `TS` minimises the error of the free run, which is what a
simulation needs; ANFIS stops at the error that flatters every model of sampled data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.arguments import check_inputs
from flysid.model.last_gates import no_worse_than_held
from flysid.model.rules.clustering import cluster, project
from flysid.model.rules.fitted import FittedTS, finish
from flysid.model.rules.free_run_error import Body, Problem, antecedent_range
from flysid.model.rules.growth import best_started, first_basis
from flysid.model.rules.operating_points import describe
from flysid.model.rules.regressor_layout import Layout, Orders, parse_antecedents, runs_of, scaling
from flysid.model.rules.stages import ordered
from flysid.model.settings import Settings
from flysid.model.threads import on_one_thread
from flysid.showing import counted

# of the step, Jang's heuristic rules


@dataclass(frozen=True)
class ANFIS(Settings):
    """Settings of a TS model trained one step ahead.

    Parameters
    ----------
    rules : number of rules, from Gustafson-Kessel clusters.
    na, nb, nk : past outputs, past inputs and their delay, the same for every input.
    antecedents : such as ("y(k-1)", "u(k-1)"); empty: the newest output and input.
    epochs : passes of hybrid learning.
    step : first length of a step of the memberships, in normalised units.

    Source: Jang (1993), IEEE Trans. SMC 23.

    Examples
    --------
    >>> model = flysid.ANFIS(rules=2, na=1, nb=1, epochs=5).fit(train)  # train: see `flysid.Dataset`
    >>> len(model.rules())
    2
    """

    rules: int = 3
    na: int = 2
    nb: int = 2
    nk: int = 1
    antecedents: Sequence[str] = ()
    epochs: int = 60
    step: float = 0.02

    def check_values(self) -> None:
        """Raise UsageError for numbers that cannot be."""
        self.at_least(1, "rules", "nb", "epochs")
        if not 0.0 < self.step < 1.0:
            raise UsageError(f"step={self.step!r}", hint="give a number between 0 and 1")

    @on_one_thread
    @no_worse_than_held
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Alternate least squares and gradient steps; the epoch with the lowest error is kept.

        That error is the one on `validation` where it is given, else the one on `train`.

        Raises
        ------
        UsageError : settings that cannot be, antecedents that are not there.
        DataError : no segment is long enough, a signal that never moves, fewer samples than numbers.
        """
        check_inputs(len(train.inputs))
        layout = self._layout(train)
        learner = _Learner.of(layout, train, self.rules)
        judge = learner if validation is None else learner.on(validation)
        best = learner.start
        best_error = np.inf
        best_epoch = 0
        for epoch, body in enumerate(learner.epochs(self.epochs, self.step)):
            error = judge.error(body)
            if error < best_error:
                best = body
                best_error = error
                best_epoch = epoch
        notes = (
            f"{counted(self.rules, 'rule')}, as asked; memberships and consequents were learned in turn "
            f"one step ahead (ANFIS), epoch {best_epoch} of {self.epochs} was the best.",
            "The free run was not used for the choice: validate it before you rely on a simulation.",
        )
        found = finish(ordered(best_started(learner.problem, best)), train, notes)
        return describe(found, train)

    def _layout(self, train: Dataset) -> Layout:
        names = self.antecedents or (train.outputs[0].name, train.inputs[0].name)
        n_u = len(train.inputs)
        antecedents = parse_antecedents(names, train.outputs, train.inputs, (self.nk,) * n_u)
        orders = Orders(self.na, (self.nb,) * n_u, (self.nk,) * n_u)
        return Layout(train.outputs, train.inputs, orders, antecedents, *scaling(train))


def of_run(*, rules: int | str, antecedents: Sequence[str] | str, nk_hint: Sequence[int]) -> ANFIS:
    """ANFIS as a run has it, whose settings are those of a search for rules: "auto" is its own choice.

    One delay serves all inputs, so that the longest of `nk_hint` counts.
    """
    return ANFIS(
        rules=rules if isinstance(rules, int) else ANFIS.rules,
        nk=max([ANFIS.nk, *nk_hint]),
        antecedents=() if isinstance(antecedents, str) else antecedents,
    )


@dataclass(frozen=True, eq=False)
class _Learner:
    """Regressors E (N, n_x), antecedents z (N, n_z) and outputs Y (N, n_y), normalised, and a start."""

    problem: Problem
    start: Body
    E: FloatArray
    z: FloatArray
    Y: FloatArray

    @classmethod
    def of(cls, layout: Layout, train: Dataset, rules: int) -> _Learner:
        """From clusters of the training data; DataError where there are fewer samples than unknowns."""
        runs = runs_of(layout, train.segments, layout.depth + 2)
        unknowns = rules * len(layout.regressors)
        if sum(len(W) - layout.depth for W in runs) <= unknowns:
            raise DataError(
                f"too few samples for {counted(rules, 'rule')} of {len(layout.regressors)} numbers",
                hint="record longer, or ask for fewer rules or lower orders",
            )
        problem = _problem(layout, runs)
        E, z, Y = _rows(problem)
        centre, width, _ = project(cluster(np.hstack([z, Y]), rules), z.shape[1], two_sided=False)
        start = Body(np.zeros((rules, layout.n_y, E.shape[1])), centre, width)
        return cls(problem, start, E, z, Y)

    def on(self, data: Dataset) -> _Learner:
        """The same model on other data. Raises DataError: no segment is long enough."""
        layout = self.problem.layout
        runs = runs_of(layout, data.segments, layout.depth + 2)
        if not runs:
            raise DataError("no validation segment is long enough", hint="give longer ones, or none")
        E, z, Y = _rows(replace(self.problem, runs=runs))
        return replace(self, E=E, z=z, Y=Y)

    def epochs(self, count: int, step: float) -> Iterator[Body]:
        """The body after least squares in every epoch; memberships move between epochs."""
        body = self.start
        errors = list[float]()
        for _ in range(count):
            body = self.with_consequents(body)
            yield body
            errors.append(self.error(body))
            step *= _pace(errors)
            slope_c, slope_s = self.slopes(body)
            length = float(np.sqrt((slope_c**2).sum() + (slope_s**2).sum()))
            if length == 0.0:
                return
            low, high = self.problem.z_range
            width = body.width * np.exp(np.clip(-step * slope_s / length, -1.0, 1.0))
            body = replace(
                body,
                centre=np.clip(body.centre - step * slope_c / length, low, high),
                width=np.clip(width, 0.02 * (high - low), 3.0 * (high - low)),
            )

    def with_consequents(self, body: Body, *, ridge: float = 1e-9) -> Body:
        """Global least squares, the paper's eq. (4), for the body's memberships.

        `ridge`: on consequents, relative: neighbouring rules are nearly collinear.
        """
        phi = self.firing(body)
        design = (phi[:, :, None] * self.E[:, None, :]).reshape(len(phi), -1)
        gram = design.T @ design
        gram[np.diag_indices_from(gram)] += ridge * gram.trace() / len(gram)
        a = np.linalg.solve(gram, design.T @ self.Y).reshape(*phi.shape[1:], -1, self.Y.shape[1])
        return replace(body, a=np.ascontiguousarray(a.transpose(0, 2, 1)))

    def error(self, body: Body) -> float:
        """Mean square of the error one step ahead, in units of the outputs' variance."""
        gap = self.conclusions(body, self.firing(body))[1] - self.Y
        return float((gap * gap).mean())

    def slopes(self, body: Body) -> tuple[FloatArray, FloatArray]:
        """Gradient of half the squared error by centres and by log widths, (R, n_z) each."""
        phi = self.firing(body)
        alone, together = self.conclusions(body, phi)
        lever = phi * np.einsum("nri,ni->nr", alone - together[:, None, :], together - self.Y)
        d = (self.z[:, None, :] - body.centre) / body.width
        return (
            np.einsum("nr,nrj->rj", lever, d / body.width),
            np.einsum("nr,nrj->rj", lever, d * d),
        )

    def conclusions(self, body: Body, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, R, n_y) of every rule and (N, n_y) of all together."""
        alone = np.einsum("rim,nm->nri", body.a, self.E)
        return alone, np.einsum("nr,nri->ni", phi, alone)

    def firing(self, body: Body) -> FloatArray:
        """(N, R) normalised firing strengths."""
        z = np.clip(self.z, *self.problem.z_range)
        d = (z[:, None, :] - body.centre) / body.width
        log_strength = -0.5 * (d * d).sum(axis=2)
        strength = np.exp(log_strength - log_strength.max(axis=1, keepdims=True))
        return np.asarray(strength / strength.sum(axis=1, keepdims=True))


def _pace(errors: Sequence[float], *, growth: float = 1.1, shrinkage: float = 0.9) -> float:
    """Factor on the step: longer after four decreases in a row, shorter after two ups and downs.

    `growth`: Jang's heuristic rules for the step.
    """
    changes = np.sign(np.diff(errors[-5:]))
    if len(changes) < 4:
        return 1.0
    if (changes < 0).all():
        return growth
    return shrinkage if tuple(changes) == (1, -1, 1, -1) else 1.0


def _problem(layout: Layout, runs: tuple[FloatArray, ...]) -> Problem:
    y = np.vstack([W[:, : layout.n_y] for W in runs])
    margin = np.ptp(y, axis=0)
    basis = np.ascontiguousarray(first_basis(layout, runs))
    return Problem(
        layout,
        runs,
        basis,
        np.zeros((layout.n_y, len(basis))),
        antecedent_range(layout, runs),
        np.stack([y.min(axis=0) - margin, y.max(axis=0) + margin]),
    )


def _rows(problem: Problem) -> tuple[FloatArray, FloatArray, FloatArray]:
    layout = problem.layout
    d = problem.layout.depth
    E = np.vstack([layout.regressor_values(W) for W in problem.runs]) @ problem.basis.T
    z = np.vstack([layout.antecedent_values(W) for W in problem.runs])
    return E, z, np.vstack([W[d:, : layout.n_y] for W in problem.runs])
