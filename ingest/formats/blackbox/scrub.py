"""Blackbox logs without positions and names: H and G frames are written anew, other frames are copied.

There is no checksum, so only frames that the reader keeps are in the copy: wounds, frames whose I frame was
not borne out, and GPS frames ahead of any home position are left out. Padding behind a log's end goes, too.
Where main frames are missing then, an event says that logging was resumed, as firmwares do behind a pause.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.blackbox import kernel
from flysid.ingest.formats.blackbox.codes import EventKind, Predictor
from flysid.ingest.formats.blackbox.frames import Block, Rows, Walker
from flysid.ingest.formats.blackbox.header import (
    Header,
    HeaderLine,
    find_logs,
    is_sound,
    numbers_of,
    read_header,
)
from flysid.ingest.formats.blackbox.layouts import (
    STREAMS,
    Layout,
    LayoutError,
    added_constants,
    layout_of,
)
from flysid.ingest.formats.blackbox.writing import Fields, Writer, unsigned_vb
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber, ScrubColumn
from flysid.ingest.formats.common.tally import Tally

SETTINGS = {4: "minthrottle", 9: "vbatref", 11: "motorOutput"}  # that predictors add
KNOWN_PREDICTORS = frozenset(
    {Predictor.NOTHING, Predictor.PREVIOUS, *SETTINGS, 8, Predictor.AT_HOME, Predictor.AT_TIME}
)  # in H and G frames: those that look at no main frame but its time
_PRIVATE = re.compile(
    r"craft|pilot|owner|operator|model.?name|device.?(name|u?id)|\bu?uid\b|serial.?n|bind", re.I
)
_TIME = "Log start datetime"


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The file's logs, scrubbed."""
    starts = find_logs(view)
    scrubber.note(rules.UNREADABLE, "before the first log", len(bytes(view[: starts[0]]).strip(b"\0\xff")))
    for start, stop in zip(starts, [*starts[1:], len(view)], strict=True):
        yield from _log(view, start, stop, scrubber, limits)


