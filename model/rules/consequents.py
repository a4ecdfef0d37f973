"""Consequents of rules from data of any size: global, local or mixed least squares, in bounded memory.

With the memberships fixed the outputs are linear in the consequents, and three errors can be lowered:

    global   sum |y - sum_r phi_r theta_r x|^2        the paper's eq. (4): the rules together follow the data
    local    sum sum_r phi_r |y - theta_r x|^2        every rule by itself follows the data where it speaks
    mixed    the mean of both                         (Yen, Wang and Gillespie 1998)

Rules of a global fit may be wild and cancel each other; those of a local one can be read by themselves, at
the cost of a worse fit together. A ridge draws all rules to the one linear model that the data have (one
rule, "always"); "auto" chooses it by generalised cross-validation (Golub, Heath and Wahba 1979). The weighted
regressors of all samples are reduced to one triangle (flysid.model.gram), so that data on disk give the
numbers of data in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.gram import Triangle, reduce_data
from flysid.model.polynomials import VANISHING
from flysid.model.regressors import CHUNK_ROWS
from flysid.model.rules.kernel import firing
from flysid.model.rules.rule_model import RuleModel, refuse_other_models
from flysid.model.stream import Source, blocks_of, windows
from flysid.model.threads import on_one_thread

M = TypeVar("M", bound=RuleModel)
Criterion = Literal["global", "local", "mixed"]
Pieces = Callable[[], Iterator[tuple[FloatArray, FloatArray, FloatArray]]]
"""Per pass: firing strengths (n, R), regressors (n, n_x) and outputs (n, n_y), in pieces."""

_RIDGES = np.geomspace(VANISHING, 1e2, 37)  # that are tried, in shares of the regressors' mean square
_SHARE_GLOBAL = {"global": 1.0, "local": 0.0, "mixed": 0.5}


@dataclass(frozen=True, eq=False)
class Consequents:
    """Consequents and how they came about.

    Attributes
    ----------
    theta : (R, n_y, n_x), ordered as the regressors.
    rows : samples behind them.
    ridge : that was taken, in shares of the regressors' mean square; 0 where there was none.
    """

    theta: FloatArray
    rows: int
    ridge: float = 0.0

    def told(self, criterion: Criterion) -> str:
        """ "global least squares" and the ridge, in words."""
        if not self.ridge:
            return f"{criterion} least squares"
        return f"{criterion} least squares with a ridge of {self.ridge:.2g} towards one linear model"


@on_one_thread
def refit_consequents(
    model: M, data: Source, *, criterion: Criterion = "global", ridge: float | Literal["auto"] = 0.0
) -> M:
    """The model with its consequents fitted one step ahead to `data`, memberships untouched.

    For flights without end, in memory or on disk (`flysid.datasetfile.DatasetFile`). It minimises the
    one-step error; the free run of the result should be compared with the old model's before it is trusted.

    Parameters
    ----------
    criterion, ridge : see `fit_consequents`.

    Raises
    ------
    UsageError : other signals or sample time than the model's; an unknown criterion, a ridge below zero.
    DataError : no segment is longer than the model's lags; no more samples than numbers.

    Examples
    --------
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> len(flysid.refit_consequents(model, train, criterion="local").rules())
    1
    """
    refuse_other_data(model, data)
    check_criterion(criterion, ridge)
    pieces = _lagged_pieces(model, data)
    if next(pieces(), None) is None:
        raise DataError(f"no segment is longer than {model.n_init} samples", hint="record longer")
    found = fit_consequents(pieces, criterion, ridge)
    refuse_few(found.rows, found.theta[:, 0].size)
    note = (
        f"Consequents were fitted again, one step ahead, to {found.rows} samples by {found.told(criterion)}; "
        "memberships are as before."
    )
    return replace(
        model,
        parameters=model.parameters._replace(theta=found.theta),
        notes=(*model.notes, note),
        noise=None,
        operating_points=(),
    )


def refuse_few(samples: int, numbers: int) -> None:
    """Raises DataError where there are no more samples than numbers that are fitted to them."""
    if samples <= numbers:
        raise DataError(
            f"{samples} samples are too few for {numbers} numbers", hint="record longer, or fit fewer rules"
        )


def refuse_other_data(model: RuleModel, data: Source) -> None:
    """Raises UsageError where the model has no rules over lags, or the data have other signals or clocks."""
    refuse_other_models(model, hidden=False)
    names = [s.name for s in (*data.outputs, *data.inputs)]
    own = [s.name for s in model.layout.signals]
    if names != own or abs(data.dt_s - model.dt_s) > 1e-9 * model.dt_s:
        raise UsageError(
            f"the data hold {names} every {data.dt_s:g} s; the model knows {own} every {model.dt_s:g} s",
            hint="resample, or fit a new model",
        )


def check_criterion(criterion: str, ridge: object) -> None:
    """Raises UsageError for what `fit_consequents` does not know."""
    if criterion not in _SHARE_GLOBAL:
        raise UsageError(f"unknown consequents {criterion!r}", hint="one of " + ", ".join(_SHARE_GLOBAL))
    number = isinstance(ridge, int | float) and not isinstance(ridge, bool)
    if ridge != "auto" and not (number and 0.0 <= float(str(ridge)) < np.inf):
        raise UsageError(f"ridge={ridge!r}", hint='give "auto", or a number from 0 on')


def fit_consequents(
    pieces: Pieces, criterion: Criterion = "global", ridge: float | Literal["auto"] = 0.0
) -> Consequents:
    """Consequents that lower the error of the criterion, by SVD of one triangle.

    Parameters
    ----------
    ridge : weight, in shares of the regressors' mean square, on how far the rules' consequents are from those
        of one linear model, every regressor counted in its own root mean square; "auto": by generalised
        cross-validation. Without one, directions that the data do not show are left at zero.
    """
    phi = next(pieces())[0]
    rules = phi.shape[1]
    share = _SHARE_GLOBAL[criterion]
    triangle: Triangle = reduce_data(lambda: _weigh(pieces(), share))
    n = triangle.n
    m = triangle.m
    R = triangle.r[: n + m, :n]
    Q = triangle.r[: n + m, n : n + m]
    samples = triangle.rows // ((share > 0.0) + rules * (share < 1.0))
    if ridge == 0.0:
        solution = np.linalg.lstsq(R, Q, rcond=VANISHING)[0]
        taken = 0.0
    else:
        solution, taken = _solve_with_ridge(R, Q, rules, samples, ridge)
    theta = solution.reshape(rules, n // rules, m).transpose(0, 2, 1)
    return Consequents(np.ascontiguousarray(theta), samples, taken)


def _weigh(
    pieces: Iterator[tuple[FloatArray, FloatArray, FloatArray]], share: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Rows of the least-squares problem: of the rules together, then of every rule by itself."""
    for phi, X, Y in pieces:
        if share == 1.0:
            yield weighted(phi, X), Y
            continue
        if share > 0.0:
            yield np.sqrt(share) * weighted(phi, X), np.sqrt(share) * Y
        n_x = X.shape[1]
        for r in range(phi.shape[1]):
            root = np.sqrt((1.0 - share) * phi[:, [r]])
            alone = np.zeros((len(X), phi.shape[1] * n_x))
            alone[:, r * n_x : (r + 1) * n_x] = root * X
            yield alone, root * Y


