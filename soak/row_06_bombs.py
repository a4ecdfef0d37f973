"""Row 6: decompression bombs in every container that compresses; those that lie about their size too."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import lz4.frame
import zstandard

from flysid.errors import FormatError
from soak import Budget, Campaign, Outcome, peak_memory
from soak.readers import MEMORY_MB
from tests.format_trials import intact, read
from tests.ingest.formats.test_mcap_damage import bombs, definitions, message, whole
from tests.samplelogs import rosbag, rosbag2

SLOWEST_S = 10.0
GIBIBYTE = 1 << 30


def mcap_bombs() -> Iterator[tuple[bytes, int]]:
    """(file, rows besides the bomb)."""
    for bomb in bombs().values():
        yield whole(definitions(), bomb, message(b'{"k": 1}'), message(b'{"k": 2}')), 2


def bag_bombs() -> Iterator[tuple[bytes, int]]:
    """Chunks of bzip2 and lz4 that expand to 256 MB, with and without owning up to it."""
    blob, at, zeros = rosbag.build(), len(rosbag.MAGIC), bytes(1 << 28)
    honest = rosbag.chunk(zeros, b"bz2")
    packed = lz4.frame.compress(zeros)
    for size in (len(zeros), 1000):
        liar = rosbag.record(packed, op=b"\x05", compression=b"lz4", size=struct.pack("<I", size))
        yield blob[:at] + liar + blob[at:], 160
    yield blob[:at] + honest + blob[at:], 160


def bag2_bombs() -> Iterator[tuple[bytes, int]]:
    """A message and a file that expand to a gibibyte."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    packed = b"".join([*(packer.compress(bytes(1 << 24)) for _ in range(GIBIBYTE >> 24)), packer.flush()])
    yield rosbag2.database(rosbag2.TOPICS, [(1, 5, packed), rosbag2.payload(1)]), 1
    yield packed, 0


def run(budget: Budget) -> Iterator[Outcome]:  # noqa: ARG001 - a dozen files
    """One outcome per container."""
    sources = {"mcap": mcap_bombs, "rosbag": bag_bombs, "rosbag2": bag2_bombs}
    for name, files in sources.items():
        intact(name)
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
        flight = read(name, blob)
    except FormatError:
        outcome.raised += 1
        return 0
    if not flight.damage.lossy:
        outcome.failures.append(f"{len(blob)} bytes: refused in silence")
    return flight.rows


CAMPAIGN = Campaign(6, "decompression bombs", run)
