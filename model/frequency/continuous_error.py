"""Simulation error of a transfer function in s, behind a hold, with its dead time as a real number.

The sampled transfer function (`sampling`) runs free over every segment; the state at each segment's start,
and with trend="estimate" an offset and a drift of its own, are projected out (as in `simulation_error`). The
Jacobian is taken by differences of the projected error: a handful of parameters, each run one compiled
filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.filters import apply_filter
from flysid.model.detrend import Trend
from flysid.model.frequency.rational import Coordinates, Hold, Rational
from flysid.model.frequency.sampling import sample
from flysid.model.refine import Refinement, levenberg_marquardt
from flysid.model.simulation_error import Record, free_space

STEP = 1e-6


@dataclass(frozen=True, eq=False)
class ContinuousError:
    """The least-squares problem of one output, in scaled deviations; theta as in `Coordinates`, and last an
    offset of the output where `offset` and no trend is estimated.

    Attributes
    ----------
    skip : first samples of every segment, whose inputs reach back before it; bounds the dead time.
    """

    records: tuple[Record, ...]
    coordinates: Coordinates
    dt_s: float
    hold: Hold
    offset: bool
    trend: Trend
    skip: int

    @property
    def has_offset(self) -> bool:
        """The last of theta is an offset."""
        return self.offset and self.trend != "estimate"

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.coordinates.form.count + self.has_offset

    def usable(self) -> Iterator[Record]:
        """Segments long enough to say anything."""
        need = self.skip + 2 * self.coordinates.form.poles + 3
        return (r for r in self.records if len(r.y) >= need)

    @property
    def samples(self) -> int:
        """Number of errors that count."""
        return sum(len(r.y) - self.skip for r in self.usable())

    def rational(self, theta: FloatArray) -> Rational:
        """The transfer function at theta."""
        return self.coordinates.rational(theta[: self.coordinates.form.count])

    def errors(self, theta: FloatArray) -> list[FloatArray] | None:
        """Projected errors of every usable segment; None where theta is not allowed."""
        if not self._allowed(theta):
            return None
        a, b = sample(self.rational(theta), self.dt_s, self.hold)
        spaces = {rows: self._nuisance(a, rows) for rows in {len(r.y) - self.skip for r in self.usable()}}
        found = []
        for record in self.usable():
            error = self._run(record, a, b) - record.y[self.skip :]
            if self.has_offset:
                error = error + theta[-1]
            space = spaces[len(error)]
            error[: len(space)] -= space @ (space.T @ error[: len(space)])
            found.append(error)
        return found

    def _allowed(self, theta: FloatArray) -> bool:
        """Stable, no faster than the samples can tell, dead times within reach."""
        rational = self.rational(theta)
        poles = np.roots(rational.denominator)
        if (poles.real >= 0.0).any() or (np.abs(poles.imag) >= np.pi / self.dt_s).any():
            return False
        longest = (self.skip - self.coordinates.form.poles - 2) * self.dt_s
        delays = rational.dead_time_s
        return bool(((delays >= 0.0) & (delays <= longest)).all())

    def _run(self, record: Record, a: FloatArray, b: list[FloatArray]) -> FloatArray:
        """Free run from rest, without the first samples."""
        forced = np.zeros(len(record.y))
        for j, taps in enumerate(b):
            forced += apply_filter(taps, a, record.u[:, j])
        return forced[self.skip :]

    def _nuisance(self, a: FloatArray, rows: int) -> FloatArray:
        """(M, q) orthonormal basis of what is fitted along: the start, and a line where asked for."""
        space = free_space(a, rows)
        if self.trend != "estimate":
            return space
        wide = np.zeros((rows, space.shape[1] + 2))
        wide[: len(space), : space.shape[1]] = space
        wide[:, -2] = 1.0 / np.sqrt(rows)
        wide[:, -1] = np.linspace(-1.0, 1.0, rows) / np.sqrt(rows)
        q, _ = np.linalg.qr(wide)
        return q

    def cost(self, theta: FloatArray) -> float:
        """Sum of squares; inf where theta is not allowed."""
        errors = self.errors(theta)
        return np.inf if errors is None else float(sum(e @ e for e in errors))

    def jacobians(self, theta: FloatArray, *, central: bool = True) -> list[FloatArray]:
        """(N_i, count) per usable segment; one-sided differences halve the cost."""
        here = self.errors(theta)
        columns: list[list[FloatArray]] = []
        for i in range(self.count):
            step = STEP * max(abs(float(theta[i])), 1e-2)
            up = theta.copy()
            down = theta.copy()
            up[i], down[i] = theta[i] + step, theta[i] - step
            high = self.errors(up)
            low = self.errors(down) if central or high is None else here
            width = step * ((high is not None) + (low is not here and low is not None))
            # at the edge of what is allowed: one side
            above = high or here
            below = low or here
            assert above is not None
            assert below is not None
            columns.append([(h - k) / max(width, step) for h, k in zip(above, below, strict=True)])
        return [np.stack(parts, axis=1) for parts in zip(*columns, strict=True)]

    def residuals_and_jacobian(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M,) errors and (M, count)."""
        errors = self.errors(theta)
        if errors is None:
            return np.full(1, np.nan), np.full((1, self.count), np.nan)
        return np.concatenate(errors), np.concatenate(self.jacobians(theta, central=False))

    def refine(self, theta: FloatArray, *, max_iterations: int = 30) -> Refinement:
        """Levenberg-Marquardt from an allowed start."""
        return levenberg_marquardt(
            self.residuals_and_jacobian, theta, cost=self.cost, max_iterations=max_iterations, tolerance=1e-6
        )
