"""Record links into a tlog: one thread receives, one writes, and neither waits for the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flysid.live.links import Link
from flysid.live.receiving import Receiver
from flysid.live.recording_parts import RecordingParts, Rotation
from flysid.live.signing import Guard
from flysid.live.spool import Spool, SpoolPiece

WRITE_EVERY_S = 0.05
GROUND_STATION = 255, 190  # system and component of MAV_TYPE_GCS


@dataclass
class Recording:
    """A recording that runs until `stop`.

    `links`: open links; closed at the end.
    `target`: the file to write.
    `rotation`: when a new part begins.
    `guard`: judges signatures; None where there is no key.
    `heartbeat`: send a ground station's heartbeat once a second, for vehicles that need one.
    `listener`: is given every piece as well, e.g. to watch what is recorded; must not wait.
    `watched`: the state of every channel that is watched meanwhile, for the sidecar.
    Raises UsageError: the target exists. Raises WriteError: it cannot be made.

    >>> recording = Recording([open_link("udp:0.0.0.0:14550")], Path("flight.tlog"))  # doctest: +SKIP
    >>> recording.start(); time.sleep(60); recording.stop()  # doctest: +SKIP
    """

    links: Sequence[Link]
    target: Path
    rotation: Rotation = field(default_factory=Rotation)
    guard: Guard | None = None
    heartbeat: bool = False
    listener: Callable[[SpoolPiece], None] | None = None
    watched: Callable[[], dict[str, str]] = dict
    spool: Spool = field(default_factory=Spool)

    def __post_init__(self) -> None:
        beat = heartbeat_of(self.guard.key if self.guard else None) if self.heartbeat else None
        self.receiver = Receiver(self.links, self._put, self.guard, beat)
        self.parts = RecordingParts(self.target, self.rotation, self.facts)
        self.fault: BaseException | None = None
        self.last_facts: dict[str, Any] = {}
        self._stop, self._drained = threading.Event(), threading.Event()
        self._threads = [
            threading.Thread(target=self._receive, name="receive", daemon=True),
            threading.Thread(target=self._write, name="write", daemon=True),
        ]

    def start(self) -> None:
        """Begin to receive and to write."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Receive what still waits, write it, close; raises what ended a thread early."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self.last_facts = self.facts()
        self.receiver.close()
        if self.fault is not None:
            raise self.fault

    @property
    def is_alive(self) -> bool:
        """Whether both threads run."""
        return all(thread.is_alive() for thread in self._threads)

    def facts(self) -> dict[str, Any]:
        """What has come, and how the writing goes."""
        queue = {"peak_bytes": self.spool.peak_bytes, "dropped_frames": self.spool.dropped_frames}
        return {"queue": queue, "channels": self.watched(), **self.receiver.facts()}

    def _put(self, piece: SpoolPiece) -> None:
        self.spool.put(piece)
        if self.listener is not None and piece.frames:
            self.listener(piece)

    def _receive(self) -> None:
        try:
            self.receiver.run(self._stop)
        except BaseException as error:  # noqa: BLE001 - `stop` raises it where someone sees it
            self.fault = error
        finally:
            self._drained.set()

    def _write(self) -> None:
        try:
            while not self._drained.wait(WRITE_EVERY_S):
                self.parts.write(self.spool.take())
                self.parts.tend(time.monotonic())
            self.parts.write(self.spool.take())
        except BaseException as error:  # noqa: BLE001 - as above
            self.fault = error
        finally:
            self.parts.close()


def heartbeat_of(key: bytes | None) -> Callable[[], bytes]:
    """What makes a ground station's heartbeats, signed where there is a key."""
    from pymavlink.dialects.v20 import common

    system, component = GROUND_STATION
    link = common.MAVLink(None, srcSystem=system, srcComponent=component)
    if key is not None:
        link.signing.secret_key = key
        link.signing.sign_outgoing = True
        link.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)  # 10 us since 2015

    def beat() -> bytes:
        message = link.heartbeat_encode(
            common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE
        )
        content = bytes(message.pack(link))
        link.seq = (link.seq + 1) % 256
        return content

    return beat
