"""The frames of one log as blocks of rows, and what is done where they break off.

There is no checksum. A wound shows where a frame does not decode, where no frame begins behind it, where
time falls, or where an I frame does not go on from the frames before it. Frames count again from the next
I frame that those behind it bear out; P frames in between cannot be told without it, and are lost. Where an
I frame and the group before it contradict each other, the frames behind decide which of both was damaged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.blackbox import kernel, recovery
from flysid.ingest.formats.blackbox.encodings import ByteArray, IntArray
from flysid.ingest.formats.blackbox.header import MIN_PADDING, PADDING, START
from flysid.ingest.formats.blackbox.layouts import Layout
from flysid.ingest.formats.common.tally import Tally

FEWEST_ROWS = 4096
BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one kind of frame.

    Attributes
    ----------
    values : (fields, n), of 32 bits (events: 64).
    us : (n,) times, or -1.
    span : (2, n) where the frames begin and end in the file.
    """

    values: npt.NDArray[Any]
    us: IntArray
    span: IntArray

    def __len__(self) -> int:
        return len(self.us)


@dataclass(frozen=True, eq=False)
class Block:
    """Rows that belong together, by stream ("main", "slow", "gps", "home", "event"); `end`: bytes read."""

    rows: dict[str, Rows]
    end: int


def content_end(raw: ByteArray, start: int, stop: int) -> int:
    """Where trailing padding (16 bytes or more of 00, or of FF) begins."""
    for byte in PADDING:
        end = stop
        while end > start:
            low = max(start, end - BLOCK)
            other = np.flatnonzero(raw[low:end] != byte)
            if len(other):
                end = low + int(other[-1]) + 1
                break
            end = low
        if stop - end >= MIN_PADDING:
            return end
    return stop


