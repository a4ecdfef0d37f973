"""The linear model of any group of flights from their triangles, and how sure it is: no flight is read.

ARX with L lags of inputs and outputs, means taken from each flight. Residuals of one flight are not white and
flights differ by more than their noise, so that the usual covariance is too small. What is true of flights is
that they are independent; so is each one's score s = Phiᵀ(y - Phi theta), and their scatter gives the
covariance A⁻¹ (sum of s sᵀ) A⁻¹ (Liang and Zeger, 1986, Biometrika 73: the sandwich over clusters). With few
flights the fit follows each of them, and its scores are too small by what it alone tells; that is put right
for each direction (CR2; Bell and McCaffrey, 2002, Survey Methodology 28).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.fleet.models.common_grid import Sampling
from flysid.model.gram import Triangle, solve, tsqr

ComplexArray = npt.NDArray[np.complex128]
EPSILON = float(np.sqrt(np.finfo(np.float64).eps))


@dataclass(frozen=True, eq=False)
class GroupModel:
    """The model of a group of flights.

    `theta`: (n,) coefficients of the inputs at lags 0..L and of the outputs at lags 1..L.
    `rows`, `flights`: behind it.
    `rmse`: of the one-step prediction, in the output's unit.
    `condition`: of the regressors, columns scaled.
    `root`: (n, n) upper triangular R, RᵀR = PhiᵀPhi.
    `influences`: (flights, n) how far each flight moves theta (CR2); their squares sum to its covariance.
    """

    theta: FloatArray
    rows: int
    flights: int
    rmse: float
    condition: float
    root: FloatArray
    influences: FloatArray

    @property
    def covariance(self) -> FloatArray | None:
        """(n, n) of theta, from the scatter between flights; None of a single flight."""
        if self.flights < 2:
            return None
        return np.asarray(self.influences.T @ self.influences)


def fit_group(triangles: Sequence[FloatArray], rows: int, sampling: Sampling, target: int = 0) -> GroupModel:
    """The model of the flights with these triangles.

    `triangles`: (c, c) each, as in `triangles.Triangle`.
    `rows`: samples behind them all.
    `target`: which output.
    Raises DataError: fewer samples than coefficients, or the flights do not excite them all.
    """
    n = sampling.regressors
    centred = [r[1:, 1:] for r in triangles]
    whole = Triangle(tsqr(centred, sampling.columns - 1), n, len(sampling.outputs), rows, "tsqr")
    found = solve(whole, range(n), target)
    if found.rank < n or rows - len(triangles) <= n:
        raise DataError(
            f"{rows} samples of {len(triangles)} flights do not determine {n} coefficients",
            hint="more flights, or more manoeuvres in them",
        )
    root = whole.r[:n, :n]
    influences = [_influence(r[:, :n], r[:, n + target], found.theta, root) for r in centred]
    return GroupModel(
        theta=found.theta,
        rows=rows,
        flights=len(triangles),
        rmse=float(np.sqrt(found.rss / (rows - len(triangles) - n))),
        condition=found.condition,
        root=root,
        influences=np.array(influences),
    )


def _influence(phi: FloatArray, y: FloatArray, theta: FloatArray, root: FloatArray) -> FloatArray:
    """(n,) how far one flight moves theta; its score is divided by the root of what the others tell."""
    own = solve_triangular(root, phi.T, trans="T").T  # its part of the identity is ownᵀ own
    explained, directions = np.linalg.eigh(own.T @ own)
    left = np.maximum(1.0 - explained, EPSILON)
    score = (directions / np.sqrt(left)) @ (directions.T @ (own.T @ (y - phi @ theta)))
    return np.asarray(solve_triangular(root, score))


@dataclass(frozen=True, eq=False)
class Response:
    """A group's frequency response from its one input to its one output, as log H: log gain and phase.

    `value`: (2 k,) log gain at k frequencies, then phase in rad.
    `white`: (2 k, 2 k) its covariance if residuals were white.
    `influences`: (flights, 2 k) how far each flight moves it.
    `flights`: how many.
    """

    value: FloatArray
    white: FloatArray
    influences: FloatArray
    flights: int

    @property
    def root(self) -> FloatArray:
        """(2 k, 2 k) lower triangular root of `white`."""
        return np.asarray(np.linalg.cholesky(self.white))


def response_of(model: GroupModel, sampling: Sampling, omega: FloatArray) -> Response:
    """The response of a channel with one input and one output at some frequencies, rad/s."""
    log_h, slope = log_response(model.theta, sampling, omega)
    jacobian = np.vstack([slope.real, slope.imag])
    half = model.rmse * solve_triangular(model.root, jacobian.T, trans="T")
    return Response(
        value=np.concatenate([log_h.real, log_h.imag]),
        white=half.T @ half,
        influences=model.influences @ jacobian.T,
        flights=model.flights,
    )


def log_response(
    theta: FloatArray, sampling: Sampling, omega: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """(k,) log H and (k, n) its derivative by theta, H = B / A; B = sum b z⁻ᵐ, A = 1 - sum a z⁻ᵐ."""
    lags = sampling.lags
    z = np.exp(-1j * np.outer(omega * sampling.dt_s, np.arange(lags + 1)))
    b = z @ theta[: lags + 1]
    a = 1.0 - z[:, 1:] @ theta[lags + 1 :]
    slope = np.hstack([z / b[:, None], z[:, 1:] / a[:, None]])
    return np.log(b / a), slope
