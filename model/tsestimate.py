"""From settings and data to a chosen TS model: orders, growth, rule count, and the reasons in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.tsgrow import (
    Stage,
    embedded_start,
    first_basis,
    linear_stage,
    one_rule_more,
    ordered,
    refine,
    rule_support,
    unrefined,
    with_ridge,
)
from flysid.model.tslayout import Antecedent, Layout, Orders, parse_antecedent, scaling
from flysid.model.tsproblem import Problem, runs_of
from flysid.model.tsrefit import on_all_runs
from flysid.model.tsselect import Candidate, choose, hold_out, initial_state_gain, judged

_HIGHEST_ORDER = 4
_RIDGES = (1e-3, 3e-2, 1.0, 1e3)  # the last one leaves the rules equal
_ORDER_LOSS = 0.01
_EXACT = 1e-10  # mean squares, in variances of the output, that count as none
_SPARE_ROWS = 10  # a segment must be longer than the depth by this to say anything


class Settings(Protocol):
    """What `learn` needs to know; `TS` is one."""

    @property
    def rules(self) -> int | Literal["auto"]: ...
    @property
    def na(self) -> int | Literal["auto"]: ...
    @property
    def nb(self) -> int | Sequence[int] | Literal["auto"]: ...
    @property
    def nk(self) -> int | Sequence[int] | Literal["auto"]: ...
    @property
    def antecedents(self) -> Sequence[str] | Literal["auto"]: ...
    @property
    def refine(self) -> bool: ...
    @property
    def most_rules(self) -> int: ...
    @property
    def iterations(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage with what a fitted model also stores."""

    stage: Stage
    initial_gain: FloatArray
    support: FloatArray
    notes: tuple[str, ...]


def learn(settings: Settings, train: Dataset, validation: Dataset | None) -> Learned:
    """Choose orders, then rules, by the validation free run; see the module's parts for the methods."""
    check(settings)
    choices = order_choices(settings, len(train.inputs))
    named = _named(settings, train)
    least = max([*(o.depth for o in choices), *(max(a.lag, a.minus) for a in named), 1]) + _SPARE_ROWS
    fit_part, check_part, own = _parts(train, validation, least)
    shift, scale = scaling(fit_part)
    workshop = Workshop(settings, fit_part, check_part, shift, scale, least)
    linear, notes = workshop.linear(choices)
    models, grown = workshop.growth(linear, named)
    at = choose(models) if settings.rules == "auto" else len(models) - 1
    chosen = models[at]
    if not chosen.stable:
        raise FitError(
            "no stable model was found: each one left its output limits under bounded random inputs",
            hint="give more data, lower orders, or fewer rules",
        )
    stage = ordered(chosen.stage)
    if own:
        stage = on_all_runs(stage, runs_of(stage.problem.layout, train.segments, least), settings.iterations)
        grown.append("The model was refined once more on the held-out part together with the rest.")
    verdict = rule_verdict(settings, models, at)
    return Learned(
        stage, initial_state_gain(stage), rule_support(stage), (*notes, *grown, *verdict, _method(settings))
    )


def check(settings: Settings) -> None:
    """Raise UsageError for settings that cannot be."""
    for name in ("rules", "na"):
        value = getattr(settings, name)
        low = 1 if name == "rules" else 0
        if value != "auto" and (isinstance(value, bool) or not isinstance(value, int) or value < low):
            raise UsageError(f"{name}={value!r}", hint=f'give "auto" or a whole number from {low} on')
    for name in ("nb", "nk"):
        value = getattr(settings, name)
        numbers = [value] if isinstance(value, int) else value
        if value != "auto" and any(isinstance(v, str) or int(v) != v or v < 0 for v in numbers):
            raise UsageError(f"{name}={value!r}", hint='give "auto", a whole number, or one per input')
    if settings.most_rules < 1 or settings.iterations < 1:
        raise UsageError("most_rules and iterations must be at least 1")


