"""What every linear estimator does first: check the data, hold out a part, centre, scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError
from flysid.model.freerun import Difference
from flysid.model.simulation_error import Record

HELD_OUT = 0.25
SEARCH_ROWS = 12_000
EXACT = 1e-6
"""Simulation error, in standard deviations of the output, that counts as none for starts and delays."""


@dataclass(frozen=True, eq=False)
class Scaling:
    """Deviation from the origin over scale: means and standard deviations of the training part."""

    u_origin: FloatArray
    y_origin: FloatArray
    u_scale: FloatArray
    y_scale: FloatArray

    @classmethod
    def of(cls, data: Dataset) -> Scaling:
        """Of all samples of a dataset.

        Raises
        ------
        DataError : an input or output never changes.
        """
        means, sizes = [], []
        for name, signals in (("u", data.inputs), ("y", data.outputs)):
            arrays = [getattr(s, name) for s in data.segments]
            total = max(sum(len(a) for a in arrays), 1)
            mean = sum(a.sum(axis=0) for a in arrays) / total
            size = np.sqrt(sum(((a - mean) ** 2).sum(axis=0) for a in arrays) / total)
            for signal, value, centre in zip(signals, size, np.atleast_1d(mean), strict=True):
                if not value > 1e-12 * max(abs(float(centre)), 1e-300):
                    kind = "input" if name == "u" else "output"
                    raise DataError(
                        f"{kind} {signal.name!r} never changes: nothing can be learnt from it",
                        hint="choose segments in which it moves, or leave it out of the recipe",
                    )
            means.append(np.asarray(mean, dtype=np.float64))
            sizes.append(np.asarray(size, dtype=np.float64))
        return cls(means[0], means[1], sizes[0], sizes[1])

    def apply(self, data: Dataset) -> Dataset:
        """The dataset in scaled deviations."""
        return data.with_segments(
            [
                Segment((s.u - self.u_origin) / self.u_scale, (s.y - self.y_origin) / self.y_scale)
                for s in data.segments
            ]
        )

    def physical(self, system: Difference) -> Difference:
        """The same system in physical units (still around the origins)."""
        ratio = self.y_scale[:, None] / self.y_scale
        gain = self.y_scale[:, None] / self.u_scale
        return Difference(system.a * ratio, system.b * gain, system.c * self.y_scale)


@dataclass(frozen=True, eq=False)
class Parts:
    """Training data in scaled deviations: all of it, the part that choices are fitted on, and the part
    that judges them (in physical units)."""

    scaling: Scaling
    whole: Dataset
    fit: Dataset
    check: Dataset
    train: Dataset
    own: bool

    @classmethod
    def of(cls, train: Dataset, validation: Dataset | None) -> Parts:
        """Use the validation part given, or hold out blocks of the training part.

        Raises
        ------
        DataError : no samples, or a signal that never changes.
        """
        if not len(train):
            raise DataError("there are no samples to learn from", hint="check the recipe and the splits")
        scaling = Scaling.of(train)
        if validation is not None:
            scaled = scaling.apply(train)
            return cls(scaling, scaled, scaled, validation, train, own=False)
        try:
            fit, check = train.split(holdout=HELD_OUT)
            Scaling.of(fit)
        except DataError:  # too short to hold anything out: choices lean on the training part
            fit = check = train
        return cls(scaling, scaling.apply(train), scaling.apply(fit), check, train, own=True)

    @property
    def limits(self) -> FloatArray:
        """(2, n_y) the training range, widened by its width on both sides."""
        low = np.min([s.y.min(axis=0) for s in self.train.segments if len(s)], axis=0)
        high = np.max([s.y.max(axis=0) for s in self.train.segments if len(s)], axis=0)
        return np.stack([low - (high - low), high + (high - low)])


def records(data: Dataset, output: int) -> tuple[Record, ...]:
    """One output of every segment."""
    return tuple(Record(s.u, np.ascontiguousarray(s.y[:, output])) for s in data.segments)


def as_tuple(value: int | Sequence[int], count: int) -> tuple[int, ...]:
    """One number for all, or one per signal."""
    return (int(value),) * count if isinstance(value, int) else tuple(int(v) for v in value)


def shortened(data: Dataset, rows: int) -> Dataset:
    """The first segments, about `rows` samples in all: enough to look for delays."""
    kept, total = [], 0
    for segment in data.segments:
        if total >= rows:
            break
        kept.append(segment.slice(0, min(len(segment), rows - total), data.dt_s))
        total += len(kept[-1])
    return data.with_segments(kept)
