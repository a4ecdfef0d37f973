"""Linear systems that rules over hidden states are grown from, and where a plant saturates.

The best state space, and output-error models of few states, as realisations whose first states are the
outputs. An end of an output's travel, seen in the data, is a limit of its state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.oe import OE
from flysid.model.polynomials import ROUNDING
from flysid.model.refine import FIRST_DAMPING
from flysid.model.rules.free_run_error import Body, Problem, range_of, widen
from flysid.model.rules.likely_start import Prior, initial_states
from flysid.model.rules.linear_starts import (
    PLAIN,
    PLAIN_WORDS,
    StateRealisation,
    coordinates,
    realise,
    uncorrelated,
)
from flysid.model.rules.recursion import Recursion
from flysid.model.rules.regressor_layout import Layout, Orders, runs_of
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage
from flysid.model.statespace import StateSpace
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.showing import counted

_OE_STATES = (2, 3)  # orders of output-error models: rules may use a state that a linear model does not
_HIDDEN_LIMIT = 12.0  # spreads that a hidden state may reach
_START_ROWS = 400  # of a run from which a linear start takes its initial state
_AT_END = 2e-3  # of an output's range: this near the extreme counts as at it
_CORNER = 0.01  # of the range: an output that arrives at an end this fast per sample has hit it
_STAY = 5  # samples that it must stay there
_VISITS = 2  # times that it must have happened


def linear_systems(
    settings: RuleSettings,
    train: Dataset,
    validation: Dataset | None,
    scaled: tuple[FloatArray, FloatArray],
) -> list[StateRealisation]:
    """The best linear state space, and output-error models of few states.

    A linear model imitates a hidden state, or a bend, by a longer delay: a delay of one sample, that of any
    plant behind a zero-order hold, is always tried besides the one found.

    Raises
    ------
    FitError : no stable linear model was found.
    """
    n_y = len(train.outputs)
    n_u = len(train.inputs)
    best = None
    found = []
    if settings.states == "auto":
        best = best_state_space(settings, train, validation, scaled)
        found = [best] if best else []
    delays = _delays_to_try(settings, best, n_u)
    for order in _orders(settings, best, n_y):
        for nk in delays:
            fitted = _output_error(train, order, nk)
            if fitted:
                late = ", ".join(map(str, sorted(set(nk))))
                real = realise(fitted, *scaled)
                found.append(replace(real, title=f"{len(real)} states, delay {late}"))
    if not found:
        raise FitError("no stable linear model was found to start from", hint="check the data for gaps")
    return found


def best_state_space(
    settings: RuleSettings,
    train: Dataset,
    validation: Dataset | None,
    scaled: tuple[FloatArray, FloatArray],
) -> StateRealisation | None:
    """What `StateSpace()` makes of the data; None where it finds nothing stable."""
    asked = StateSpace(nk=settings.nk, nk_hint=tuple(settings.nk_hint))
    try:
        with np.errstate(all="ignore"):
            model = asked.fit(train, validation)
    except (DataError, FitError):
        return None
    if np.abs(model.poles).max(initial=0.0) > 1.0 + ROUNDING:  # of what integrates one may be on the circle
        return None
    title = f"the best linear state space ({counted(model.order, 'state')})"
    return replace(realised_states(model, *scaled), title=title)


def _orders(settings: RuleSettings, best: StateRealisation | None, n_y: int) -> list[int]:
    if settings.states != "auto":
        return [max(1, -(-settings.states // n_y))]
    known = min(settings.search.highest_order, -(-len(best) // n_y)) if best else 2
    return sorted({*_OE_STATES, max(known, 2)} if n_y == 1 else {2, max(known, 1)})


def _delays_to_try(settings: RuleSettings, best: StateRealisation | None, n_u: int) -> list[tuple[int, ...]]:
    if settings.nk != "auto":
        return [(settings.nk,) * n_u if isinstance(settings.nk, int) else tuple(settings.nk)]
    delays = {(1,) * n_u}
    if best:
        delays.add(best.orders.nk)
    if settings.nk_hint:
        delays.add(tuple(settings.nk_hint))
    return sorted(delays)


def _output_error(train: Dataset, order: int, nk: tuple[int, ...]) -> FittedLinear | None:
    try:
        return OE(na=order, nb=[order + (k == 0) for k in nk], nk=nk).fit(train)
    except FitError:
        return None


def realised_states(model: FittedStateSpace, shift: FloatArray, scale: FloatArray) -> StateRealisation:
    """A state space in coordinates that begin with its outputs, normalised by shift and scale (n_y + n_u,).

    The other states are uncorrelated with the outputs and of spread one. With x = w(k) the states there,
    X = T w + E u + s has the outputs first; where the outputs do not show n_y independent directions of w,
    X has more entries than w, and moves in their image.
    """
    system = model.realisation
    n_y = len(model.outputs)
    y_shift = shift[:n_y]
    u_shift = shift[n_y:]
    y_scale = scale[:n_y]
    u_scale = scale[n_y:]
    offset = u_shift - model.u_origin
    root = _spread(system.state, system.a)
    C = np.asarray(system.c @ root / y_scale[:, None])
    D = system.d * u_scale / y_scale[:, None]
    level = (system.level + system.d @ offset + model.y_origin - y_shift) / y_scale
    T = np.vstack([C, _unseen(C)])
    back = np.linalg.pinv(T)
    E = np.zeros((len(T), len(u_scale)))
    s = np.zeros(len(T))
    E[:n_y] = D
    s[:n_y] = level
    inverse = np.linalg.inv(root)
    A = T @ (inverse @ system.a @ root) @ back
    B = T @ (inverse @ system.b * u_scale) - A @ E
    c = T @ (inverse @ (system.drift + system.b @ offset)) - A @ s + s
    late = model.delays or (0,) * len(u_scale)
    through = [bool(column.any()) for column in D.T]
    orders = Orders.of_states([(k, k + 1) if d else (k + 1,) for k, d in zip(late, through, strict=True)])
    taps = np.zeros((orders.depth + 1, *B.shape))
    for j, k in enumerate(late):
        taps[k + 1, :, j] = B[:, j]
        taps[k, :, j] += E[:, j]
    return StateRealisation(Recursion(A[None], taps, c), orders, PLAIN_WORDS)


def system_stage(
    real: StateRealisation,
    data: Dataset,
    least: int,
    scaled: tuple[FloatArray, FloatArray],
    ends: FloatArray,
    *,
    linear_steps: int = 20,
) -> Stage:
    """One rule: the system refined on the data.

    Parameters
    ----------
    least : rows that a segment must have.
    scaled : shift and scale (n_y + n_u,).
    ends : (2, n_y) outputs at which the plant itself saturates, physical.
    linear_steps : of a linear system's refinement.
    """
    shift, scale = scaled
    n_y = len(data.outputs)
    hidden = len(real) - n_y
    layout = Layout(
        data.outputs,
        data.inputs,
        real.orders,
        (),
        np.concatenate([shift[:n_y], np.zeros(hidden), shift[n_y:]]),
        np.concatenate([scale[:n_y], np.ones(hidden), scale[n_y:]]),
        hidden,
        0.0,
    )
    runs = runs_of(layout, data.segments, least)
    return linear_stage(layout, runs, real, (ends - shift[:n_y]) / scale[:n_y], linear_steps, whiten=True)


def coordinate_names(stage: Stage) -> tuple[str, ...]:
    """The choices of hidden states for a single rule, most readable first; one where none are hidden."""
    if not stage.layout.hidden:
        return (PLAIN,)
    return tuple(coordinates(StateRealisation.of(stage.layout, stage.body.a[0]), stage.layout.n_y))


def in_coordinates(stage: Stage, name: str) -> tuple[Stage, str]:
    """A single rule in other coordinates, and what its hidden states are then."""
    if name == PLAIN:
        return stage, PLAIN_WORDS
    choices = coordinates(StateRealisation.of(stage.layout, stage.body.a[0]), stage.layout.n_y)
    real = choices.get(name, next(iter(choices.values())))
    ends = stage.problem.limits[:, : stage.layout.n_y]
    layout = replace(stage.layout, antecedents=())
    return linear_stage(layout, stage.problem.runs, real, ends, 0), real.words


def linear_stage(
    layout: Layout,
    runs: tuple[FloatArray, ...],
    real: StateRealisation,
    ends: FloatArray,
    iterations: int,
    *,
    whiten: bool = False,
) -> Stage:
    """The refined linear model in the coordinates of `real`, hidden states scaled to their spread.

    With `whiten` in coordinates of its own: hidden states uncorrelated with the outputs and each other.

    Parameters
    ----------
    ends : (2, n_y) normalised outputs at which the plant itself saturates; infinite where it does not.
    """
    n = layout.n
    n_y = layout.n_y
    d = layout.depth
    limits = np.full((2, n), np.inf) * np.array([[-1.0], [1.0]])
    limits[:, :n_y] = widen(range_of([W[d - 1 :, :n_y] for W in runs]), 1.0)
    problem = hold_still(layout, runs, np.zeros((2, 0)), limits)
    nowhere = Prior(np.zeros(n), 1e3 * np.eye(n), 1.0)
    stage = _linear(problem, real, nowhere)
    states = np.vstack([r[d - 1 :, :n] for r in stage.simulated()])
    spread = states.std(axis=0)
    middle = states.mean(axis=0)
    spread[:n_y] = 1.0
    middle[:n_y] = 0.0
    spread = np.where((spread > 1e-12) & np.isfinite(spread), spread, 1.0)
    if whiten and np.abs(states).max() < 1.0 / ROUNDING:
        T = uncorrelated(np.cov(states, rowvar=False).reshape(n, n), n_y)
        shift = T @ states.mean(axis=0)
        real = real.transformed(T, np.where(np.arange(n) < n_y, 0.0, shift))
    else:
        real = real.transformed(np.diag(1.0 / spread), np.where(np.isfinite(middle), middle, 0.0) / spread)
    limits[:, n_y:] = np.array([[-_HIDDEN_LIMIT], [_HIDDEN_LIMIT]])
    limits[0, :n_y] = np.maximum(limits[0, :n_y], ends[0])
    limits[1, :n_y] = np.minimum(limits[1, :n_y], ends[1])
    stage = _linear(problem, real, nowhere)
    stage = stage.refined(iterations, 1e-6) if iterations else stage
    H = stage.normal()[1].corner
    diagonal = np.diag(H)
    # a little weight on directions that the linear model does not feel
    metric = H + np.diag(FIRST_DAMPING * diagonal + 1e-9 * diagonal.max())
    return stage.under(metric=metric)


def _linear(problem: Problem, real: StateRealisation, prior: Prior) -> Stage:
    """One rule from a realisation, every run started from its most likely state."""
    still = np.zeros((1, 0))
    body = Body(real.consequent(problem.layout)[None], still, still)
    par = problem.parameters(body)
    initial = initial_states(problem.layout, problem.runs, par, prior, _START_ROWS)
    return Stage(problem, body, initial, np.inf)


def hold_still(
    layout: Layout, runs: tuple[FloatArray, ...], z_range: FloatArray, limits: FloatArray
) -> Problem:
    """A problem whose consequents stand as they are, without a ridge."""
    n_x = len(layout.regressors)
    return Problem(layout, runs, np.eye(n_x), np.zeros((layout.n, n_x)), z_range, limits)


def _spread(covariance: FloatArray, a: FloatArray) -> FloatArray:
    """A root of the states' covariance, directions that hardly move not stretched without bound."""
    covariance = (covariance + covariance.T) / 2
    size = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    values = np.maximum(values, 1e-12 * max(float(values.max(initial=0.0)), 1e-12))
    if not np.isfinite(values).all():
        return np.eye(len(a))
    return np.asarray(size[:, None] * (vectors * np.sqrt(values)))


