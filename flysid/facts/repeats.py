"""Frames that come again, by number and content: a loop of routers, or two ways to one place."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

ROUND = 256  # numbers of the sequence
HALF = ROUND // 2  # of a round: a copy from further back may be a frame of the round before
LATELY = 64  # frames among which copies are common where a loop makes them; and that show a pace
COMMON = 8  # frames to a copy, at most, where no copy states a time
NO_CLOCK = -1


@dataclass(frozen=True, eq=False)
class FrameRows:
    """Frames of one sender in the order of their arrival, one row each.

    `sequence`: (n,) numbers, 0 to 255.
    `stamp_us`: (n,) arrivals; None where nobody noted them.
    `checksum`: (n,) of content and number.
    `clock_ms`: (n,) since boot, as frames state it; `NO_CLOCK` where they do not.
    """

    sequence: IntArray
    stamp_us: IntArray | None
    checksum: IntArray
    clock_ms: IntArray

    def __len__(self) -> int:
        return len(self.sequence)

    def where(self, kept: BoolArray | IntArray) -> FrameRows:
        """Some of the rows."""
        stamps = None if self.stamp_us is None else self.stamp_us[kept]
        return FrameRows(self.sequence[kept], stamps, self.checksum[kept], self.clock_ms[kept])


@dataclass
class CopyFinder:
    """Finds the frames of one sender that came before, batch by batch."""

    _recent: deque[tuple[int, int, int]] = field(default_factory=lambda: deque(maxlen=ROUND))
    _last_key: int = -1  # number and content of the frame before
    _lately: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))  # what seemed to come again
    _dated: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))  # frames with a time
    _doubted: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))  # and was taken for new
    _advances: int = 0
    _standing: int = 0  # frames of other content under the number before

    def shift(self, step_us: int) -> None:
        """The host's clock was set: what was seen before is dated anew."""
        self._recent = deque(((key, at, us + step_us) for key, at, us in self._recent), ROUND)

    def find(self, rows: FrameRows, frames: int, interval_us: float) -> tuple[BoolArray, BoolArray, int]:
        """(n,) which frames are copies, (n,) which seem to be, and how many were taken for new before.

        `frames`: of the sender so far, copies left out.
        `interval_us`: from frame to frame; 0 where fewer than `LATELY` steps were timed, for the mean of a
            few irregular ones may be far too short.
        """
        if not len(rows):
            return np.zeros(0, dtype=bool), np.zeros(0, dtype=bool), 0
        keys = (rows.clock_ms + 1) << 24 | rows.checksum << 8 | rows.sequence
        stamps = np.zeros(len(rows), np.int64) if rows.stamp_us is None else rows.stamp_us
        before = self._last_key % ROUND if self._last_key >= 0 else rows.sequence[0]
        steps = np.diff(rows.sequence, prepend=before) % ROUND
        self._advances += int(((steps > 0) & (steps < HALF)).sum())
        is_back = (steps == 0) | (steps >= HALF)
        is_back[0] &= self._last_key >= 0
        again = np.zeros(len(rows), dtype=bool)
        if is_back.any() or self._lately[-1:].any():  # behind a copy, copies go on
            other = np.diff(keys, prepend=self._last_key) != 0
            self._standing += int((is_back & (steps == 0) & other).sum())
            if self._advances >= self._standing:  # others do not count, and may well repeat themselves
                again = self._seen(keys.tolist(), stamps.tolist(), frames, interval_us)
        copies, taken_back = self._confirmed(again, rows.clock_ms != NO_CLOCK)
        fresh = ~copies
        at = frames - taken_back + np.cumsum(fresh)
        tail = np.flatnonzero(fresh)[-ROUND:]
        self._recent.extend(zip(keys[tail].tolist(), at[tail].tolist(), stamps[tail].tolist(), strict=True))
        self._last_key = int(keys[-1])
        return copies, again & ~copies, taken_back

    def _confirmed(self, again: BoolArray, states_time: BoolArray) -> tuple[BoolArray, int]:
        """(n,) which of what seems to come again does; and how many copies earlier batches took for new.

        Two radios send equal heartbeats, by chance under one number, but never one time of the vehicle. So a
        copy near states a time, or copies are common there.
        """
        size = len(self._lately)
        all_again = np.concatenate([self._lately, again])
        all_dated = np.concatenate([self._dated, states_time])
        sure = _near(all_again & all_dated) > 0
        near = _near(all_again)
        common = (
            (self._advances > self._standing) & (near > 1) & (COMMON * near >= _near(np.ones_like(all_again)))
        )
        copies = again & (sure | common)[size:]
        self._lately, self._dated = all_again[-LATELY:], all_dated[-LATELY:]
        self._doubted = np.concatenate([self._doubted, again & ~copies])[-LATELY:]
        taken_back = int(self._doubted.sum()) if copies.any() else 0
        if taken_back:
            self._doubted[:] = False
        return copies, taken_back

    def _seen(self, keys: list[int], stamps: list[int], frames: int, interval_us: float) -> BoolArray:
        """(n,) whether a frame of this number and content came a moment ago."""
        known = {key: (at, us) for key, at, us in self._recent}
        at = frames
        if not interval_us and len(stamps) >= LATELY:
            interval_us = (stamps[-1] - stamps[0]) / len(stamps)
        longest_us = HALF * interval_us
        again = np.zeros(len(keys), dtype=bool)
        for i, (key, stamp_us) in enumerate(zip(keys, stamps, strict=True)):
            there = known.get(key)
            if there and at - there[0] < HALF and (not longest_us or stamp_us - there[1] < longest_us):
                again[i] = True
            else:
                at += 1
                known[key] = (at, stamp_us)
        return again


def _near(flags: BoolArray) -> IntArray:
    """(n,) how many of the flags are set within `LATELY` frames before or after each."""
    sums = np.concatenate([[0], np.cumsum(flags)])
    here = np.arange(len(flags))
    near: IntArray = sums[np.minimum(here + LATELY, len(flags))] - sums[np.maximum(here - LATELY, 0)]
    return near
