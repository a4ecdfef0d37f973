"""Frames, losses and repeats of every vehicle on every link, counted as frames become tlog records.

A sender is a peer, a system and a component: two vehicles with one number on two addresses stay two.
What its link lost is counted by `facts.link`, as it is when the recording is read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.facts.link import LinkLoss, SequenceCounter
from flysid.facts.repeats import NO_CLOCK, FrameRows
from flysid.live.batches import ByteArray, IntArray

SENDER = np.dtype(
    [
        ("peer", np.int64),
        ("system", np.int64),
        ("component", np.int64),
        ("frames", np.int64),
        ("bytes", np.int64),
        ("signed", np.int64),
        ("first_us", np.int64),
        ("last_us", np.int64),
    ]
)
OTHERS = 0  # the row of senders for which there is no room
ROOM = 4096
OF_A_FRAME = 5  # what the counter of losses wants to know: row, number, arrival, checksum, clock
# Where the milliseconds since boot stand: SYSTEM_TIME; ATTITUDE, LOCAL_POSITION_NED, GLOBAL_POSITION_INT.
SYSTEM_TIME = 2
TIMED_FIRST = (30, 32, 33)


@dataclass
class Ledger:
    """The senders of all links.

    `senders`: (n,) rows of `SENDER`; the first is for all those that found no room.
    `counters`: row -> what counts the losses of that sender.
    """

    _table: npt.NDArray[Any] = field(default_factory=lambda: np.zeros(ROOM, SENDER))
    _used: IntArray = field(default_factory=lambda: np.ones(1, np.int64))
    _rows: dict[int, npt.NDArray[np.int32]] = field(default_factory=dict)
    counters: dict[int, SequenceCounter] = field(default_factory=dict)

    @property
    def senders(self) -> npt.NDArray[Any]:
        """A copy of the rows in use, in the order of their first frame; row 0 first."""
        return self._table[: int(self._used[0])].copy()

    def loss(self, row: int) -> LinkLoss:
        """What the link lost of the sender in a row."""
        return self.counters[row].loss if row in self.counters else LinkLoss()

    def enter(
        self, peer: int, raw: ByteArray, starts: IntArray, ends: IntArray, stamps_us: IntArray
    ) -> tuple[bytes, int]:
        """Count frames of a peer, and make a tlog's records of them.

        Parameters
        ----------
        peer : the peer's number.
        raw, starts : bytes, and the markers of the frames in them.
        ends, stamps_us : ends of the datagrams and their times of arrival: a frame's time is that of the
            datagram which completed it.

        Returns
        -------
        The records, and where among them the first stands that a vehicle sent after it had been started
        anew; -1 where none was.
        """
        if peer not in self._rows:
            self._rows[peer] = np.full(1 << 16, -1, np.int32)
        records = np.empty(len(raw) + 8 * len(starts), np.uint8)
        frames = np.empty((len(starts), OF_A_FRAME), np.int64)
        offsets = np.empty(len(starts), np.int64)
        size = enter(
            raw,
            starts,
            ends,
            stamps_us,
            self._rows[peer],
            peer,
            self._table,
            self._used,
            records,
            frames,
            offsets,
        )
        restarts = self._count(frames)
        boot = int(offsets[restarts.argmax()]) if restarts.any() else -1
        return records[:size].tobytes(), boot

    def _count(self, frames: IntArray) -> npt.NDArray[np.bool_]:
        """Count losses, sender by sender; (n,) whether a vehicle had been started anew before a frame."""
        restarts = np.zeros(len(frames), dtype=bool)
        for row in np.unique(frames[:, 0]).tolist():
            if row == OTHERS:
                continue
            mine = np.flatnonzero(frames[:, 0] == row)
            counter = self.counters.setdefault(row, SequenceCounter())
            _, restarts[mine] = counter.count(FrameRows(*frames[mine, 1:].T))
        return restarts

    def shift_clock(self, step_us: int) -> None:
        """The host's clock was set: what was seen before is dated anew, so that no silence is made up."""
        rows = self._table[: int(self._used[0])]
        rows["last_us"] += step_us
        for counter in self.counters.values():
            counter.shift(step_us)


@njit(cache=True)
def enter(
    raw: ByteArray,
    starts: IntArray,
    ends: IntArray,
    stamps_us: IntArray,
    rows: npt.NDArray[np.int32],
    peer: int,
    table: Any,
    used: IntArray,
    records: ByteArray,
    frames: IntArray,
    offsets: IntArray,
) -> int:
    """`Ledger.enter`, compiled; `frames` and `offsets` are filled, a row for every frame."""
    at = 0
    datagram = 0
    for k in range(len(starts)):
        q = starts[k]
        length = np.int64(raw[q + 1])
        if raw[q] == 0xFD:
            payload = q + 10
            end = payload + length + 2 + 13 * np.int64(raw[q + 2])
            signed = np.int64(raw[q + 2])
            sequence = np.int64(raw[q + 4])
            system = np.int64(raw[q + 5])
            component = np.int64(raw[q + 6])
            message = np.int64(raw[q + 7]) | np.int64(raw[q + 8]) << 8 | np.int64(raw[q + 9]) << 16
        else:
            payload = q + 6
            end = payload + length + 2
            signed = np.int64(0)
            sequence = np.int64(raw[q + 2])
            system = np.int64(raw[q + 3])
            component = np.int64(raw[q + 4])
            message = np.int64(raw[q + 5])
        while datagram < len(ends) - 1 and ends[datagram] < end:
            datagram += 1
        stamp = stamps_us[datagram]
        row = rows[system << 8 | component]
        if row < 0:
            row = _new_row(table, used, peer, system, component, stamp)
            rows[system << 8 | component] = row
        sender = table[row]
        sender.last_us = stamp
        sender.frames += 1
        sender.bytes += end - q
        sender.signed += signed
        now_ms = np.int64(NO_CLOCK)
        if message == SYSTEM_TIME or message in TIMED_FIRST:
            first = payload + (8 if message == SYSTEM_TIME else 0)
            now_ms = np.int64(0)
            for b in range(4):  # version 2 leaves zeros out at the end
                if first + b < payload + length:
                    now_ms |= np.int64(raw[first + b]) << (8 * b)
        crc_at = payload + length
        frames[k, 0] = row
        frames[k, 1] = sequence
        frames[k, 2] = stamp
        frames[k, 3] = np.int64(raw[crc_at]) | np.int64(raw[crc_at + 1]) << 8
        frames[k, 4] = now_ms
        offsets[k] = at
        for b in range(8):
            records[at + b] = (stamp >> (56 - 8 * b)) & 0xFF
        for b in range(end - q):  # a slice's assignment takes seconds longer to compile
            records[at + 8 + b] = raw[q + b]
        at += 8 + end - q
    return at


@njit(cache=True)
def _new_row(table: Any, used: IntArray, peer: Any, system: Any, component: Any, stamp: Any) -> int:
    if used[0] == len(table):
        return OTHERS
    row = used[0]
    used[0] += 1
    sender = table[row]
    sender.peer = peer
    sender.system = system
    sender.component = component
    sender.first_us = stamp
    return int(row)
