"""Families: models with 1, 2, 3, ... rules grown from one linear start, and how many of the rules to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.judging import AWAY, EXACT, Candidate
from flysid.model.rules.realisation import PLAIN, PLAIN_WORDS, StateRealisation
from flysid.model.selection import standard_error

_CLEAR = 1.5  # standard errors over windows of several folds; those of one fold share a model


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
        means = [[max(m.mean, EXACT) if m.stable else AWAY for m in f[: self.stages]] for f in self.folds]
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
        return np.maximum(found, EXACT) if all(m.stable for m in models) else np.full(len(found), AWAY)


def tolerant(family: Family) -> Family:
    """The family as if all were bounded: a process that integrates has linear models that drift, too."""
    return replace(family, folds=tuple(tuple(replace(m, stable=True) for m in f) for f in family.folds))


def fewest_rules(family: Family, plain: Family, gain: float) -> int:
    """Index of the rule count to take: the fewest rules that are not clearly worse than the best.

    Windows of several folds are compared in logarithms, blocks of one free run in shares of its mean square.

    Parameters
    ----------
    plain : judges a single rule, the best of all starts.
    gain : share of the mean square that a rule must win, however sure it is.
    """
    units = sweep(family, plain)
    best = _best(units, family)
    clear = _CLEAR if len(family.folds) > 1 else 1.0
    for i in range(best):
        gap = _gap(units[i], units[best], family)
        if gap.mean() <= max(clear * standard_error(gap), gain) or units[i].mean() <= EXACT:
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
