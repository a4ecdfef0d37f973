"""What a log format provides, and how flysid finds it.

A format is a module of this folder that ends with `FORMAT = Format(...)`, its suffixes written out. Nothing
else registers it: `all_formats` walks the folder. A reader is a generator: it yields tables (parts of
streams, in any interleaving) and returns a Summary, so that a log of any size is read in bounded memory.
"""

from __future__ import annotations

import hashlib
import importlib
import mmap
import re
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pyarrow as pa

from flysid.errors import FormatError, UsageError
from flysid.flight import ClockMap, Damage, Flight, Source
from flysid.parts import exhausted

HEAD_BYTES = 65536
CERTAIN = 0.95
_SUFFIX = re.compile(r'"(\.[a-z0-9.]+)"')
_HASH_BYTES = 16 << 20
WHOLE_BATCH_BYTES = 32 << 20  # to memory: few, large parts
JOIN_BYTES = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Bounds that hold for hostile input. `max_chunk_bytes` bounds one decompressed chunk."""

    max_chunk_bytes: int = 1 << 30
    max_ratio: float = 200.0
    batch_bytes: int = 8 << 20


@dataclass(frozen=True)
class StreamPart:
    """Some rows of one stream. All parts of a stream have the same schema, `time_ns` and `boot` first."""

    stream: str
    table: pa.Table


@dataclass(frozen=True)
class Summary:
    """What a reader knows once it has reached the end."""

    damage: Damage = field(default_factory=Damage)
    clocks: tuple[ClockMap, ...] = ()
    info: Mapping[str, str] = field(default_factory=dict)


Parts = Generator[StreamPart, None, Summary]


@dataclass(frozen=True)
class Format:
    """A log format.

    Attributes
    ----------
    name : short name, e.g. "tlog".
    title : what a person calls it.
    suffixes : usual file name endings, lower case; a hint for folders, never proof.
    sniff : (first `HEAD_BYTES` bytes, file name) -> confidence from 0 to 1.
    read : (whole file as a buffer, file name, limits) -> parts. Never raises for damage: damage is
        counted. Raises FormatError only where nothing at all can be read.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes, str], float]
    read: Callable[[memoryview, str, Limits], Parts]


@cache
def _statements() -> Mapping[str, str]:
    """Module name -> its statement FORMAT = ..., for every module that has one. Imports none of them."""
    found: dict[str, str] = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        _, mark, statement = path.read_bytes().rpartition(b"\nFORMAT = ")
        if mark:
            found[path.stem] = statement.decode("utf-8")
    return found


@cache
def suffixes_by_module() -> Mapping[str, tuple[str, ...]]:
    """The file name endings that each format's module states, without importing it: imports cost 0.2 s."""
    return {module: tuple(_SUFFIX.findall(text)) for module, text in _statements().items()}


@cache
def all_formats() -> Mapping[str, Format]:
    """Every format of this folder, by name."""
    found = [_format_in(module) for module in _statements()]
    return {fmt.name: fmt for fmt in found}


def _format_in(module: str) -> Format:
    fmt: Format = importlib.import_module(f"flysid.ingest.{module}").FORMAT
    return fmt


def detect(head: bytes, name: str) -> Format:
    """The format of a file by its first bytes; its name only breaks ties.

    Raises FormatError when no format recognises it.
    """
    if not head:
        raise FormatError(
            "the file is empty", path=name, byte=0, hint="check that the download or copy finished"
        )
    lower = name.lower()
    for module, suffixes in suffixes_by_module().items():
        if lower.endswith(suffixes) and (likely := _format_in(module)).sniff(head, name) >= CERTAIN:
            return likely  # the usual case: nothing else is imported
    scored = [
        (f.sniff(head, name) + (0.05 if lower.endswith(f.suffixes) else 0.0), f)
        for f in all_formats().values()
    ]
    confidence, best = max(scored, key=lambda pair: pair[0], default=(0.0, None))
    if best is None or confidence < 0.3:
        raise FormatError(
            "not a flight log that flysid knows",
            path=name,
            byte=0,
            hint="formats read: " + ", ".join(f.title for f in all_formats().values()),
        )
    return best


