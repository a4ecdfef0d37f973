"""Streams, rates and fields of a log that has just been dropped, from its beginning, before it is taken in.

The workers that read come from a process that has imported this module, and with it the readers of the usual
logs: the first look does not wait for them.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from flysid.errors import FlysidError
from flysid.ingest.lake.survey import survey
from flysid.ingest.lake.workers import Bounds, Lost, read_bounded

for _usual in ("mavlink", "dataflash", "ulog"):
    importlib.import_module(f"flysid.ingest.formats.{_usual}.reader")

QUICK_BYTES = 4 << 20  # names and rates are known from the beginning of a log


def begin_workers() -> None:
    """Have the process that workers come from begin, before the first log comes."""
    for _ in read_bounded(_begun, [0], 1, Bounds(seconds=60.0)):
        pass


def _begun(_: int) -> None:
    """Nothing, in a worker."""


def quick_look(path: Path) -> dict[str, Any]:
    """Streams, rates and fields as the beginning of a log shows them, at once; read in a bounded worker."""
    for _, outcome in read_bounded(_look, [path], 1, Bounds(memory_bytes=10**9, seconds=20.0)):
        return {"reason": outcome.reason} if isinstance(outcome, Lost) else outcome
    return {"reason": "not read"}


def _look(path: Path) -> dict[str, Any]:
    """The summary of a log's first bytes, or why there is none. Runs in the worker."""
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