def _unseen(C: FloatArray) -> FloatArray:
    """(n - rank, n) orthonormal rows, orthogonal to those of C."""
    _, values, rows = np.linalg.svd(C)
    rank = int((values > ROUNDING * values.max(initial=1e-300)).sum())
    return np.asarray(rows[rank:])


def saturation_limits(data: Dataset) -> FloatArray:
    """(2, n_y) outputs at which the plant or its sensor saturates; infinite where it does not.

    An end is the same extreme value, reached or left with a corner (fast, then standing still) at least
    twice: a tank that overflows, a stop that is hit, a sensor at its end. A smooth peak has no corner.
    """
    ends = np.array([[-np.inf], [np.inf]]) * np.ones(len(data.outputs))
    for i in range(len(data.outputs)):
        y = [s.y[:, i] for s in data.segments]
        for side, sign in enumerate((-1.0, 1.0)):
            ends[side, i] = sign * _upper_end([sign * v for v in y])
    return ends


def in_words(ends: FloatArray, train: Dataset) -> list[str]:
    """A sentence about every end."""
    return [
        f"{signal.name} {word} {ends[side, i]:.4g} {signal.unit}".rstrip()
        + ", where it stopped repeatedly: taken as a saturation limit."
        for side, word in enumerate(("never falls below", "never exceeds"))
        for i, signal in enumerate(train.outputs)
        if np.isfinite(ends[side, i])
    ]


