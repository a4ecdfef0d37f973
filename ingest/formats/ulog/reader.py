"""PX4 ULog (version 1): one table per topic and instance, plus messages, parameters, dropouts.

Stream keys: `vehicle_attitude` for instance 0, `vehicle_attitude#1` for instance 1; a topic that is
subscribed again goes on in its table, and under `~2` if its format has changed. `time_ns` is the
field `timestamp`, the vehicle's microseconds since boot. Framing and recovery: `records`; formats:
`layouts`; tables and their times: `data`. Units are not in the file: those that PX4's definitions state are
in `px4_units`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from flysid.errors import FormatError
from flysid.flight import ClockMap
from flysid.ingest.formats.base import Limits, Parts, StreamPart, Summary, release
from flysid.ingest.formats.common.clock import UtcFit
from flysid.ingest.formats.common.gather import numbers
from flysid.ingest.formats.common.gps_weeks import note_of
from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.ulog.data import AHEAD_US, MAX_TIME_US, DataDecoder, Subscription
from flysid.ingest.formats.ulog.layouts import (
    NUMBERS,
    LayoutError,
    UlogLayout,
    flatten,
    parse_format,
)
from flysid.ingest.formats.ulog.records import DATA, FILE_HEAD_BYTES, MAGIC, PARAMETER, DataRun, Framer
from flysid.ingest.formats.ulog.texts import Words

MAX_SUBSCRIPTIONS = 5000
MAX_FORMATS = 5000
APPENDED_BIT = 1
START_AT = 8  # of the time at which logging began, in microseconds; 8 bytes


@dataclass
class _Batch:
    """Runs of data records that wait to be decoded."""

    runs: list[DataRun] = field(default_factory=list)
    size: int = 0


class UlogReader:
    """Parts of one file; what is learnt on the way stays in `words`, `tally` and `utc`."""

    def __init__(self, view: memoryview, limits: Limits, tally: Tally) -> None:
        self.view = view
        self.words = Words()
        self._limits = limits
        self._tally = tally
        self._framer = Framer(view, len(view))
        self._formats: dict[str, str] = {}
        self._decoder = DataDecoder(self._framer.data, tally)
        self._subscriptions = self._decoder.subscriptions
        self._versions: dict[tuple[str, int], list[int]] = {}  # subscriptions by topic and instance
        self._lost: dict[int, str] = {}  # ids of subscriptions without a layout
        self._time_us = self._doubtful_us = 0  # of the last data record
        self._batch = _Batch()
        self._at = 0  # where the record in hand begins
        self._appended: list[int] = []

    def parts(self) -> Iterator[StreamPart]:
        """Everything in the file, section by section (appended data are sections of their own)."""
        at = FILE_HEAD_BYTES
        yield from self._section(at, len(self.view))
        while self._appended:
            at = self._appended.pop(0)
            yield from self._section(at, self._appended[0] if self._appended else len(self.view))
        for stream, table in self.words.tables().items():
            yield StreamPart(stream, table)

    @property
    def utc(self) -> UtcFit:
        """Pairs of vehicle time and UTC seen so far."""
        return self._decoder.utc

    @property
    def notes(self) -> dict[str, str]:
        """Remarks about the clocks."""
        weeks = self._decoder.weeks_lost
        return {"clock_note": note_of(weeks)} if weeks else {}

    @property
    def _now_ns(self) -> int:
        return self._time_us * 1000

    def _section(self, at: int, stop: int) -> Iterator[StreamPart]:
        framer = self._framer
        framer.stop = stop
        framer.changed()
        batch = _Batch()
        since = at
        self._batch = batch
        while at < framer.stop:
            head = framer.head(at)
            run = framer.data_run(at) if head[0] == DATA else None
            if run is None:
                at = self._key(at) or self._other(at, head)
                continue
            batch.runs.append(run)
            at = self._end_of(run)
            batch.size += at - int(run.at[0])
            if batch.size >= self._limits.batch_bytes:
                yield from self._decoder.parts(batch.runs, self._time_us)
                release(self.view, since, at)
                batch = _Batch()
                since = at
                self._batch = batch
        yield from self._decoder.parts(batch.runs, self._time_us)

    def _end_of(self, run: DataRun) -> int:
        """Where a run ends; remembers the time of its last record."""
        last = int(run.at[-1])
        time = self._subscriptions[int(run.subscription[-1])].layout.time
        if time is not None:
            found = numbers(self._framer.data, np.array([last + 5 + time.offset]), NUMBERS[time.kind])
            self._advance(int(found[0]))
        return self._framer.head(last)[2]

    def _advance(self, time_us: int) -> None:
        """Move the clock forward; over a minute only where two records in a row say so."""
        near = time_us - self._time_us < AHEAD_US or abs(time_us - self._doubtful_us) < AHEAD_US
        self._doubtful_us = time_us
        if self._time_us < time_us < MAX_TIME_US and (near or not self._time_us):
            self._time_us = time_us

    def _key(self, at: int) -> int:
        """Take in a run of information and parameters; returns where to go on, 0 without any."""
        end = 0
        origin = self._origin
        now_ns = self._now_ns
        for kind, body, end, key in self._framer.keyed_run(at):
            if kind != PARAMETER or not self.words.add_keyed(key, self.view[body:end], now_ns, origin):
                self._take(kind, self.view[body:end])
        return end

    def _other(self, at: int, head: tuple[int, int, int]) -> int:
        """One record that is not data, or damage; returns where to go on."""
        framer = self._framer
        kind, body, end = head
        if framer.is_sound(at):
            resume = end if framer.is_exact(head) else framer.next_record(at + 1, end)
            if resume < end:
                self._tally.skip(at, resume, "record of a wrong size")
                return resume
            self._at = at
            self._take(kind, self.view[body:end])
            return end
        if framer.is_unit(at):
            self._tally.undecode(self._name_of(kind, body, end))
            return end
        resume = framer.stop if framer.is_cut_data(at) else self._resume(at)
        if resume < at:
            return resume
        if resume >= framer.stop and framer.is_cut(at):
            self._tally.truncated = True
            self._tally.skip(at, framer.stop, "cut off inside a record")
        else:
            named = kind == ord("D") and framer.knows(body)
            wrong = f"record of {self._name_of(kind, body, body + 2)} has a wrong size" if named else ""
            self._tally.skip(at, resume, wrong or "no record here")
        return resume

    def _resume(self, at: int) -> int:
        """The next record after damage at `at`; before it where the last data record's size swallowed one."""
        runs = self._batch.runs
        last = int(runs[-1].at[-1]) if runs else -1
        if last < 0 or self._framer.head(last)[2] != at:
            return self._framer.next_record(at + 1)
        resume = self._framer.next_record(last + 1)
        if resume < at:
            runs[-1] = DataRun(runs[-1].at[:-1], runs[-1].subscription[:-1])
            if not len(runs[-1].at):
                runs.pop()
            self._tally.skip(last, resume, "record of a wrong size")
        return resume

    def _name_of(self, kind: int, body: int, end: int) -> str:
        """What to call a record that is framed well and cannot be used."""
        if kind != ord("D") or end - body < 2:
            return f"(record type 0x{kind:02x})"
        number = self.view[body] | self.view[body + 1] << 8
        subscription = int(self._framer.sizes.subscription[number])
        if subscription >= 0:
            return self._subscriptions[subscription].stream
        return self._lost.get(number, f"(message id {number})")

    # ------------------------------------------------------------------ records other than data

    def _take(self, kind: int, body: memoryview) -> None:
        """Take in a sound record that is not data."""
        take = self._TAKE.get(kind)
        if take is not None:
            take(self, body)

    def _add_info(self, body: memoryview) -> None:
        self._count(self.words.add_info(body), "information")

    def _add_multiple(self, body: memoryview) -> None:
        self._count(self.words.add_multiple(body, self._now_ns), "information")

    def _add_parameter(self, body: memoryview) -> None:
        self._count(self.words.add_parameter(body, self._now_ns, self._origin), "parameters")

    @property
    def _origin(self) -> int:
        """Of a parameter, as in ORIGINS: initial before the first subscription, changed from there on."""
        return 1 if self._subscriptions or self._lost else 0

    def _add_default(self, body: memoryview) -> None:
        self._count(self.words.add_default(body, self._now_ns), "parameters")

    def _add_message(self, body: memoryview) -> None:
        self.words.add_message(body, tagged=False)

    def _add_tagged(self, body: memoryview) -> None:
        self.words.add_message(body, tagged=True)

    def _count(self, good: bool, name: str) -> None:
        if not good:
            self._tally.undecode(f"({name})")

    def _add_format(self, body: memoryview) -> None:
        try:
            name, fields = parse_format(bytes(body).decode("utf-8", "replace"))
        except LayoutError:
            self._tally.undecode("(formats)")
            return
        if len(self._formats) < MAX_FORMATS:
            self._formats[name] = fields
            self._framer.topics.add(name.encode())

    def _add_flags(self, body: memoryview) -> None:
        """compat[8], incompat[8], three offsets of appended data."""
        incompatible = bytes(body[8:16])
        if incompatible[0] & ~APPENDED_BIT or any(incompatible[1:]):
            self._tally.undecode("(incompatible flags)")
        if incompatible[0] & APPENDED_BIT:
            offsets = sorted(set(np.frombuffer(body[16:40], dtype="<u8").tolist()) - {0})
            self._appended = [o for o in offsets if FILE_HEAD_BYTES < o < len(self.view)]
            if self._appended and self._framer.stop > self._appended[0]:
                self._framer.stop = self._appended[0]
                self._framer.changed()

    def _subscribe(self, body: memoryview) -> None:
        number = body[1] | body[2] << 8
        instance = body[0]
        topic = bytes(body[3:]).decode("utf-8", "replace")
        try:
            layout = flatten(topic, self._formats)
        except LayoutError:
            self._lost[number] = topic
            self._framer.sizes.remove(number)
            self._framer.sizes.known[number] = True
            self._framer.changed()
            return
        if self._is_taken(number, Subscription("", topic, instance, layout)):
            return
        index = self._subscription(topic, instance, layout)
        if index >= 0:
            self._framer.sizes.subscribe(number, index, layout.size, layout.full_size)
            self._framer.changed()

    def _is_taken(self, number: int, new: Subscription) -> bool:
        """Whether the id belongs to another subscription, and its data go on to have that one's size.

        Vehicles use an id once, so one of both is damaged; which one, only sizes can tell.
        """
        used = int(self._framer.sizes.subscription[number])
        old = self._subscriptions[used] if used >= 0 else new
        if (old.topic, old.instance) == (new.topic, new.instance):
            return False
        self._tally.undecode("(subscriptions)")
        if old.layout == new.layout:
            return False
        ours, theirs = (range(one.size, one.full_size + 1) for one in (old.layout, new.layout))
        return self._framer.fits_better(number, self._at, ours, theirs)

    def _subscription(self, topic: str, instance: int, layout: UlogLayout) -> int:
        """The number of a subscription; the same one for the same topic, instance and layout."""
        versions = self._versions.setdefault((topic, instance), [])
        for index in versions:
            if self._subscriptions[index].layout == layout:
                return index
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            return -1
        stream = topic + (f"#{instance}" if instance else "") + (f"~{len(versions) + 1}" if versions else "")
        versions.append(len(self._subscriptions))
        self._subscriptions.append(Subscription(stream, topic, instance, layout))
        return versions[-1]

    def _unsubscribe(self, body: memoryview) -> None:
        self._framer.sizes.remove(body[0] | body[1] << 8)
        self._framer.changed()

    def _add_dropout(self, body: memoryview) -> None:
        self._tally.dropouts["records"] += 1
        self._tally.dropouts["ms"] += self.words.add_dropout(body, self._now_ns)

    _TAKE: ClassVar[Mapping[int, Callable[[UlogReader, memoryview], None]]] = {
        ord("F"): _add_format,
        ord("A"): _subscribe,
        ord("R"): _unsubscribe,
        ord("B"): _add_flags,
        ord("O"): _add_dropout,
        ord("I"): _add_info,
        ord("M"): _add_multiple,
        ord("P"): _add_parameter,
        ord("Q"): _add_default,
        ord("L"): _add_message,
        ord("C"): _add_tagged,
    }


