"""A recording on the disk: parts that end at a frame, rejected bytes beside them, and a sidecar."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from flysid.errors import UsageError
from flysid.files import sync, write_atomically, writing_to
from flysid.live.spool import SpoolPiece, whole_records

REJECTS_KEPT = 1 << 20
SYNC_S = 1.0
SIDECAR_S = 5.0
RESERVE_BYTES = 1 << 18  # kept free for the sidecar of a recording whose disk is full
UNITS = {"KB": 10**3, "MB": 10**6, "GB": 10**9}
TIMES = {"s": 1, "min": 60, "h": 3600}


@dataclass(frozen=True)
class Rotation:
    """When a new part begins: beyond so many bytes or seconds, or where a vehicle was started anew."""

    size: int | None = None
    seconds: float | None = None
    boot: bool = False

    def __bool__(self) -> bool:
        return self != Rotation()


def parse_rotation(words: Sequence[str]) -> Rotation:
    """256MB, 10min, boot: any of them; raises UsageError for others."""
    size = seconds = None
    boot = False
    for word in words:
        digits = word.rstrip("KMGBsminh")
        unit = word[len(digits) :]
        number = float(digits) if digits.replace(".", "", 1).isdigit() else 0.0
        if word == "boot":
            boot = True
        elif unit in UNITS and number > 0.0:
            size = int(number * UNITS[unit])
        elif unit in TIMES and number > 0.0:
            seconds = number * TIMES[unit]
        else:
            raise UsageError(f"no rotation {word!r}", hint="a size (256MB), a time (10min) or boot")
    return Rotation(size, seconds, boot)


class RecordingParts:
    """Writes records, syncs them, begins new parts; stops writing, with a notice, where the disk refuses.

    `target`: the file, ending in .tlog; with a rotation, NAME-0001.tlog and so on.
    `rotation`: when a new part begins.
    `facts`: returns the sidecar's account of the links, called whenever it is written.
    `paths`: the parts so far.
    `frames`, `bytes`: written to all parts.
    `refusal`: why nothing is written any more; "" while all is well.
    Raises UsageError: the target exists. Raises WriteError: it cannot be made.
    """

    def __init__(self, target: Path, rotation: Rotation, facts: Callable[[], dict[str, Any]]) -> None:
        self.paths: list[Path] = []
        self.frames = self.bytes = 0
        self.unwritten_frames = 0
        self.refusal = ""
        self.sync_slowest_s = 0.0
        self._target = target
        self._rotation = rotation
        self._facts = facts
        self._handle = -1
        self._rejected = 0
        self._reserve = target.with_name(f".{target.name}.reserve")
        self._next_sync = self._next_sidecar = time.monotonic()
        self._begin()

    def write(self, pieces: Sequence[SpoolPiece]) -> None:
        """Append what has come, in order; pieces are never split between parts."""
        waiting: list[SpoolPiece] = []
        for piece in pieces:
            if not piece.frames:
                self._reject(piece.content)
                continue
            if self._is_full(piece, sum(len(p.content) for p in waiting)):
                self._append(waiting)
                waiting = []
                self._rotate()
            waiting.append(piece)
        self._append(waiting)

    def tend(self, now: float) -> None:
        """Once a second: bring the data to the disk; every five: the sidecar."""
        if now >= self._next_sync and not self.refusal:
            began = time.monotonic()
            os.fdatasync(self._handle) if hasattr(os, "fdatasync") else os.fsync(self._handle)
            self.sync_slowest_s = max(self.sync_slowest_s, time.monotonic() - began)
            self._next_sync = now + SYNC_S
        if now >= self._next_sidecar:
            self._next_sidecar = now + SIDECAR_S
            self._write_sidecar("recording")

    def close(self) -> None:
        """All is written: sync, and say so in the sidecar."""
        self._finish()
        with suppress(OSError):
            self._reserve.unlink()

    def _begin(self) -> None:
        """Open the next part; it must not be there yet."""
        path = self._target
        if self._rotation:
            path = path.with_name(f"{path.stem}-{len(self.paths) + 1:04}{path.suffix}")
        with writing_to(path):
            try:
                self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            except FileExistsError:
                raise UsageError("the target exists", path=path, hint="choose another with -o") from None
            if not self.paths:
                self._make_reserve()
            sync(path.parent)
        self.paths.append(path)
        self._size = self._part_frames = 0
        self._began = time.monotonic()
        self._next_sync = self._began + SYNC_S
        self._next_sidecar = self._began
        self.tend(self._began)

    def _make_reserve(self) -> None:
        with self._reserve.open("wb") as file:
            file.write(bytes(RESERVE_BYTES))

    def _is_full(self, piece: SpoolPiece, waiting: int) -> bool:
        """Whether a new part begins with this piece."""
        size = self._size + waiting
        if not size or not self._rotation or self.refusal:
            return False
        rotation = self._rotation
        return (
            (rotation.boot and piece.boots)
            or (rotation.size is not None and size + len(piece.content) > rotation.size)
            or (rotation.seconds is not None and time.monotonic() - self._began >= rotation.seconds)
        )

    def _rotate(self) -> None:
        try:
            self._finish()
            self._begin()
        except OSError as error:
            self._refuse(error)

    def _append(self, pieces: Sequence[SpoolPiece]) -> None:
        """Write pieces with one call; where the disk refuses, whole records stay."""
        frames = sum(piece.frames for piece in pieces)
        if not frames:
            return
        if self.refusal:
            self.unwritten_frames += frames
            return
        content = b"".join(piece.content for piece in pieces)
        done = 0
        try:
            while done < len(content):
                done += os.write(self._handle, memoryview(content)[done:])
        except OSError as error:
            whole, kept = whole_records(content, done)
            os.ftruncate(self._handle, self._size + whole)
            self._count(whole, kept)
            self.unwritten_frames += frames - kept
            self._refuse(error)
            return
        self._count(done, frames)

    def _count(self, size: int, frames: int) -> None:
        self._size += size
        self._part_frames += frames
        self.bytes += size
        self.frames += frames

    def _refuse(self, error: OSError) -> None:
        """Stop writing; make room for the sidecar, which states the reason."""
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        self.refusal = "the disk is full" if full else f"the disk refuses: {error.strerror}"
        with suppress(OSError):
            self._reserve.unlink()
        with suppress(OSError):
            os.fsync(self._handle)
        self._write_sidecar("stopped")

    def _reject(self, content: bytes) -> None:
        """Keep the first bytes that are no frame, for whoever wants to know what they are."""
        room = REJECTS_KEPT - self._rejected
        if room <= 0 or self.refusal:
            return
        self._rejected += len(content)
        with suppress(OSError), self._target.with_suffix(".rejects").open("ab") as file:
            file.write(content[:room])

    def _finish(self) -> None:
        """The part ends: on the disk, and in the sidecar."""
        if self._handle < 0:
            return
        with suppress(OSError):
            os.fsync(self._handle)
        os.close(self._handle)
        self._handle = -1
        self._write_sidecar("stopped" if self.refusal else "closed")

    def _write_sidecar(self, state: str) -> None:
        path = self.paths[-1]
        part = {"file": path.name, "state": state, "frames": self._part_frames, "bytes": self._size}
        written = {
            "parts": len(self.paths),
            "frames": self.frames,
            "bytes": self.bytes,
            "frames_not_written": self.unwritten_frames,
            "refusal": self.refusal,
            "slowest_sync_s": round(self.sync_slowest_s, 3),
        }
        document = {"format": "flysid-recording", "version": 1, **part, "written": written, **self._facts()}
        with suppress(OSError):  # the records are what counts; the last sidecar stays
            text = msgspec.json.format(msgspec.json.encode(document), indent=1)
            write_atomically(path.with_name(f"{path.name}.json"), text + b"\n")
