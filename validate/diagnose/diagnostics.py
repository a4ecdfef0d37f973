"""Why a model is right or wrong on held-out data: residual tests, extrapolation, poles, rules."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.extras import Extra, extra
from flysid.feedback import Feedback, feedback
from flysid.model.base import Fitted
from flysid.model.nonlinearity import Nonlinearity, nonlinearity
from flysid.model.start import as_modelled
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.trials import FREE_RUN, StructureTrial, run_trials
from flysid.validate.diagnose.checks import Checks, check
from flysid.validate.diagnose.nearness import Nearness, nearness
from flysid.validate.diagnose.residuals import (
    Correlation,
    ResidualSpectrum,
    autocorrelation,
    cross_correlation,
    spectrum,
)

T = TypeVar("T")


@dataclass(frozen=True)
class Outside:
    """Share of held-out samples of one signal outside its training range, and where most of it is."""

    signal: Signal
    low: float
    high: float
    share: float
    worst_segment: int
    worst_share: float


@dataclass(frozen=True)
class RuleUse:
    """How the rules of one model are used on held-out data.

    Attributes
    ----------
    strongest : (R,) share of samples where each rule is the strongest.
    mean : (R,) mean firing strength.
    overlap : mean of 1 - the largest firing strength; 0: one rule at a time, 1 - 1/R: all alike.
    """

    strongest: tuple[float, ...]
    mean: tuple[float, ...]
    overlap: float


@dataclass(frozen=True, eq=False)
class OutputDiagnosis:
    """Residual tests of one output.

    Attributes
    ----------
    whiteness : one-step autocorrelation, by model.
    dependence : free-run error against every input, by model; models that diverged are left out.
    responses : empirical frequency response from every input, None where data are too short.
    """

    output: Signal
    whiteness: Mapping[str, Correlation]
    dependence: Mapping[str, tuple[Correlation, ...]]
    responses: tuple[ResidualSpectrum | None, ...]

    @property
    def main_input(self) -> int:
        """The input with the highest mean coherence: the one worth drawing."""
        means = [0.0 if s is None else float(np.mean(s.coherence)) for s in self.responses]
        return int(np.argmax(means))


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything about one channel.

    Attributes
    ----------
    outside : per signal (inputs, then outputs); empty without training data.
    pole_radius : largest pole modulus over the rules, by model.
    changes : per input, share of held-out samples that differ from the one before.
    checks : of the models of the headline: stability, conditioning, intervals.
    near : how far held-out samples are from training samples; None without training data, or too few.
    loops : per output, whether the input answers it, in the training data where known.
    nonlinear : per output, what share does not follow the inputs linearly in the training data, where known.
    steps : predictions by horizon: one step ahead of every model, further ahead of those of the headline.
    """

    outputs: tuple[OutputDiagnosis, ...]
    outside: tuple[Outside, ...]
    pole_radius: Mapping[str, float]
    rule_use: Mapping[str, RuleUse]
    changes: tuple[float, ...]
    checks: Mapping[str, Checks]
    free_runs: tuple[StructureTrial, ...]
    loops: tuple[Feedback, ...] = ()
    nonlinear: tuple[Nonlinearity, ...] = ()
    near: Nearness | None = None
    steps: Mapping[str, tuple[StructureTrial, ...]] = field(default_factory=dict)


def diagnose(comparison: Comparison, train: Dataset | None = None) -> Diagnosis:
    """Run every test on the held-out part of `comparison`; `train` gives the ranges seen in training.

    A test that breaks is left out (`flysid.extras`).
    """
    where = comparison.channel
    return extra(Extra.DIAGNOSIS, partial(_diagnose, comparison, train), unknown(comparison), where)


def unknown(comparison: Comparison) -> Diagnosis:
    """Nothing is known of any test."""
    nothing = (None,) * len(comparison.test.inputs)
    outputs = tuple(OutputDiagnosis(s, {}, {}, nothing) for s in comparison.test.outputs)
    return Diagnosis(outputs, (), {}, {}, (), {}, (), steps={"1": ()})


