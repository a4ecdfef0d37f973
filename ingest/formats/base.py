"""What a log format provides, and how flysid reads a log of any format.

A format is a folder here whose package holds its row; other packages add theirs with an entry point of the
group "flysid.formats" (`flysid.ingest.formats.registry`). A reader is a generator: it yields tables (parts of
streams, in any interleaving) and returns a Summary, so that a log of any size is read in bounded memory.
"""

from __future__ import annotations

import hashlib
import importlib
import mmap
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import pyarrow as pa

from flysid.errors import FormatError
from flysid.files import remedy_unread, why_unread
from flysid.flight import ClockMap, Damage, Flight, Source
from flysid.ingest.formats.keyed import KeyedStreams
from flysid.parts import exhaust

HEAD_BYTES = 65536
_HASH_BYTES = 16 << 20
WHOLE_BATCH_BYTES = 32 << 20  # to memory: few, large parts
JOIN_BYTES = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Settings of a reader: bounds that hold for hostile input, and what the caller knows of the log.

    Attributes
    ----------
    max_chunk_bytes : of one decompressed chunk.
    time_unit : of a table's times that state none: "s", "ms", "us", "ns", "min", "h" or "d"; "" where the
        caller cannot tell.
    date_order : of a table's dates that fit in two: "dmy", "mdy" or "ymd"; "" where the caller cannot tell.
    format : the log's format, by name; "" where its bytes shall tell.
    max_things : streams that messages whose rows belong to several things are split into, of a whole log.
    """

    max_chunk_bytes: int = 1 << 30
    max_ratio: float = 200.0
    batch_bytes: int = 8 << 20
    time_unit: str = ""
    date_order: str = ""
    format: str = ""
    max_things: int = 2000


@dataclass(frozen=True)
class StreamPart:
    """Some rows of one stream. All parts of a stream have the same schema, `time_ns` and `boot` first.

    Where the schema's metadata names a `key`, rows of each of its values go to a stream of their own.
    """

    stream: str
    table: pa.Table


@dataclass(frozen=True)
class Summary:
    """What a reader knows once it has reached the end.

    `renamed`: streams whose name has turned out to be another since their parts were yielded.
    """

    damage: Damage = field(default_factory=Damage)
    clocks: tuple[ClockMap, ...] = ()
    info: Mapping[str, str] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)


Parts = Generator[StreamPart, None, Summary]


@dataclass(frozen=True)
class Format:
    """A log format: what can be known of it without importing its reader, which costs 0.2 s.

    Attributes
    ----------
    name : short name, e.g. "tlog".
    title : what a person calls it.
    suffixes : usual file name endings, lower case; a hint for folders, never proof.
    reader : module with `sniff(head, name)` and `read(view, name, limits)`.
    scrubber : module with `scrub(view, scrubber, limits)`; None where the format cannot be scrubbed.
    zeros : how many zero bytes a sound log may begin with. More are what a lost write left.
    joins : whether its recorders split a log over several files: the reader has `read_files` then, which
        takes views where `read` takes one.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    reader: str
    scrubber: str | None = None
    zeros: int = 0
    joins: bool = False

    def sniff(self, head: bytes, name: str) -> float:
        """Confidence from 0 to 1 that a file with these first `HEAD_BYTES` bytes is of this format."""
        confidence: float = importlib.import_module(self.reader).sniff(head, name)
        return confidence

    def read(self, view: memoryview, name: str, limits: Limits, rest: Sequence[memoryview] = ()) -> Parts:
        """The parts of a whole log. Zeros ahead of it count as damage.

        Damage never raises: it is counted. FormatError is raised only where nothing at all can be read.

        `rest`: the files behind the first, of a format that `joins` them.
        """
        if rest:
            read_files = importlib.import_module(self.reader).read_files
            whole: Summary = yield from _things_apart(read_files((view, *rest), name, limits), limits)
            return whole
        skipped = self.zeros_ahead(view)
        try:
            parts = importlib.import_module(self.reader).read(view[skipped:], name, limits)
            summary = yield from _things_apart(parts, limits)
        except FormatError as error:
            error.byte = None if error.byte is None else error.byte + skipped
            raise
        return replace(summary, damage=summary.damage.behind_zeros(skipped)) if skipped else summary

    def zeros_ahead(self, view: memoryview) -> int:
        """Zero bytes that a log begins with, those that belong to it left out."""
        return max(0, count_zeros(view) - self.zeros)


