"""The state a free run starts from, estimated from a window of measured samples.

Starting a sampled model at its measured lags amplifies measurement noise: the lags of a model of order n
at a fast sample rate encode n - 1 derivatives, so 0.02 m/s of noise at 100 Hz can start a fourth-order
model metres per second off. Following the habit of MATLAB's `compare`, the first lags are estimated so
that the simulation fits a window of measured samples best (least squares, Gauss-Newton: exact in one step for
a linear model, which knows its derivatives; finite differences for others). All structures are treated alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from flysid.dataset import FloatArray, Segment
from flysid.model.own_constants import shapes
from flysid.model.polynomials import VANISHING
from flysid.showing import Table, as_html, counted, first_lines

if TYPE_CHECKING:
    from flysid.model.base import Fitted

WINDOW_S = 1.0
WINDOW_LAGS = 5
MAX_SHARE = 0.1
START_SHARE = 0.05
STEPS = 4
_DROWNED = 0.3  # spread of a free run for want of its start that noise hides
_HELPS = 0.8  # of the spread, or less, where more samples help
_SHIFT = 0.01  # of the outputs' range: a constant's effect on a run is a difference of two
_SEEN = 1e-3  # of a constant, or less, that shows in a run: it cannot be told from the start
_SHARES = (1.0, 0.25)  # of a step, tried in turn
_SETTLED = 0.9999  # of the squares, or less, that another step is worth
_CONSTANT_STEPS = 8
_FLAT = 1e-7  # cosine between the residual and what a start can still move


def start_window(n_init: int, n_samples: int, dt_s: float) -> int:
    """Samples that start a free run: `full_window`, at most a tenth of the segment.

    Never fewer than `n_init`; a static model (n_init 0) uses none of them, but leaves them out alike.
    """
    return max(n_init, min(full_window(n_init, dt_s), int(MAX_SHARE * n_samples)))


def full_window(n_init: int, dt_s: float) -> int:
    """Samples that suffice to estimate a start: 1 s, or five times the lags."""
    return max(round(WINDOW_S / dt_s), WINDOW_LAGS * n_init)


def judging_rows(n_init: int, n_samples: int, dt_s: float) -> int:
    """Samples that start a run which a choice hangs on: `full_window`, at most half of the segment.

    A held-out block is short. Started from a tenth of it, a third-order lag errs by three times the noise,
    and whichever candidate happens to start well looks best. Never fewer than `n_init`.
    """
    return max(n_init, min(full_window(n_init, dt_s), n_samples // 2))


def lags_inside_window(dt_s: float, needed: int) -> int:
    """As many lags as never lengthen `full_window`; at least `needed`, and 1."""
    return max(round(WINDOW_S / dt_s / WINDOW_LAGS), needed, 1)


def most_start_rows(depth: int, dt_s: float, shortest: int) -> int:
    """As many samples as a simulation starts from at most; fewer of a short segment, never below `depth`."""
    return max(depth, min(full_window(depth, dt_s), int(START_SHARE * shortest)), 1)


def settled_start_rows(spread: Callable[[int], float], rows: int, most: int) -> int:
    """Samples that a simulation starts from: the fewest that serve nearly as well as `most`, `rows` doubled.

    All structures ask alike. A few rows more may not help where many do, so that all doublings are looked at.

    `spread`: by number of samples, how far a free run errs for want of the right start, in standard
        deviations of what is measured on top of it.
    """
    enough = max(_DROWNED, spread(most) / _HELPS) if rows < most else 0.0
    while rows < most and spread(rows) > enough:
        rows = min(2 * rows, most)
    return rows


class Runs(Protocol):
    """What a start is estimated for: anything that simulates from its first outputs."""

    @property
    def n_init(self) -> int: ...
    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray: ...


class Timed(Runs, Protocol):
    """One that knows its sample time."""

    @property
    def dt_s(self) -> float: ...


@runtime_checkable
class Limited(Protocol):
    """A model that can also run without its output limits."""

    def unlimited(self) -> Runs: ...


@runtime_checkable
class LinearInStart(Protocol):
    """A model whose run without limits is a sum: of what inputs do, and of what each first output does."""

    def start_responses(self, rows: int) -> FloatArray:
        """(rows, n_y, n_init, n_y) what one unit of each first output adds to a run."""
        ...


@runtime_checkable
class StartsItself(Protocol):
    """A model that estimates by itself, in numbers of its own, what a run starts from."""

    def run_from_measured(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) run whose start fits the measured first rows y (W, n_y) best."""
        ...


