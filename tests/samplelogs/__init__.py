"""Small logs, one module per format, for the contract tests that every format passes.

A module `tests/samplelogs/<format name>.py` offers

- `SUFFIX`, e.g. ".tlog";
- `build() -> bytes`: an intact log of about 20 kB, the same bytes at every call;
- `records(blob) -> list[Record]`: every record of that log in order, contiguous from first to last byte;
- optionally `FORMAT`: the format whose reader it is for, where that is not the module's name;
- optionally `left_of(piece) -> tuple[int, bool]`: rows that can be read of the beginning of a record, and
  whether nothing of them is lost;
- optionally `unseen(blob, start, end) -> bool`: whether bytes changed there may make a record mean something
  else, which is passed over as such;
- optionally `at_risk(blob, byte) -> int`: rows that damage to this byte may cost; by default those of
  the record it belongs to. (A definition puts all rows of its stream at risk; a chunk all of its rows.)
- optionally `RESYNC_BYTES`: intact bytes after damage that the reader may lose before it finds its way
  again; 0 by default;
- optionally `KNOWS_ITS_END = True`: a log that is cut between two records shows that it is cut;
- optionally `ADDRESSED = True`: records refer to each other by their place in the file (pages of a database),
  so that damage is tried by overwriting, not by inserting or deleting (docs/adr/0011);
- optionally `UNCHECKED = True`: no checksums, so that a record whose middle is deleted takes in as many bytes
  behind it, and nothing tells where these happen to end at another record's end;
- optionally `defining(blob) -> list[tuple[int, int, int]]`: bytes [start, end) that define a stream, and the
  rows that any edit of a byte there may cost; by default, records that `at_risk` makes definitions;
- optionally `HARMLESS`: bytes that mean nothing between records (empty lines of a text log).
"""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass
from types import ModuleType


@dataclass(frozen=True)
class Record:
    """One record of a sample log: bytes [start, end), which give `rows` table rows."""

    start: int
    end: int
    rows: int


def sample_modules() -> dict[str, ModuleType]:
    """Every sample module by the name of its format."""
    return {
        module.name: importlib.import_module(f"{__name__}.{module.name}")
        for module in pkgutil.iter_modules(__path__)
    }


def record_at(records: list[Record], byte: int) -> Record:
    """The record that a byte belongs to."""
    return next(record for record in records if record.start <= byte < record.end)
