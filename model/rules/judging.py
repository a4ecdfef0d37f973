"""Choosing among TS models without looking at the test: validation free run, one standard error, stability.

A model is judged by its free run over validation runs, cut into blocks; two models are compared block by
block, so that what is hard for both cancels. The simplest model whose mean square is within one standard
error of the best is taken (Breiman et al. 1984). A model that does not come back from bounded random inputs
is never offered. Of a family, models with 1, 2, 3, ... rules grown from one linear start, the fewest rules
are taken that are not clearly worse than the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.model.polynomials import VANISHING
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.likely_start import initial_states
from flysid.model.rules.linear_starts import PLAIN, PLAIN_WORDS, LinearStart, StateRealisation
from flysid.model.rules.recursion import drop_held
from flysid.model.rules.regressor_layout import windows
from flysid.model.rules.search_settings import QUARTERS
from flysid.model.rules.stages import Stage, prior_of
from flysid.model.selection import FEWEST, block_means, standard_error
from flysid.model.start import MAX_SHARE

INTEGRATES = (
    "The process integrates: its free run keeps the initial condition, and an input with a non-zero "
    "mean drives it to the output limits."
)
"""What users are told of a model that does not come back."""
_LONGER = 3  # times what starts it, that a window of a judging part is at least long
AWAY = 1.0 / VANISHING
"""Mean square of what ran away, or may not be offered."""
_CLEAR = 1.5  # standard errors over windows of several folds; those of one fold share a model


def hold_out(train: Dataset, least: int, fold: int = 0) -> tuple[Dataset, Dataset]:
    """Training and validation parts of `train`: every fourth segment, or a quarter of each where few.

    Whole segments are held out where there are at least four long enough; otherwise one quarter of each,
    the last one in fold 0, earlier ones in folds 1 to 3. Nothing is drawn sample by sample.
    """
    usable = [s for s in train.segments if len(s) >= least]
    if len(usable) >= QUARTERS:
        held = [s for i, s in enumerate(usable) if i % QUARTERS == (2 + fold) % QUARTERS]
        kept = [s for i, s in enumerate(usable) if i % QUARTERS != (2 + fold) % QUARTERS]
        return train.with_segments(kept), train.with_segments(held)
    first: list[Segment] = []
    last: list[Segment] = []
    for segment in usable:
        n = len(segment)
        begin = n - (fold + 1) * (n // QUARTERS)
        end = n - fold * (n // QUARTERS)
        parts = [segment.slice(a, b, train.dt_s) for a, b in ((0, begin), (end, n)) if b - a >= least]
        if end - begin < least or not parts:
            first.append(segment)
            continue
        first += parts
        last.append(segment.slice(begin, end, train.dt_s))
    return train.with_segments(first), train.with_segments(last or first)


def free_run_errors(stage: Stage, runs: Sequence[FloatArray], window: int) -> list[FloatArray]:
    """(N - window, n_y) simulated minus measured outputs of every run, normalised.

    The first `window` rows only give the initial state, as in the comparison on held-out data: a choice
    must not hang on how well a few noisy samples start a high order. Hidden states start where they are
    most likely.
    """
    layout = stage.layout
    n_y = layout.n_y
    par = stage.problem.parameters(stage.body)
    par = par if layout.hidden else drop_held(layout.lags, par)
    first = initial_states(layout, runs, par, prior_of(stage), window - layout.uncompared)
    limits = stage.problem.limits[:, :n_y]
    return [
        (np.clip(started_run(layout, W, x, par)[:, :n_y], *limits) - W[:, :n_y])[window:]
        for W, x in zip(runs, first, strict=True)
    ]


def judging_window(runs: Sequence[FloatArray], least: int) -> int:
    """Rows of every validation run that start the candidates: a tenth of the shortest, or `least`."""
    return max(least, int(MAX_SHARE * min(len(W) for W in runs)))


def blocks(errors: Sequence[FloatArray]) -> FloatArray:
    """Mean squares over about 16 blocks of consecutive samples; no block crosses a run's edge."""
    return block_means([np.mean(e * e, axis=1) for e in errors])


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
    linear: LinearStart | None = None
    moved: bool = True
    windows: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def mean(self) -> float:
        """Mean square of the validation free run, in units of the outputs' variance."""
        return float(self.errors.mean())


def judged(stage: Stage, runs: Sequence[FloatArray], skip: int, *, must_be_bounded: bool = True) -> Candidate:
    """A stage on judging runs, of which the first rows (at least `skip`) only start it; may it be offered?"""
    errors = blocks(free_run_errors(stage, runs, judging_window(runs, skip)))
    own = _window_errors(stage, runs, skip)
    stable = is_bounded(stage) if must_be_bounded else True
    return Candidate(stage, _finite(errors), stable, windows=_finite(own if len(own) else errors))