class Walker:
    """Decodes one log from behind its header; what is lost goes to the tally.

    Parameters
    ----------
    raw : the whole file. start, stop : the log's bytes behind its header.
    batch_bytes : about how much memory the rows of a block may take.
    """

    def __init__(
        self, raw: ByteArray, start: int, stop: int, layout: Layout, tally: Tally, batch_bytes: int
    ) -> None:
        self._raw = raw
        self._at = start
        self._stop = stop
        self._program = layout.program
        self._tally = tally
        self._state = np.zeros(1, dtype=kernel.STATE).view(np.recarray)[0]
        for name, value in layout.settings.items():
            self._state[name] = value
        self._state["end"] = stop
        self._state["content_end"] = content_end(raw, start, stop)
        self._state["us"] = self._state["confirmed_us"] = -1
        width = layout.program.encoding.shape[1]
        self._history = np.zeros((5, width), dtype=np.int64)
        self._scratch = np.zeros((4, width), dtype=np.int64)
        self._found = np.zeros(3, dtype=np.int64)
        self._batch_bytes = batch_bytes
        self._tables = _tables(layout.program.size, batch_bytes)
        self.rejected = 0
        self.padding = 0

    @property
    def homeless(self) -> int:
        """GPS frames before any home frame: where they were cannot be told."""
        return int(self._state["homeless"])

    def due(self, iteration: int) -> int:
        """The loop iteration that is logged next."""
        return int(kernel.next_iteration(self._state, iteration))

    def blocks(self) -> Iterator[Block]:
        """All rows of the log."""
        state = self._state
        limit = self._at
        while self._at < state["content_end"]:
            if self._at >= limit:
                limit = self._at + self._batch_bytes
            reached, self._at = kernel.walk(
                self._raw, self._at, limit, self._program, state, self._history, self._tables
            )
            if reached == kernel.ENDED:
                break
            if reached == kernel.SEAM:
                self._judge_seam()
            elif reached in (kernel.NO_FRAME, kernel.CUT, kernel.FALL):
                self._pass_over(reached)
            else:
                if reached == kernel.FULL and not self._is_anything_closed():
                    self._split_group()
                yield Block(self._take(), self._at)
        kernel.close_group(state, True)
        yield Block(self._take(), self._at)
        self._finish()

    def _finish(self) -> None:
        """What stands behind the end of the log: padding, or bytes that are lost."""
        end = int(self._state["content_end"])
        if self._at < end:
            behind = self._raw[self._at : min(end, self._at + len(START))].tobytes()
            is_start = end == len(self._raw) and START.startswith(behind)
            self._tally.truncated |= is_start
            self._tally.skip(
                self._at, end, "cut off inside the header" if is_start else "behind the end of the log"
            )
        self.padding = self._stop - max(self._at, end)

    def _pass_over(self, reached: int) -> None:
        """Go on at the next I frame behind damage, or at the End event, or at the end."""
        state = self._state
        at = self._at
        self.rejected += kernel.close_group(state, reached != kernel.FALL)
        self._at = recovery.find_intra(self._raw, at + 1, self._program, state, self._scratch, self._found)
        if self._at >= 0:
            self._tally.skip(at, self._at, "no frame here, up to the next I frame")
            return
        self._at = self._stop if reached == kernel.CUT else int(state["content_end"])
        if reached == kernel.CUT:
            self._tally.truncated |= self._stop == len(self._raw)
            self._tally.skip(at, self._at, "cut off inside a frame")
        else:
            self._tally.skip(at, self._at, "no frame here, and no I frame after it")

    def _judge_seam(self) -> None:
        """An I frame that does not go on from its group: which of both is right?"""
        state = self._state
        found = self._found
        sure = recovery.is_confirmed(self._raw, self._at, self._program, state, self._scratch, found)
        falls = int(np.int32(np.uint32((int(found[1]) - int(state["us"])) & 0xFFFFFFFF))) < 0
        first = state["confirmed_us"] < 0
        after = (
            first or int(np.int32(np.uint32((int(found[1]) - int(state["confirmed_us"])) & 0xFFFFFFFF))) > 0
        )
        behind = first or state["iteration_at"] < 0 or found[0] > state["confirmed_iteration"]
        if not sure or not after or not behind:
            self._pass_over(kernel.NO_FRAME)
            return
        next_group = found[0] == state["group_iteration"] + state["interval"]
        if falls or next_group or found[0] <= state["iteration"]:
            self.rejected += kernel.close_group(state, False)
        else:
            due = int(state["iteration"]) + 1
            self._tally.sequence_gaps["main"] += max(0, int(found[0]) - due)
            kernel.close_group(state, True)

    def _is_anything_closed(self) -> bool:
        """Whether there are rows that do not wait for the next I frame."""
        return not self._state["has_group"] or any(self._state[f"{n}_open"] for n in _STREAMS)

    def _split_group(self) -> None:
        """Keep the rows of a group that fills a table alone."""
        kernel.close_group(self._state, True)
        self._state["has_group"] = 1

    def _take(self) -> dict[str, Rows]:
        """Copy the rows that are certain out of the tables, and move the others to their beginnings."""
        rows = {}
        for name in _STREAMS:
            values, us, span = (getattr(self._tables, name + part) for part in ("", "_us", "_span"))
            count = int(self._state[f"{name}_open"] if self._state["has_group"] else self._state[name])
            left = int(self._state[name]) - count
            if count:
                rows[name] = Rows(values[:, :count].copy(), us[:count].copy(), span[:, :count].copy())
                values[:, :left] = values[:, count : count + left].copy()
                us[:left] = us[count : count + left].copy()
                span[:, :left] = span[:, count : count + left].copy()
            self._state[name] = left
            self._state[f"{name}_open"] = 0
        return rows


_STREAMS = ("main", "slow", "gps", "home", "event")


def _tables(count: IntArray, batch_bytes: int) -> kernel.Tables:
    """Empty tables for the rows of one block; the system clears them, so larger ones save nothing."""
    rows = max(FEWEST_ROWS, min(batch_bytes, Limits.batch_bytes) // (4 * max(1, int(count[kernel.INTRA]))))
    tables: dict[str, npt.NDArray[Any]] = {}
    for name, kind in (
        ("main", kernel.INTRA),
        ("slow", kernel.SLOW),
        ("gps", kernel.GPS),
        ("home", kernel.HOME),
    ):
        long = rows if name == "main" else FEWEST_ROWS
        tables[name] = np.empty((int(count[kind]), long), dtype=np.int32)
        tables[f"{name}_us"] = np.empty(long, dtype=np.int64)
        tables[f"{name}_span"] = np.empty((2, long), dtype=np.int64)
    tables["event"] = np.empty((5, FEWEST_ROWS), dtype=np.int64)
    tables["event_us"] = np.empty(FEWEST_ROWS, dtype=np.int64)
    tables["event_span"] = np.empty((2, FEWEST_ROWS), dtype=np.int64)
    return kernel.Tables(**tables)