@contextmanager
def open_log(path: Path) -> Iterator[memoryview]:
    """The bytes of a log, memory-mapped. Raises FormatError where it is not a readable regular file."""
    try:
        if not path.is_file():
            raise FormatError("not a regular file", path=path, hint="give a log file")
        with path.open("rb") as file:
            if path.stat().st_size == 0:
                raise FormatError(
                    "the file is empty", path=path, byte=0, hint="check that the download or copy finished"
                )
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            view = memoryview(mapped)
            try:
                yield view
            finally:
                # A traceback or cycle may keep arrays that look at the map; it closes with the last of them.
                with suppress(BufferError):
                    view.release()
                    mapped.close()
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path=path) from error


def release(view: memoryview, start: int, stop: int) -> None:
    """Tell the system that [start, stop) of a mapped log is not needed for now, so that memory stays flat.

    Does nothing for bytes that are not mapped; the bytes stay readable either way.
    """
    mapped = view.obj
    if isinstance(mapped, mmap.mmap) and hasattr(mapped, "madvise"):
        first = -(-start // mmap.PAGESIZE) * mmap.PAGESIZE
        length = (stop - first) // mmap.PAGESIZE * mmap.PAGESIZE
        if length > 0:
            mapped.madvise(mmap.MADV_DONTNEED, first, length)


def hash_log(view: memoryview) -> str:
    """sha256 of a log, in hexadecimal, without keeping a mapped log in memory."""
    digest = hashlib.sha256()
    for start in range(0, len(view), _HASH_BYTES):
        digest.update(view[start : start + _HASH_BYTES])
        release(view, start, min(start + _HASH_BYTES, len(view)))
    return digest.hexdigest()


def source_of(view: memoryview, name: str, fmt: Format) -> Source:
    """Name, size and sha256 of a log."""
    return Source(name=name, format=fmt.name, size_bytes=len(view), sha256=hash_log(view))


def read(path: str | Path, *, format: str | None = None, limits: Limits | None = None) -> Flight:  # noqa: A002
    """Read a whole log into memory.

    Parameters
    ----------
    path : the log.
    format : name of its format; found from its bytes when None.
    limits : bounds for hostile input.

    Raises
    ------
    FormatError : not a log, empty or unreadable.
    UsageError : `format` is not a name that flysid knows.
    """
    path = Path(path)
    with open_log(path) as view:
        fmt = detect(bytes(view[:HEAD_BYTES]), path.name) if format is None else _format_named(format)
        return collect(view, path.name, fmt, limits or Limits(batch_bytes=WHOLE_BATCH_BYTES))


def collect(view: memoryview, name: str, fmt: Format, limits: Limits) -> Flight:
    """Run a format's reader to its end and join the parts of each stream."""
    parts: dict[str, list[pa.Table]] = {}
    reader = fmt.read(view, name, limits)
    summary = exhausted(reader, lambda part: parts.setdefault(part.stream, []).append(part.table))
    tables = {stream: _joined(pa.concat_tables(parts.pop(stream))) for stream in sorted(parts)}
    return Flight(source_of(view, name, fmt), tables, summary.damage, summary.clocks, summary.info)


def _joined(table: pa.Table) -> pa.Table:
    """One chunk per column where that is cheap; a large table keeps its few parts, which are not copied."""
    if table.num_columns == 0 or table.column(0).num_chunks <= 1:
        return table  # every column of a table has as many
    return table.combine_chunks() if table.nbytes <= JOIN_BYTES else table


def _format_named(name: str) -> Format:
    try:
        return all_formats()[name]
    except KeyError:
        raise UsageError(f"no format {name!r}", hint="one of " + ", ".join(all_formats())) from None
