"""Row 6: decompression bombs in every container that compresses; those that lie about their size too."""

from __future__ import annotations

import io
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import zstandard

import flysid
from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.common.compression import Packer
from flysid.ingest.formats.opening import members_of
from soak import Budget, Campaign, Outcome, peak_memory
from soak.readers import MEMORY_MB
from tests.format_trials import intact, read, sample
from tests.ingest.formats.test_mcap_damage import bombs, definitions, message, whole
from tests.samplelogs import rosbag, rosbag2

SLOWEST_S = 10.0
GIBIBYTE = 1 << 30
STEP = 1 << 24
PACKED = "packed logs"


def mcap_bombs() -> Iterator[tuple[bytes, int]]:
    """(file, rows besides the bomb)."""
    for bomb in bombs().values():
        yield whole(definitions(), bomb, message(b'{"k": 1}'), message(b'{"k": 2}')), 2


def bag_bombs() -> Iterator[tuple[bytes, int]]:
    """Chunks of bzip2 and lz4 that expand to 256 MB, with and without owning up to it."""
    blob = rosbag.build()
    at = len(rosbag.MAGIC)
    zeros = bytes(1 << 28)
    honest = rosbag.chunk(zeros, b"bz2")
    packed = lz4.frame.compress(zeros)
    for size in (len(zeros), 1000):
        liar = rosbag.record(packed, op=b"\x05", compression=b"lz4", size=struct.pack("<I", size))
        yield blob[:at] + liar + blob[at:], 160
    yield blob[:at] + honest + blob[at:], 160


def bag2_bombs() -> Iterator[tuple[bytes, int]]:
    """A message that expands to a gibibyte."""
    packed = _packed(zstandard.ZstdCompressor(level=1).compressobj(), b"")
    yield rosbag2.database(rosbag2.TOPICS, [(1, 5, packed), rosbag2.payload(1)]), 1


def packed_bombs() -> Iterator[tuple[bytes, int]]:
    """Logs with a gibibyte of zeros behind them, or a hundred: gzip, zstd, zip that owns up to it or not."""
    log = sample("tlog")
    rows = intact("tlog").rows
    bomb = _packed(zlib.compressobj(wbits=31), log)
    yield bomb, rows
    yield bomb + 99 * _packed(zlib.compressobj(wbits=31), b""), rows
    yield _packed(zstandard.ZstdCompressor(level=1).compressobj(), log), rows
    whole = io.BytesIO()
    with (
        zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("bomb.tlog", "w", force_zip64=True) as member,
    ):
        for piece in (log, *[bytes(STEP)] * (GIBIBYTE // STEP)):
            member.write(piece)
    blob = whole.getvalue()
    yield blob, rows
    yield blob[: blob.rindex(b"PK\x01\x02")], rows  # its header still states what it expands to
    header = bytearray(blob[: blob.rindex(b"PK\x01\x02")])
    at = header.index(b"\x01\x00\x10\x00") + 4  # the extended sizes, in the header
    header[at : at + 8] = (1 << 20).to_bytes(8, "little")
    yield bytes(header), rows
    yield _shared(1000), 0


def _packed(packer: Packer, log: bytes) -> bytes:
    zeros = (packer.compress(bytes(STEP)) for _ in range(GIBIBYTE // STEP))
    return b"".join([packer.compress(log), *zeros, packer.flush()])


def _shared(count: int) -> bytes:
    """An archive whose list names the same bytes many times, each as a member of its own."""
    one = io.BytesIO()
    with zipfile.ZipFile(one, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a0000.tlog", bytes(200_000))
    blob = one.getvalue()
    start = blob.index(b"PK\x01\x02")
    end = blob.index(b"PK\x05\x06")
    entries = b"".join(blob[start:end].replace(b"a0000", b"a%04d" % k) for k in range(count))
    tail = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, count, count, len(entries), start, 0)
    return blob[:start] + entries + tail


def run(budget: Budget) -> Iterator[Outcome]:  # noqa: ARG001 - a dozen files
    """One outcome per container."""
    sources = {"mcap": mcap_bombs, "rosbag": bag_bombs, "rosbag2": bag2_bombs, PACKED: packed_bombs}
    for name, files in sources.items():
        intact("tlog" if name == PACKED else name)
        outcome = Outcome(name)
        for blob, rows in files():
            with peak_memory(outcome), outcome.trial():
                kept = _rows(name, blob, outcome)
            outcome.keep(kept, rows)
            if kept < rows:
                outcome.failures.append(f"{len(blob)} bytes: {kept} rows of {rows}")
        if (outcome.peak_mb or 0) > MEMORY_MB or (outcome.slowest_s or 0) > SLOWEST_S:
            outcome.failures.append(f"{outcome.peak_mb:.0f} MB, {outcome.slowest_s:.1f} s")
        yield outcome


def _rows(name: str, blob: bytes, outcome: Outcome) -> int:
    try:
        flight = _read_packed(blob) if name == PACKED else read(name, blob)
    except FormatError:
        outcome.raised += 1
        return 0
    if not flight.damage.lossy:
        outcome.failures.append(f"{len(blob)} bytes: refused in silence")
    return flight.rows


def _read_packed(blob: bytes) -> Flight:
    with tempfile.NamedTemporaryFile() as file:
        file.write(blob)
        file.flush()
        path = Path(file.name)
        return flysid.read(path / next(iter(members_of(path)), ""))


CAMPAIGN = Campaign(6, "decompression bombs", run)
