"""Output-error models, output by output: delays, orders, refinement, noise model, covariance.

Used by ARX (where it refines the simulation error) and by OE. Each output has its own transfer from all
inputs; outputs do not feed each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.freerun import Difference
from flysid.model.linear.data import (
    CHOICE_ROWS,
    EXACT,
    FOLDED_ROWS,
    SEARCH_ROWS,
    Parts,
    judging_window,
    records,
)
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.free_runner import free_runner
from flysid.model.linear.initial_state import start_gains
from flysid.model.noise import coloured_covariance, noise_model
from flysid.model.polynomials import free_basis, monic_basis, nearly_cancelled, poles
from flysid.model.selection import LEVEL, STRONG, block_errors, simplest, standard_error
from flysid.model.shared import digest, once
from flysid.model.simulation_error import (
    OutputError,
    OutputOrders,
    Record,
    Transfer,
    find_start,
    from_transfer,
    to_transfer,
)

HIGHEST_ORDER = 6
DELAY_S = 0.5
MOST_DELAYS = 50
ORDER_LOSS = 0.02
PATIENCE = 2
WORSE_FIT = 1.5
"""Mean square of the free run over the fitting part, relative to a simpler candidate's, that is too much."""
CANCELLING = np.array([1.0, -0.5])
"""A pole and a zero that leave a transfer as it is."""


@dataclass(frozen=True, eq=False)
class OneOutput:
    """A refined transfer of one output, in scaled deviations."""

    problem: OutputError
    theta: FloatArray
    cost: float

    @property
    def transfer(self) -> Transfer:
        """The transfer at the parameters reached."""
        return to_transfer(self.theta, self.problem.orders)


