"""From settings and data to a chosen TS model: orders, growth, rule count, and the reasons in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.oe_search import check_hint
from flysid.model.tsclustered import clustered_stage
from flysid.model.tsgrow import (
    Stage,
    embedded_start,
    first_basis,
    linear_stage,
    one_rule_more,
    ordered,
    rebased,
    refine,
    unrefined,
    with_ridge,
)
from flysid.model.tslayout import Antecedent, Layout, Orders, parse_antecedent, scaling
from flysid.model.tsproblem import Problem, runs_of
from flysid.model.tsrefit import on_all_runs
from flysid.model.tsselect import Candidate, choose, hold_out, judged
from flysid.model.tsstart import arx_start, as_stage, chosen_by_arx

_HIGHEST_ORDER = 4
_DEEPEST_DELAY = 40  # samples of delay and lags that the linear side may choose on long records
_RIDGES = (1e-2, 1.0, 1e3)  # the last one leaves the rules equal
_ORDER_LOSS = 0.01
_RULE_GAIN = 0.05  # of the mean square: what a rule must win, about 2.5 % of the error
_SMALL = 4000  # samples below which every quarter is held out in turn,
_SMALL_GAIN = 0.2  # and a rule must win more: the choice itself overfits
_HOPELESS = 4.0  # times the mean square of the best linear model: such orders are not grown
_WORSE = 1.5  # times the mean square of a rule less: such a model has gone astray
_CLEARLY = 0.9  # of the mean square: other orders must do better by this to be taken
_LATE = 2  # samples of delay from which a dead time is tried as such
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
    @property
    def nk_hint(self) -> Sequence[int]: ...


@dataclass(frozen=True, eq=False)
class Learned:
    """A chosen stage and how it was chosen, in words."""

    stage: Stage
    notes: tuple[str, ...]


def learn(settings: Settings, train: Dataset, validation: Dataset | None) -> Learned:
    """Choose orders, then rules, by the validation free run; see the module's parts for the methods."""
    check(settings)
    check_hint(settings.nk_hint, len(train.inputs))
    choices = order_choices(settings, len(train.inputs))
    named = _named(settings, train)
    deepest = _DEEPEST_DELAY if len(choices) > 1 and len(train) > _SMALL else 0
    depths = [deepest, *(o.depth for o in choices), *(max(a.lag, a.minus) for a in named)]
    least = max(depths) + _SPARE_ROWS
    fit_part, check_part, own = _parts(train, validation, least)
    shift, scale = scaling(fit_part)
    small = own and settings.rules == "auto" and settings.refine and len(train) < _SMALL
    folds = tuple(hold_out(train, least, fold) for fold in (1, 2, 3)) if small else ()
    workshop = Workshop(settings, fit_part, check_part, shift, scale, least, folds=folds)
    candidates, notes = workshop.linear(choices)
    workshop = replace(workshop, must_be_bounded=any(c.stable for c in candidates))
    if not workshop.must_be_bounded:
        notes.append(
            "The process integrates: linear models of it drift too, so boundedness was not asked for."
        )
    if folds:
        notes.append("Little data: every quarter of it was held out in turn to choose the number of rules.")
    models, grown = workshop.growth(candidates, named)
    at = choose(models, least_gain=workshop.rule_gain) if settings.rules == "auto" else len(models) - 1
    chosen = models[at]
    if not chosen.stable:
        raise FitError(
            "no stable model was found: none came back from bounded random inputs",
            hint="give more data, lower orders, or fewer rules",
        )
    stage = ordered(chosen.stage)
    if own and settings.refine:
        stage = on_all_runs(stage, runs_of(stage.problem.layout, train.segments, least), settings.iterations)
        grown.append("The model was refined once more on the held-out part together with the rest.")
    verdict = rule_verdict(settings, models, at)
    return Learned(stage, (*notes, *grown, *verdict, _method(settings)))


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
    return sorted([*choices, *_delayed(settings, choices)], key=lambda o: (o.na, sum(o.nb)))


