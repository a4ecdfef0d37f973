"""Signals of a recipe while their streams come in: what `load_signal` and `tidy` make of a log, row by row.

A row is given out once nothing that follows can change it: a derivative waits for the next row, a vector for
a heading as late as itself, a spike for the four rows behind it. Rows that come behind their time, and second
rows of one time that come in another step, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import RecipeError
from flysid.flight import field_scale, field_unit
from flysid.ingest.align import resample
from flysid.ingest.align.recipe import SignalSpec, Source
from flysid.ingest.align.signals import angle_between, find_source, gain_of, schema_of
from flysid.ingest.align.transforms import TRANSFORMS
from flysid.ingest.align.values import ELEMENT, is_one_of, names_of
from flysid.ingest.formats.common.arrow_arrays import fixed_text
from flysid.ingest.formats.common.units import factor
from flysid.live.decoding import Decoder, Rows

IntArray = npt.NDArray[np.int64]
KEPT_S = 2.0  # of every signal, for its period; more where its last value counts for ever


class LatestSamples:
    """The latest samples of a signal."""

    def __init__(self) -> None:
        self.t_ns = np.empty(0, np.int64)
        self.x = np.empty(0)

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def series(self) -> resample.RecordedSignal:
        """As the batch has it."""
        return resample.RecordedSignal(self.t_ns, self.x)

    def add(self, t_ns: IntArray, x: npt.NDArray[np.generic]) -> None:
        """Append samples later than all before."""
        self.t_ns = np.concatenate([self.t_ns, t_ns])
        self.x = np.concatenate([self.x, x])

    def forget(self, before_ns: int) -> None:
        """Drop samples before a time, but the last of them: it may still count."""
        first = int(np.searchsorted(self.t_ns, before_ns)) - 1
        if first > len(self.t_ns) // 2:
            self.t_ns = self.t_ns[first:]
            self.x = self.x[first:]


class RunningSource:
    """One source of a recipe: rows of its stream to values in a unit, without scale and offset.

    Raises RecipeError where its columns cannot be read.
    """

    def __init__(self, source: Source, stream: str, unit: str, log: Decoder) -> None:
        self.stream = stream
        self.source = source
        self.transform = TRANSFORMS[source.transform]
        table = log.table(stream, log.columns(stream))
        self._schema = table.schema
        self._gain = gain_of(source, stream, unit, table)[0]
        self._names = {column: names_of(table, stream, column, log.info) for column in source.where}
        self._time_factor = 0.0
        if source.time:
            self._time_factor = factor(field_unit(schema_of(table, source.time)) or "us", "ns")
        if source.row_period_s is not None:
            raise RecipeError("a link has its own times", hint="leave out row_period_s in the recipe")
        self._columns = [(name, field_scale(schema_of(table, name))) for name in source.fields]
        self._turn = 2 * np.pi * factor("rad", unit) if self.transform.wraps else 0.0
        self._turns = Turns(self._turn)
        self._first_ns = 0
        self._t = np.empty(0, np.int64)  # rows that wait, behind one that is out already
        self._m: FloatArray | None = None
        self._out = 0
        self._heading: RunningHeading | None = None
        if source.yaw is not None:
            found = find_source((source.yaw,), log)
            if found is None:
                raise RecipeError(f"no {source.yaw.stream}")
            self._heading = RunningHeading(RunningSource(*found, "rad", log))

    def take(self, rows: Mapping[str, Sequence[Rows]]) -> tuple[IntArray, FloatArray]:
        """Samples that are certain now: (n,) times, (n,) values."""
        if self._heading is not None:
            self._heading.take(rows)
        for part in rows.get(self.stream, ()):
            self._append(part)
        waits = len(self._t) - self._out
        certain = max(0, waits - 1) if self.transform.per_second else waits
        if self._heading is not None:
            certain = min(certain, self._heading.known(self._t[self._out :]))
        if not certain or self._m is None:
            return self._t[:0], np.empty(0)
        first = self._out
        stop = first + certain
        yaw = np.empty(0)
        seconds = np.asarray((self._t - self._first_ns) * 1e-9, dtype=np.float64)
        if self._heading is not None:
            yaw = np.full(len(self._t), np.nan)
            yaw[first:stop] = self._heading.at(self._t[first:stop])
        with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is left out
            values = self._gain * self.transform.apply(self._m, seconds, yaw)[first:stop]
        times = self._t[first:stop]
        keep = max(0, stop - 1)  # a derivative looks one row back
        self._t = self._t[keep:]
        self._m = self._m[keep:]
        self._out = stop - keep
        if self._turn:
            finite = np.isfinite(values)
            values[finite] = self._turns.counted(values[finite])
        return times, values

    def _append(self, rows: Rows) -> None:
        """Rows in the order of time, later than those before."""
        records = rows.records
        t_ns = rows.t_ns
        for column, wanted in self.source.where.items():
            held = is_one_of(values_of(records, column), [wanted], self._names[column])
            records = records[held]
            t_ns = t_ns[held]
        if self.source.time:
            own = values_of(records, self.source.time).astype(np.float64)
            timed = np.isfinite(own)
            records = records[timed]
            t_ns = np.round(own[timed] * self._time_factor).astype(np.int64)
        t_ns = t_ns - round(self.source.lag_s * 1e9)
        is_later = np.diff(t_ns, prepend=self._t[-1:] if len(self._t) else t_ns[:1] - 1) > 0
        if not is_later.all():
            order = np.argsort(t_ns, kind="stable")
            t_ns = t_ns[order]
            keep = np.append(t_ns[1:] > t_ns[:-1], True)[: len(t_ns)]
            if len(self._t):
                keep &= t_ns > self._t[-1]
            t_ns = t_ns[keep]
            records = records[order[keep]]
        if not len(t_ns):
            return
        parts = [
            values_of(records, name).astype(np.float64).reshape(len(t_ns), -1) * scale
            for name, scale in self._columns
        ]
        matrix = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if self._m is None:
            self._first_ns = int(t_ns[0])
        self._m = matrix if self._m is None else np.concatenate([self._m, matrix])
        self._t = np.concatenate([self._t, t_ns])


class RunningHeading:
    """A heading between its samples, as `signals` interpolates it in a log."""

    def __init__(self, source: RunningSource) -> None:
        self._source = source
        self._tail = LatestSamples()
        self._turns = Turns(2 * np.pi)
        self._first_ns: int | None = None  # of the samples that the period is of
        self._period_ns = 0.0

    def take(self, rows: Mapping[str, Sequence[Rows]]) -> None:
        """New rows."""
        t_ns, x = self._source.take(rows)
        finite = np.isfinite(x)
        self._tail.add(t_ns[finite], self._turns.counted(x[finite]))

    def known(self, t_ns: IntArray) -> int:
        """How many of the next rows have a heading for certain, or certainly none."""
        if len(self._tail) < 2:
            return 0
        return int(np.searchsorted(t_ns, self._tail.t_ns[-1], side="right"))

    def at(self, t_ns: IntArray) -> FloatArray:
        """(n,) heading, NaN inside pauses."""
        own = self._tail.t_ns
        if own[0] != self._first_ns:
            self._first_ns = int(own[0])
            self._period_ns = float(np.median(np.diff(own)))
        found = angle_between(own, self._tail.x, t_ns, self._period_ns)
        found[t_ns < own[0] - self._period_ns] = np.nan
        self._tail.forget(int(t_ns[0] - KEPT_S * 1e9))
        return found


class Turns:
    """`numpy.unwrap` that goes on: whole turns are counted from piece to piece."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._last = np.nan
        self._sum = 0.0

    def counted(self, x: FloatArray) -> FloatArray:
        """(n,) the next values without jumps."""
        if not len(x):
            return x
        if np.isnan(self._last):
            self._last = x[0]
        half = self._period / 2
        steps = np.diff(np.append(self._last, x))
        short = np.mod(steps + half, self._period) - half
        short[(short == -half) & (steps > 0)] = half
        correction = np.where(np.abs(steps) < half, 0.0, short - steps)
        total = np.cumsum(np.append(self._sum, correction))[1:]
        self._last = x[-1]
        self._sum = float(total[-1])
        return np.asarray(x + total)


