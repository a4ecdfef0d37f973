"""ULog data records as tables: their times, those that cannot be, and the columns of their fields.

Old samples are common (a topic's last value when logging began), so a time in the past is kept. A record more
than a minute ahead of the records on both sides is rejected and counted, unless it is the first of its topic:
that one was kept by the vehicle from an earlier boot (missions are), and gets the time of its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from flysid.flight import BOOT, TIME, field_metadata
from flysid.ingest.formats.base import StreamPart
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.clock import UNIX_NS, UtcFit
from flysid.ingest.formats.common.gather import Bytes, Index, numbers, rows
from flysid.ingest.formats.common.gps_weeks import WEEK_NS, weeks_lost
from flysid.ingest.formats.common.px4_keys import px4_key
from flysid.ingest.formats.common.px4_units import px4_unit
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.ulog.layouts import NUMBERS, UlogLayout
from flysid.ingest.formats.ulog.records import DataRun

AHEAD_US = 60_000_000
NEIGHBOURS = 16
MAX_TIME_US = (1 << 63) // 1000 - 1
MAX_RETAINED_US = 30 * 86_400 * 10**6


@dataclass(frozen=True)
class Subscription:
    """A topic's instance with its layout, and the stream it goes to."""

    stream: str
    topic: str
    instance: int
    layout: UlogLayout