def _delayed(settings: Settings, choices: Sequence[Orders]) -> list[Orders]:
    """The choices behind the dead times that the log shows, where no choice bridges those by itself."""
    hint = tuple(settings.nk_hint)
    if settings.nk != "auto" or max(hint, default=0) < _LATE:
        return []
    fewer = 1 if settings.nb == "auto" else 0  # the coefficient of the present input goes
    return [Orders(o.na, tuple(max(1, b - fewer) for b in o.nb), hint) for o in choices]


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
    must_be_bounded: bool = True
    folds: tuple[tuple[Dataset, Dataset], ...] = ()

    @property
    def rule_gain(self) -> float:
        """What a rule must win of the mean square."""
        return _SMALL_GAIN if self.folds else _RULE_GAIN

    def problem(self, orders: Orders) -> Problem:
        """The problem of a linear model of these orders."""
        layout = Layout(self.fit_part.outputs, self.fit_part.inputs, orders, (), self.shift, self.scale)
        runs = runs_of(layout, self.fit_part.segments, self.least)
        y = np.vstack([W[:, : layout.n_y] for W in runs])
        margin = np.ptp(y, axis=0)
        limits = np.stack([y.min(axis=0) - margin, y.max(axis=0) + margin])
        basis = first_basis(layout, runs)
        return Problem(layout, runs, basis, np.zeros((layout.n_y, len(basis))), np.zeros((2, 0)), limits)

    def judge(self, stage: Stage) -> Candidate:
        """The stage on the validation part."""
        runs = runs_of(stage.problem.layout, self.check_part.segments, self.least)
        return judged(stage, runs, self.least - _SPARE_ROWS, must_be_bounded=self.must_be_bounded)

    def linear(self, choices: Sequence[Orders]) -> tuple[list[Candidate], list[str]]:
        """Linear models, each refined from the one before, up to the best orders."""
        candidates: list[Candidate] = []
        for orders in choices:
            problem = self.problem(orders)
            if self.settings.refine:
                nested = (embedded_start(c.stage, problem) for c in reversed(candidates))
                start = next(filter(None, nested), ())
                start += arx_start(problem, self.fit_part)
                stage = linear_stage(problem, self.settings.iterations, start)
            else:
                stage = unrefined(problem)
            candidates.append(self.judge(stage))
        candidates += self._linear_side(len(choices))
        at = choose(candidates, most_loss=_ORDER_LOSS)
        orders = candidates[at].stage.problem.layout.orders
        how = (
            "as given" if len(choices) == 1 else "the simplest within 1 % and one standard error of the best"
        )
        note = f"Orders {orders}: {how} (validation free run of the linear model)."
        others = [c for i, c in enumerate(candidates) if i != at and c.stable == candidates[at].stable]
        if self.settings.nk_hint:  # neighbours in order, not every order with and without the dead time
            others = [c for c in others if c.stage.problem.layout.orders.nk == orders.nk]
        return [candidates[at], *others], [note]

    def _linear_side(self, choices: int) -> list[Candidate]:
        """What the linear side chooses by itself, with its delays, as it is and refined."""
        if choices == 1 or not self.settings.refine:
            return []
        found = chosen_by_arx(self.fit_part, self.check_part, self.settings.nk_hint)
        if found is None or found[0].depth + _SPARE_ROWS > self.least:
            return []
        plain = as_stage(found[1], self.problem(found[0]))
        plain = rebased(plain)
        refined = refine(plain, self.settings.iterations, 1e-6)
        return [self.judge(plain), self.judge(refined)]

    def growth(
        self, linear: Sequence[Candidate], named: tuple[Antecedent, ...]
    ) -> tuple[list[Candidate], list[str]]:
        """Models with 1, 2, 3, ... rules, simplest first, from the best linear model.

        Neighbouring orders are grown too (lower ones always, higher ones where rules help): a linear model
        uses lags to imitate bends, so that its best orders say little about a nonlinear plant.
        """
        settings, first = self.settings, linear[0].stage.problem.layout.orders
        most = settings.most_rules if settings.rules == "auto" else settings.rules
        best = self.cross_validated(self.grown_from(linear[0], named, most), named)
        self._check_count(best)
        notes: list[str] = []
        if settings.rules == "auto" and settings.refine:
            helped = choose(best, least_gain=self.rule_gain) > 0
            for other in linear[1:]:
                orders = other.stage.problem.layout.orders
                lower = orders.na == first.na - 1 and other.mean < _HOPELESS * linear[0].mean
                if not lower and not (helped and orders.na == first.na + 1):
                    continue
                rival = self.cross_validated(self.grown_from(other, named, most, best), named)
                if rival[choose(rival)].mean < best[choose(best)].mean * _CLEARLY:
                    best = rival
                    notes = [f"With rules, orders {orders} did better and were taken."]
        return best, [*notes, *_unstable(best)]

    def grown_from(
        self,
        linear: Candidate,
        named: tuple[Antecedent, ...],
        most: int,
        against: Sequence[Candidate] = (),
    ) -> list[Candidate]:
        """Models with 1 to `most` rules that grow from one linear model.

        Fewer where growth stalls, or where two rules do much worse than two do in `against`.
        """
        settings, stage = self.settings, linear.stage
        candidates = named or found_antecedents(stage.problem.layout)
        models = [linear]
        if not settings.refine:
            plain = (clustered_stage(stage, candidates[:2], r) for r in range(2, most + 1))
            return [linear, *(self.judge(s) for s in plain)]
        parameters = stage.body.a.size
        while len(models) < most and parameters * (len(models) + 1) * 4 < stage.problem.samples:
            models.append(self.one_rule_more(models[-1], candidates))
            behind = len(against) > 1 and models[1].mean > _WORSE * against[1].mean
            if settings.rules == "auto" and (_has_stalled(models) or behind):
                break
        return models

    def cross_validated(self, models: Sequence[Candidate], named: tuple[Antecedent, ...]) -> list[Candidate]:
        """The models with the validation errors of all further folds, as far as every fold reached."""
        errors = [[m.errors] for m in models]
        orders = models[0].stage.problem.layout.orders
        for fit_part, check_part in self.folds:
            try:
                shift, scale = scaling(fit_part)
            except DataError:  # a quarter without which nothing moves says nothing
                continue
            other = replace(self, fit_part=fit_part, check_part=check_part, shift=shift, scale=scale)
            linear, _ = other.linear([orders])
            if linear[0].mean > _HOPELESS * max(models[0].mean, _EXACT):
                continue  # the linear refit went astray: rules that mend it would look useful
            grown = other.grown_from(linear[0], named, len(models))
            for known, model in zip(errors, grown, strict=False):
                known.append(model.errors)
        return [
            Candidate(m.stage, np.concatenate(e), m.stable)
            for m, e in zip(models, errors, strict=True)
            if len(e) == len(errors[0])
        ]

    def _check_count(self, models: Sequence[Candidate]) -> None:
        rules, stage = self.settings.rules, models[0].stage
        if rules != "auto" and len(models) < rules:
            raise DataError(
                f"{rules} rules of {stage.body.a.size} numbers need more than the "
                f"{stage.problem.samples} samples there are",
                hint="ask for fewer rules or lower orders, or record longer",
            )

    def one_rule_more(self, before: Candidate, candidates: tuple[Antecedent, ...]) -> Candidate:
        """The best insertion; held together by a stronger ridge where freedom made it unstable or blind.

        In the basis of the linear model's Gauss-Newton matrix a ridge of 1 halves what the data say about
        the difference of two rules, so that the ladder is the same for every data set.
        """
        start, stage = one_rule_more(before.stage, candidates, self.settings.iterations)
        tried = [self.judge(stage)]
        for ridge in _RIDGES:
            if tried[-1].stable and tried[-1].mean <= _WORSE * max(before.mean, _EXACT):
                break
            tried.append(self.judge(refine(with_ridge(start, ridge), self.settings.iterations, 1e-4)))
        return min(tried, key=lambda c: (not c.stable, c.mean))


def _unstable(models: Sequence[Candidate]) -> list[str]:
    """Which models may not be offered, in words."""
    counts = ", ".join(str(len(m.stage.body.a)) for m in models if not m.stable)
    if not counts:
        return []
    return [f"Did not come back from bounded random inputs, and were not offered: {counts} rules."]


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
        "were offered only if they came back from bounded random inputs."
    )
