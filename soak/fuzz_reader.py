"""One reader fuzzed, in a process in which `instrument` counts its blocks (see `fuzz_child`)."""

from __future__ import annotations

import hashlib
import random
import struct
from pathlib import Path

from mcap.writer import CompressionType

from flysid.errors import FormatError
from flysid.flight import Flight
from soak import Budget, Outcome, instrument, peak_memory
from soak.fuzz import HANG_S, REPAIR, Corpus, leave, no_longer_than
from tests.format_trials import read, sample
from tests.samplelogs import mcap, navdata

FOUND = Path(__file__).resolve().parents[1] / ".bench" / "fuzz"


def seeds(name: str) -> list[bytes]:
    """The sample log, and others where it is compressed or of one kind only."""
    if name == "mcap":
        pairs = [struct.pack("<Idf", k, k / 3, k) for k in range(30)]
        text = "uint32 k\nfloat64 x\nfloat32[] y\nstring s\n"
        topics = [
            mcap.json_topic("/a", {"properties": {"k": {"type": "integer"}}}, [{"k": k} for k in range(30)]),
            mcap.ros1_topic(
                "/b", "p/Mixed", text, [p[:12] + struct.pack("<IfI", 1, 2, 2) + b"ab" for p in pairs]
            ),
        ]
        plain = CompressionType.NONE
        chunked = [
            mcap.mcap_file(topics, compression=plain, chunked=c, chunk_size=400) for c in (True, False)
        ]
        return [*chunked, sample(name)]
    if name == "navdata":
        packets = [
            (k * 5_000_000, navdata.udp(navdata.pcmd(k, (0.1, 0.2, 0.3, 0.4)), 5556, 5556)) for k in range(9)
        ]
        whole = [(k * 5_000_000 + 9, navdata.udp(sample(name)[:500], 5554, 5554)) for k in range(9)]
        return [sample(name), navdata.pcap(sorted([*packets, *whole]))]
    return [sample(name)]


def fuzz(name: str, seed: int, budget: Budget) -> Outcome:
    """Mutate until the time is up."""
    outcome = Outcome(name)
    corpus = Corpus(seeds(name), random.Random(f"{name}{seed}"))
    repair = REPAIR.get(name, leave)
    for blob in list(corpus.inputs):
        _try(name, blob, corpus, outcome)
    del corpus.inputs[len(seeds(name)) :]
    first = corpus.blocks
    goes_on = budget.clock()
    with peak_memory(outcome):
        while goes_on():
            _try(name, corpus.propose(repair), corpus, outcome)
    outcome.remark = f"blocks {first:,} to {corpus.blocks:,}, corpus {len(corpus.inputs)}"
    return outcome


def last_input(name: str) -> Path:
    """Where the input in hand is kept, in case the process dies of it."""
    return FOUND / f"{name}-last"


def _try(name: str, blob: bytes, corpus: Corpus, outcome: Outcome) -> None:
    last_input(name).write_bytes(blob)
    instrument.reset()
    fault = ""
    with outcome.trial():
        try:
            with no_longer_than(HANG_S):
                fault = wrong_with(read(name, blob), len(blob))
        except FormatError:
            outcome.raised += 1
        except Exception as error:  # noqa: BLE001 - this is what is looked for
            fault = f"{type(error).__name__}: {error}"
    corpus.judge(blob, instrument.taken())
    if fault:
        place = FOUND / f"{name}-{hashlib.sha256(blob).hexdigest()[:12]}"
        place.write_bytes(blob)
        outcome.failures.append(f"{place.name}: {fault}")


def wrong_with(flight: Flight, size: int) -> str:
    """What cannot be true of a flight read from `size` bytes; "" if nothing."""
    for table in flight.tables.values():
        table.validate(full=True)
    damage = flight.damage
    if not 0 <= damage.bytes_skipped <= size:
        return f"{damage.bytes_skipped} bytes of {size} skipped"
    if any(not 0 <= region.start < region.end <= size for region in damage.regions):
        return f"damage outside the file: {damage.regions}"
    if any(a.end > b.start for a, b in zip(damage.regions, damage.regions[1:], strict=False)):
        return f"damage counted twice: {damage.regions}"
    return ""