@dataclass
class DataDecoder:
    """Turns runs of data records into tables; what is seen on the way stays in `tally` and `utc`.

    Attributes
    ----------
    data : the whole file.
    subscriptions : by the number that runs give; the reader adds to them.
    """

    data: Bytes
    tally: Tally
    subscriptions: list[Subscription] = field(default_factory=list)
    utc: UtcFit = field(default_factory=UtcFit)
    weeks_lost: int = 0
    _previous_ns: dict[int, int] = field(default_factory=dict)

    def parts(self, runs: Sequence[DataRun], now_us: int) -> Iterator[StreamPart]:
        """Tables of records that follow each other in the file; `now_us` is the time of the last of them."""
        if not runs:
            return
        at = np.concatenate([run.at for run in runs]) + 5
        number = np.concatenate([run.subscription for run in runs])
        order = np.argsort(number.astype(np.uint16), kind="stable")
        cuts = np.flatnonzero(np.diff(number[order])) + 1
        groups = [(int(number[which[0]]), which) for which in np.split(order, cuts)]
        time_us = self._times(at, number)
        ahead = far_ahead(time_us)
        if ahead.any():
            groups = [(k, self._without_outliers(k, which, ahead, time_us, now_us)) for k, which in groups]
        self.utc.add(0, time_us[~ahead] * 1000)
        for index, which in groups:
            if len(which):
                yield self._part(index, at[which], time_us[which])

    def _without_outliers(
        self, index: int, which: Index, ahead: NDArray[np.bool_], time_us: Index, now_us: int
    ) -> Index:
        """The records whose time can be used; that of a retained first one is set to its neighbours'."""
        stream = self.subscriptions[index].stream
        first = int(which[0])
        if ahead[first] and index not in self._previous_ns and time_us[first] < MAX_RETAINED_US:
            near = np.flatnonzero(~ahead[first + 1 : first + NEIGHBOURS])
            time_us[first] = time_us[first + 1 + near[0]] if len(near) else now_us
            ahead[first] = False
            self.tally.out_of_order[stream] += 1
        rejected = ahead[which]
        if rejected.any():
            self.tally.time_outliers[stream] += int(rejected.sum())
        return which[~rejected]

    def _times(self, at: Index, number: Index) -> Index:
        """Times of all records in file order, in us; those of topics without any are the last one before."""
        time_us = np.full(len(at), -1, dtype=np.int64)
        specs = [subscription.layout.time for subscription in self.subscriptions]
        for place in {(spec.offset, spec.kind) for spec in specs if spec is not None}:
            has = np.array([spec is not None and (spec.offset, spec.kind) == place for spec in specs])
            which = np.flatnonzero(has[number])
            raw = numbers(self.data, at[which] + place[0], NUMBERS[place[1]])
            time_us[which] = np.where(raw > MAX_TIME_US, MAX_TIME_US, raw).astype(np.int64)
        unknown = np.flatnonzero(time_us < 0)
        if len(unknown):
            known = np.maximum.accumulate(np.where(time_us >= 0, np.arange(len(at)), -1))
            before = known[unknown]
            time_us[unknown] = np.where(before >= 0, time_us[before], 0)
        return time_us

    def _part(self, index: int, at: Index, time_us: Index) -> StreamPart:
        subscription = self.subscriptions[index]
        layout = subscription.layout
        records = rows(self.data, at, layout.size).view(np.uint8)
        time_ns = time_us * 1000
        self._observe(index, records, time_ns)
        schema = _schema(subscription.topic, subscription.instance, layout)
        return StreamPart(subscription.stream, layout.form.table(schema, (time_ns, 0), records, len(at)))

    def _observe(self, index: int, records: Bytes, time_ns: Index) -> None:
        """Count steps back and collect pairs of vehicle time and UTC."""
        subscription = self.subscriptions[index]
        back = int(np.count_nonzero(time_ns[1:] < time_ns[:-1]))
        back += int(time_ns[0] < self._previous_ns.get(index, 0))
        self._previous_ns[index] = int(time_ns[-1])
        if back:
            self.tally.out_of_order[subscription.stream] += back
        utc = subscription.layout.utc
        if utc is not None:
            places = np.arange(len(time_ns)) * subscription.layout.size + utc.offset
            utc_us = numbers(records, places, NUMBERS[utc.kind]).astype(np.int64)
            good = (utc_us > UNIX_NS // 1000) & (utc_us < MAX_TIME_US)
            lost = weeks_lost(utc_us[good] * 1000)
            self.weeks_lost = max(self.weeks_lost, lost)
            self.utc.add(0, time_ns[good], utc_us[good] * 1000 + lost * WEEK_NS)


@lru_cache(maxsize=1024)
def _schema(topic: str, instance: int, layout: UlogLayout) -> pa.Schema:
    """time_ns, boot, then the fields of a topic with their units; logs of one kind share it."""
    names = [TIME, BOOT]
    taken = {TIME, BOOT}
    notes: list[dict[bytes, bytes] | None] = [None, None]
    for spec in layout.fields:
        name = arrow_arrays.free_name(spec.name, taken)
        taken.add(name)
        names.append(name)
        notes.append(field_metadata(px4_unit(topic, spec.name)))
    fields = [
        pa.field(name, kind, metadata=note)
        for name, kind, note in zip(names, layout.form.types, notes, strict=True)
    ]
    time_source = "timestamp" if layout.time else "neighbours"
    about = {"time_source": time_source, "topic": topic, "instance": str(instance)}
    return pa.schema(fields, metadata={**about, **px4_key(topic, names)})


def far_ahead(time_us: Index) -> NDArray[np.bool_]:
    """True where a time is over a minute ahead of all 16 records before and of all but one of 16 behind.

    Times in file order, (n,). Alone in the file, or before a step back, a time is not ahead of anything.
    """
    ahead = time_us >= MAX_TIME_US
    times = np.where(ahead, 0, time_us)
    for _ in range(8):
        found = _jumps(times)
        if not len(found):
            break
        ahead[found] = True
        times[found] = 0
    return ahead


def _jumps(times: Index) -> Index:
    """Places that stand out to the future from both sides."""
    before = np.zeros(len(times), dtype=np.int64)
    for shift in range(1, NEIGHBOURS + 1):
        np.maximum(before[shift:], times[:-shift], out=before[shift:])
    steps = np.flatnonzero((times > before + AHEAD_US)[1:]) + 1
    behind = [times[p + 1 : p + 1 + NEIGHBOURS] for p in steps.tolist()]
    later = [int((b > times[p] - AHEAD_US).sum()) for p, b in zip(steps.tolist(), behind, strict=True)]
    lone = [n < 2 and len(b) >= 4 for n, b in zip(later, behind, strict=True)]
    return steps[np.array(lone, dtype=np.bool_)] if len(steps) else steps
