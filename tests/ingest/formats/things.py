"""What another reader gives of a log, with the things of each message apart as flysid has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pyarrow as pa

from flysid.flight import RECEIVED, Flight, stem_of
from flysid.ingest.formats.keyed import key_fields, thing_name, thing_text


def apart(
    flight: Flight, expected: Mapping[str, Sequence[Any]], value: Callable[[Any, str], object] = getattr
) -> dict[str, list[Any]]:
    """The rows of every message by the stream that flysid has for their thing.

    Parameters
    ----------
    value : of a field of a row.
    """
    keys = {stem_of(name): key_fields(table.schema) for name, table in flight.tables.items()}
    found: dict[str, list[Any]] = {}
    for stem, rows in expected.items():
        for row in rows:
            texts = [thing_text(value(row, name)) for name in keys.get(stem, ())]
            found.setdefault(f"{stem}[{thing_name(texts)}]" if texts else stem, []).append(row)
    return found


def together(flight: Flight, message: str) -> pa.Table:
    """The rows of all things of a message in the order of their arrival, as another reader gives them."""
    tables = [table for name, table in flight.tables.items() if stem_of(name) == message]
    return pa.concat_tables(tables).sort_by(RECEIVED)
