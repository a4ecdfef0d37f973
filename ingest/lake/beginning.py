"""Which recipes a log can serve by its first megabyte, before all of it is read."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from flysid.errors import FlysidError
from flysid.ingest.align.recipe import load_recipe, shipped_recipes
from flysid.ingest.align.signals import FlightLog, Log, serves
from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.registry import read
from flysid.ingest.lake.workers import Bounds, Lost, read_bounded


def recipes_by_beginning(path: Path, limits: Limits, *, size: int = 1 << 20) -> dict[str, tuple[str, ...]]:
    """Shipped recipes whose streams are in the first `size` bytes of a log -> the channels they serve.

    The bytes are read in a bounded worker. Nothing where they cannot be read alone, as in a packed log, or
    a table whose end tells its columns: that is no error, as the whole log may still be read.
    """
    look = partial(_served, limits=limits, size=size)
    for _, outcome in read_bounded(look, [path], 1, Bounds(memory_bytes=10**9, seconds=20.0)):
        return {} if isinstance(outcome, Lost) else outcome
    return {}


def _served(path: Path, limits: Limits, size: int) -> dict[str, tuple[str, ...]]:
    """The task of the worker."""
    with TemporaryDirectory() as folder:
        beginning = Path(folder) / path.name
        try:
            with path.open("rb") as whole:
                beginning.write_bytes(whole.read(size))
            log = FlightLog(read(beginning, limits=limits))
        except (FlysidError, OSError, MemoryError):
            return {}
    served = {name: _channels(log, name) for name in shipped_recipes()}
    return {name: channels for name, channels in served.items() if channels}


def _channels(log: Log, name: str) -> tuple[str, ...]:
    recipe = load_recipe(name)
    return tuple(channel for channel in recipe.channels if serves(log, recipe, channel))