def _window_errors(stage: Stage, runs: Sequence[FloatArray], skip: int) -> FloatArray:
    """Mean squares of free runs over windows, cut alike for every depth, so that any two can be compared."""
    rows = max(sum(len(W) for W in runs) // QUARTERS, _LONGER * skip)
    pieces = [W for W in windows(runs, skip, rows) if len(W) >= skip + FEWEST]
    return np.array([float((e * e).mean()) for e in free_run_errors(stage, pieces, skip)])


def _finite(errors: FloatArray) -> FloatArray:
    return np.where(np.isfinite(errors), np.minimum(errors, AWAY), AWAY)


@dataclass(frozen=True, eq=False)
class Family:
    """Models with 1, 2, 3, ... rules grown from one linear model, judged over the folds.

    Attributes
    ----------
    folds : per fold, the models in the order of their rules.
    ridge : weight on the difference of the rules, see `Training`.
    system, coordinates : over hidden states, the linear system they come from, and how its states are chosen.
    words : what the hidden states are.
    """

    folds: tuple[tuple[Candidate, ...], ...]
    ridge: float = 0.0
    system: StateRealisation | None = None
    coordinates: str = PLAIN
    words: str = PLAIN_WORDS

    @property
    def linear(self) -> Candidate:
        """One rule on the first part."""
        return self.folds[0][0]

    @property
    def stages(self) -> int:
        """Numbers of rules that every fold has reached."""
        return min(len(f) for f in self.folds)

    @property
    def logs(self) -> FloatArray:
        """(folds, rules) logarithms of the mean squares, as far as all folds reach.

        Folds are averaged in logarithms: where a fold hides the only manoeuvre of its kind, every model
        errs there by multiples, and a plain mean would look at nothing else.
        """
        means = [[max(m.mean, VANISHING) if m.stable else AWAY for m in f[: self.stages]] for f in self.folds]
        return np.asarray(np.log(np.array(means)), dtype=np.float64)

    @property
    def rmse(self) -> FloatArray:
        """(rules,) typical validation error in standard deviations of the output."""
        return np.asarray(np.exp(0.5 * self.logs.mean(axis=0)))

    def units(self, at: int) -> FloatArray:
        """Mean squares of all windows of all folds; of a single fold of the blocks of its free run.

        A manoeuvre which only one fold holds out, and which every model errs on by multiples, is then one
        voice of many. The worst for what is not bounded.
        """
        models = [fold[at] for fold in self.folds]
        found = models[0].errors if len(models) == 1 else np.concatenate([m.windows for m in models])
        return np.maximum(found, VANISHING) if all(m.stable for m in models) else np.full(len(found), AWAY)


def tolerant(family: Family, *, stressed: bool = True) -> Family:
    """The family as if all were bounded: a process that integrates has linear models that drift, too.

    Parameters
    ----------
    stressed : what grows from it is still kept near its range under stress.
    """

    def free(model: Candidate) -> Candidate:
        stage = model.stage if stressed else model.stage.under(stress=None)
        return replace(model, stage=stage, stable=True)

    return replace(family, folds=tuple(tuple(map(free, fold)) for fold in family.folds))


def fewest_rules(family: Family, plain: Family, gain: float) -> int:
    """Index of the rule count to take: the fewest rules that are not clearly worse than the best.

    Windows of several folds are compared in logarithms, blocks of one free run in shares of its mean square.

    Parameters
    ----------
    plain : judges a single rule, the best of all starts.
    gain : share of the mean square that a rule must win, however sure it is.
    """
    return simplest_of(sweep(family, plain), family, gain)


def simplest_of(units: Sequence[FloatArray], family: Family, gain: float) -> int:
    """Index of the first of several models, simplest first, that is not clearly worse than the best.

    Parameters
    ----------
    units : `Family.units` of every model, over the folds of `family`.
    gain : as in `fewest_rules`.
    """
    best = _best(units, family)
    clear = _CLEAR if len(family.folds) > 1 else 1.0
    for i in range(best):
        gap = _gap(units[i], units[best], family)
        if gap.mean() <= max(clear * standard_error(gap), gain) or units[i].mean() <= VANISHING:
            return i
    return best


def sweep(family: Family, plain: Family) -> list[FloatArray]:
    """`Family.units` per number of rules, those of one rule from `plain`."""
    return [plain.units(0), *(family.units(i) for i in range(1, family.stages))]


def sweep_in_words(family: Family, plain: Family) -> str:
    """ "1: 0.183 +- 0.012, 2: 0.134, 3: not bounded"; +- is a standard error of the distance to the best."""
    units = sweep(family, plain)
    errors = [float(plain.rmse[0]), *(float(e) for e in family.rmse[1:])]
    best = units[_best(units, family)]
    said = []
    for rules, (error, own) in enumerate(zip(errors, units, strict=True), 1):
        if own.max() >= AWAY:
            said.append(f"{rules}: not bounded")
            continue
        spread = 0.5 * error * standard_error(_gap(own, best, family))
        said.append(f"{rules}: {error:.3g}" + (f" +- {spread:.2g}" if spread > 0.0 else ""))
    return ", ".join(said)


def _best(units: Sequence[FloatArray], family: Family) -> int:
    means = [u.mean() if len(family.folds) == 1 else np.log(u).mean() for u in units]
    return int(np.argmin(means))


def _gap(one: FloatArray, other: FloatArray, family: Family) -> FloatArray:
    """By how much the first errs more, in shares of the mean square or nearly so."""
    if len(family.folds) > 1:
        return np.asarray(np.log(one) - np.log(other))
    return (one - other) / float(one.mean())
