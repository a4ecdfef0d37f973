"""The stages of an instrumental variable estimate: filters, Grams of lagged signals, small equations.

One output at a time. The signals of a stage are rows: the output y, its noise-free image x, the inputs u and,
with references, the inputs' noise-free images. Phi regresses on lags of y and u; the instruments Z are the
same lags of the images, and theta solves Zᵀ Phi theta = Zᵀ y.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FitError
from flysid.lagged import lagged_gram
from flysid.model.arguments import none_longer
from flysid.model.freerun import Difference
from flysid.model.linear.data import SEARCH_ROWS, Parts, as_tuple, shorten
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.free_runner import free_runner
from flysid.model.linear.initial_state import start_gains
from flysid.model.noise import HIGHEST_ORDER, noise_models
from flysid.model.polynomials import NEARLY_ONE, RCOND, VANISHING, stabilise
from flysid.model.stream import Block, Blocks, windows

LONG_ORDER = 20
"""Order of the regression that tells what a reference, or a controller, drives."""


@dataclass(frozen=True)
class SignalRoles:
    """Which inputs of a dataset the model has, and which are references."""

    inputs: tuple[int, ...]
    references: tuple[int, ...]

    def pick(self, value: int | Sequence[int]) -> tuple[int, ...]:
        """One number for all, or one per input of the dataset: those of the model's inputs."""
        every = as_tuple(value, len(self.inputs) + len(self.references))
        return tuple(every[j] for j in self.inputs)


@dataclass(frozen=True)
class IVOrders:
    """Of one output; nb and nk per input of the model."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]
    offset: bool

    @property
    def depth(self) -> int:
        """Samples that must be known before the first one can be computed."""
        return max(self.na, *(n + k - 1 for n, k in zip(self.nb, self.nk, strict=True)), 1)

    def columns(self, step: int, own: int, first_input: int, shift: int = 0) -> list[int]:
        """Regressors in the layout of `lagged_gram`: lags of signal `own`, of the inputs, the constant."""
        found = [own * step + lag + shift for lag in range(1, self.na + 1)]
        for j, (count, delay) in enumerate(zip(self.nb, self.nk, strict=True)):
            found += [(first_input + j) * step + lag + shift for lag in range(delay, delay + count)]
        return found + [-1] * self.offset

    def polynomials(self, theta: FloatArray) -> tuple[FloatArray, list[FloatArray], float]:
        """A (monic), B per input (from lag 0), the constant."""
        b = []
        at = self.na
        for count, delay in zip(self.nb, self.nk, strict=True):
            b.append(np.concatenate([np.zeros(delay), theta[at : at + count]]))
            at += count
        return np.append(1.0, -theta[: self.na]), b, float(theta[-1]) if self.offset else 0.0


@dataclass(frozen=True, eq=False)
class Path:
    """A noise-free image of a signal: the sources (rows) through numerators of their own, summed, over one
    denominator."""

    denominator: FloatArray
    numerators: dict[int, FloatArray]


@dataclass(frozen=True, eq=False)
class Estimate:
    """theta with its covariance, in scaled deviations."""

    theta: FloatArray
    covariance: FloatArray

    @property
    def standard_error(self) -> FloatArray:
        """Of every coefficient."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def scaled_blocks(blocks: Blocks, scale: FloatArray) -> Blocks:
    """The blocks, every signal over its scale."""

    def read() -> Iterator[Block]:
        for number, block in blocks():
            yield number, block / scale[:, None]

    return read


def fitted_by_iv(
    parts: Parts,
    blocks: Blocks,
    orders: Sequence[IVOrders],
    columns: SignalRoles,
    n_init: int | None,
) -> FittedLinear:
    """Every output's estimate, as one model.

    `blocks`: outputs, then inputs, in scaled deviations.
    Raises FitError: the instruments are blind. Raises DataError: no segment is long enough.
    """
    driven = driven_by(blocks, len(orders), columns)
    found = [estimated_by_iv(parts, blocks, (i, own), columns, driven) for i, own in enumerate(orders)]
    return _model(parts, orders, columns, found, n_init)


