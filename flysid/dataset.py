"""Dataset: experiments on one clock, with units, cut at gaps; ready for identification.

A Dataset holds inputs u and outputs y as segments of equally spaced samples. Nothing is interpolated
across a gap: a gap ends a segment. Arrays are 2-D float64, (N, n_u) and (N, n_y), and finite.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from flysid import tabular
from flysid.errors import DataError, UsageError
from flysid.showing import Table, as_text, counted
from flysid.split import By, Split, plan_split
from flysid.stretch import FloatArray as FloatArray

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


@dataclass(frozen=True)
class Signal:
    """The name and unit of one input or output.

    `resolution` is the smallest difference the source can show, in `unit` (0 when unknown).

    Examples
    --------
    >>> flysid.Signal("theta", "deg", resolution=0.01)
    Signal(name='theta', unit='deg', resolution=0.01)
    """

    name: str
    unit: str = ""
    resolution: float = 0.0


BEGAN = "began_utc_s"
"""Mark of a segment: when its flight began, seconds of UTC; only where the log knows."""
JITTER = "jitter_s"
"""Mark of a segment: how far the stamps of its inputs scatter around an even rate, standard deviation."""
LOWPASS = "lowpass_ratio"
"""Mark of a segment that passed the loader's low-pass: how much faster its sources were; else absent."""
LOWPASS_BETA = 5.0
"""Shape of the Kaiser window of that low-pass: how far down it holds what it should stop."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Equally spaced samples without a gap.

    Attributes
    ----------
    u : (N, n_u) inputs.
    y : (N, n_y) outputs.
    t0_ns : vehicle time of the first sample, nanoseconds.
    flight : identifies the log (and boot) the samples came from; segments of one flight share it.
    marks : quality marks, e.g. {"excitation": 12.3, "mode": "STABILIZE"}.

    Examples
    --------
    >>> segment = flysid.Segment(np.zeros((50, 2)), np.zeros((50, 1)), flight="monday")
    >>> len(segment), segment.u.shape
    (50, (50, 2))
    """

    u: FloatArray
    y: FloatArray
    t0_ns: int = 0
    flight: str = ""
    marks: Mapping[str, str | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("u", "y"):
            array = _own(getattr(self, name))
            if array.ndim != 2:
                raise DataError(f"{name} must be 1-D or 2-D, not {array.ndim}-D")
            if not np.isfinite(array).all():
                row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
                raise DataError(
                    f"{name} is not finite at sample {row}",
                    hint="cut the segment there, or repair the source",
                )
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len(self.u) != len(self.y):
            raise DataError(f"u has {len(self.u)} samples and y has {len(self.y)}")

    def __len__(self) -> int:
        return len(self.y)

    def time_s(self, dt_s: float) -> FloatArray:
        """(N,) vehicle time of every sample, in seconds."""
        return self.t0_ns * 1e-9 + dt_s * np.arange(len(self), dtype=np.float64)

    def slice(self, start: int, stop: int, dt_s: float) -> Segment:
        """The samples [start, stop) as a segment of their own."""
        return replace(
            self,
            u=self.u[start:stop],
            y=self.y[start:stop],
            t0_ns=self.t0_ns + round(start * dt_s * 1e9),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Segments that share a sample time, inputs and outputs.

    Attributes
    ----------
    dt_s : sample time, seconds.
    inputs, outputs : names and units, in the order of the columns of u and y.
    segments : the experiments.
    name : the channel's name, e.g. "longitudinal".

    Examples
    --------
    The record that other examples call `train`: a plant of gain 2 whose pole is at 0.9, and noise.

    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    >>> y = lfilter([0.0, 0.2], [1.0, -0.9], u) + 0.01 * rng.standard_normal(600)
    >>> train = flysid.Dataset.from_arrays(u, y, dt_s=0.1)
    >>> len(train), train.inputs[0].name, train.outputs[0].name
    (600, 'u', 'y')
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    segments: tuple[Segment, ...]
    name: str = ""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.dt_s) and self.dt_s > 0):
            raise DataError(f"the sample time must be positive, not {self.dt_s!r} s")
        for segment in self.segments:
            shape = (segment.u.shape[1], segment.y.shape[1])
            if shape != (len(self.inputs), len(self.outputs)):
                raise DataError(
                    f"a segment has {_signal_counts(*shape)}; "
                    f"the dataset has {_signal_counts(len(self.inputs), len(self.outputs))}"
                )

    @classmethod
    def from_arrays(
        cls,
        u: npt.ArrayLike | Sequence[npt.ArrayLike],
        y: npt.ArrayLike | Sequence[npt.ArrayLike],
        dt_s: float,
        *,
        inputs: Sequence[Signal | str] | None = None,
        outputs: Sequence[Signal | str] | None = None,
        name: str = "",
    ) -> Dataset:
        """A dataset from arrays: one (N,) or (N, n) array each, or lists of them, one per segment.

        A list of plain numbers is one array. Signals are named u, y (or u1, u2, ...) unless given.

        Raises
        ------
        DataError : lengths differ, or a value is not finite.
        UsageError : the lists of u and y have different numbers of segments.
        """
        us = _as_segments(u)
        ys = _as_segments(y)
        if len(us) != len(ys):
            raise UsageError(f"u has {counted(len(us), 'segment')} and y has {len(ys)}")
        segments = tuple(
            Segment(ui, yi, flight=f"segment-{i}") for i, (ui, yi) in enumerate(zip(us, ys, strict=True))
        )
        if not segments:
            raise DataError("a dataset needs at least one segment")
        n_u = segments[0].u.shape[1]
        n_y = segments[0].y.shape[1]
        return cls(
            dt_s=float(dt_s),
            inputs=_signals(inputs, n_u, "u"),
            outputs=_signals(outputs, n_y, "y"),
            segments=segments,
            name=name,
        )

    def __len__(self) -> int:
        """Number of samples in all segments."""
        return sum(len(s) for s in self.segments)

    @property
    def flights(self) -> tuple[str, ...]:
        """The flights the segments came from, in order of appearance."""
        return tuple(dict.fromkeys(s.flight for s in self.segments))

    def with_segments(self, segments: Sequence[Segment]) -> Dataset:
        """The same signals with other segments."""
        return replace(self, segments=tuple(segments))

    def group_by(self, mark: str) -> dict[str, Dataset]:
        """One dataset per value of a mark of the segments, e.g. "vehicle", "mode", or "flight" itself.

        Segments without the mark are under "".
        """
        groups: dict[str, list[Segment]] = {}
        for segment in self.segments:
            value = segment.flight if mark == "flight" else str(segment.marks.get(mark, ""))
            groups.setdefault(value, []).append(segment)
        return {value: self.with_segments(members) for value, members in groups.items()}

    def plan_split(
        self, *, holdout: float = 0.3, by: By = "auto", seed: int = 0, guard_s: float | None = None
    ) -> Split:
        """Which samples to hold out; see `flysid.split.plan_split`."""
        return plan_split(self, holdout=holdout, by=by, seed=seed, guard_s=guard_s)

    def split(
        self, *, holdout: float = 0.3, by: By = "auto", seed: int = 0, guard_s: float | None = None
    ) -> tuple[Dataset, Dataset]:
        """(train, test) by whole flights or by blocks of time, never by sample; see `plan_split`."""
        return self.plan_split(holdout=holdout, by=by, seed=seed, guard_s=guard_s).apply(self)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The Arrow stream protocol: one row per sample; see `flysid.tabular`."""
        return tabular.table_of(self).__arrow_c_stream__(requested_schema)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """NumPy's protocol: (samples, inputs + outputs) of all segments, one below the other.

        Raises
        ------
        ValueError : `copy=False`, which segments of their own cannot give.
        """
        if copy is False:
            raise ValueError("segments lie apart: their samples cannot be joined without a copy")
        width = len(self.inputs) + len(self.outputs)
        rows = [np.concatenate([s.u, s.y], axis=1) for s in self.segments]
        return np.concatenate([np.empty((0, width)), *rows]).astype(dtype or np.float64, copy=False)

    def to_arrow(self) -> pa.Table:
        """A pyarrow.Table, one row per sample, units in the columns' metadata."""
        return tabular.table_of(self)

    def to_pandas(self) -> pd.DataFrame:
        """A pandas.DataFrame, one row per sample: flight, segment, time_ns, marks, then the signals."""
        return tabular.table_of(self).to_pandas()

    def to_xarray(self) -> Any:
        """An xarray.Dataset over `sample`, units as attributes; needs xarray."""
        return tabular.xarray_of(self)

    def __repr__(self) -> str:
        signals = [", ".join(f"{s.name} [{s.unit}]" if s.unit else s.name for s in side)
                   for side in (self.inputs, self.outputs)]  # fmt: skip
        title = (
            f"{self.name or 'dataset'}: {signals[0]} -> {signals[1]}; "
            f"{counted(len(self.segments), 'segment')}, {counted(len(self), 'sample')}, "
            f"{1.0 / self.dt_s:.4g} Hz"
        )
        rows = []
        for flight in self.flights:
            own = [s for s in self.segments if s.flight == flight]
            rows.append((flight, str(len(own)), f"{sum(map(len, own)) * self.dt_s:.1f}"))
        return as_text(Table(title, ("flight", "segments", "seconds"), rows))

    def _repr_html_(self) -> str:
        """What a notebook shows: signals, and a bar per flight with the lost time left white."""
        return tabular.html_of(self)

    def content_hash(self) -> str:
        """sha256 over sample time, signals and all samples: equal data, equal hash."""
        digest = hashlib.sha256()
        digest.update(repr((self.dt_s, self.inputs, self.outputs)).encode())
        for segment in self.segments:
            digest.update(repr(segment.u.shape).encode())
            digest.update(segment.u.tobytes())
            digest.update(segment.y.tobytes())
        return digest.hexdigest()