def delay_steps(dt_s: float, longest: int) -> list[int]:
    """Delays worth trying: dense near zero, sparse up to half a second, no deeper than the data allow."""
    most = min(max(5, round(DELAY_S / dt_s)), MOST_DELAYS, max(longest // 10, 1))
    steps = [1, 0, 2, 3, 4, 5, 7, 9, 12, 16, 21, 28, 37, 50]
    return [s for s in steps if s <= most]


def widen(options: Sequence[int], delay: int, most: int) -> list[int]:
    """The options, then another delay and its neighbours, as far as they are new and not above `most`."""
    return [*options, *(d for d in (delay, delay - 1, delay + 1) if 0 <= d <= most and d not in options)]


@once(lambda problem: problem.key)
def fit_output(problem: OutputError) -> OneOutput:
    """Start and refine; of long records first a part, from which all of them need a step or two.

    Raises FitError: no stable start was found. Raises DataError: no segment is long enough.
    """
    if not any(True for _ in problem.usable()):
        raise DataError(
            f"no segment has the {problem.start_row() + 2 * problem.orders.na + 1} samples these orders need",
            hint="choose smaller orders or delays, or bring longer segments",
        )
    thin = problem.thinned(SEARCH_ROWS)
    found = thin.refine(find_start(thin).theta, max_iterations=40)
    if thin is not problem:
        found = problem.refine(found.theta, max_iterations=40)
    return OneOutput(problem, found.theta, found.cost)


@once(lambda data, output, probe: (digest(data), output, probe))
def find_delays(data: Dataset, output: int, probe: OutputOrders) -> tuple[int, ...]:
    """Delay per input, one input at a time, by the simulation error of the start.

    One sample, the delay of any plant behind a zero-order hold, holds unless another lowers the cost by more
    than chance would (a BIC step).

    `probe`: the orders to try delays with. Its own delays are tried too, with their neighbours.
    """
    parts = OutputError(records(data, output), probe).thinned(SEARCH_ROWS, least=1.0).records
    rows = sum(len(r.y) for r in parts)
    longest = max(len(r.y) for r in parts)
    cost = cache(lambda nk: _delay_cost(parts, replace(probe, nk=nk)))
    nk: tuple[int, ...] = (1,) * len(probe.nb)
    for j in range(len(nk)):
        late = partial(_with_delay, nk, j)
        tried = widen(delay_steps(data.dt_s, longest), probe.nk[j], longest // 4)
        best = min(tried, key=lambda d: cost(late(d)))
        tried += [d for d in {best - 1, best + 1} - set(tried) if d >= 0]  # between the sparse steps
        best = min(tried, key=lambda d: cost(late(d)))
        margin = np.exp(2.0 * np.log(rows) / rows)
        nk = late(best if cost(late(1)) > max(margin * cost(late(best)), EXACT**2) else 1)
    return nk


def _with_delay(nk: tuple[int, ...], j: int, delay: int) -> tuple[int, ...]:
    return *nk[:j], delay, *nk[j + 1 :]


def _delay_cost(parts: tuple[Record, ...], orders: OutputOrders) -> float:
    counts = tuple(n + 1 if k == 0 else n for n, k in zip(orders.nb, orders.nk, strict=True))
    problem = OutputError(parts, replace(orders, nb=counts))
    rows = sum(len(r.y) - problem.start_row() for r in problem.usable())
    if rows <= problem.orders.count:
        return np.inf
    try:
        return find_start(problem, tries=2, polish=0).cost / rows
    except FitError:
        return np.inf


def assemble(
    structure: str, parts: Parts, fits: Sequence[OneOutput], notes: Sequence[str], n_init: int | None = None
) -> FittedLinear:
    """One model of several refined outputs, with noise model, start and covariance."""
    noises = []
    covariances = []
    for fit in fits:
        d, variance = noise_model(fit.problem.errors(fit.theta))
        noises.append(d)
        covariances.append(_covariance(fit, d, variance))
    noise = np.zeros((max(len(d) for d in noises), len(noises)))
    for i, d in enumerate(noises):
        noise[: len(d), i] = d
    return replace(
        runner(structure, parts, fits, n_init),
        noise=noise,
        covariance=_joint(covariances, fits, parts),
        notes=tuple(notes),
    )


def runner(structure: str, parts: Parts, fits: Sequence[OneOutput], n_init: int | None) -> FittedLinear:
    """A model good for free runs only: its noise is white, its covariance unknown."""
    system = _join([f.transfer for f in fits], len(parts.whole.inputs))
    starts = start_gains(system, parts, n_init)
    return free_runner(structure, parts, system, starts, _free(system, fits))


def _join(transfers: Sequence[Transfer], n_u: int) -> Difference:
    n_y = len(transfers)
    na = max(len(t.a) for t in transfers)
    nb = max((len(b) for t in transfers for b in t.b), default=1)
    a = np.zeros((na, n_y, n_y))
    b = np.zeros((max(nb, 1), n_y, n_u))
    c = np.zeros(n_y)
    for i, t in enumerate(transfers):
        a[: len(t.a), i, i] = t.a
        c[i] = t.c
        for j, taps in enumerate(t.b):
            b[: len(taps), i, j] = taps
    return Difference(a, b, c)


def _covariance(fit: OneOutput, d: FloatArray, variance: float) -> FloatArray:
    """Of [a1..an, b.., c] in scaled units."""
    orders = fit.problem.orders
    jacobians = fit.problem.jacobians(fit.theta)
    inner = coloured_covariance(jacobians, d, variance)
    blocks = [monic_basis(orders.na)[1], *(free_basis(n) for n in orders.nb)]
    if orders.offset:
        blocks.append(np.ones((1, 1)))
    size = sum(len(b) for b in blocks)
    outer = np.zeros((size, size))
    position = 0
    for block in blocks:
        outer[position : position + len(block), position : position + len(block)] = block
        position += len(block)
    covariance: FloatArray = outer @ inner @ outer.T
    return covariance


def _free(system: Difference, fits: Sequence[OneOutput]) -> tuple[int, ...]:
    """Where each output's parameters stand in the flat order."""
    n_y, n_u = system.b.shape[1:]
    a_size = system.a[1:].size
    b_size = system.b.size
    free: list[int] = []
    for i, fit in enumerate(fits):
        orders = fit.problem.orders
        free += [lag * n_y * n_y + i * n_y + i for lag in range(orders.na)]
        for j, (count, delay) in enumerate(zip(orders.nb, orders.nk, strict=True)):
            free += [a_size + lag * n_y * n_u + i * n_u + j for lag in range(delay, delay + count)]
        if orders.offset:
            free.append(a_size + b_size + i)
    return tuple(free)


def _joint(covariances: Sequence[FloatArray], fits: Sequence[OneOutput], parts: Parts) -> FloatArray:
    """The covariance of all outputs' parameters, in physical units."""
    factors: list[float] = []
    for scale, fit in zip(parts.scaling.y_scale, fits, strict=True):
        orders = fit.problem.orders
        factors += [1.0] * orders.na
        for count, source in zip(orders.nb, parts.scaling.u_scale, strict=True):
            factors += [float(scale / source)] * count
        factors += [float(scale)] * orders.offset
    joint = np.zeros((len(factors), len(factors)))
    position = 0
    for block in covariances:
        joint[position : position + len(block), position : position + len(block)] = block
        position += len(block)
    return joint * np.outer(factors, factors)


def choose_orders(parts: Parts, candidates: Sequence[Sequence[OutputOrders]]) -> tuple[list[OneOutput], str]:
    """Fit every candidate on the fitting part, judge by the validation free run, simplest within noise.

    A candidate that free-runs the fitting part much worse than a simpler one is left out: the state at
    every segment's start is fitted along, and slow modes of a high order use it to follow disturbances, which
    no free run can. The search ends when two orders in a row were no better than the best before.

    What a lower order may cost is bounded by `ORDER_LOSS`, but not where a zero nearly cancels a pole: that
    pole describes nothing, and goes unless the free run notices beyond doubt.

    `candidates`: simplest first; each gives the orders of every output.
    Raises FitError: no candidate could be fitted.
    """
    deepest = max(o.depth for orders in candidates for o in orders)
    folds = parts.folds if len(candidates) > 1 else (parts,)
    window = max(judging_window(f, deepest) for f in folds)
    before: list[list[OneOutput]] = [[] for _ in folds]
    tried: list[_Tried] = []
    left_out: list[int] = []
    least = np.inf
    best = np.inf
    since = 0
    for orders in candidates:
        try:
            before = [_fit(f, orders, b) for f, b in zip(folds, before, strict=True)]
        except (FitError, DataError):
            continue
        own = _run_errors(folds, before, window, [f.fitted for f in folds])
        fitted = float(own.mean()) if len(own) else np.inf
        if fitted > WORSE_FIT * least:
            left_out.append(_order(before[0]))
            continue
        least = min(least, fitted)
        tried.append(_Tried(before, _run_errors(folds, before, window, [f.check for f in folds])))
        mean = float(tried[-1].errors.mean()) if len(tried[-1].errors) else np.inf
        best, since = (mean, 0) if mean < (1.0 - LEVEL) * best else (best, since + 1)
        if since == PATIENCE:
            break
    if not tried:
        raise FitError(
            "no stable output-error model was found",
            hint="give lower orders, or check the data for gaps and feedback",
        )
    if len(tried) == 1:
        return tried[0].fits, ""
    index = simplest([t.errors for t in tried], ORDER_LOSS)
    said = _said(tried, _order(tried[index].fits), left_out)
    reduced = _reduce(
        tried[: index + 1], lambda fits: _run_errors(folds, fits, window, [f.check for f in folds])
    )
    if reduced is not tried[index]:
        lower = ", ".join(str(f.problem.orders.na) for f in reduced.fits)
        said += f"; reduced to {lower}: a zero nearly cancels a pole, and the free run does not notice"
    return reduced.fits, said


@dataclass(frozen=True, eq=False)
class _Tried:
    """The fits of one order, of every fold and output, and their (B,) validation block errors."""

    folds: Sequence[Sequence[OneOutput]]
    errors: FloatArray

    @property
    def fits(self) -> list[OneOutput]:
        return list(self.folds[0])


def _run_errors(
    folds: Sequence[Parts],
    fits: Sequence[Sequence[OneOutput]],
    window: int,
    data: Sequence[Dataset],
) -> FloatArray:
    """(B,) block errors of the free runs of every fold's fits on its data."""
    return np.concatenate(
        [
            block_errors(runner("oe", fold, own, window), part, window, fold.scaling.y_scale)
            for fold, own, part in zip(folds, fits, data, strict=True)
        ]
    )


def _reduce(tried: Sequence[_Tried], judged: Callable[[Sequence[Sequence[OneOutput]]], FloatArray]) -> _Tried:
    """The last of these, or with lower orders for outputs that have a pole which a zero nearly cancels.

    Such a pair has a place that the search was free to choose, among six orders, so that a gain of one or two
    standard errors is chance: the lower order is taken unless the evidence against it is very strong.
    """
    kept = tried[-1]
    for lower in reversed(tried[:-1]):
        low = [_has_cancelling(fit) for fit in kept.fits]
        if not any(low) or not len(kept.errors):
            break
        fits = [
            [b if lowered else a for a, b, lowered in zip(own, less, low, strict=True)]
            for own, less in zip(kept.folds, lower.folds, strict=True)
        ]
        errors = judged(fits)
        gap = errors - kept.errors
        if gap.mean() <= np.sqrt(STRONG) * standard_error(gap):
            kept = _Tried(fits, errors)
    return kept


def _has_cancelling(fit: OneOutput) -> bool:
    transfer = fit.transfer
    return any(nearly_cancelled(pole, transfer.b) for pole in poles(transfer.a))


def _said(tried: Sequence[_Tried], chosen: int, left_out: Sequence[int]) -> str:
    """How an order was chosen, in words."""
    table = ", ".join(
        f"order {_order(t.fits)}: {np.sqrt(t.errors.mean()) if len(t.errors) else np.nan:.3g}" for t in tried
    )
    worse = f"; {', '.join(map(str, left_out))} free-ran the fitting part worse" if left_out else ""
    return (
        f"order {chosen} is the simplest within one standard error of the best validation free run "
        f"(RMSE in standard deviations of the output: {table}{worse})"
    )


def _fit(parts: Parts, orders: Sequence[OutputOrders], before: Sequence[OneOutput]) -> list[OneOutput]:
    """Every output on the fitting part, or much of it; never worse than fits of lower orders (`before`)."""
    fits = []
    for i, own in enumerate(orders):
        fit = fit_output(OutputError(records(parts.fit, i), own).thinned(CHOICE_ROWS))
        lower = before[i] if before else None
        if lower is not None and fit.cost > lower.cost and lower.problem.orders.nk == own.nk:
            nested = fit.problem.refine(raise_order(lower.transfer, own), max_iterations=40)
            fit = OneOutput(fit.problem, nested.theta, nested.cost) if nested.cost < fit.cost else fit
        fits.append(fit)
    return fits


def raise_order(transfer: Transfer, orders: OutputOrders) -> FloatArray:
    """The same transfer in higher orders: its poles and zeros, and as many more that cancel."""
    a = transfer.a
    b = list(transfer.b)
    for _ in range(orders.na + 1 - len(a)):
        a = np.convolve(a, CANCELLING)
        b = [np.convolve(taps, CANCELLING) for taps in b]
    sizes = [k + n for n, k in zip(orders.nb, orders.nk, strict=True)]
    padded = [np.resize(np.append(t, np.zeros(n)), n) for t, n in zip(b, sizes, strict=True)]
    return from_transfer(
        Transfer(a, tuple(padded), transfer.c * CANCELLING.sum() ** (len(a) - len(transfer.a))), orders
    )


def _order(fits: Sequence[OneOutput]) -> int:
    return max(f.problem.orders.na for f in fits)


def refit(parts: Parts, fits: Sequence[OneOutput]) -> list[OneOutput]:
    """The same orders on all training data, refined from where the search ended.

    Short data have more than one minimum: there a fresh start is tried, too.
    """
    if all(sum(len(r.y) for r in f.problem.records) == len(parts.whole) for f in fits):
        return list(fits)
    again = []
    for i, fit in enumerate(fits):
        problem = replace(fit.problem, records=records(parts.whole, i))
        found = problem.refine(fit.theta, max_iterations=25)
        ends = [OneOutput(problem, found.theta, found.cost)]
        if len(parts.train) <= FOLDED_ROWS:
            with suppress(FitError):
                ends.append(fit_output(problem))
        again.append(min(ends, key=lambda end: end.cost))
    return again