def estimate_start(model: Runs, u: FloatArray, y: FloatArray) -> FloatArray:
    """(n_init, n_y) first outputs from which the model follows a measured window best.

    Parameters
    ----------
    u, y : (W, n_u), (W, n_y) measured window, W >= n_init.

    Returns
    -------
    The measured lags themselves where W gives no more equations than unknowns, or where no better start
    was found. Models that can are run without their output limits, where no derivative shows the way back;
    of a model that starts itself its own run's.
    """
    if isinstance(model, StartsItself):
        return np.array(model.run_from_measured(u[: len(y)], y)[: model.n_init])
    return searched_start(model, u, y)


def searched_start(model: Runs, u: FloatArray, y: FloatArray) -> FloatArray:
    """`estimate_start` by simulations from first outputs alone."""
    if isinstance(model, Limited):
        model = model.unlimited()
    measured = np.array(y[: model.n_init], dtype=np.float64)
    if len(y) <= 2 * model.n_init or measured.size == 0:
        return measured
    scale = np.where(np.ptp(y, axis=0) > 0.0, np.ptp(y, axis=0), 1.0)
    guesses = [measured, *_smooth_guesses(y, model.n_init)]
    costs = [_cost(model, u, y, guess, scale) for guess in guesses]
    at = int(np.argmin([cost for cost, _ in costs]))
    best = guesses[at]
    (cost, residual) = costs[at]
    for _ in range(STEPS):
        jacobian = _jacobian(model, u, best, scale)
        if not np.isfinite(jacobian).all():
            break
        step = np.linalg.lstsq(jacobian, residual, rcond=VANISHING)[0].reshape(best.shape) * scale
        trial = best + step
        new_cost, new_residual = _cost(model, u, y, trial, scale)
        if not new_cost < cost * (1.0 - 1e-9):
            break
        best = trial
        cost = new_cost
        residual = new_residual
        slope = jacobian.T @ residual
        if np.abs(slope).max() <= _FLAT * float(np.linalg.norm(jacobian, axis=0).max()) * math.sqrt(cost):
            break  # a linear model is there in one step, and another Jacobian would be the same
    return best


class FreeRuns:
    """What every fitted model can do, beside what its structure does."""

    def __repr__(self) -> str:
        return first_lines(str(self))

    def _repr_html_(self: Fitted) -> str:
        rows = [(r.label, r.condition, r.conclusion) for r in self.rules()]
        title = f"{self.structure}, {counted(self.n_parameters, 'parameter')}, sample time {self.dt_s:g} s"
        return as_html(Table(title, ("rule", "if", "then"), rows))

    def plot_step(self: Fitted, output: int = 0, ax: Any = None) -> Any:
        """Unit steps of every input from rest, as matplotlib axes.

        `output`: column of the outputs.
        `ax`: axes to draw into; new ones where None.
        Raises UsageError: matplotlib is not installed.
        """
        from flysid.model.plots import plot_step

        return plot_step(self, output, ax)

    def plot_bode(self: Fitted, output: int = 0, ax: Any = None) -> Any:
        """Magnitude and phase of small signals about rest, as two matplotlib axes; else as `plot_step`."""
        from flysid.model.plots import plot_bode

        return plot_bode(self, output, ax)

    def free_run(self: Timed, segment: Segment) -> FloatArray:
        """(N, n_y) free run of a segment as `flysid.compare` starts it.

        The starting state is estimated from a window of measured samples: 1 s or five times the lags, at most
        a tenth of the segment, as `start_window` counts them. No score should count that window. Started from
        the first `n_init` measured samples alone, as `simulate` does, noise becomes a transient.

        >>> run = model.free_run(test.segments[0])  # doctest: +SKIP
        """
        window = start_window(self.n_init, len(segment), self.dt_s)
        return run_from_window(self, segment, window)


class OneRule(FreeRuns):
    """A fitted model of one rule that always holds."""

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:  # noqa: ARG002
        """(N, 1) ones."""
        return np.ones((len(np.asarray(y)), 1))


def run_from_window(
    model: Timed, segment: Segment, window: int, drifting: tuple[bool, ...] | None = None
) -> FloatArray:
    """(N, n_y) simulation of a segment whose first `window` samples only give the starting state.

    `drifting`: the segment has a constant or a drift of its own beside the model, see `own_part`; None: where
        the model says that flights have one.
    """
    drifting = drifting or drifting_of([model])
    if drifting is None:
        return plain_run(model, segment, window)
    return _run_beside(model, segment, window, own_part(model, segment, window, drifting))


def drifting_of(models: Iterable[object]) -> tuple[bool, ...] | None:
    """Which outputs drift where models leave out the constants of flights; None where none of them does."""
    own = [known for model in models if (known := getattr(model, "flight_offsets", None)) is not None]
    return own[0].drifting if own else None