def _per_input(value: int | Sequence[int], inputs: int, name: str) -> tuple[int, ...]:
    numbers = (int(value),) * inputs if isinstance(value, int) else tuple(int(v) for v in value)
    if len(numbers) != inputs:
        raise UsageError(f"{name} has {len(numbers)} numbers for {inputs} inputs")
    return numbers


def order_choices(settings: Settings, inputs: int) -> list[Orders]:
    """Orders to try, simplest first: n outputs and n + 1 inputs from the present one on, n = 1..4."""
    choices: list[Orders] = []
    for n in range(1, _HIGHEST_ORDER + 1):
        na = n if settings.na == "auto" else settings.na
        nk = 0 if settings.nk == "auto" else settings.nk
        more = 1 if settings.nk == "auto" else 0
        nb = (n if settings.na == "auto" else na) + more if settings.nb == "auto" else settings.nb
        orders = Orders(na, _per_input(nb, inputs, "nb"), _per_input(nk, inputs, "nk"))
        if orders not in choices:
            choices.append(orders)
    if all(b == 0 for b in choices[0].nb) and choices[0].na == 0:
        raise UsageError("na = 0 and nb = 0 leave nothing to learn")
    return choices


def _named(settings: Settings, train: Dataset) -> tuple[Antecedent, ...]:
    if settings.antecedents == "auto":
        return ()
    if isinstance(settings.antecedents, str) or not settings.antecedents:
        raise UsageError(f"antecedents={settings.antecedents!r}", hint='give "auto" or a list of names')
    return tuple(parse_antecedent(a, train.outputs, train.inputs) for a in settings.antecedents)


def _parts(train: Dataset, validation: Dataset | None, least: int) -> tuple[Dataset, Dataset, bool]:
    longest = max((len(s) for s in train.segments), default=0)
    if longest < least:
        raise DataError(
            f"the longest segment has {longest} samples; these orders need {least}",
            hint="record longer, allow longer gaps, or ask for lower orders",
        )
    if validation is not None and any(len(s) >= least for s in validation.segments):
        return train, validation, False
    kept, held = hold_out(train, least)
    return kept, held, True


