"""Logs that are dropped on the page: streamed to a folder of their own, under a name that is safe."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from flysid.errors import FlysidError, UsageError
from flysid.files import slug, writing_to

QUICK_BYTES = 4 << 20  # names and rates are known from the beginning of a log


async def keep_upload(folder: Path, name: str, parts: AsyncIterator[bytes], length: int) -> Path:
    """Write what arrives into `folder`; the path of the file.

    Raises
    ------
    UsageError : no name, no bytes, or fewer than were announced. WriteError : the disk is full.
    """
    base = name.replace("\\", "/").rpartition("/")[2]
    if not base.strip(". "):
        raise UsageError("the log has no name", hint="uploads?name=flight.bin")
    if not length:
        raise UsageError(f"{base} is empty")
    stem, dot, suffix = base.rpartition(".")
    safe = f"{slug(stem)}.{slug(suffix)}" if dot and stem else slug(base)
    place = folder / uuid.uuid4().hex
    path = place / safe
    received = 0
    try:
        with writing_to(path):
            place.mkdir()
            with path.open("wb") as file:
                async for part in parts:
                    received += len(part)
                    file.write(part)
        if received != length:
            raise UsageError(f"{base}: {received:,} of {length:,} bytes arrived", hint="drop it again")
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    return path


def quick_look(path: Path) -> dict[str, Any]:
    """Streams, rates and fields as the beginning of a log shows them, at once; read in a bounded worker."""
    from flysid.ingest.lake.workers import Bounds, Lost, run_bounded

    for _, outcome in run_bounded(_look, [path], 1, Bounds(memory_bytes=10**9, seconds=20.0)):
        return {"reason": outcome.reason} if isinstance(outcome, Lost) else outcome
    return {"reason": "not read"}


def _look(path: Path) -> dict[str, Any]:
    """The summary of a log's first bytes, or why there is none. Runs in the worker."""
    from flysid.ingest.lake.survey import survey

    beginning = path.with_name(f".beginning.{path.name}")
    try:
        with path.open("rb") as log:
            beginning.write_bytes(log.read(QUICK_BYTES))
        found = survey(beginning if path.stat().st_size > QUICK_BYTES else path)
    except FlysidError as error:
        return {"reason": error.advice}
    finally:
        beginning.unlink(missing_ok=True)
    streams = {key: [count.rows, count.rate_hz] for key, count in sorted(found.streams.items())}
    return {"format": found.source.format, "streams": streams, "info": dict(found.info)}
