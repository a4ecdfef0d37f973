"""What came of every vehicle on every link: counted while its frames become records of a tlog.

A sender is a peer, a system and a component: two vehicles with one number on two addresses stay two.
Loss between the vehicle and here is told by gaps in the sequence. The number has eight bits, so that a long
gap hides multiples of 256: as many are added as the sender's usual interval makes likely.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flysid.live.batches import ByteArray, IntArray

SENDER = np.dtype(
    [
        ("peer", np.int64),
        ("system", np.int64),
        ("component", np.int64),
        ("frames", np.int64),
        ("bytes", np.int64),
        ("signed", np.int64),
        ("lost", np.int64),  # told by the sequence alone
        ("lost_in_silence", np.int64),  # multiples of 256 in addition, likely
        ("late", np.int64),
        ("silences", np.int64),
        ("silent_us", np.int64),
        ("first_us", np.int64),
        ("last_us", np.int64),
        ("sequence", np.int64),
        ("late_sequence", np.int64),
        ("interval_us", np.float64),  # between frames as sent
        ("boot_ms", np.int64),  # the vehicle's clock when it was last told, and when that was
        ("boot_at_us", np.int64),
        ("doubted", np.int64),  # what the last silence added to the losses, and when it ended
        ("doubted_in_silence", np.int64),
        ("doubted_at_us", np.int64),
        ("boots", np.int64),
        ("clock_steps", np.int64),
    ]
)
OTHERS = 0  # the row of senders for which there is no room
ROOM = 4096
SILENCE_US = 100_000
LATE_WITHIN = 64  # so many places a frame may be overtaken
STEP_MS = 5_000
AWAKE_US = 2_000_000  # within so long, a vehicle that was started anew tells its time
MEMORY = 128.0  # frames over which the usual interval is remembered
# Where the milliseconds since boot stand: SYSTEM_TIME; ATTITUDE, LOCAL_POSITION_NED, GLOBAL_POSITION_INT.
SYSTEM_TIME = 2
TIMED_FIRST = (30, 32, 33)


@dataclass
class Ledger:
    """The senders of all links.

    Attributes
    ----------
    senders : (n,) rows of `SENDER`; the first is for all those that found no room.
    """

    _table: npt.NDArray[Any] = field(default_factory=lambda: np.zeros(ROOM, SENDER))
    _used: IntArray = field(default_factory=lambda: np.ones(1, np.int64))
    _rows: dict[int, npt.NDArray[np.int32]] = field(default_factory=dict)

    @property
    def senders(self) -> npt.NDArray[Any]:
        """A copy of the rows in use, in the order of their first frame; row 0 first."""
        return self._table[: int(self._used[0])].copy()

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
        size, boot = enter(
            raw, starts, ends, stamps_us, self._rows[peer], peer, self._table, self._used, records
        )
        return records[:size].tobytes(), int(boot)

    def shift_clock(self, step_us: int) -> None:
        """The host's clock was set: what was seen before is dated anew, so that no silence is made up."""
        rows = self._table[: int(self._used[0])]
        rows["last_us"] += step_us
        rows["boot_at_us"] += step_us


@numba.njit(cache=True)
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
) -> tuple[int, int]:
    """`Ledger.enter`, compiled."""
    at = 0
    boot_at = -1
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
            row = _new_row(table, used, peer, system, component, stamp, sequence)
            rows[system << 8 | component] = row
        sender = table[row]
        if sender.frames:
            _sequence(sender, sequence, stamp)
        sender.frames += 1
        sender.bytes += end - q
        sender.signed += signed
        if message == SYSTEM_TIME or message in TIMED_FIRST:
            first = payload + (8 if message == SYSTEM_TIME else 0)
            now_ms = np.int64(0)
            for b in range(4):  # version 2 leaves zeros out at the end
                if first + b < payload + length:
                    now_ms |= np.int64(raw[first + b]) << (8 * b)
            if _clock(sender, now_ms, stamp) and boot_at < 0:
                boot_at = at
        for b in range(8):
            records[at + b] = (stamp >> (56 - 8 * b)) & 0xFF
        for b in range(end - q):  # a slice's assignment takes seconds longer to compile
            records[at + 8 + b] = raw[q + b]
        at += 8 + end - q
    return at, boot_at


@numba.njit(cache=True)
def _new_row(
    table: Any, used: IntArray, peer: Any, system: Any, component: Any, stamp: Any, sequence: Any
) -> int:
    if used[0] == len(table):
        return OTHERS
    row = used[0]
    used[0] += 1
    sender = table[row]
    sender.peer = peer
    sender.system = system
    sender.component = component
    sender.first_us = stamp
    sender.last_us = stamp
    sender.sequence = sequence
    sender.late_sequence = -1
    sender.boot_at_us = -1
    return int(row)


@numba.njit(cache=True)
def _sequence(sender: Any, sequence: Any, stamp: Any) -> None:
    """One more frame of a sender: what is missing between it and the one before."""
    gap = max(stamp - sender.last_us, 0)
    missing = (sequence - sender.sequence - 1) & 0xFF
    goes_on = sender.late_sequence >= 0 and sequence == (sender.late_sequence + 1) & 0xFF
    if gap < SILENCE_US and missing >= 256 - LATE_WITHIN and not goes_on:
        sender.late += 1  # overtaken on its way, or sent twice
        sender.late_sequence = sequence
        if sender.lost and sequence != sender.sequence:
            sender.lost -= 1
        return
    hidden = 0
    if gap >= SILENCE_US and sender.interval_us > 0.0:
        hidden = max(0, round((gap / sender.interval_us - 1.0 - missing) / 256.0))
    if gap >= SILENCE_US and missing + hidden:  # who speaks once a second is not silent in between
        sender.silences += 1
        sender.silent_us += gap
        sender.doubted = missing
        sender.doubted_in_silence = 256 * hidden
        sender.doubted_at_us = stamp
    sender.lost += missing
    sender.lost_in_silence += 256 * hidden
    share = 1.0 / min(MEMORY, np.float64(sender.frames))
    sender.interval_us += share * (gap / (missing + 1.0 + 256.0 * hidden) - sender.interval_us)
    sender.sequence = sequence
    sender.late_sequence = -1
    sender.last_us = stamp


@numba.njit(cache=True)
def _clock(sender: Any, now_ms: Any, stamp: Any) -> bool:
    """Whether the vehicle was started anew, by the clock that it tells."""
    booted = False
    if sender.boot_at_us >= 0:
        step = (now_ms - sender.boot_ms) - (stamp - sender.boot_at_us) // 1000
        if abs(step) > STEP_MS:
            booted = now_ms < sender.boot_ms
            sender.boots += booted
            if booted and stamp - sender.doubted_at_us < AWAKE_US:  # it counts anew: nothing was lost
                sender.lost -= sender.doubted
                sender.lost_in_silence -= sender.doubted_in_silence
            sender.clock_steps += not booted
    sender.boot_ms = now_ms
    sender.boot_at_us = stamp
    return booted