def driven_by(blocks: Blocks, n_y: int, columns: SignalRoles) -> dict[int, Path]:
    """The part of every output (rows 0 to n_y - 1) and input that the references drive; empty without any."""
    references = [n_y + j for j in columns.references]
    rows = [*range(n_y), *(n_y + j for j in columns.inputs)]
    return {row: _driven(blocks, row, references) for row in rows} if references else {}


def estimated_by_iv(
    parts: Parts,
    blocks: Blocks,
    equation: tuple[int, IVOrders],
    columns: SignalRoles,
    driven: Mapping[int, Path],
) -> Estimate:
    """One output's estimate; `equation` is that output and its orders. Raises as `fitted_by_iv`."""
    output, own = equation
    rows = [len(parts.train.outputs) + j for j in columns.inputs]
    images = {row: driven[row] for row in rows if row in driven}
    memory = max(min(HIGHEST_ORDER, len(parts.train) // 50), 1)
    return _four_stages(_Signals(blocks, output, rows, images), own, driven.get(output), memory)


@dataclass(frozen=True, eq=False)
class _Signals:
    """Where the signals of one output's equation are found."""

    blocks: Blocks
    output: int
    inputs: Sequence[int]
    images: dict[int, Path]

    def gram(self, depth: int, image: Path | None, prefilter: FloatArray) -> FloatArray:
        """Of all lags of (y, x, u, images of u), all filtered.

        Raises DataError: no segment is long enough.
        """
        full = lagged_gram(windows(self._rows(image, prefilter), depth), depth)
        if len(full) == 1:
            raise none_longer(depth + len(prefilter))
        return full

    def _rows(self, image: Path | None, prefilter: FloatArray) -> Iterator[Block]:
        from scipy.signal import lfilter

        paths = ([image] if image is not None else []) + [self.images[j] for j in self.inputs if self.images]
        number = -1
        memory = []
        tail = np.zeros((0, 0))
        drop = 0
        for current, block in self.blocks():
            if current != number:
                number = current
                drop = len(prefilter) - 1
                memory = [_Memory(path) for path in paths]
                tail = np.zeros((1 + len(self.inputs) + len(paths), len(prefilter) - 1))
            made = [m.run(block) for m in memory]
            first = 1 if image is not None else 0
            rows = np.stack([block[self.output], *made[:first], *block[list(self.inputs)], *made[first:]])
            rows, tail = lfilter(prefilter, [1.0], rows, axis=1, zi=tail)
            skip = min(drop, rows.shape[1])  # the filter's start at a segment's edge
            drop -= skip
            if rows.shape[1] > skip:
                yield number, rows[:, skip:]


class _Memory:
    """A path that runs on from block to block."""

    def __init__(self, path: Path) -> None:
        self.path = path
        poles = len(path.denominator)
        self.states = {row: np.zeros(max(poles, len(b)) - 1) for row, b in path.numerators.items()}

    def run(self, block: FloatArray) -> FloatArray:
        """(n,) filtered sum over the rows of a block (signals, n), going on from the block before."""
        from scipy.signal import lfilter

        total = np.zeros(block.shape[1])
        for row, b in self.path.numerators.items():
            part, self.states[row] = lfilter(b, self.path.denominator, block[row], zi=self.states[row])
            total += part
        return total


def _driven(blocks: Blocks, target: int, references: Sequence[int]) -> Path:
    """The part of a signal that the references drive: a long regression, simulated.

    Many coefficients tell the same where the reference is smooth (a sweep, sampled fast): any of the
    solutions gives the same part, the shortest is taken.
    """
    own = IVOrders(LONG_ORDER, (LONG_ORDER + 1,) * len(references), (0,) * len(references), offset=True)
    signals = _Signals(blocks, target, references, {})
    gram = signals.gram(own.depth, None, np.ones(1))
    step = own.depth + 1
    regressors = own.columns(step, 0, 1)
    power = gram[np.ix_(regressors, regressors)]
    size = np.sqrt(np.maximum(np.diag(power), np.finfo(float).tiny))
    theta = (
        np.linalg.lstsq(power / np.outer(size, size), gram[regressors, 0] / size, rcond=VANISHING)[0] / size
    )
    return _path(own, theta, references)


def _path(orders: IVOrders, theta: FloatArray, rows: Sequence[int]) -> Path:
    a, b, _ = orders.polynomials(theta)
    return Path(stabilise(a, NEARLY_ONE), {row: taps for row, taps in zip(rows, b, strict=True) if len(taps)})


def _four_stages(
    signals: _Signals, orders: IVOrders, driven: Path | None, memory: int, *, most_images: int = 3
) -> Estimate:
    """The estimate.

    A model that noise has bent makes poor instruments. They are simulated anew, at most `most_images` times,
    until the second model stays within its standard errors.
    """
    none = np.ones(1)
    depth = orders.depth
    step = orders.depth + 1
    image = driven
    if image is None:
        plain = signals.gram(depth, None, none)
        regressors = orders.columns(step, 0, 1)
        first = _solve(plain[np.ix_(regressors, regressors)], plain[regressors, 0])
        image = _path(orders, first, signals.inputs)
    gram = signals.gram(depth + memory, image, none)
    second = _instrumental(gram, orders, signals)
    for _ in range(0 if driven is not None else most_images):
        image = _path(orders, second.theta, signals.inputs)
        gram = signals.gram(depth + memory, image, none)
        known = second
        second = _instrumental(gram, orders, signals)
        if (np.abs(second.theta - known.theta) <= second.standard_error).all():
            break
    whitening = _autoregression(gram, orders, second.theta, memory)
    if driven is None:
        image = _path(orders, second.theta, signals.inputs)
    last = _instrumental(signals.gram(depth, image, whitening), orders, signals)
    if not orders.offset:
        return last
    size = np.ones(len(last.theta))  # the filter changed the constant's regressor
    size[-1] = 1.0 / whitening.sum() if abs(whitening.sum()) > 1e-9 else 0.0
    return Estimate(last.theta * size, last.covariance * np.outer(size, size))


def _instrumental(gram: FloatArray, orders: IVOrders, signals: _Signals) -> Estimate:
    n_u = len(signals.inputs)
    step = (len(gram) - 1) // (2 + n_u * (2 if signals.images else 1))
    phi = orders.columns(step, 0, 2)
    z = orders.columns(step, 1, 2 + n_u if signals.images else 2)
    cross = gram[np.ix_(z, phi)]
    theta = _solve(cross, gram[z, 0])
    misfit = np.append(1.0, -theta)
    both = gram[np.ix_([0, *phi], [0, *phi])]
    rows = float(gram[-1, -1])
    variance = max(float(misfit @ both @ misfit), 0.0) / max(rows - len(theta), 1.0)
    half = _solve(cross, _root(gram[np.ix_(z, z)]))
    return Estimate(theta, variance * half @ half.T)


def _root(gram: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """matrix⁻¹ right, rows and columns scaled first. Raises FitError: singular."""
    rows = np.linalg.norm(matrix, axis=1)
    columns = np.linalg.norm(matrix, axis=0)
    if not (rows > 0).all() or not (columns > 0).all():
        raise FitError("an instrument or a regressor is always zero", hint="check delays and references")
    scaled = matrix / rows[:, None]
    columns = np.linalg.norm(scaled, axis=0)
    scaled = scaled / columns
    values = np.linalg.svd(scaled, compute_uv=False)
    if values[-1] < RCOND * values[0]:
        raise FitError(
            "the instruments do not determine every coefficient: the regression is singular",
            hint="lower the orders, take a longer sample time, or bring data with more excitation",
        )
    lifted = right / (rows if right.ndim == 1 else rows[:, None])
    answer = np.linalg.solve(scaled, lifted)
    return np.asarray(answer / (columns if right.ndim == 1 else columns[:, None]))


def _autoregression(gram: FloatArray, orders: IVOrders, theta: FloatArray, memory: int) -> FloatArray:
    """Monic L that whitens what theta leaves over, from the Gram that theta came from."""
    step = orders.depth + memory + 1
    weights = np.zeros((len(gram), memory + 1))
    for shift in range(memory + 1):
        weights[shift, shift] = 1.0
        np.add.at(weights[:, shift], orders.columns(step, 0, 2, shift), -theta)
    power = weights.T @ gram @ weights
    size = np.sqrt(np.maximum(np.diag(power), np.finfo(float).tiny))
    scaled = power / np.outer(size, size)
    taps = np.linalg.lstsq(scaled[1:, 1:], scaled[1:, 0], rcond=1e-10)[0]
    return np.append(1.0, -taps * size[0] / size[1:])


def _model(
    parts: Parts,
    orders: Sequence[IVOrders],
    columns: SignalRoles,
    found: Sequence[Estimate],
    n_init: int | None,
) -> FittedLinear:
    n_y = len(orders)
    n_u = len(parts.train.inputs)
    last = max((n + k for o in orders for n, k in zip(o.nb, o.nk, strict=True)), default=1)
    a = np.zeros((max(o.na for o in orders) + 1, n_y, n_y))
    b = np.zeros((max(last, 1), n_y, n_u))
    c = np.zeros(n_y)
    free: list[int] = []
    factors: list[float] = []
    a_size = a[1:].size
    scaling = parts.scaling
    for i, (own, estimate) in enumerate(zip(orders, found, strict=True)):
        denominator, numerators, c[i] = own.polynomials(estimate.theta)
        a[: len(denominator), i, i] = denominator
        free += [lag * n_y * n_y + i * n_y + i for lag in range(own.na)]
        factors += [1.0] * own.na
        for j, taps, delay in zip(columns.inputs, numerators, own.nk, strict=True):
            b[: len(taps), i, j] = taps
            free += [a_size + lag * n_y * n_u + i * n_u + j for lag in range(delay, len(taps))]
            factors += [float(scaling.y_scale[i] / scaling.u_scale[j])] * (len(taps) - delay)
        free += [a_size + b.size + i] * own.offset
        factors += [float(scaling.y_scale[i])] * own.offset
    # the flat order counts A's lags from 1 and signs them as in A y = B u, theta as in y = ...
    covariance = np.zeros((len(free),) * 2)
    at = 0
    for own, estimate in zip(orders, found, strict=True):
        sign = np.ones(len(estimate.theta))
        sign[: own.na] = -1.0
        block = slice(at, at + len(sign))
        covariance[block, block] = estimate.covariance * np.outer(sign, sign)
        at += len(sign)
    system = Difference(a, b, c)
    return _start(parts, system, free, covariance * np.outer(factors, factors), n_init)


def _start(
    parts: Parts, system: Difference, free: Sequence[int], covariance: FloatArray, n_init: int | None
) -> FittedLinear:
    """The model with its start and its noise model; lags as measured where it is not stable."""
    roots = [np.roots(system.a[:, i, i]) for i in range(len(system.c))]
    stable = max((float(np.abs(r).max(initial=0.0)) for r in roots), default=0.0) < 1.0
    starts = start_gains(system, parts, n_init) if stable else None
    model = replace(free_runner("iv", parts, system, starts, tuple(free)), covariance=covariance)
    return _with_noise(model, parts) if stable else replace(model, noise=None)


def _with_noise(model: FittedLinear, parts: Parts) -> FittedLinear:
    n = model.n_init
    errors = [
        (s.y - model.simulate(s.u, s.y[:n]))[n:] / parts.scaling.y_scale
        for s in shorten(parts.train, SEARCH_ROWS).segments
        if len(s) > n + 1
    ]
    return replace(model, noise=noise_models(errors)) if errors else model
