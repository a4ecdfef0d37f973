"""A simulator that flysid can run but not look into, as a model that is compared like any other.

What a run starts from is a row of numbers of the simulator's own. It is estimated as that of other models is:
the run fits a window of measured samples best (least squares, Gauss-Newton with finite differences).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.arguments import as_columns, as_record, check_start
from flysid.model.base import Rule
from flysid.model.freerun import saturate
from flysid.model.noise import output_error_ahead
from flysid.model.start import STEPS, OneRule, lags_inside_window

FAR = 1e12
SHIFT = 1e-4
"""Of a finite difference, in units of the start's own size."""


class Simulator(Protocol):
    """What a function or an FMU comes down to."""

    @property
    def words(self) -> str:
        """What it is, for people."""
        ...

    @property
    def starts_at_outputs(self) -> bool:
        """What a run starts from are the outputs at the first sample."""
        ...

    @property
    def start(self) -> FloatArray:
        """(n,) what a run starts from, where nothing is known."""
        ...

    def run(self, u: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n_y) outputs; row k depends on u[: k + 1] alone."""
        ...


@contextmanager
def running(words: str) -> Iterator[None]:
    """Somebody else's program runs inside: whatever it raises becomes a UsageError that names it."""
    try:
        yield
    except Exception as error:
        raise UsageError(f"{words} fails: {type(error).__name__}: {error}"[:300]) from error


@dataclass(frozen=True, eq=False, repr=False)
class Simulated(OneRule):
    """A simulator with the laws of `flysid.model.base`; it cannot be stored.

    `u_factors`, `y_factors`: value in the simulator's unit = factor * value in the data's.
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    simulator: Simulator
    u_factors: FloatArray
    y_factors: FloatArray
    notes: tuple[str, ...] = ()

    structure = "simulator"
    n_parameters = 0

    @property
    def n_init(self) -> int:
        """As few samples as never lengthen the window that the starts of all models are estimated from."""
        return lags_inside_window(self.dt_s, len(self.simulator.start))

    @property
    def output_limits(self) -> FloatArray:
        """(2, n_y) far off."""
        return np.array([[-FAR] * len(self.outputs), [FAR] * len(self.outputs)])

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the start that fits the first `n_init` outputs best, or from its own.

        Raises UsageError: shapes do not fit, fewer outputs than `n_init`, or the simulator fails.
        """
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            return self._run(u, self.simulator.start)
        n = self.n_init
        y0 = as_columns(y0, len(self.outputs), "y0")
        check_start(len(y0), min(n, len(u)))
        if len(u) <= n:
            return np.array(y0[: len(u)])
        run = self.run_from_measured(u, y0[:n])
        return np.concatenate([y0[:n], run[n:]])

    def run_from_measured(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) run whose start fits the measured first rows y (W, n_y) best."""
        return self._run(u, self._start_for(u[: len(y)], y))

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) the free run and its last known error; the first n_init + k - 1 rows are NaN.

        Raises UsageError: shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        out = np.full(y.shape, np.nan)
        first = self.n_init + k - 1
        if len(u) > first:
            kept = np.array([np.ones(y.shape[1]), -np.ones(y.shape[1])])
            out[first:] = output_error_ahead(self.simulate(u, y[: self.n_init]), y, kept, k)[first:]
        return out

    def rules(self) -> tuple[Rule, ...]:
        """A description that always holds."""
        unknown = np.full((len(self.outputs), len(self.inputs)), np.nan)
        return (Rule("R1", "always", self.simulator.words, unknown, np.nan, np.nan, 1.0),)

    def __str__(self) -> str:
        return "\n".join([self.simulator.words, *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Raises UsageError: flysid does not keep a copy of somebody else's simulator."""
        raise UsageError(f"{self.simulator.words} cannot be stored", hint="name it on the command line again")

    def save(self, path: str | Path) -> None:  # noqa: ARG002
        """Raises UsageError, as `to_dict`."""
        self.to_dict()

    def _run(self, u: FloatArray, start: FloatArray) -> FloatArray:
        y = self.simulator.run(u * self.u_factors, start) / self.y_factors
        return saturate(y, self.output_limits)

    def _start_for(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(n,) the start from which the run follows measured rows best; the simulator's own where it has
        nothing to choose."""
        best = self.simulator.start
        if not len(best):
            return best
        if self.simulator.starts_at_outputs:
            best = y[0] * self.y_factors
        size = np.maximum(np.abs(best), 1.0)
        scale = np.where(np.ptp(y, axis=0) > 0.0, np.ptp(y, axis=0), 1.0)

        def miss(start: FloatArray) -> FloatArray:
            found: FloatArray = ((y - self._run(u, start)) / scale).ravel()
            return found

        residual = miss(best)
        for _ in range(STEPS):
            columns = [
                (miss(best - shift) - miss(best + shift)) / (2.0 * SHIFT) for shift in SHIFT * np.diag(size)
            ]
            jacobian = np.stack(columns, axis=1)
            if not np.isfinite(jacobian).all() or not np.isfinite(residual).all():
                break
            trial = best + np.linalg.lstsq(jacobian, residual, rcond=1e-10)[0] * size
            after = miss(trial)
            if not after @ after < residual @ residual * (1.0 - 1e-9):
                break
            best = trial
            residual = after
        return best
