"""How much of an output does not follow its inputs linearly? Asked before any nonlinear model is fitted.

What the best linear model's free run leaves over is noise, and what no linear model can follow. The two
differ in what a nonlinearity would leave: shapes of the inputs and of the free run (magnitudes, bends one
standard deviation out, signed squares, products) are sent through the model as if they were added to an
input. A static nonlinearity ahead of the dynamics (Hammerstein) acts so, and a weak one inside them (drag)
to first order. Shapes of the free run itself stand for a sensor's (Wiener), and linear columns for what a
better linear model would take.

Noise does not know the shapes: their products with the remainder are summed over blocks of time, and the same
sum with signs drawn at random says how large it is by chance (Wu, 1986, Annals of Statistics 14, the wild
bootstrap; over blocks, because noise is coloured).

The share is a lower bound: other shapes than these are not seen, nor what comes from inputs that the channel
lacks. Shares of nonlinear distortion: Pintelon and Schoukens, System Identification, 2012, section 4.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.model.base import Fitted
from flysid.model.covariance import STEP
from flysid.model.start import as_modelled, plain_run, start_window

LEVEL = 0.005


@dataclass(frozen=True)
class Nonlinearity:
    """What part of one output does not follow the inputs linearly.

    `p_value`: of chance making the shapes explain so much; 1 where there are too few samples.
    `share`: of the output's standard deviation, at least; 0 where nothing is explained.
    `smallest`: the share that would have been found.
    """

    output: str
    inputs: tuple[str, ...]
    p_value: float
    share: float
    smallest: float

    @property
    def found(self) -> bool:
        """Beyond doubt."""
        return self.p_value <= LEVEL

    @property
    def words(self) -> str:
        """One sentence; "" where there were too few samples to say anything."""
        inputs = " and ".join(self.inputs)
        if self.found:
            return (
                f"At least {100 * self.share:.2g} % of {self.output} (of its standard deviation) is a "
                f"nonlinear response to {inputs}."
            )
        if not np.isfinite(self.smallest):
            return ""
        return (
            f"No nonlinear response of {self.output} to {inputs} was found; one of "
            f"{100 * self.smallest:.2g} % (of its standard deviation) would have been detected."
        )


def nonlinearity(model: Fitted, data: Dataset) -> tuple[Nonlinearity, ...]:
    """For every output, what share does not follow the inputs linearly.

    `model`: the best linear model of `data`, fitted to it.
    `data`: its training data.

    >>> from flysid.model.nonlinearity import nonlinearity
    >>> line = flysid.ARX(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`, a linear plant
    >>> [found.found for found in nonlinearity(line, train)]
    [False]
    """
    return tuple(_of_output(model, data, j) for j in range(len(data.outputs)))


def _of_output(model: Fitted, data: Dataset, output: int, *, draws: int = 1999) -> Nonlinearity:
    names = tuple(s.name for s in data.inputs)
    grams, error = _grams(model, data, output)
    linear = 2 + len(names) * LINEAR_COLUMNS
    sums = _sums(grams, linear)
    if sums is None:
        return Nonlinearity(data.outputs[output].name, names, 1.0, 0.0, float("inf"))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(draws, len(sums)))
    explained = float((sums.sum(axis=0) ** 2).sum())
    chance = ((signs @ sums) ** 2).sum(axis=1)
    by_chance = float(chance.mean())
    y = np.concatenate([s.y[:, output] for s in data.segments])
    unit = error / float(np.linalg.norm(y - y.mean()))
    return Nonlinearity(
        data.outputs[output].name,
        names,
        float(1 + (chance >= explained).sum()) / (1 + draws),
        unit * float(np.sqrt(max(0.0, explained - by_chance))),
        unit * float(np.sqrt(np.quantile(chance, 1.0 - LEVEL) - by_chance)),
    )


def _sums(
    grams: FloatArray, linear: int, *, fewest: int = 16, least_share: float = 1e-6
) -> FloatArray | None:
    """(blocks, m) products of the linear remainder with orthonormal combinations of the shapes, by block.

    `grams`: (blocks, c, c) products of linear columns, shapes and the model's error.
    `least_share`: of the largest: variances of combinations of shapes below it are rounding.
    """
    if len(grams) < fewest:
        return None
    total = grams.sum(axis=0)
    lines = total[:linear, :linear]
    remove = np.linalg.lstsq(lines, total[:linear, linear:], rcond=least_share)[0]
    left = total[linear:, linear:] - total[linear:, :linear] @ remove
    values, vectors = np.linalg.eigh(left[:-1, :-1])
    kept = values > least_share * max(values[-1], 0.0)
    basis = vectors[:, kept] / np.sqrt(values[kept])
    apart = grams[:, linear:, linear:] - grams[:, linear:, :linear] @ remove
    apart = apart - remove.T @ (grams[:, :linear, linear:] - grams[:, :linear, :linear] @ remove)
    return np.asarray(apart[:, :-1, -1] @ basis)


def _grams(
    model: Fitted, data: Dataset, output: int, *, shortest: int = 40, most_blocks: int = 64
) -> tuple[FloatArray, float]:
    """(blocks, c, c) products of the columns of `_columns`, each of unit size, over blocks of time.

    Then the size that the last column, the error, has by itself.

    `shortest`: samples of a block, at least.
    """
    u = np.concatenate([s.u for s in data.segments])
    y = np.concatenate([s.y[:, output] for s in data.segments])
    scales = _Scales(u.mean(axis=0), u.std(axis=0) + np.finfo(float).tiny, float(y.mean()), float(y.std()))
    length = max(shortest, len(y) // most_blocks)
    found = []
    for segment in data.segments:
        window = start_window(model.n_init, len(segment), model.dt_s)
        if len(segment) < window + shortest or scales.y_std == 0.0:
            continue
        columns = np.column_stack(list(_columns(model, segment, output, scales)))[window:]
        blocks = np.array_split(columns, max(1, len(columns) // length))
        found += [block.T @ block for block in blocks]
    if not found:
        return np.zeros((0, 0, 0)), 0.0
    sizes = np.sqrt(np.diagonal(np.sum(found, axis=0)))
    sizes[sizes == 0.0] = 1.0
    return np.asarray(np.asarray(found) / sizes[:, None] / sizes), float(sizes[-1])


@dataclass(frozen=True, eq=False)
class _Scales:
    """Means and standard deviations of inputs (n_u,) and output."""

    u_mean: FloatArray
    u_std: FloatArray
    y_mean: float
    y_std: float


LAGS = (1, 4)
LINEAR_COLUMNS = 2 + len(LAGS)
"""Per input."""


def _columns(
    model: Fitted, segment: Segment, output: int, scales: _Scales, *, far: float = 100.0
) -> Iterator[FloatArray]:
    """(N,) linear columns, then shapes, then the error of the free run.

    `far`: standard deviations of the output; a free run that is farther off says nothing of a shape.
    """
    window = start_window(model.n_init, len(segment), model.dt_s)
    segment = as_modelled(model, segment)
    run = plain_run(model, segment, window)
    start = run[: model.n_init]
    held = model.simulate(segment.u, start)[:, output]
    free = run[:, output]
    most = far * scales.y_std
    at = np.clip(free - scales.y_mean, -most, most) / scales.y_std

    def through(i: int, shape: FloatArray) -> FloatArray:
        u = segment.u.copy()
        u[:, i] += STEP * scales.u_std[i] * shape
        return np.asarray((model.simulate(u, start)[:, output] - held) / STEP)

    inputs = [(segment.u[:, i] - mean) / scales.u_std[i] for i, mean in enumerate(scales.u_mean)]
    yield np.ones(len(free))
    yield free
    for i, u in enumerate(inputs):
        answer = through(i, u)
        yield answer
        yield through(i, at)
        for lag in LAGS:
            yield np.concatenate([np.full(lag, answer[0]), answer[:-lag]])
    for i, u in enumerate(inputs):
        for shape in (*_shapes(u), *_shapes(at), u * at):
            yield through(i, shape)
    yield from _shapes(at)
    yield segment.y[:, output] - free


def _shapes(x: FloatArray) -> tuple[FloatArray, ...]:
    """What a nonlinearity may make of a signal in standard deviations."""
    return np.abs(x), np.maximum(x - 1.0, 0.0), np.maximum(-x - 1.0, 0.0), x * np.abs(x)