def _things_apart(parts: Parts, limits: Limits) -> Parts:
    """The parts with a stream for each thing that the rows of one message belong to."""
    streams = KeyedStreams(limits.max_things)
    with closing(parts):
        while True:
            try:
                part = next(parts)
            except StopIteration as stop:
                summary: Summary = stop.value
                break
            for stream, table in streams.split(part.stream, part.table):
                yield StreamPart(stream, table)
    summary = replace(summary, renamed=streams.renamed)
    if not streams.joined:
        return summary
    counts = ", ".join(f"{rows:,} of {stream}" for stream, rows in streams.joined.items())
    note = f"rows of things beyond the {limits.max_things:,} that are kept apart: {counts}"
    return replace(summary, info={**summary.info, "keys_note": note})


def sniff_magic(head: bytes, name: str, magic: bytes, suffix: str) -> float:
    """1 for the magic; 0.5 for a file of the right suffix whose magic is damaged in up to two bytes."""
    if head.startswith(magic):
        return 1.0
    same = sum(a == b for a, b in zip(head, magic, strict=False))
    return 0.5 if same >= len(magic) - 2 and name.lower().endswith(suffix) else 0.0


def count_zeros(view: memoryview) -> int:
    """How many zero bytes a log begins with: a file system leaves them where a write was lost."""
    for start in range(0, len(view), HEAD_BYTES):
        piece = bytes(view[start : start + HEAD_BYTES])
        if rest := piece.lstrip(b"\0"):
            return start + len(piece) - len(rest)
        release(view, start, start + len(piece))
    return len(view)


def _no_file(path: Path) -> FormatError:
    """What is there instead of a file."""
    if path.is_dir():
        return FormatError(
            "a folder, not a log", path=path, hint=f"flysid ingest {path} -o DATA reads all its logs"
        )
    if path.exists():
        return FormatError("a pipe, socket or device, not a file", path=path, hint="give a log file")
    if path.is_symlink():
        return FormatError(
            f"a link to {path.readlink()}, which is not there", path=path, hint="give the log itself"
        )
    return FormatError("no such file", path=path, hint="check its name and folder")


@contextmanager
def map_file(path: Path) -> Iterator[memoryview]:
    """The bytes of a file, memory-mapped. Raises FormatError where it is not a readable regular file."""
    try:
        if not path.is_file():
            raise _no_file(path)
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
        raise FormatError(
            f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error


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


def hash_log(*views: memoryview) -> str:
    """sha256 of a log's files one after the other, in hexadecimal, without keeping mapped ones in memory."""
    digest = hashlib.sha256()
    for view in views:
        for start in range(0, len(view), _HASH_BYTES):
            digest.update(view[start : start + _HASH_BYTES])
            release(view, start, min(start + _HASH_BYTES, len(view)))
    return digest.hexdigest()


def source_of(view: memoryview, name: str, fmt: Format, rest: Sequence[memoryview] = ()) -> Source:
    """Name, size and sha256 of a log; `rest` is as `Format.read` takes it."""
    size = len(view) + sum(len(other) for other in rest)
    return Source(name=name, format=fmt.name, size_bytes=size, sha256=hash_log(view, *rest))


def collect(
    view: memoryview, name: str, fmt: Format, limits: Limits, rest: Sequence[memoryview] = ()
) -> Flight:
    """Run a format's reader to its end and join the parts of each stream; `rest` as `Format.read`."""
    parts: dict[str, list[pa.Table]] = {}
    reader = fmt.read(view, name, limits, rest)
    summary = exhaust(reader, lambda part: parts.setdefault(part.stream, []).append(part.table))
    parts = {summary.renamed.get(stream, stream): found for stream, found in parts.items()}
    tables = {stream: _join(parts.pop(stream)) for stream in sorted(parts)}
    return Flight(source_of(view, name, fmt, rest), tables, summary.damage, summary.clocks, summary.info)


def _join(parts: list[pa.Table]) -> pa.Table:
    """One chunk per column where that is cheap; a large table keeps its few parts, which are not copied."""
    table = parts[0] if len(parts) == 1 else pa.concat_tables(parts)
    if table.num_columns == 0 or table.column(0).num_chunks <= 1:
        return table  # every column of a table has as many
    return table.combine_chunks() if table.nbytes <= JOIN_BYTES else table
