"""A stream of tlog records onto the grids of a run's channels, and to their watches."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from flysid.errors import DataError, RecipeError
from flysid.ingest.align.recipe import Recipe
from flysid.live.decoding import Decoder, Rows
from flysid.live.gridding import RunningGrid, streams_of
from flysid.live.spool import SpoolPiece
from flysid.live.watching import ChannelWatch, Notice

EVERY_S = 0.06  # at most so often; else as soon as something has come
LOOK_S = 0.5
WATCH_NAP_S = 0.08  # of a receiver that only watches: each pass costs as much for one datagram as for many
MISSING_S = 5.0  # a channel whose samples do not come for so long counts as silent


@dataclass
class Follower:
    """Watches channels of a live vehicle.

    It follows the first sender that is heard; another one is followed when that one has fallen silent.

    `watches`: of the channels.
    `recipe`: of the run.
    `tell`: is called with every event, from the thread that calls `step`.
    """

    watches: Sequence[ChannelWatch]
    recipe: Recipe
    tell: Callable[[Notice], None]
    _waiting: list[bytes] = field(default_factory=list)
    _guard: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._came = threading.Event()
        self._decoder = Decoder(streams_of(self.recipe))
        self._grids = {
            w.name: RunningGrid(self.recipe, w.name, w.model.dt_s, self._decoder) for w in self.watches
        }
        self._newest_ns = {w.name: 0 for w in self.watches}
        self._heard_s = {w.name: time.monotonic() for w in self.watches}
        self._silent: set[str] = set()
        self._peer = -1
        self._peer_heard_s = float("-inf")

    def listen(self, piece: SpoolPiece) -> None:
        """Take records from the thread that receives; never waits."""
        now = time.monotonic()
        if piece.peer != self._peer and now - self._peer_heard_s > MISSING_S:
            self._peer = piece.peer
        if piece.frames and piece.peer == self._peer:
            self._peer_heard_s = now
            with self._guard:
                self._waiting.append(piece.content)
            self._came.set()

    def step(self) -> None:
        """Align what has come, and judge it."""
        with self._guard:
            records = b"".join(self._waiting)
            self._waiting.clear()
        rows = self._decoder.read(records)
        for watch in self.watches:
            if rows:
                self._follow(watch, rows)
            self._judge_silence(watch.name)

    def run(self, stop: threading.Event) -> None:
        """Step until `stop` is set."""
        while not stop.is_set():
            self._came.wait(LOOK_S)
            self._came.clear()
            self.step()
            stop.wait(EVERY_S)
        self.step()

    def _follow(self, watch: ChannelWatch, rows: Mapping[str, Sequence[Rows]]) -> None:
        """The new samples of a channel."""
        try:
            pieces = self._grids[watch.name].take(rows)
        except (RecipeError, DataError):
            return  # the grid reports it while the channel is silent
        for piece in pieces:
            if not piece.follows:
                watch.restart()
            self._newest_ns[watch.name] = piece.t0_ns + (len(piece.u) - 1) * round(watch.model.dt_s * 1e9)
            self._heard_s[watch.name] = time.monotonic()
            for event in watch.feed(piece.u, piece.y, piece.t0_ns * 1e-9):
                self.tell(event)

    def _judge_silence(self, name: str) -> None:
        """Say it where a channel's samples stop, and where they come again."""
        silent = time.monotonic() - self._heard_s[name] > MISSING_S
        if silent == (name in self._silent):
            return
        self._silent ^= {name}
        at = self._newest_ns[name] * 1e-9
        text = f"does not arrive: {self.lack(name)}" if silent else "arrives"
        self.tell(Notice("silent" if silent else "heard", name, "", at, text=f"{name} {text}"))

    def lack(self, name: str) -> str:
        """Why a channel's samples do not come."""
        return self._grids[name].lack

    def states(self) -> dict[str, str]:
        """Of every channel: "judged", or why it is not."""
        return {watch.name: self._state(watch) for watch in self.watches}

    def _state(self, watch: ChannelWatch) -> str:
        if watch.name in self._silent:
            return f"does not arrive: {self.lack(watch.name)}"
        if not self._newest_ns[watch.name]:
            return "waiting for samples"
        return "outside what the model knows" if watch.is_outside else "judged"
