"""Consequents of rules from data of any size: global least squares, the paper's eq. (4), in bounded memory.

With the memberships fixed the outputs are linear in the consequents; the weighted regressors of all samples
are reduced to one triangle (flysid.model.gram), so that data on disk give the numbers of data in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.fuzzy.kernel import firing
from flysid.model.fuzzy.model import FittedTS
from flysid.model.gram import Triangle, reduce_data
from flysid.model.regressors import CHUNK_ROWS
from flysid.model.stream import Source, blocks_of, windows
from flysid.model.threads import on_one_thread

Weighted = Callable[[], Iterator[tuple[FloatArray, FloatArray]]]
"""Per pass: regressors weighted by firing strengths (n, R n_x) and outputs (n, n_y), in pieces."""

_RCOND = 1e-10  # neighbouring rules make the regressors nearly collinear


@on_one_thread
def refit_consequents(model: FittedTS, data: Source) -> FittedTS:
    """The model with its consequents fitted one step ahead to `data`, memberships untouched.

    For flights without end, in memory or on disk (`flysid.datasetfile.DatasetFile`). It minimises the
    one-step error; the free run of the result should be compared with the old model's before it is trusted.

    Raises
    ------
    UsageError : other signals or sample time than the model's.
    DataError : no segment is longer than the model's lags.
    """
    refuse_other_data(model, data)
    pieces = _lagged_pieces(model, data)
    if next(pieces(), None) is None:
        raise DataError(f"no segment is longer than {model.n_init} samples", hint="record longer")
    theta, rows = least_squares(pieces, len(model.parameters.theta))
    note = f"Consequents were fitted again, one step ahead, to {rows} samples; memberships are as before."
    return replace(
        model,
        parameters=model.parameters._replace(theta=theta),
        notes=(*model.notes, note),
        noise=None,
        gain_interval=None,
    )


def refuse_other_data(model: FittedTS, data: Source) -> None:
    """Raises UsageError where the data have other signals or another sample time than the model's."""
    names = [s.name for s in (*data.outputs, *data.inputs)]
    own = [s.name for s in model.layout.signals]
    if names != own or abs(data.dt_s - model.dt_s) > 1e-9 * model.dt_s:
        raise UsageError(
            f"the data hold {names} every {data.dt_s:g} s; the model knows {own} every {model.dt_s:g} s",
            hint="resample, or fit a new model",
        )


def least_squares(pieces: Weighted, rules: int) -> tuple[FloatArray, int]:
    """(R, n_y, n_x) consequents and the number of samples behind them, eq. (4), by SVD of the triangle."""
    triangle: Triangle = reduce_data(pieces)
    n, m, r = triangle.n, triangle.m, triangle.r
    solution = np.linalg.lstsq(r[: n + m, :n], r[: n + m, n : n + m], rcond=_RCOND)[0]
    theta = solution.reshape(rules, n // rules, m).transpose(0, 2, 1)
    return np.ascontiguousarray(theta), triangle.rows


def weighted(phi: FloatArray, X: FloatArray) -> FloatArray:
    """(n, R n_x) regressors X (n, n_x) weighted by firing strengths phi (n, R)."""
    return np.asarray((phi[:, :, None] * X[:, None, :]).reshape(len(X), -1))


def _lagged_pieces(model: FittedTS, data: Source) -> Weighted:
    layout, d, n_y = model.layout, model.n_init, model.layout.n_y
    blocks = blocks_of(data)

    def read() -> Iterator[tuple[FloatArray, FloatArray]]:
        for _, window in windows(blocks(), d):
            for begin in range(0, window.shape[1] - d, CHUNK_ROWS):
                part = window[:, begin : begin + CHUNK_ROWS + d]
                W = layout.stack(part[n_y:].T, part[:n_y].T)
                phi = firing(W, d, layout.lags, model.parameters)[d:]
                yield weighted(phi, layout.regressor_values(W)), W[d:, :n_y]

    return read
