"""Which start, ridge and number of rules to take: families of models, judged over held-out parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.hidden.judge import Judged
from flysid.model.hidden.start import Realisation

_RULE_GAIN = 0.1  # of the mean square: what a rule must win
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_UNBOUNDED = 1e6  # mean square that stands for a model that may not be offered


@dataclass(frozen=True, eq=False)
class Start:
    """A linear model in one choice of coordinates, from which rules are grown."""

    real: Realisation
    order: int

    def __str__(self) -> str:
        lags = sorted({min(own) for own in self.real.input_lags})
        return f"{len(self.real.A)} states, delay {', '.join(map(str, lags))}"


@dataclass(frozen=True, eq=False)
class Family:
    """Models with 1, 2, 3, ... rules grown from one start, judged over the folds.

    Attributes
    ----------
    ridge : weight on the difference of the rules, see `Training`.
    folds : per fold, the models in the order of their rules.
    """

    start: Start
    ridge: float
    folds: tuple[tuple[Judged, ...], ...]

    @property
    def logs(self) -> FloatArray:
        """(folds, rules) logarithms of the mean squares, as far as all folds reach.

        Folds are averaged in logarithms: where a fold hides the only manoeuvre of its kind, every model
        errs there by multiples, and a plain mean would look at nothing else.
        """
        most = min(len(f) for f in self.folds)
        means = [[max(m.mean, _EXACT) if m.bounded else _UNBOUNDED for m in f[:most]] for f in self.folds]
        return np.asarray(np.log(np.array(means)), dtype=np.float64)

    @property
    def rmse(self) -> FloatArray:
        """(rules,) typical validation error in standard deviations of the output."""
        return np.asarray(np.exp(0.5 * self.logs.mean(axis=0)))


def fewest_rules(family: Family) -> int:
    """Index of the rule count to take: the fewest rules within one standard error of the best."""
    logs = family.logs
    best = int(logs.mean(axis=0).argmin())
    for i in range(best):
        gap = logs[:, i] - logs[:, best]
        spread = gap.std(ddof=1) / np.sqrt(len(gap)) if len(gap) > 1 else _block_error(family, i, best)
        if gap.mean() <= max(float(spread), _RULE_GAIN):
            return i
    return best


def _block_error(family: Family, i: int, best: int) -> float:
    """Standard error of the relative difference of two models of a single fold, over its blocks."""
    models = family.folds[0]
    gap = (models[i].errors - models[best].errors) / max(models[i].mean, _EXACT)
    return float(gap.std(ddof=1) / np.sqrt(len(gap))) if len(gap) > 1 else 0.0


def chosen(families: Sequence[Family], rules: int | Literal["auto"]) -> tuple[Family, int]:
    """The family to take and the index of its rule count.

    The family of the lowest error, where a mode that drives the outputs is preferred to rates of change at an
    equal error: it is easier to name.
    """
    last = min(f.logs.shape[1] for f in families) - 1
    values = [
        float(f.logs.mean(axis=0)[last] if rules != "auto" else f.logs.mean(axis=0).min()) for f in families
    ]
    order = sorted(
        range(len(families)), key=lambda i: ("mode" not in families[i].start.real.words, values[i])
    )
    family = families[next(i for i in order if values[i] <= min(values) + _RULE_GAIN)]
    return family, fewest_rules(family) if rules == "auto" else last