def _own(values: npt.ArrayLike) -> FloatArray:
    """2-D float64 array that no caller can write to; a read-only one (a slice of a segment) is shared."""
    array = np.asarray(values)
    if array.flags.writeable or array.dtype != np.float64 or not array.flags.c_contiguous:
        array = np.array(array, dtype=np.float64, order="C")
    return array[:, None] if array.ndim == 1 else array


def _as_segments(values: npt.ArrayLike | Sequence[npt.ArrayLike]) -> list[FloatArray]:
    if isinstance(values, (list, tuple)) and values and np.ndim(values[0]) > 0:
        return [np.asarray(v, dtype=np.float64) for v in values]
    return [np.asarray(values, dtype=np.float64)]


def _signal_counts(inputs: int, outputs: int) -> str:
    return f"{counted(inputs, 'input')} and {counted(outputs, 'output')}"


def _signals(given: Sequence[Signal | str] | None, count: int, letter: str) -> tuple[Signal, ...]:
    if given is None:
        return tuple(Signal(letter if count == 1 else f"{letter}{i + 1}") for i in range(count))
    if len(given) != count:
        raise UsageError(f"{counted(len(given), 'name')} for {counted(count, 'signal')}")
    return tuple(s if isinstance(s, Signal) else Signal(s) for s in given)
