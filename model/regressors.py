"""(u, y) -> Phi: lagged inputs and outputs as rows of a regression, never across a segment's edge.

Row k of Phi holds y_j(k - i) and u_j(k - i) for the lags i of `LagTerms`, outputs first, each signal's lags
in the order given. Rows before the deepest lag are left out, so a segment of N samples gives N - depth rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import UsageError
from flysid.lagged import CHUNK_ROWS as CHUNK_ROWS
from flysid.model.arguments import none_longer


@dataclass(frozen=True)
class LagTerms:
    """Which past samples enter a regression.

    `y`: for every output the lags used, in samples, each at least 1.
    `u`: for every input the lags used, each at least 0 (0 is direct feed-through).
    """

    y: tuple[tuple[int, ...], ...]
    u: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        if any(lag < 1 for lags in self.y for lag in lags):
            raise UsageError(
                "an output's lag must be at least 1: the present output is what the model predicts"
            )
        if any(lag < 0 for lags in self.u for lag in lags):
            raise UsageError("an input's lag must not be negative: the model would not be causal")

    @classmethod
    def arx(cls, na: Sequence[int], nb: Sequence[int], nk: Sequence[int]) -> LagTerms:
        """Lags 1..na of every output and nk..nk+nb-1 of every input."""
        return cls(
            y=tuple(tuple(range(1, n + 1)) for n in na),
            u=tuple(tuple(range(k, k + n)) for n, k in zip(nb, nk, strict=True)),
        )

    @property
    def depth(self) -> int:
        """The deepest lag: samples that a segment spends before its first row."""
        return max((lag for lags in (*self.y, *self.u) for lag in lags), default=0)

    @property
    def count(self) -> int:
        """Number of columns."""
        return sum(len(lags) for lags in (*self.y, *self.u))

    def names(self, outputs: Sequence[Signal], inputs: Sequence[Signal]) -> tuple[str, ...]:
        """Of every column, as people write it: "v_x(k-1)", "theta_in(k)"."""
        pairs = [*zip(outputs, self.y, strict=True), *zip(inputs, self.u, strict=True)]
        return tuple(lagged_name(signal.name, lag) for signal, lags in pairs for lag in lags)


def lagged_name(name: str, lag: int) -> str:
    """ "v_x(k-1)"; "v_x(k)" for lag 0."""
    return f"{name}(k-{lag})" if lag else f"{name}(k)"


def regressors(
    u: FloatArray, y: FloatArray, lags: LagTerms, start: int | None = None, stop: int | None = None
) -> FloatArray:
    """(stop - start, lags.count) rows k = start..stop-1 of Phi.

    `u`, `y`: (N, n_u) and (N, n_y) samples without a gap.
    `start`: first row, at least `lags.depth` (its default).
    `stop`: one past the last row (default N; up to N + 1, where every lag is at least 1).
    """
    first = lags.depth if start is None else start
    last = len(y) if stop is None else stop
    rows = max(last - first, 0)
    phi = np.empty((rows, lags.count), order="F")
    column = 0
    for signals, all_lags in ((y, lags.y), (u, lags.u)):
        for j, signal_lags in enumerate(all_lags):
            for lag in signal_lags:
                phi[:, column] = signals[first - lag : first - lag + rows, j]
                column += 1
    return phi


class RegressorTransform(Protocol):
    """Inputs and outputs as scaled deviations."""

    @property
    def u_origin(self) -> FloatArray: ...
    @property
    def y_origin(self) -> FloatArray: ...
    @property
    def u_scale(self) -> FloatArray: ...
    @property
    def y_scale(self) -> FloatArray: ...
    def u(self, values: FloatArray) -> FloatArray: ...
    def y(self, values: FloatArray) -> FloatArray: ...


def chunks(
    data: Dataset,
    lags: LagTerms,
    start: int | None = None,
    rows: int = CHUNK_ROWS,
    transform: RegressorTransform | None = None,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Phi and Y in pieces of at most `rows` rows: a fit needs memory for one piece only.

    Raises DataError: no segment is longer than the deepest lag.
    """
    first = lags.depth if start is None else start
    for segment in usable_segments(data, first):
        for begin in range(first, len(segment), rows):
            end = min(begin + rows, len(segment))
            u = segment.u[begin - first : end]
            y = segment.y[begin - first : end]
            if transform is not None:
                u = transform.u(u)
                y = transform.y(y)
            yield regressors(u, y, lags, first), y[first:]


def usable_segments(data: Dataset, depth: int) -> tuple[Segment, ...]:
    """The segments longer than `depth` samples. Raises DataError: there is none."""
    usable = tuple(s for s in data.segments if len(s) > depth)
    if not usable:
        raise none_longer(depth, max((len(s) for s in data.segments), default=0))
    return usable