class RunningSignal:
    """A signal of a recipe: its samples, finite and without spikes."""

    def __init__(self, spec: SignalSpec, log: Decoder) -> None:
        found = find_source(spec.sources, log)
        if found is None:
            raise RecipeError("its streams have not come")
        self.spec = spec
        self.found = found
        self.tail = LatestSamples()
        self._source = RunningSource(*found, spec.unit, log)
        self._raw = LatestSamples()
        self._judged = 0  # of the raw samples

    def take(self, rows: Mapping[str, Sequence[Rows]]) -> None:
        """New rows."""
        t_ns, values = self._source.take(rows)
        if not len(t_ns):
            return
        source = self.found[0]
        x = source.scale * values + source.offset
        finite = np.isfinite(x)
        if self.spec.max_rate is None:
            self.tail.add(t_ns[finite], x[finite])
            return
        self._raw.add(t_ns[finite], x[finite])
        stop = len(self._raw) - resample.SPIKE_SAMPLES // 2
        if stop > self._judged and len(self._raw) >= resample.SPIKE_SAMPLES:
            good = ~resample.spikes(self._raw.t_ns, self._raw.x, self.spec.max_rate)
            good[: self._judged] = False
            good[stop:] = False
            self.tail.add(self._raw.t_ns[good], self._raw.x[good])
            before = len(self._raw)
            self._raw.forget(int(self._raw.t_ns[-1] - KEPT_S * 1e9))
            self._judged = stop - (before - len(self._raw))


def values_of(records: npt.NDArray[np.void], column: str) -> npt.NDArray[np.generic]:
    """(n,) or (n, k) raw values of a message's field, of one element of it, or texts."""
    names = records.dtype.names or ()
    match = None if column in names or column.removesuffix("_") in names else ELEMENT.match(column)
    name = match[1] if match else column if column in names else column.removesuffix("_")
    values = records[name]
    if values.dtype.kind == "S":
        width = values.dtype.itemsize
        plain = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), width)
        return np.array(fixed_text(plain).to_pylist(), dtype=object)
    return np.asarray(values[:, int(match[2])] if match else values)
