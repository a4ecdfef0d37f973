"""Which stream of a log a name means: of several senders one, of several things of one message none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.flight import matching_streams, stem_of, thing_of
from flysid.ingest.align.values import Value, is_one_of, names_of
from flysid.ingest.formats.keyed import key_fields, thing_texts

_VEHICLE = re.compile(r"^(\d+)\.(\d+)/")


def autopilot_system(rows: Mapping[str, int]) -> str:
    """The MAVLink system whose component 1 logs most rows; '' where streams carry no system."""
    count: dict[str, int] = {}
    for key, n in rows.items():
        match = _VEHICLE.match(key)
        if match and match[2] == "1":
            count[match[1]] = count.get(match[1], 0) + n
    return max(count, key=lambda system: (count[system], -int(system)), default="")


def find_stream(name: str, rows: Mapping[str, int]) -> str | None:
    """The key that `name` means: exact, else the autopilot's, else its system's, else the one with most rows.

    None where the log has no such stream, only empty ones, or several things of that message.
    """
    found = things_of(name, rows)
    return found[0] if len(found) == 1 else None


def things_of(name: str, rows: Mapping[str, int]) -> list[str]:
    """The streams of the things that `name` means, of one sender as `find_stream` chooses it; by key."""
    found = [key for key in matching_streams(name, rows) if rows[key] > 0]
    stems = {stem_of(key) for key in found}
    if len(stems) <= 1:
        return sorted(found)
    system = autopilot_system(rows)

    def preference(stem: str) -> tuple[int, int]:
        rank = 2 if stem.startswith(f"{system}.1/") else 1 if stem.startswith(f"{system}.") else 0
        return rank, sum(rows[key] for key in found if stem_of(key) == stem)

    best = max(stems, key=preference)
    return sorted(key for key in found if stem_of(key) == best)


def things_where(
    where: Mapping[str, Value], things: Sequence[str], table: pa.Table, info: Mapping[str, str]
) -> list[str]:
    """Those of several things of a message whose key has the values that `where` names.

    Parameters
    ----------
    table : columns of one of their streams, those that `where` names.
    info : facts about the vehicle.
    """
    keys = key_fields(table.schema)
    names = {key: names_of(table, things[0], key, info) for key in keys if key in table.column_names}
    if not names:
        return list(things)

    def fits(stream: str) -> bool:
        texts = dict(zip(keys, thing_texts(thing_of(stream), len(keys)), strict=False))
        return all(
            is_one_of(_as_value(texts[key], table.schema.field(key).type), [where[key]], names[key]).all()
            for key in names
        )

    return [stream for stream in things if fits(stream)]


def _as_value(text: str, kind: pa.DataType) -> npt.NDArray[np.generic]:
    """(1,) the value of a key, of which a stream's name has the text."""
    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    return np.array([float(text)]) if is_number and text else np.array([text], dtype=object)
