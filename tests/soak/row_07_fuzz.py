"""Row 7: coverage-guided fuzzing of every reader, checksums repaired; an hour for each unless told otherwise.

Inputs that fail are left in `.bench/fuzz`; each becomes a small test before it is deleted.
"""

from __future__ import annotations

import hashlib
import random
import struct
from collections.abc import Iterator
from pathlib import Path

from mcap.writer import CompressionType

from flysid.errors import FormatError
from tests.format_trials import FORMATS, Ask, read, sample
from tests.samplelogs import mcap, navdata
from tests.soak import Budget, Campaign, Outcome
from tests.soak.fuzz import HANG_S, REPAIR, Corpus, leave, no_longer_than, traced
from tests.soak.readers import each_format

HOUR_S = 3600.0
FOUND = Path(__file__).resolve().parents[2] / ".bench" / "fuzz"


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


def fuzz(name: str, goes_on: Ask) -> Outcome:
    """Mutate until the time is up."""
    outcome = Outcome(name)
    corpus, repair = Corpus(seeds(name), random.Random(name)), REPAIR.get(name, leave)
    for seed in list(corpus.inputs):
        _try(name, seed, corpus, outcome)
    del corpus.inputs[len(seeds(name)) :]
    first = corpus.branches
    while goes_on():
        _try(name, corpus.propose(repair), corpus, outcome)
    outcome.remark = f"branches {first:,} to {corpus.branches:,}, corpus {len(corpus.inputs)}"
    return outcome


def _try(name: str, blob: bytes, corpus: Corpus, outcome: Outcome) -> None:
    taken: set[tuple[str, int, int]] = set()
    fault = ""
    with outcome.trial(), traced(taken):
        try:
            with no_longer_than(HANG_S):
                flight = read(name, blob)
            for table in flight.tables.values():
                table.validate(full=True)
        except FormatError:
            outcome.raised += 1
        except Exception as error:  # noqa: BLE001 - this is what is looked for
            fault = f"{type(error).__name__}: {error}"
    corpus.judge(blob, taken)
    if fault:
        FOUND.mkdir(parents=True, exist_ok=True)
        place = FOUND / f"{name}-{hashlib.sha256(blob).hexdigest()[:12]}"
        place.write_bytes(blob)
        outcome.failures.append(f"{place.name}: {fault}")


def run(budget: Budget) -> Iterator[Outcome]:
    """One outcome per format."""
    return each_format(budget if budget.seconds else Budget(HOUR_S * len(FORMATS)), fuzz)


CAMPAIGN = Campaign(7, "coverage-guided fuzzing", run)