@dataclass(frozen=True, eq=False)
class Workshop:
    """Data and settings that all stages of one fit share."""

    settings: Settings
    fit_part: Dataset
    check_part: Dataset
    shift: FloatArray
    scale: FloatArray
    least: int

    def problem(self, orders: Orders) -> Problem:
        """The problem of a linear model of these orders."""
        layout = Layout(self.fit_part.outputs, self.fit_part.inputs, orders, (), self.shift, self.scale)
        runs = runs_of(layout, self.fit_part.segments, self.least)
        y = np.vstack([W[:, : layout.n_y] for W in runs])
        margin = np.ptp(y, axis=0)
        limits = np.stack([y.min(axis=0) - margin, y.max(axis=0) + margin])
        basis = first_basis(layout, runs)
        return Problem(layout, runs, basis, np.zeros((layout.n_y, len(basis))), np.zeros((2, 0)), limits)

    def judge(self, stage: Stage, *, must_be_bounded: bool = True) -> Candidate:
        """The stage on the validation part."""
        runs = runs_of(stage.problem.layout, self.check_part.segments, self.least)
        return judged(stage, runs, self.least - _SPARE_ROWS, must_be_bounded=must_be_bounded)

    def linear(self, choices: Sequence[Orders]) -> tuple[Candidate, list[str]]:
        """The linear model of the best orders, each refined from the one before."""
        if not self.settings.refine:
            stages = [unrefined(self.problem(o)) for o in choices]
            candidates = [self.judge(s, must_be_bounded=False) for s in stages]
        else:
            candidates = []
            for orders in choices:
                start = embedded_start(candidates[-1].stage, self.problem(orders)) if candidates else ()
                stage = linear_stage(self.problem(orders), self.settings.iterations, start)
                candidates.append(self.judge(stage))
        at = choose(candidates, _ORDER_LOSS)
        orders = candidates[at].stage.problem.layout.orders
        how = (
            "as given" if len(choices) == 1 else "the simplest within 1 % and one standard error of the best"
        )
        return candidates[at], [f"Orders {orders}: {how} (validation free run of the linear model)."]

    def growth(self, linear: Candidate, named: tuple[Antecedent, ...]) -> tuple[list[Candidate], list[str]]:
        """Models with 1, 2, 3, ... rules."""
        settings = self.settings
        stage = linear.stage
        candidates = named or found_antecedents(stage.problem.layout)
        models = [linear if settings.rules != 1 else self.judge(stage)]
        notes: list[str] = []
        most = settings.most_rules if settings.rules == "auto" else settings.rules
        parameters = stage.body.a.size
        while len(models) < most and parameters * (len(models) + 1) * 4 < stage.problem.samples:
            models.append(self.one_rule_more(models[-1], candidates))
            if settings.rules == "auto" and _has_stalled(models):
                break
        if settings.rules != "auto" and len(models) < settings.rules:
            raise DataError(
                f"{settings.rules} rules of {parameters} numbers need more than the "
                f"{stage.problem.samples} samples there are",
                hint="ask for fewer rules or lower orders, or record longer",
            )
        unstable = [len(m.stage.body.a) for m in models if not m.stable]
        if unstable:
            notes.append(
                "Left the output limits under bounded random inputs, and were not offered: models with "
                + ", ".join(map(str, unstable))
                + " rules."
            )
        return models, notes

    def one_rule_more(self, before: Candidate, candidates: tuple[Antecedent, ...]) -> Candidate:
        """The best split; held together by a ridge where freedom made it unstable or worse.

        In the basis of the linear model's Gauss-Newton matrix a ridge of 1 halves what the data say about
        the difference of two rules, so that the ladder is the same for every data set.
        """
        start, stage = one_rule_more(before.stage, candidates, self.settings.iterations)
        tried = [self.judge(stage)]
        for ridge in _RIDGES:
            if tried[-1].stable and tried[-1].mean <= max(before.mean, _EXACT):
                break
            tried.append(self.judge(refine(with_ridge(start, ridge), self.settings.iterations, 1e-4)))
        return min(tried, key=lambda c: (not c.stable, c.mean))


def found_antecedents(layout: Layout) -> tuple[Antecedent, ...]:
    """Variables to split along: the newest output and input lags, and the change of every output."""
    n_y = layout.n_y
    newest = [Antecedent(i, 1) for i in range(n_y)] if layout.orders.na else []
    inputs = [Antecedent(n_y + j, nk) for j, nk in enumerate(layout.orders.nk) if layout.orders.nb[j]]
    change = [Antecedent(i, 1, 2) for i in range(n_y)] if layout.orders.na >= 2 else []
    return (*newest, *inputs, *change)


def _has_stalled(models: Sequence[Candidate]) -> bool:
    """Two rules more have not helped on validation, or the data are explained exactly."""
    means = [m.mean for m in models]
    return means[-1] < _EXACT or (len(means) > 2 and min(means[-2:]) > 0.98 * min(means[:-2]))


def rule_verdict(settings: Settings, models: Sequence[Candidate], at: int) -> list[str]:
    """The rule count in words."""
    if settings.rules != "auto":
        return [f"{settings.rules} rules, as asked."]
    tried = ", ".join(f"{len(m.stage.body.a)}: {np.sqrt(m.mean):.3g}" for m in models)
    sweep = f"Validation free-run error by number of rules, in standard deviations of the output: {tried}."
    if at == 0:
        return [sweep, "One rule is enough: more rules do not lower the validation error beyond its spread."]
    return [sweep, f"{at + 1} rules: the fewest within one standard error of the best."]


def _method(settings: Settings) -> str:
    if not settings.refine:
        return "Consequents are one-step least squares; the simulation error was not refined."
    return (
        "Consequents and memberships were refined on the simulation error with exact sensitivities; models "
        "were offered only if bounded random inputs kept them inside their output limits."
    )
