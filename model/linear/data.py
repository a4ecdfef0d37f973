"""What every linear estimator does first: check the data, hold out a part, centre, scale."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError
from flysid.model.arguments import never_changes, no_samples
from flysid.model.freerun import Difference
from flysid.model.selection import FEWEST, parts_to_choose_on
from flysid.model.simulation_error import Record
from flysid.model.start import MAX_SHARE, judging_rows
from flysid.model.stream import Block, OnDisk, Source, blocks_of

FOLDS = 3
FOLDED_ROWS = 5_000
SEARCH_ROWS = 12_000
CHOICE_ROWS = 200_000
"""Samples that orders and delays are chosen on: pieces of long data in memory, the first of those on disk."""
EXACT = 1e-6
"""Simulation error, in standard deviations of the output, that counts as none for starts and delays."""


@dataclass(frozen=True, eq=False)
class Scaling:
    """Deviation from the origin over scale: means and standard deviations of the training part.

    `y_range` is (2, n_y), the lowest and the highest output.
    """

    u_origin: FloatArray
    y_origin: FloatArray
    u_scale: FloatArray
    y_scale: FloatArray
    y_range: FloatArray

    @classmethod
    def of(cls, data: Source, *, centred: bool = True) -> Scaling:
        """Of all samples of a dataset, in memory or on disk; the origins are zero unless `centred`.

        Raises DataError: an input or output never changes.
        """
        mean, size, low, high = _moments(blocks_of(data)())
        n_y = len(data.outputs)
        kinds = ["output"] * n_y + ["input"] * len(data.inputs)
        for kind, signal, value, centre in zip(kinds, (*data.outputs, *data.inputs), size, mean, strict=True):
            if not value > 1e-12 * max(abs(float(centre)), 1e-300):
                raise never_changes(kind, signal.name)
        origin = mean if centred else np.zeros_like(mean)
        limits = np.stack([low[:n_y], high[:n_y]])
        return cls(origin[n_y:], origin[:n_y], size[n_y:], size[:n_y], limits)

    def u(self, values: FloatArray) -> FloatArray:
        """Inputs in scaled deviations."""
        return (values - self.u_origin) / self.u_scale

    def y(self, values: FloatArray) -> FloatArray:
        """Outputs in scaled deviations."""
        return (values - self.y_origin) / self.y_scale

    def apply(self, data: Dataset) -> Dataset:
        """The dataset in scaled deviations."""
        return data.with_segments([Segment(self.u(s.u), self.y(s.y)) for s in data.segments])

    def physical(self, system: Difference) -> Difference:
        """The same system in physical units (still around the origins)."""
        ratio = self.y_scale[:, None] / self.y_scale
        gain = self.y_scale[:, None] / self.u_scale
        return Difference(system.a * ratio, system.b * gain, system.c * self.y_scale)


def _moments(blocks: Iterable[Block]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mean, standard deviation, minimum and maximum of every signal, in one pass.

    Sums are of deviations from the first sample, block by block, so that a large offset costs no digits.
    """
    rows = 0
    for _, block in blocks:
        if not rows:
            first = block[:, 0].copy()
            total = np.zeros(len(block))
            squares = np.zeros(len(block))
            low = first.copy()
            high = first.copy()
        low = np.minimum(low, block.min(axis=1))
        high = np.maximum(high, block.max(axis=1))
        block -= first[:, None]
        total += block.sum(axis=1)
        squares += np.einsum("ij,ij->i", block, block)
        rows += block.shape[1]
    shift = total / rows
    return first + shift, np.sqrt(np.maximum(squares / rows - shift**2, 0.0)), low, high