def _log(view: memoryview, start: int, stop: int, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    header = read_header(view, start, stop)
    for region in header.damaged:
        scrubber.note(rules.UNREADABLE, "between header lines", region.end - region.start)
    told = b"".join(_line(line, scrubber) for line in header.lines)
    yield told
    if header.cut:
        scrubber.note(rules.UNREADABLE, "header lines", stop - header.end)
        return
    try:
        defining = read_header(memoryview(told), 0, len(told))
        layout = layout_of(defining)
    except LayoutError:
        scrubber.note(rules.UNREADABLE, "frames that the header does not define", stop - header.end)
        return
    raw = np.frombuffer(view, dtype=np.uint8)
    walker = Walker(raw, header.end, stop, layout, Tally(), limits.batch_bytes)
    again = _Again(view, defining, layout, walker, scrubber)
    for block in walker.blocks():
        yield again.frames(block)
    scrubber.note(rules.UNREADABLE, "between frames", stop - header.end - again.copied - walker.padding)


def _line(line: HeaderLine, scrubber: Scrubber) -> bytes:
    """A header line without names of persons and crafts and numbers of hardware; b"" where it is damaged."""
    if not is_sound(line):
        scrubber.note(rules.UNREADABLE, "header lines", 1)
        return b""
    text = line.text.encode()
    if _PRIVATE.search(line.name) or rules.is_private_parameter(line.name.upper().replace(" ", "_")):
        text = b"x" * len(text)
        scrubber.note(rules.IDENTITY, f"parameters: {line.name}", text != line.text.encode())
    elif line.name != _TIME and not numbers_of(line.text):
        text = rules.redact(text)
        scrubber.note(rules.TEXT, f"parameters: {line.name}", text != line.text.encode())
    return b"H " + line.name.encode() + b":" + text + b"\n"


class _Again:
    """Writes the frames of one log again, block by block; `copied` counts the bytes they had."""

    def __init__(
        self, view: memoryview, header: Header, layout: Layout, walker: Walker, scrubber: Scrubber
    ) -> None:
        self.copied = 0
        self._view = view
        self._walker = walker
        self._iteration_at = layout.settings["iteration_at"]
        self._scrubber = scrubber
        self._definitions = layout.definitions
        settings = {name: str(added_constants(header)[code]) for code, name in SETTINGS.items()}
        fields = {
            kind: Fields(d.names, [not u for u in d.unsigned], d.predictors, d.encodings)
            for kind, d in layout.definitions.items()
        }
        self._writer = Writer(fields, settings, layout.settings["version"])
        self._last_us = 0
        self._last_main = (-1, 0)  # where it began, and its iteration
        self._pauses: list[int] = []

    def frames(self, block: Block) -> bytes:
        """The block's frames in their order."""
        new = dict(self._place(block)) | dict(self._events(block)) | dict(self._resume(block))
        main = block.rows.get("main")
        if main is not None:
            self._last_us = int(main.us[-1])
        spans = np.concatenate(
            [np.zeros((2, 0), dtype=np.int64), *(r.span for r in block.rows.values())], axis=1
        )
        begin, end = spans[:, np.argsort(spans[0])]
        self.copied += int((end - begin).sum())
        is_new = np.isin(begin, list(new))
        starts = np.flatnonzero(np.r_[True, (begin[1:] != end[:-1]) | is_new[1:] | is_new[:-1]][: len(begin)])
        stops = np.r_[starts[1:], len(begin)][: len(starts)]
        return b"".join(
            new[first] if first in new else bytes(self._view[first:last])
            for first, last in zip(begin[starts].tolist(), end[stops - 1].tolist(), strict=True)
        )

    def _place(self, block: Block) -> Iterator[tuple[int, bytes]]:
        """(where it began, new frame) of every H and G frame: a G frame counts from the H frame before it."""
        found = []
        for kind in "HG":
            rows = block.rows.get(STREAMS[kind])
            if rows is not None:
                values = self._scrub(kind, rows).tolist()
                found += [
                    (begin, kind, row) for begin, row in zip(rows.span[0].tolist(), values, strict=True)
                ]
        main = block.rows.get("main")
        times = {} if main is None else dict(zip(main.span[0].tolist(), main.us.tolist(), strict=True))
        begins = np.array(sorted(times), dtype=np.int64)
        at = np.searchsorted(begins, [begin for begin, _, _ in sorted(found)])
        for (begin, kind, row), k in zip(sorted(found), at.tolist(), strict=True):
            if not KNOWN_PREDICTORS.issuperset(self._definitions[kind].predictors):
                self._scrubber.note(rules.UNREADABLE, f"{STREAMS[kind]} frames of unusual predictors", 1)
                yield begin, b""
                continue
            self._writer.time_us = times[int(begins[k - 1])] if k else self._last_us
            yield begin, self._writer.frame(kind, row)

    def _resume(self, block: Block) -> Iterator[tuple[int, bytes]]:
        """(where it began, event and frame) of I frames that do not go on from the main frame before them."""
        rows = block.rows.get("event")
        if rows is not None:
            self._pauses += rows.span[0, rows.values[0] == EventKind.RESUME].tolist()
        main = block.rows.get("main")
        if main is None or self._iteration_at < 0:
            return
        iterations = main.values[self._iteration_at].view(np.uint32).tolist()
        last_begin, last = self._last_main
        for begin, end, iteration, us in zip(*main.span.tolist(), iterations, main.us.tolist(), strict=True):
            is_intra = self._view[begin] == kernel.LETTERS[kernel.INTRA]
            leaps = is_intra and last_begin >= 0 and iteration != self._walker.due(last)
            if leaps and not any(last_begin < pause < begin for pause in self._pauses):
                event = bytes([kernel.LETTERS[kernel.EVENT], EventKind.RESUME])
                stated = event + unsigned_vb(iteration) + unsigned_vb(us)
                yield begin, stated + bytes(self._view[begin:end])
            last_begin = begin
            last = iteration
        self._last_main = last_begin, last

    def _scrub(self, kind: str, rows: Rows) -> npt.NDArray[Any]:
        """(n,) records of one kind of frame, as they shall be."""
        definition = self._definitions[kind]
        types = [
            (f, "<u4" if u else "<i4") for f, u in zip(definition.names, definition.unsigned, strict=True)
        ]
        records = np.zeros(len(rows), dtype=types)
        for name, values in zip(definition.names, rows.values, strict=True):
            records[name] = values.view(records.dtype[name])
        columns = [ScrubColumn(name, name) for name in definition.names]
        rules.scrub_rows(records, columns, STREAMS[kind], self._scrubber)
        return records

    def _events(self, block: Block) -> Iterator[tuple[int, bytes]]:
        """(where it began, new event) of every event that carries text or data of a user."""
        rows = block.rows.get("event")
        if rows is None:
            return
        number, _, _, at, size = rows.values
        for k in np.flatnonzero(np.isin(number, (EventKind.CUSTOM_DATA, EventKind.CUSTOM_STRING))).tolist():
            begin = int(rows.span[0, k])
            text = bytes(self._view[int(at[k]) : int(at[k] + size[k])])
            is_data = number[k] == EventKind.CUSTOM_DATA
            clean = bytes(len(text)) if is_data else rules.redact(text)
            self._scrubber.note(rules.CONTENT if is_data else rules.TEXT, "events", clean != text)
            yield begin, bytes(self._view[begin : int(at[k])]) + clean