def _upper_end(y: Sequence[FloatArray]) -> float:
    """The level at which y saturates above; inf where it does not."""
    top = max(float(v.max()) for v in y)
    span = top - min(float(v.min()) for v in y)
    bends = np.concatenate([np.abs(np.diff(v, n=2)) for v in y if len(v) > 2])
    noise = float(np.median(bends)) / (0.6745 * np.sqrt(6.0)) if len(bends) else 0.0
    steps = np.concatenate([np.abs(np.diff(v)) for v in y])
    quantum = float(steps[steps > 0].min(initial=span)) if len(steps) else span
    coarse = 4.0 * quantum if quantum > 1e-3 * span else 0.0
    near = min(max(_AT_END, 4.0 * noise / span), _CORNER) * span if span > 0 else 0.0
    corner = max(_CORNER * span, 6.0 * noise, coarse)
    levels = [level for v in y for level in _visits(v, top - near, corner)]
    return float(np.median(levels)) if len(levels) >= _VISITS else np.inf


def _visits(y: FloatArray, threshold: float, corner: float) -> list[float]:
    """The median of y in every stay above a threshold that begins or ends with a corner."""
    at = np.concatenate([[0], (y >= threshold).astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(at))
    levels = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        arrival = y[begin] - y[begin - 1] if begin else 0.0
        leaving = y[end - 1] - y[end] if end < len(y) else 0.0
        if end - begin >= _STAY and max(arrival, leaving) > corner:
            levels.append(float(np.median(y[begin:end])))
    return levels
