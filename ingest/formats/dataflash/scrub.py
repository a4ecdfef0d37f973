"""DataFlash logs (.bin) without positions and identifiers: fields overwritten where they stand.

DataFlash has no checksums. Definitions (FMT, UNIT, ...) and times stay. Raw satellite measurements, from
which a position can be computed, and pieces of files are emptied. Bytes that are no message, and messages
without a known layout, are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Position, Scrubber, ScrubColumn
from flysid.ingest.formats.dataflash.frames import LOOK_AHEAD, Messages, Walker
from flysid.ingest.formats.dataflash.layouts import HEADER_BYTES, TIME_LABELS, Definition

CONTENT = frozenset({"GRAW", "GRXH", "GRXS", "GPSR", "RTCM", "FILE", "DID"})
DEFINING = frozenset({"FMT", "FMTU", "UNIT", "MULT"})


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The log's messages, scrubbed."""
    walker = Walker()
    position = 0
    kept = 0
    while position < len(view):
        start = position
        size = min(limits.batch_bytes + LOOK_AHEAD, len(view) - start)
        limit = size if start + size == len(view) else limits.batch_bytes
        messages, position = walker.walk(view[start : start + size], start, limit)
        content = _scrub(messages, walker.definitions.items, scrubber)
        kept += len(content)
        yield content
    scrubber.note(rules.UNREADABLE, "between messages", len(view) - kept - walker.padding)


def _scrub(messages: Messages, items: list[Definition], scrubber: Scrubber) -> bytes:
    """The messages of a batch one after the other, without what lay between them."""
    if not len(messages):
        return b""
    lengths = np.array([item.length for item in items], dtype=np.int64)[messages.code]
    known = np.array([item.layout is not None for item in items])[messages.code]
    starts = messages.start[known]
    lengths = lengths[known]
    codes = messages.code[known]
    scrubber.note(rules.UNREADABLE, "messages of unknown layout", int((~known).sum()))
    ends = np.cumsum(lengths)
    places = ends - lengths
    total = int(ends[-1]) if len(ends) else 0
    index = np.repeat(starts - places, lengths) + np.arange(total)
    out = messages.buffer[index]
    for code in np.unique(codes).tolist():
        definition = items[code]
        if definition.name not in DEFINING and definition.layout is not None:
            _scrub_kind(out, places[codes == code] + HEADER_BYTES, definition, scrubber)
    return out.tobytes()


def _scrub_kind(
    out: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], definition: Definition, scrubber: Scrubber
) -> None:
    """Scrub all messages of one definition, in place."""
    layout = definition.layout
    assert layout is not None
    index = at[:, None] + np.arange(layout.size)
    rows = out[index].view(layout.dtype).reshape(len(at))
    scrub_messages(rows, definition, scrubber)
    out[index] = rows.view(np.uint8).reshape(index.shape)


def scrub_messages(rows: npt.NDArray[Any], definition: Definition, scrubber: Scrubber) -> None:
    """Scrub decoded messages of one definition in place."""
    layout = definition.layout
    where = definition.name
    assert layout is not None
    scales = {f.name: f.scale for f in layout.fields}
    columns = {name: ScrubColumn(name, name, scales.get(name)) for name in layout.dtype.names or ()}
    rules.scrub_rows(rows, list(columns.values()), where, scrubber)
    for name in columns:
        if where in CONTENT and name not in TIME_LABELS:
            rules.clear(rows, name, (rules.CONTENT, where), scrubber)
    if where == "MSG" and "Message" in columns:
        rules.scrub_texts(rows, "Message", (rules.TEXT, where), scrubber)
    if where == "PARM" and {"Name", "Value"} <= set(columns):
        _parameters(rows, scrubber)
    if where == "MAVC" and {"X", "Y", "Fr", "Cmd"} <= set(columns):
        used = np.isin(rows["Fr"], rules.GLOBAL_FRAMES) & np.isin(rows["Cmd"], rules.LOCATED_COMMANDS)
        rules.scrub_place(rows, Position(columns["X"], columns["Y"], ()), where, scrubber, used)


def _parameters(rows: npt.NDArray[Any], scrubber: Scrubber) -> None:
    for i, raw in enumerate(rows["Name"]):
        name = bytes(raw).split(b"\0", 1)[0].decode("ascii", "replace")
        if rules.is_private_parameter(name):
            keys = [key for key in ("Value", "Default") if key in (rows.dtype.names or ())]
            scrubber.note(rules.PARAMETER, f"PARM {name}", any(rows[key][i] != 0 for key in keys))
            for key in keys:
                rows[key][i] = 0
