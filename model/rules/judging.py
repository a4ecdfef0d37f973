"""Choosing among TS models without looking at the test: validation free run, one standard error, stability.

A model is judged by its free run over validation runs, cut into blocks; two models are compared block by
block, so that what is hard for both cancels. The simplest model whose mean square is within one standard
error of the best is taken (Breiman et al. 1984). A model that does not come back from bounded random inputs
is never offered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.model.rules.contraction import is_contracting
from flysid.model.rules.free_run_error import Stage, started_run, widened
from flysid.model.rules.kernel import Parameters, free_run
from flysid.model.rules.linear_starts import LinearModel
from flysid.model.rules.probe_inputs import probe_run
from flysid.model.rules.realisation import initial_states
from flysid.model.rules.regressor_layout import windows
from flysid.model.rules.rule_poles import unheld
from flysid.model.rules.stages import prior_of
from flysid.model.start import MAX_SHARE, estimate_start

INTEGRATES = (
    "The process integrates: its free run keeps its start, and inputs that do not average out drive it to "
    "the output limits."
)
"""What users are told of a model that does not come back."""
_BLOCKS = 16
_FAR = 10.0  # ranges: in a closed loop an output that integrates is never seen to move as it can
_NEAR = 0.5  # of what was seen: hidden states, and outputs beside them, that are farther out have left it
_STEPS = 3000  # of random inputs
# samples that random inputs are held, at most
_LONG_SEED = 2
_LONG_HOLD = 100
_RARELY = 0.02  # of the samples
_MOST_AWAY = 0.2  # of the samples: models that were any good on fresh data stayed below a tenth
_ROUNDING = 1e-5  # of a pole at one that stands twice
_RESOLUTION = 1e-10  # mean squares (of normalised outputs) below this are all "exact"
_WINDOWS = 4  # that a judging part is cut into,
_LONGER = 3  # each at least this many times as long as what starts it,
_SCORED = 5  # with so many rows at least to score
_AWAY = 1e12  # mean square of what ran away


def hold_out(train: Dataset, least: int, fold: int = 0) -> tuple[Dataset, Dataset]:
    """Training and validation parts of `train`: every fourth segment, or a quarter of each where few.

    Whole segments are held out where there are at least four long enough; otherwise one quarter of each,
    the last one in fold 0, earlier ones in folds 1 to 3. Nothing is drawn sample by sample.
    """
    usable = [s for s in train.segments if len(s) >= least]
    if len(usable) >= 4:
        held = [s for i, s in enumerate(usable) if i % 4 == (2 + fold) % 4]
        kept = [s for i, s in enumerate(usable) if i % 4 != (2 + fold) % 4]
        return train.with_segments(kept), train.with_segments(held)
    first: list[Segment] = []
    last: list[Segment] = []
    for segment in usable:
        n = len(segment)
        begin = n - (fold + 1) * (n // 4)
        end = n - fold * (n // 4)
        parts = [segment.slice(a, b, train.dt_s) for a, b in ((0, begin), (end, n)) if b - a >= least]
        if end - begin < least or not parts:
            first.append(segment)
            continue
        first += parts
        last.append(segment.slice(begin, end, train.dt_s))
    return train.with_segments(first), train.with_segments(last or first)


def initial_state_gain(stage: Stage) -> FloatArray:
    """(depth n_y, depth (n_y + n_u) + 1) correction from measured first samples to the model's own.

    A ridge regression, over all windows of the training runs, of simulated minus measured outputs on
    measured outputs and inputs: the best linear guess of where the model's state is. At 100 Hz the raw
    first samples would start a fourth-order model with noise a million times amplified. Without noise the
    differences vanish and so does the correction.
    """
    problem = stage.problem
    d = stage.problem.layout.depth
    n_y = problem.layout.n_y
    features = []
    targets = []
    for run, W in zip(stage.simulated(), problem.runs, strict=True):
        features.append(_windows(W, d))
        targets.append(_windows(run[:, :n_y] - W[:, :n_y], d))
    X = np.vstack(features)
    X = np.hstack([X, np.ones((len(X), 1))])
    Y = np.vstack(targets)
    gram = X.T @ X / len(X)
    noise = float((Y * Y).mean())
    gain = np.linalg.solve(gram + (1e-9 + 1e-3 * noise) * np.eye(len(gram)), X.T @ Y / len(X))
    return np.ascontiguousarray(gain.T)


def _windows(W: FloatArray, depth: int) -> FloatArray:
    """(N - depth + 1, depth * columns) every window of `depth` rows, flattened row by row."""
    view = np.lib.stride_tricks.sliding_window_view(W, depth, axis=0)
    return np.ascontiguousarray(view.transpose(0, 2, 1)).reshape(len(view), -1)


@dataclass(frozen=True, eq=False)
class _Runner:
    """What `estimate_start` needs of a model, in normalised units."""

    stage: Stage

    @property
    def n_init(self) -> int:
        return self.stage.problem.layout.depth

    @cached_property
    def _free(self) -> Parameters:
        problem = self.stage.problem
        return unheld(problem.layout.lags, problem.parameters(self.stage.body))

    def unlimited(self) -> _Runner:
        problem = replace(self.stage.problem, limits=self._free.limits)
        return _Runner(replace(self.stage, problem=problem))

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        problem = self.stage.problem
        W = np.hstack([np.zeros((len(u), problem.layout.n_y)), u])
        W[: self.n_init, : problem.layout.n_y] = y0
        free_run(W, self.n_init, problem.layout.lags, self._free)
        return np.asarray(np.clip(W[:, : problem.layout.n_y], *problem.limits))


def free_run_errors(stage: Stage, runs: Sequence[FloatArray], window: int) -> list[FloatArray]:
    """(N - window, n_y) simulated minus measured outputs of every run, normalised.

    The first `window` rows only give the initial state, as in the comparison on held-out data: a choice
    must not hang on how well a few noisy samples start a high order. Hidden states start where they are
    most likely.
    """
    layout = stage.layout
    n_y = layout.n_y
    if layout.hidden:
        par = stage.problem.parameters(stage.body)
        first = initial_states(layout, runs, par, prior_of(stage), window - layout.depth + 1)
        pairs = zip(runs, first, strict=True)
        return [(started_run(layout, W, x, par) - W)[window:, :n_y] for W, x in pairs]
    runner = _Runner(stage)
    errors = []
    for W in runs:
        u = W[:, n_y:]
        y = W[:, :n_y]
        start = estimate_start(runner, u[:window], y[:window])
        errors.append(runner.simulate(u, start)[window:] - y[window:])
    return errors


def judging_window(runs: Sequence[FloatArray], least: int) -> int:
    """Rows of every validation run that start the candidates: a tenth of the shortest, or `least`."""
    return max(least, int(MAX_SHARE * min(len(W) for W in runs)))


def blocks(errors: Sequence[FloatArray]) -> FloatArray:
    """Mean squares over about 16 blocks of consecutive samples; no block crosses a run's edge."""
    size = max(1, sum(len(e) for e in errors) // _BLOCKS)
    parts = [part for e in errors for part in np.array_split(e, max(1, round(len(e) / size)))]
    return np.array([float((p * p).mean()) for p in parts])


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model on a judging part, simplest first in every list.

    Attributes
    ----------
    errors : mean squares over about 16 blocks of one free run per segment.
    stable : it came back from bounded random inputs.
    linear : the model of the linear side that a stage of one rule comes from.
    moved : it was refined since.
    windows : mean squares over a few windows, each with a start of its own, so that what one manoeuvre left
        behind does not speak again in the next.
    """

    stage: Stage
    errors: FloatArray
    stable: bool = True
    linear: LinearModel | None = None
    moved: bool = True
    windows: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def mean(self) -> float:
        """Mean square of the validation free run, in units of the outputs' variance."""
        return float(self.errors.mean())


def choose(
    candidates: Sequence[Candidate],
    *,
    least_gain: float = 0.0,
    most_loss: float = np.inf,
    most_misfit: float = np.inf,
) -> int:
    """Index of the simplest stable candidate within one standard error of the best stable one.

    `least_gain` and `most_loss` bound the relative loss in mean square that simplicity is worth: a rule
    must lower it by more than the first, however sure that gain is. Orders are chosen with a most_loss of
    0.05, because a linear model of too low an order makes rules look useful that only replace its lags.
    `most_misfit` bounds the loss on the training part in the same way: one validation flight may happen not
    to ask for what a simpler model lacks.
    """
    stable = [i for i, c in enumerate(candidates) if c.stable]
    if not stable:
        return 0
    best = min(stable, key=lambda i: candidates[i].mean)
    for i in stable:
        gap = candidates[i].errors - candidates[best].errors
        allowed = float(gap.std(ddof=1) / np.sqrt(len(gap))) if len(gap) > 1 else 0.0
        allowed = min(max(allowed, least_gain * candidates[best].mean), most_loss * candidates[best].mean)
        fits = candidates[i].stage.cost <= (1.0 + most_misfit) * candidates[best].stage.cost
        if i == best or (fits and gap.mean() <= allowed) or candidates[i].mean < _RESOLUTION:
            return i
    return best


def is_bounded(stage: Stage, seed: int = 0) -> bool:
    """Whether the free run comes back from bounded random inputs, and stays near under usual ones.

    First random steps over the whole range of the training inputs, which may push any plant far out; then
    blocks of the training inputs in random order. In that second part no more than one sample in fifty may
    lie on an output limit (the range of training, widened by itself on each side) or, with hidden states,
    half the range beyond what was simulated: ends at which a plant itself saturates are no limits in this
    sense. The model must also forget how it was started (`is_contracting`), and rules over lags must stay
    off the limits most of the time where random inputs are held for long. Of a model that holds an integrator
    the changes of the output are asked instead (the range widened tenfold), as its output may go anywhere.
    Lags are held at the limits here, those of a single rule too (`unheld`): one that stays there is too near
    to instability.
    """
    problem = stage.problem
    layout = stage.layout
    x = _pushed(stage, seed)[_STEPS + _STEPS // 4 :]
    limits = problem.limits
    seen = [run[layout.uncompared :, : layout.n] for run in stage.simulated()]
    if layout.hidden:
        limits = widened(_range(seen), _NEAR)
    if problem.integrates:
        if not _rules_settle(stage):
            return False
        x = np.diff(x, axis=0)
        limits = widened(_range([np.diff(run, axis=0) for run in seen]), _FAR)
    if not _share_at(x, limits) < _RARELY:
        return False
    if problem.integrates or not _returns(stage):
        return problem.integrates
    par = problem.parameters(stage.body)
    return is_contracting(problem.runs, _range(seen), layout.depth, layout.lags, par)


def _range(runs: Sequence[FloatArray]) -> FloatArray:
    """(2, n) smallest and largest values of every column."""
    x = np.vstack(list(runs))
    return np.stack([x.min(axis=0), x.max(axis=0)])


def _returns(stage: Stage) -> bool:
    """Whether rules over lags stay off their limits most of the time under random inputs held for long.

    Short pushes average out in a slow plant: they do not reach the place from which rules run away. A stable
    linear model comes back by itself once the inputs turn, so that only rules are asked.
    """
    if stage.rules == 1 or stage.layout.hidden:
        return True
    y = _pushed(stage, _LONG_SEED, _LONG_HOLD)[:_STEPS]
    return _share_at(y, stage.problem.limits) < _MOST_AWAY


def _pushed(stage: Stage, seed: int, longest: int | None = None) -> FloatArray:
    """(2 _STEPS, n) what is simulated under the inputs of `probe_run`, held at the limits."""
    problem = stage.problem
    layout = stage.layout
    W = probe_run(problem.runs, layout.n, _STEPS, seed, longest)
    free_run(W, layout.depth, layout.lags, problem.parameters(stage.body))
    return W[:, : layout.n]


def _share_at(x: FloatArray, limits: FloatArray) -> float:
    """Share of the rows of x (N, n) in which a column is at a limit, beyond it, or no number."""
    return float((~((x > limits[0]) & (x < limits[1]))).any(axis=1).mean())


def _rules_settle(stage: Stage) -> bool:
    """Whether no rule has a pole outside the unit circle: behind an integrator it would drift away."""
    lags = stage.problem.layout.orders.na
    theta = stage.problem.parameters(stage.body).theta[:, 0, :lags]
    poles = [np.abs(np.roots(np.concatenate([[1.0], -row]))).max() for row in theta]
    return bool(max(poles) < 1.0 + _ROUNDING)


def judged(stage: Stage, runs: Sequence[FloatArray], skip: int, *, must_be_bounded: bool = True) -> Candidate:
    """A stage on judging runs, of which the first rows (at least `skip`) only start it; may it be offered?"""
    errors = blocks(free_run_errors(stage, runs, judging_window(runs, skip)))
    own = _window_errors(stage, runs, skip) if stage.layout.hidden else np.zeros(0)
    stable = is_bounded(stage) if must_be_bounded else True
    return Candidate(stage, _finite(errors), stable, windows=_finite(own))


def _window_errors(stage: Stage, runs: Sequence[FloatArray], skip: int) -> FloatArray:
    """Mean squares of free runs over windows, cut alike for every depth, so that any two can be compared."""
    rows = max(sum(len(W) for W in runs) // _WINDOWS, _LONGER * skip)
    pieces = [W for W in windows(runs, skip, rows) if len(W) > skip + _SCORED]
    return np.array([float((e * e).mean()) for e in free_run_errors(stage, pieces, skip)])


def _finite(errors: FloatArray) -> FloatArray:
    return np.where(np.isfinite(errors), np.minimum(errors, _AWAY), _AWAY)