def _solve_with_ridge(
    R: FloatArray, Q: FloatArray, rules: int, samples: int, ridge: float | Literal["auto"]
) -> tuple[FloatArray, float]:
    """(R n_x, n_y) coefficients of the triangle's problem, and the ridge that was taken.

    Written as what the rules add to the linear model, in columns of unit mean square.
    """
    n_x = R.shape[1] // rules
    together = R.reshape(len(R), rules, n_x).sum(axis=1)  # the regressors of one rule: firing sums to 1
    line = np.tile(np.linalg.lstsq(together, Q, rcond=VANISHING)[0], (rules, 1))
    size = np.tile(np.sqrt((together * together).sum(axis=0)), rules)
    size = np.where(size > 0.0, size, 1.0)
    U, s, Vt = np.linalg.svd(R / size, full_matrices=False)
    rest = Q - R @ line
    c = U.T @ rest
    square = (rest * rest).sum(axis=0)
    weight = _chosen_ridge(s * s, c, square, samples, n_x) if ridge == "auto" else float(ridge)
    added = Vt.T @ ((s / (s * s + weight))[:, None] * c)
    return line + added / size[:, None], weight


def _chosen_ridge(values: FloatArray, c: FloatArray, square: FloatArray, samples: int, used: int) -> float:
    """The ridge of lowest generalised cross-validation error, outputs in units of what the line leaves."""
    scale = np.where(square > 0.0, square, 1.0)

    def score(ridge: float) -> float:
        kept = values / (values + ridge)
        left = square - ((1.0 - (1.0 - kept) ** 2)[:, None] * c * c).sum(axis=0)
        freedom = 1.0 - min(max(float(kept.sum()), used) / samples, 1.0 - 1e-9)
        return float((np.maximum(left, 0.0) / scale).sum()) / freedom**2

    return float(min(_RIDGES, key=score))


def weighted(phi: FloatArray, X: FloatArray) -> FloatArray:
    """(n, R n_x) regressors X (n, n_x) weighted by firing strengths phi (n, R)."""
    return np.asarray((phi[:, :, None] * X[:, None, :]).reshape(len(X), -1))


def _lagged_pieces(model: RuleModel, data: Source) -> Pieces:
    layout = model.layout
    d = model.layout.depth
    n_y = model.layout.n_y
    blocks = blocks_of(data)

    def read() -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        for _, window in windows(blocks(), d):
            for begin in range(0, window.shape[1] - d, CHUNK_ROWS):
                part = window[:, begin : begin + CHUNK_ROWS + d]
                W = layout.stack(part[n_y:].T, part[:n_y].T)
                phi = firing(W, d, layout.lags, model.parameters)[d:]
                yield phi, layout.regressor_values(W), W[d:, :n_y]

    return read