@dataclass(frozen=True, eq=False)
class Parts:
    """Training data, and what choices need: a part to fit candidates on and a part that judges them.

    `train`: all of it, as given.
    `validation`: the judging part, or None: blocks of the training part are held out.
    `scaling`: of the training data.
    `seed`: which blocks are held out.
    """

    train: Dataset
    validation: Dataset | None
    scaling: Scaling
    seed: int = 0

    @property
    def folds(self) -> tuple[Parts, ...]:
        """The same data with other blocks held out: what one block says of an order is half luck.

        One where a validation part was given, or where the data are long enough for one to speak.
        """
        if self.validation is not None or len(self.train) > FOLDED_ROWS or self.fit is self.whole:
            return (self,)
        return (self, *(replace(self, seed=seed) for seed in range(1, FOLDS)))

    @classmethod
    def on_disk(cls, data: OnDisk, *, centred: bool = True) -> Parts:
        """The first samples, measured by all of them: for what a fit from disk takes from memory.

        Raises DataError: no samples, or a signal that never changes.
        """
        head = data.head(SEARCH_ROWS)
        if not len(head):
            raise no_samples()
        return cls(head, head, Scaling.of(data, centred=centred))

    @classmethod
    def of(cls, train: Dataset, validation: Dataset | None, *, centred: bool = True) -> Parts:
        """Check and measure the data. Raises DataError: no samples, or a signal that never changes."""
        if not len(train):
            raise no_samples()
        return cls(train, validation, Scaling.of(train, centred=centred))

    @classmethod
    def measured(cls, data: Source, *, centred: bool = True) -> Parts:
        """For what needs no choices: the data, in memory or on disk, as they are.

        Raises DataError: no samples, or a signal that never changes.
        """
        if isinstance(data, OnDisk):
            return cls.on_disk(data, centred=centred)
        return cls.of(data, None, centred=centred)

    @cached_property
    def _split(self) -> tuple[Dataset, Dataset]:
        if self.validation is not None:
            return self.train, self.validation
        try:
            fit, check = parts_to_choose_on(self.train, seed=self.seed, guard_s=guard_s(self.train))
            Scaling.of(fit)
        except DataError:  # too short to hold anything out: choices lean on the training part
            return self.train, self.train
        return fit, check

    @cached_property
    def whole(self) -> Dataset:
        """All training data in scaled deviations."""
        return self.scaling.apply(self.train)

    @cached_property
    def fit(self) -> Dataset:
        """The part to fit candidates on, in scaled deviations."""
        part = self._split[0]
        return self.whole if part is self.train else self.scaling.apply(part)

    @property
    def check(self) -> Dataset:
        """The part that judges candidates, in physical units."""
        return self._split[1]

    @property
    def fitted(self) -> Dataset:
        """The part to fit candidates on, in physical units."""
        return self._split[0]

    @property
    def limits(self) -> FloatArray:
        """(2, n_y) the training range, widened by its width on both sides."""
        low, high = self.scaling.y_range
        return np.stack([low - (high - low), high + (high - low)])


def judging_window(parts: Parts, depth: int) -> int:
    """Samples of every validation segment from which all candidates estimate their start alike."""
    longest = max((len(s) for s in parts.check.segments), default=0)
    usable = [len(s) for s in parts.check.segments if len(s) > longest // 4]
    shortest = min(usable, default=0)
    return max(judging_rows(depth, shortest, parts.train.dt_s), 1, int(MAX_SHARE * shortest))


def guard_s(data: Dataset) -> float:
    """Seconds to leave out around held-out blocks: as long as an output remembers itself.

    The correlation length, in samples, of the slowest output (first lag below 1/e), between `FEWEST`
    and a twentieth of the longest segment: what is chosen must not hang on the unit of time.
    """
    segment = max(data.segments, key=len)
    most = max(len(segment) // 20, FEWEST)
    y = segment.y - segment.y.mean(axis=0)
    power = np.einsum("ij,ij->j", y, y)
    length = most
    for lag in range(FEWEST, most):
        if (np.einsum("ij,ij->j", y[lag:], y[:-lag]) < power / np.e).all():
            length = lag
            break
    return length * data.dt_s


def records(data: Dataset, output: int) -> tuple[Record, ...]:
    """One output of every segment."""
    return tuple(Record(s.u, np.ascontiguousarray(s.y[:, output])) for s in data.segments)


def as_tuple(value: int | Sequence[int], count: int) -> tuple[int, ...]:
    """One number for all, or one per signal."""
    return (int(value),) * count if isinstance(value, int) else tuple(int(v) for v in value)


def shorten(data: Dataset, rows: int) -> Dataset:
    """The first segments, about `rows` samples in all: enough to look for delays."""
    kept = []
    total = 0
    for segment in data.segments:
        if total >= rows:
            break
        kept.append(segment.slice(0, min(len(segment), rows - total), data.dt_s))
        total += len(kept[-1])
    return data.with_segments(kept)
