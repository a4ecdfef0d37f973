"""Which stream of a log a name means: of several senders one, of several things of one message none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from flysid.flight import matching_streams, stem_of, thing_of
from flysid.ingest.align.values import Value
from flysid.ingest.formats.keyed import thing_texts

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
    wanted: Mapping[str, Value],
    things: Sequence[str],
    keys: Sequence[str],
    names: Mapping[str, Mapping[str, str]],
) -> list[str]:
    """Those of several things of a message whose key has the values that are wanted.

    `wanted`: by field of the key.
    `keys`: all fields of the key.
    `names`: of a field's numbers, as text.
    """

    def fits(stream: str) -> bool:
        texts = dict(zip(keys, thing_texts(thing_of(stream), len(keys)), strict=False))
        return all(_is(texts.get(key, ""), value, names.get(key, {})) for key, value in wanted.items())

    return [stream for stream in things if fits(stream)]


def _is(text: str, wanted: Value, names: Mapping[str, str]) -> bool:
    """Whether a key's text is a value that is wanted, which may be given by its name."""
    if isinstance(wanted, str):
        return wanted in (text, names.get(text))
    try:
        return float(text) == float(wanted)
    except ValueError:
        return False
