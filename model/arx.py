"""ARX: the next output as a regression on past outputs and inputs; optionally refined for the free run.

    A(q) y(k) = B(q) u(k) + c + e(k)        (Ljung, 1999, System Identification, 4.2)

with full polynomial matrices: every output may feed every other. Least squares one step ahead is exact
where the noise enters as e; where the sensors add it to y, and at fast sampling above all, it is biased.
Then the same orders fitted to the simulation error (`output_error`) free-run better. `refine="auto"` lets
the validation free run decide, and `notes` say how.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError, UsageError
from flysid.model.arguments import check_rows
from flysid.model.flight_offsets import with_own_constants
from flysid.model.freerun import Difference
from flysid.model.gram import LeastSquares
from flysid.model.linear.data import CHOICE_ROWS, Parts, Scaling, as_tuple, judging_window
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.initial_state import equation_starts
from flysid.model.linear.oe_search import SHARE, Refined, search
from flysid.model.linear.orders import Grid, OrderChoice, best_per_order, grid_triangle
from flysid.model.linear.output_error import delay_steps, runner, widen
from flysid.model.linear.settings import Auto, PolynomialSettings
from flysid.model.linear.stability import keep_stable
from flysid.model.selection import block_errors, clearly_better, simplest
from flysid.model.shared import fit_key, once
from flysid.model.stream import OnDisk, Source
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class ARX(PolynomialSettings):
    """Settings of an ARX model: those of `PolynomialSettings`, and whether to refine.

    Parameters
    ----------
    na, nb : past outputs of every output, past inputs.
    refine : fit the simulation error instead of the next sample: "auto" unless the validation free run is
        worse for it by more than noise, True or False to force. A refined model has no coupling between
        outputs.
    n_init : of a refined model; others start from their lags.

    Source: Ljung (1999), System Identification, 4.2; the refinement: `flysid.model.linear.oe_search`.

    Examples
    --------
    >>> model = flysid.ARX(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.dc_gain.round(2)
    array([[2.]])
    """

    refine: bool | Auto = field(default="auto", kw_only=True)

    @on_one_thread
    @once(fit_key)
    @with_own_constants
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedLinear:
        """Choose orders and fit.

        From disk (`flysid.datasetfile.open_dataset`) in bounded memory: orders are chosen on the first
        200,000 samples, the coefficients are the least squares of all; nothing is refined.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : refine=True and no stable model was found.
        """
        self.check(train)
        if isinstance(train, OnDisk):
            return keep_stable(self._fit(train, validation), train.head(CHOICE_ROWS), stable=self.stable)
        train, validation = self.detrended(train, validation)
        return keep_stable(self._fit(train, validation), train, stable=self.stable)

    def _fit(self, train: Source, validation: Dataset | None) -> FittedLinear:
        if isinstance(train, OnDisk):
            return _from_disk(self, train, validation)
        parts = Parts.of(train, validation, centred=self.offset)
        plain = None if self.refine is True else _LeastSquaresFit(self, parts)
        if self.refine is False:
            assert plain is not None
            return plain.final()
        try:
            refined = search("arx", self, parts, None if plain is None else plain.choice.nk)
        except FitError as error:
            if plain is None:
                raise
            note = f"Refinement on the simulation error was tried and given up: {error.message}."
            return _note(plain.final(), note)
        if plain is None:
            return refined.final(())
        return _decide(parts, plain, refined)


class _LeastSquaresFit:
    """The one-step fit: orders from one pass over the fitting part, free run on the checking part."""

    def __init__(self, settings: ARX, parts: Parts) -> None:
        self.settings = settings
        self.parts = parts
        self.n_y = len(parts.train.outputs)
        self.n_u = len(parts.train.inputs)
        if settings.refine is False and "auto" not in (settings.na, settings.nb, settings.nk):
            self.choice = self._fix()
            self.note = f"Orders as given: {self.choice}."
            self._check_rows()
            return
        choices, grid = self._candidates()
        window = judging_window(parts, max(c.lags(self.n_y).depth for c in choices))
        models = [self._model(c, grid.fit(c), "", window) for c in choices]
        errors = [block_errors(m, parts.check, window, parts.scaling.y_scale) for m in models]
        index = simplest(errors)
        self.choice = choices[index]
        self._check_rows()
        self.model = models[index]
        self.note = _order_note(choices, errors, index)

    def _check_rows(self) -> None:
        """Raise DataError where the data hold no more equations than there are unknowns."""
        numbers = self.n_y * self.choice.na + sum(self.choice.nb) + self.settings.offset
        check_rows(self.parts.train, self.choice.lags(self.n_y).depth, numbers)

    def _fix(self) -> OrderChoice:
        s = self.settings
        n_u = self.n_u
        return OrderChoice(int(s.na), as_tuple(s.nb, n_u), as_tuple(s.nk, n_u))  # type: ignore[arg-type]

    def final(self) -> FittedLinear:
        """The chosen orders on all training data."""
        return self.of_all(self.parts.train, self.parts)

    def of_all(self, data: Source, parts: Parts) -> FittedLinear:
        """The chosen orders on these data, which `parts` measured."""
        grid = _grid(data, [self.choice], self.settings.offset, parts.scaling)
        return self._model(self.choice, grid.fit(self.choice), self.note, parts=parts)

    def _candidates(self, *, highest_na: int = 6) -> tuple[list[OrderChoice], Grid]:
        s = self.settings
        n_u = self.n_u
        rows = len(self.parts.fit)
        longest = max(len(x) for x in self.parts.fit.segments)
        budget = max(rows // SHARE, 1)
        most = max(1, min(highest_na, (budget - 1) // (self.n_y + n_u)))
        nas = range(1, most + 1) if s.na == "auto" else [int(s.na)]
        counts = range(1, most + 1) if s.nb == "auto" else None
        nbs = [as_tuple(c, n_u) for c in counts] if counts else [as_tuple(s.nb, n_u)]  # type: ignore[arg-type]
        if s.nk == "auto":
            top = max(delay_steps(self.parts.train.dt_s, longest))
            most_delay = max(1, min(top, budget - 1, 20))
            own = [1, 0, *range(2, most_delay + 1)]
            reach = min(longest // 4, budget - 1)
            nks: list[list[int]] = [widen(own, k, reach) for k in s.nk_hint or (1,) * n_u]
        else:
            nks = [[k] for k in as_tuple(s.nk, n_u)]
        corner = OrderChoice(
            max(nas), tuple(max(x) for x in zip(*nbs, strict=True)), tuple(max(k) for k in nks)
        )
        grid = _grid(self.parts.fit, [corner], s.offset)
        choices = best_per_order(grid, list(nas), nbs, nks)
        if not choices:  # collinear throughout: the smallest choice, by its shortest solution
            choices = [OrderChoice(min(nas), nbs[0], tuple(k[0] for k in nks))]
        return choices, grid

    def _system(
        self, choice: OrderChoice, fits: Sequence[LeastSquares]
    ) -> tuple[Difference, tuple[int, ...]]:
        """The equation of the coefficients, and where each output's coefficients stand in flat order."""
        n_y = self.n_y
        n_u = self.n_u
        last = max((k + n for n, k in zip(choice.nb, choice.nk, strict=True) if n), default=1)
        a = np.zeros((choice.na + 1, n_y, n_y))
        a[0] = np.eye(n_y)
        b = np.zeros((last, n_y, n_u))
        c = np.zeros(n_y)
        free: list[int] = []
        for i, fit in enumerate(fits):
            theta = fit.theta
            position = 0
            for j, lag in product(range(n_y), range(1, choice.na + 1)):
                a[lag, i, j] = -theta[position]
                free.append((lag - 1) * n_y * n_y + i * n_y + j)
                position += 1
            for j, (count, delay) in enumerate(zip(choice.nb, choice.nk, strict=True)):
                for lag in range(delay, delay + count):
                    b[lag, i, j] = theta[position]
                    free.append(choice.na * n_y * n_y + lag * n_y * n_u + i * n_u + j)
                    position += 1
            if self.settings.offset:
                c[i] = theta[position]
                free.append(choice.na * n_y * n_y + b.size + i)
        return Difference(a, b, c), tuple(free)

    def _model(
        self,
        choice: OrderChoice,
        fits: Sequence[LeastSquares],
        note: str,
        window: int | None = None,
        parts: Parts | None = None,
    ) -> FittedLinear:
        """The model, its start estimated from `window` samples (default: its depth)."""
        parts = parts or self.parts
        system, free = self._system(choice, fits)
        physical = parts.scaling.physical(system)
        scaled = np.concatenate([system.a[1:].ravel(), system.b.ravel(), system.c])
        unit = np.concatenate([physical.a[1:].ravel(), physical.b.ravel(), physical.c])
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.where(scaled != 0, unit / scaled, 0.0)[list(free)]
        size = len(fits[0].theta)
        covariance = np.zeros((len(free), len(free)))
        for i, fit in enumerate(fits):
            block = slice(i * size, (i + 1) * size)
            covariance[block, block] = fit.covariance
        depth = max(choice.lags(self.n_y).depth, 1)
        starts = equation_starts(system, parts, window or depth)
        return FittedLinear(
            structure="arx",
            dt_s=parts.train.dt_s,
            inputs=parts.train.inputs,
            outputs=parts.train.outputs,
            n_init=depth if starts is None else starts.shape[2],
            output_limits=parts.limits,
            system=physical,
            u_origin=parts.scaling.u_origin,
            y_origin=parts.scaling.y_origin,
            noise=None,
            starts=starts,
            free=free,
            covariance=covariance * np.outer(factor, factor),
            notes=(note,) if note else (),
        )


def _grid(data: Source, choices: Sequence[OrderChoice], offset: bool, scaling: Scaling | None = None) -> Grid:
    """The triangle over all lags that the choices need, in one pass.

    `scaling`: to apply on the way; None when the data are scaled already.
    Raises DataError: the segments are shorter than the lags.
    """
    n_y = len(data.outputs)
    n_u = len(data.inputs)
    na = max(c.na for c in choices)
    last = max((k + n - 1 for c in choices for n, k in zip(c.nb, c.nk, strict=True) if n), default=0)
    lags = Grid.lags(n_y, n_u, na, last)
    return Grid(grid_triangle(data, lags, scaling), n_y, n_u, na, last, offset)


def _from_disk(settings: ARX, data: OnDisk, validation: Dataset | None) -> FittedLinear:
    """Orders from the head, coefficients from all blocks. Raises UsageError: a refinement was asked for."""
    if settings.refine is True:
        raise UsageError(
            "a refinement needs its data in memory", hint="fit data.read(), or data.head(rows) for a part"
        )
    plain = replace(settings, refine=False)
    chosen = _LeastSquaresFit(plain, Parts.of(data.head(CHOICE_ROWS), validation, centred=settings.offset))
    found = chosen.of_all(data, Parts.on_disk(data, centred=settings.offset))
    return _note(found, f"Fitted to all {len(data)} samples on disk, one step ahead.")


def _order_note(choices: Sequence[OrderChoice], errors: Sequence[FloatArray], index: int) -> str:
    if len(choices) == 1:
        return f"Orders: {choices[0]}."
    rmse = [
        f"na {c.na}: {np.sqrt(e.mean()) if len(e) else np.nan:.3g}"
        for c, e in zip(choices, errors, strict=True)
    ]
    return (
        f"One step ahead, {choices[index]}: nb and nk by BIC for every na, then the simplest na within one "
        "standard error of the best validation free run "
        f"(RMSE in standard deviations of the output: {', '.join(rmse)})."
    )


def _decide(parts: Parts, plain: _LeastSquaresFit, refined: Refined) -> FittedLinear:
    """The refined model, unless the plain one free-runs better on validation by more than noise.

    Where the validation part is only a piece of the training data, held out by ourselves, the plain one must
    free-run all of them better too: one flight is too little to give up what fits every flight better.
    """
    window = max(plain.model.n_init, judging_window(parts, refined.depth))
    judged = runner("arx", parts, refined.fits, window)
    before = block_errors(plain.model, parts.check, window, parts.scaling.y_scale)
    after = block_errors(judged, parts.check, window, parts.scaling.y_scale)
    if not len(before):
        return _note(
            plain.final(), "No validation segment is long enough to judge a refinement; not refined."
        )
    figures = (
        f"validation free run RMSE {np.sqrt(after.mean()):.3g} refined against {np.sqrt(before.mean()):.3g}"
    )
    words = f"The refined model was kept: {figures} (standard deviations of the output)."
    if not clearly_better(before, after):
        return refined.final((words,))
    final = plain.final()
    if parts.validation is None:
        kept = refined.final((words,))
        if not _better_everywhere(parts, final, kept, window):
            return kept
    return _note(final, f"Refinement on the simulation error was tried and not kept: {figures}.")


def _better_everywhere(parts: Parts, plain: FittedLinear, refined: FittedLinear, window: int) -> bool:
    """The plain model's free run of all training data has the lower mean square."""
    skip = max(window, plain.n_init, refined.n_init)
    plain_error, refined_error = (
        block_errors(m, parts.train, skip, parts.scaling.y_scale) for m in (plain, refined)
    )
    return bool(len(plain_error) and plain_error.mean() < refined_error.mean())


def _note(model: FittedLinear, note: str) -> FittedLinear:
    return replace(model, notes=(*model.notes, note))
