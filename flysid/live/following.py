"""A stream of tlog records onto the grids of a run's channels, and to their watches.

The latest seconds are aligned as a log is (recipe, clocks, conditions), again and again; samples that are new
go to the watch.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import DataError, RecipeError
from flysid.flight import TIME
from flysid.ingest.align.align import segments_of
from flysid.ingest.align.recipe import Recipe
from flysid.ingest.formats.mavlink.reader import Pieces
from flysid.live.framing import LIVE_DIALECT
from flysid.live.spool import Piece
from flysid.live.watching import ChannelWatch, Event

WINDOW_S = 2.0
EVERY_S = 0.06
MISSING_S = 5.0  # a channel whose samples do not come for so long is said to be silent


@dataclass
class RollingLog:
    """The latest seconds of every stream, as a log (`flysid.ingest.align.signals.Log`)."""

    name: str = "live"
    info: Mapping[str, str] = field(default_factory=dict)
    _tables: dict[str, pa.Table] = field(default_factory=dict)

    @property
    def rows(self) -> Mapping[str, int]:
        return {key: table.num_rows for key, table in self._tables.items()}

    @property
    def allowed(self) -> None:
        return None

    def columns(self, stream: str) -> Sequence[str]:
        names: Sequence[str] = self._tables[stream].column_names
        return names

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        return self._tables[stream].select(list(columns))

    def add(self, stream: str, table: pa.Table) -> None:
        """Append rows; what is older than the window goes, and all of it where the clock steps back."""
        if not table.num_rows:
            return
        before = self._tables.get(stream)
        times = _times(table)
        if before is not None:
            known = _times(before)
            if known[-1] <= times[0] + WINDOW_S * 1e9:
                is_old = np.append(known < times[-1] - WINDOW_S * 1e9, False)
                table = pa.concat_tables([before.slice(int(np.argmin(is_old))), table]).combine_chunks()
        self._tables[stream] = table


def _times(table: pa.Table) -> npt.NDArray[np.int64]:
    return np.asarray(table.column(TIME).to_numpy(), dtype=np.int64)


@dataclass
class Follower:
    """Watches channels of a live vehicle.

    It follows the first sender that is heard; another one is followed when that one has fallen silent.

    Parameters
    ----------
    watches : of the channels.
    recipe : of the run.
    tell : is called with every event, from the thread that calls `step`.
    """

    watches: Sequence[ChannelWatch]
    recipe: Recipe
    tell: Callable[[Event], None]
    _waiting: list[bytes] = field(default_factory=list)
    _guard: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        conditions = tuple(replace(c, margin_s=0.0) for c in self.recipe.conditions)
        self._recipe = replace(self.recipe, conditions=conditions, min_segment_s=0.0)
        self._pieces = Pieces(LIVE_DIALECT)
        self._log = RollingLog()
        self._newest_ns = {w.name: 0 for w in self.watches}
        self._heard_s = {w.name: time.monotonic() for w in self.watches}
        self._silent: set[str] = set()
        self._peer = -1
        self._peer_heard_s = float("-inf")

    def listen(self, piece: Piece) -> None:
        """Take records from the thread that receives; never waits."""
        now = time.monotonic()
        if piece.peer != self._peer and now - self._peer_heard_s > MISSING_S:
            self._peer = piece.peer
        if piece.frames and piece.peer == self._peer:
            self._peer_heard_s = now
            with self._guard:
                self._waiting.append(piece.content)

    def step(self) -> None:
        """Align what has come, and judge it."""
        with self._guard:
            records = b"".join(self._waiting)
            self._waiting.clear()
        if records:
            for part in self._pieces.read(records):
                self._log.add(part.stream, part.table)
            self._log.info = self._pieces.info
        for watch in self.watches:
            if records:
                self._follow(watch)
            self._judge_silence(watch.name)

    def run(self, stop: threading.Event) -> None:
        """Step until `stop` is set."""
        while not stop.wait(EVERY_S):
            self.step()
        self.step()

    def _follow(self, watch: ChannelWatch) -> None:
        """The new samples of a channel."""
        dt_s = watch.model.dt_s
        dt_ns = round(dt_s * 1e9)
        try:
            _, segments = segments_of(self._log, self._recipe, watch.name, dt_s)
        except (RecipeError, DataError):
            return  # its streams have not come yet: silent
        for segment in segments:
            last_ns = segment.t0_ns + (len(segment) - 1) * dt_ns
            newest = self._newest_ns[watch.name]
            if last_ns < newest - round(WINDOW_S * 1e9):
                newest = 0  # the vehicle was started anew
            first = max(0, -((segment.t0_ns - newest - dt_ns // 2) // dt_ns)) if newest else 0
            if first >= len(segment):
                continue
            begins_ns = segment.t0_ns + first * dt_ns
            if abs(begins_ns - newest - dt_ns) > dt_ns:
                watch.restart()
            self._newest_ns[watch.name] = last_ns
            self._heard_s[watch.name] = time.monotonic()
            for event in watch.feed(segment.u[first:], segment.y[first:], begins_ns * 1e-9):
                self.tell(event)

    def _judge_silence(self, name: str) -> None:
        """Say it where a channel's samples stop, and where they come again."""
        silent = time.monotonic() - self._heard_s[name] > MISSING_S
        if silent == (name in self._silent):
            return
        self._silent ^= {name}
        at = self._newest_ns[name] * 1e-9
        text = (
            "does not arrive: its streams are missing, or a condition does not hold" if silent else "arrives"
        )
        self.tell(Event("silent" if silent else "heard", name, "", at, text=f"{name} {text}"))