def _diagnose(comparison: Comparison, train: Dataset | None) -> Diagnosis:
    models = comparison.fitted
    test = comparison.test
    where = comparison.channel
    free = run_trials(models, test, FREE_RUN)
    one = run_trials(models, test, "1")
    headline = {n: models[n] for n in (comparison.baseline, comparison.contender) if n}
    further = [h for h in comparison.horizons if h not in (FREE_RUN, "1")]
    dynamic = [name for name, info in comparison.models.items() if not info.reference]
    several = [name for name, info in comparison.models.items() if info.n_rules > 1]
    found = Diagnosis(
        outputs=tuple(_output(j, free, one, comparison) for j in range(len(test.outputs))),
        outside=(),
        pole_radius=_of_each(
            Extra.POLES, dynamic, lambda n: max(r.pole_radius for r in models[n].rules()), where
        ),
        rule_use=_of_each(Extra.RULE_USE, several, lambda n: rule_use(models[n], test), where),
        checks={n: check(model, test, train, f"{n} on {where}") for n, model in headline.items()},
        changes=tuple(_changes(test, i) for i in range(len(test.inputs))),
        free_runs=free,
        steps={"1": one} | {h: run_trials(headline, test, h) for h in further},
    )
    if train is None:
        return found
    linear = models[comparison.baseline]
    lags = max(1, comparison.lags)
    return replace(
        found,
        outside=extra(Extra.OUTSIDE, partial(outside_training, train, test), (), where),
        loops=extra(Extra.LOOP, partial(feedback, train), (), where),
        nonlinear=extra(Extra.NONLINEARITY, partial(nonlinearity, linear, train), (), where),
        near=extra(Extra.NEARNESS, partial(nearness, train, test, lags), None, where),
    )


def _of_each(which: Extra, names: Iterable[str], find: Callable[[str], T], where: str) -> dict[str, T]:
    """What is found of every model, by name; without those of which nothing can be."""
    found = {name: extra(which, partial(find, name), None, f"{name} on {where}") for name in names}
    return {name: value for name, value in found.items() if value is not None}


def _output(
    j: int, free: Sequence[StructureTrial], one: Sequence[StructureTrial], comparison: Comparison
) -> OutputDiagnosis:
    test = comparison.test
    lags = _lags([len(t.y) for t in free], test.dt_s)
    inputs = range(len(test.inputs))
    us = [[test.segments[t.segment].u[t.first :, i] for t in free] for i in inputs]
    lost = {name for t in free for name in t.diverged_s}

    def white(name: str) -> Correlation:
        return autocorrelation([t.y[:, j] - t.yh[name][:, j] for t in one], lags)

    def depends(name: str) -> tuple[Correlation, ...]:
        errors = [t.y[:, j] - t.yh[name][:, j] for t in free]
        return tuple(cross_correlation(errors, us[i], lags) for i in inputs)

    def response(i: int) -> ResidualSpectrum | None:
        return spectrum([s.u[:, i] for s in test.segments], [s.y[:, j] for s in test.segments], test.dt_s)

    where = comparison.channel
    kept = [name for name in comparison.models if name not in lost]
    return OutputDiagnosis(
        output=test.outputs[j],
        whiteness=_of_each(Extra.WHITENESS, list(comparison.models), white, where),
        dependence=_of_each(Extra.DEPENDENCE, kept, depends, where),
        responses=tuple(extra(Extra.RESPONSES, partial(response, i), None, where) for i in inputs),
    )


def _lags(lengths: Sequence[int], dt_s: float, *, look_back_s: float = 2.0) -> int:
    """About two seconds, 20 to 60 samples, never more than a quarter of the longest segment."""
    return max(1, min(int(np.clip(round(look_back_s / dt_s), 20, 60)), max(lengths) // 4))


def outside_training(train: Dataset, test: Dataset) -> tuple[Outside, ...]:
    """Share of `test` outside the range of `train`, per signal: inputs, then outputs."""
    found = []
    for side, signals in (("u", test.inputs), ("y", test.outputs)):
        for i, signal in enumerate(signals):
            seen = np.concatenate([getattr(s, side)[:, i] for s in train.segments])
            low = float(seen.min())
            high = float(seen.max())
            shares = [_share_outside(getattr(s, side)[:, i], low, high) for s in test.segments]
            weights = np.array([len(s) for s in test.segments], dtype=np.float64)
            worst = int(np.argmax(shares))
            mean = float(np.average(shares, weights=weights))
            found.append(Outside(signal, low, high, mean, worst, shares[worst]))
    return tuple(found)


def _share_outside(x: FloatArray, low: float, high: float) -> float:
    return float(np.mean((x < low) | (x > high))) if len(x) else 0.0


def rule_use(model: Fitted, data: Dataset) -> RuleUse:
    """Firing strengths of `model` along measured data."""
    firing = np.vstack([model.firing(s.u, as_modelled(model, s).y) for s in data.segments])
    strongest = np.bincount(np.argmax(firing, axis=1), minlength=firing.shape[1]) / len(firing)
    return RuleUse(
        strongest=tuple(float(v) for v in strongest),
        mean=tuple(float(v) for v in firing.mean(axis=0)),
        overlap=float(np.mean(1.0 - firing.max(axis=1))),
    )


def _changes(test: Dataset, i: int) -> float:
    moved = sum(int(np.count_nonzero(np.diff(s.u[:, i]))) for s in test.segments)
    return moved / max(1, sum(len(s) - 1 for s in test.segments))