def without(segment: Segment, own: FloatArray) -> Segment:
    """The segment with its outputs less what it has of its own, (N, n_y)."""
    return replace(segment, y=segment.y - own)


def as_modelled(model: Timed, segment: Segment) -> Segment:
    """The segment without what it has of its own beside the model; itself where flights have nothing."""
    window = start_window(model.n_init, len(segment), model.dt_s)
    return without(segment, own_part(model, segment, window, drifting_of([model])))


def own_part(model: Timed, segment: Segment, window: int, drifting: tuple[bool, ...] | None) -> FloatArray:
    """(N, n_y) what a segment's outputs have beside a model's free run, by least squares over all of it.

    Constants, or drifts of the outputs in `drifting`; 0 where one changes nothing, because the model takes it
    up in its start, and where `drifting` is None: flights have nothing of their own.
    """
    if drifting is None or len(segment) <= window:
        return np.zeros(segment.y.shape)
    n_y = segment.y.shape[1]
    size = np.where(np.ptp(segment.y, axis=0) > 0.0, np.ptp(segment.y, axis=0), 1.0)
    shape = shapes(drifting, len(segment), model.dt_s)
    unit = size / np.maximum(np.abs(shape).max(axis=0), np.finfo(float).tiny)
    numbers = np.zeros(n_y)

    def missed(trial: FloatArray) -> FloatArray:
        run = _run_beside(model, segment, window, shape * trial)
        return np.asarray(((segment.y - run)[window:] / size).ravel())

    miss = missed(numbers)
    for _ in range(_CONSTANT_STEPS):
        moves = np.diag(_SHIFT * unit)
        slopes = np.stack([(miss - missed(numbers + move)) / _SHIFT for move in moves], axis=1)
        seen = np.linalg.norm(slopes, axis=0) > _SEEN * math.sqrt(len(slopes) / n_y)
        if not (np.isfinite(slopes).all() and np.isfinite(miss).all() and seen.any()):
            break
        step = np.zeros(n_y)
        step[seen] = np.linalg.lstsq(slopes[:, seen], miss, rcond=None)[0]
        trials = (numbers + share * np.clip(step, -1.0, 1.0) * unit for share in _SHARES)
        found = next(((t, m) for t in trials if (m := missed(t)) @ m < _SETTLED * (miss @ miss)), None)
        if found is None:
            break
        numbers, miss = found
    return shape * numbers


def _run_beside(model: Runs, segment: Segment, window: int, own: FloatArray) -> FloatArray:
    return plain_run(model, without(segment, own), window) + own


def plain_run(model: Runs, segment: Segment, window: int) -> FloatArray:
    """`run_from_window` of a segment that has nothing of its own beside the model."""
    with np.errstate(over="ignore", invalid="ignore"):  # what breaks the laws is counted, not warned of
        if isinstance(model, StartsItself):
            return model.run_from_measured(segment.u, segment.y[:window])
        y0 = estimate_start(model, segment.u[:window], segment.y[:window])
        return model.simulate(segment.u, y0)


def _smooth_guesses(y: FloatArray, n_init: int) -> list[FloatArray]:
    """First lags on a constant and on a straight line through the window's beginning.

    From noisy lags a simulation may run into its output limits, where no derivative shows the way back.
    """
    rows = np.arange(min(len(y), max(2 * n_init, 10)), dtype=np.float64)
    lines = [np.polynomial.polynomial.polyfit(rows, y[: len(rows)], degree) for degree in (0, 1)]
    powers = [np.vander(rows[:n_init], degree + 1, increasing=True) for degree in (0, 1)]
    return [power @ line for power, line in zip(powers, lines, strict=True)]


def _cost(
    model: Runs, u: FloatArray, y: FloatArray, y0: FloatArray, scale: FloatArray
) -> tuple[float, FloatArray]:
    residual = ((y - model.simulate(u, y0)) / scale).ravel()
    return float(residual @ residual), residual


def _jacobian(model: Runs, u: FloatArray, y0: FloatArray, scale: FloatArray) -> FloatArray:
    """(W n_y, n_init n_y) sensitivity of simulation to start, both scaled.

    By central differences, unless the model knows it.
    """
    if isinstance(model, LinearInStart):
        found = model.start_responses(len(u)) * (scale / scale[:, None, None])
        return np.asarray(found.reshape(len(u) * len(scale), y0.size))
    columns = []
    for i, j in np.ndindex(*y0.shape):
        shift = np.zeros_like(y0)
        shift[i, j] = 1e-4 * scale[j]
        difference = model.simulate(u, y0 + shift) - model.simulate(u, y0 - shift)
        columns.append((difference / (2e-4 * scale)).ravel())
    return np.stack(columns, axis=1)
