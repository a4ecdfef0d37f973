"""What the link of every sender lost, counted frame by frame as a log is read; copies are set aside."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flysid.facts.link import SequenceCounter
from flysid.facts.repeats import NO_CLOCK, FrameRows, IntArray
from flysid.ingest.formats.common.columns import gather
from flysid.ingest.formats.mavlink.frames import Frames, MessageId

CLOCK_BYTES = 4
CLOCKS = {MessageId.SYSTEM_TIME: 8, 30: 0, 32: 0, 33: 0}
"""Where messages state the milliseconds since boot; the others are ATTITUDE and the two positions."""


@dataclass
class Links:
    """The counters of a log's senders, by system * 256 + component."""

    counters: dict[int, SequenceCounter] = field(default_factory=dict)

    def counted(self, frames: Frames) -> Frames:
        """The frames of a batch that came for the first time."""
        if not len(frames):
            return frames
        senders = frames.senders()
        order = np.argsort(senders.astype(np.uint16), kind="stable")
        edges = np.flatnonzero(np.diff(senders[order], prepend=-1))
        fresh = np.ones(len(frames), dtype=bool)
        clocks = _clocks_of(frames)
        sums = frames.checksums()
        for rows in np.split(order, edges[1:]):
            counter = self.counters.setdefault(int(senders[rows[0]]), SequenceCounter())
            stamps = None if frames.stamp_us is None else frames.stamp_us[rows]
            numbers = frames.sequence[rows].astype(np.int64)
            fresh[rows], _ = counter.count(FrameRows(numbers, stamps, sums[rows], clocks[rows]))
        return frames if fresh.all() else frames.where(fresh)

    def by_sender(self, what: str) -> dict[str, int]:
        """One count of `LinkLoss` by "system.component"; senders without any are left out."""
        counts = {who: getattr(counter.loss, what) for who, counter in sorted(self.counters.items())}
        return {f"{who >> 8}.{who & 255}": count for who, count in counts.items() if count}


def _clocks_of(frames: Frames) -> IntArray:
    """(n,) milliseconds since boot that frames state; `NO_CLOCK` for those that state none."""
    found = np.full(len(frames), NO_CLOCK, dtype=np.int64)
    for message, at in CLOCKS.items():
        rows = np.flatnonzero(frames.message == message)
        if len(rows):
            left = np.clip(frames.length[rows] - at, 0, CLOCK_BYTES)
            content = gather(frames.buffer, frames.payload[rows] + at, left, CLOCK_BYTES)
            found[rows] = content.view("<u4").reshape(-1)
    return found