def read(view: memoryview, name: str, limits: Limits) -> Parts:
    """Parts of a ULog file.

    Raises
    ------
    FormatError : it is not a ULog, or nothing in it can be read.
    """
    if len(view) < FILE_HEAD_BYTES or bytes(view[:4]) != MAGIC[:4]:
        raise FormatError(
            "not a ULog: the header is missing or cut",
            path=name,
            byte=0,
            hint="check that the download or copy finished",
        )
    tally = Tally()
    reader = UlogReader(view, limits, tally)
    yield from reader.parts()
    about = {**_about(reader.words), **reader.notes}
    return Summary(tally.freeze(), _from_start(reader.utc.clocks(), view), about)


def _about(words: Words) -> dict[str, str]:
    """Autopilot and firmware, then the file's own information."""
    release = words.numbers.get("ver_sw_release")
    known = {"autopilot": "px4"} if words.info.get("sys_name", "PX4") == "PX4" else {}
    if release is not None:
        known["firmware"] = ".".join(str(release >> shift & 255) for shift in (24, 16, 8))
    return {**words.info, **known}


def sniff(head: bytes, name: str) -> float:  # noqa: ARG001
    """1 for the magic of 7 bytes; 0.6 where only its first four are right."""
    if head.startswith(MAGIC):
        return 1.0
    return 0.6 if head.startswith(MAGIC[:4]) else 0.0


def _from_start(clocks: tuple[ClockMap, ...], view: memoryview) -> tuple[ClockMap, ...]:
    """Clocks that begin when logging began, as the head states it.

    A log opens with the last message of topics that were published before, stamped with their own times, some
    of them with 0: a log of 76 s seemed to last four minutes.
    """
    start_ns = 1000 * int.from_bytes(view[START_AT:FILE_HEAD_BYTES], "little")
    return tuple(
        replace(c, first_ns=max(c.first_ns, start_ns)) if start_ns < c.last_ns else c for c in clocks
    )
