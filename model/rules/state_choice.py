"""Which start, ridge and number of rules to take: families of models, judged over held-out parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.judging import Candidate
from flysid.model.rules.realisation import PLAIN_WORDS
from flysid.model.rules.state_systems import System

_RULE_GAIN = 0.1  # of the mean square: what a rule must win
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_CLEAR = 1.5  # standard errors over windows; those of one fold share a model
_UNBOUNDED = 1e6  # mean square that stands for a model that may not be offered


@dataclass(frozen=True, eq=False)
class Start:
    """A linear system in one choice of coordinates, from which rules are grown."""

    system: System
    coordinates: str


@dataclass(frozen=True, eq=False)
class Family:
    """Models with 1, 2, 3, ... rules grown from one start, judged over the folds.

    Attributes
    ----------
    ridge : weight on the difference of the rules, see `Training`.
    folds : per fold, the models in the order of their rules.
    words : what the hidden states are.
    """

    start: Start
    ridge: float
    folds: tuple[tuple[Candidate, ...], ...]
    words: str = PLAIN_WORDS

    @property
    def logs(self) -> FloatArray:
        """(folds, rules) logarithms of the mean squares, as far as all folds reach.

        Folds are averaged in logarithms: where a fold hides the only manoeuvre of its kind, every model
        errs there by multiples, and a plain mean would look at nothing else.
        """
        most = min(len(f) for f in self.folds)
        means = [[max(m.mean, _EXACT) if m.stable else _UNBOUNDED for m in f[:most]] for f in self.folds]
        return np.asarray(np.log(np.array(means)), dtype=np.float64)

    @property
    def rmse(self) -> FloatArray:
        """(rules,) typical validation error in standard deviations of the output."""
        return np.asarray(np.exp(0.5 * self.logs.mean(axis=0)))


def fewest_rules(family: Family, plain: Family) -> int:
    """Index of the rule count to take: the fewest rules that are not clearly worse than the best.

    Models are compared window by window in logarithms, so that a manoeuvre which only one fold holds out, and
    which every model errs on by multiples, is one voice of many. A single judging part is compared over the
    blocks of its free run.

    Parameters
    ----------
    plain : judges a single rule, the best of all starts.
    """
    if len(family.folds) == 1:
        models = (plain.folds[0][0], *family.folds[0][1:])
        return _fewest([m.errors if m.stable else np.full(len(m.errors), _UNBOUNDED) for m in models])
    counts = range(min(len(f) for f in family.folds))
    units = [_window_logs(plain if i == 0 else family, i) for i in counts]
    best = int(np.argmin([u.mean() for u in units]))
    for i in range(best):
        gap = units[i] - units[best]
        if gap.mean() <= max(_CLEAR * _standard_error(gap), _RULE_GAIN):
            return i
    return best


def _window_logs(family: Family, at: int) -> FloatArray:
    """Logarithms of the mean squares of all windows of all folds; the worst for what is not bounded."""
    models = [fold[at] for fold in family.folds]
    found = np.log(np.maximum(np.concatenate([m.windows for m in models]), _EXACT))
    return found if all(m.stable for m in models) else np.full(len(found), np.log(_UNBOUNDED))


def _fewest(errors: list[FloatArray]) -> int:
    best = int(np.argmin([e.mean() for e in errors]))
    for i in range(best):
        gap = (errors[i] - errors[best]) / max(float(errors[i].mean()), _EXACT)
        if gap.mean() <= max(_standard_error(gap), _RULE_GAIN) or errors[i].mean() < _EXACT:
            return i
    return best


def _standard_error(gap: FloatArray) -> float:
    return float(gap.std(ddof=1) / np.sqrt(len(gap))) if len(gap) > 1 else 0.0
