"""DataFlash text logs (.log) without positions and identifiers: cells rewritten, all else as it was.

Lines of unknown kinds, and lines that do not hold what their FMT states, are left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Scrubber, ScrubColumn
from flysid.ingest.formats.dataflash.scrub import CONTENT, DEFINING


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The log's lines, scrubbed."""
    labels: dict[str, list[str]] = {}
    position = 0
    lost = 0
    while position < len(view):
        piece = bytes(view[position : position + limits.batch_bytes])
        end = piece.rfind(b"\n") + 1 or len(piece)
        out = []
        for line in piece[:end].splitlines(keepends=True):
            clean = _line(line, labels, scrubber)
            lost += len(line) if clean is None else 0
            out.append(clean or b"")
        yield b"".join(out)
        position += end
    scrubber.note(rules.UNREADABLE, "lines", lost)


def _line(line: bytes, labels: dict[str, list[str]], scrubber: Scrubber) -> bytes | None:
    """One line scrubbed; None where it cannot be understood."""
    text = line.decode("utf-8", "replace")
    body = text.rstrip("\r\n")
    name, _, rest = body.partition(", ")
    if not body.strip():
        return line
    if name == "FMT":
        cells = [c.strip() for c in rest.split(",")]
        if len(cells) < 4:
            return None
        labels[cells[2]] = cells[4:]
        return line
    known = labels.get(name)
    if name in DEFINING:
        return line
    if known is None:
        return None
    cells = [c.strip() for c in rest.split(",", max(len(known) - 1, 0))]
    if len(cells) != len(known):
        return None
    if name in CONTENT:
        scrubber.note(rules.CONTENT, name, 1)
        return b""
    clean = _cells(name, known, cells, scrubber)
    return line if clean == cells else (", ".join([name, *clean]) + text[len(body) :]).encode()


def _cells(name: str, labels: list[str], cells: list[str], scrubber: Scrubber) -> list[str]:
    """The cells of one line, scrubbed."""
    clean = list(cells)
    for place in rules.places([ScrubColumn(label, label) for label in labels]):
        used = [place.lat, place.lon, *place.altitudes]
        where = [labels.index(c.key) for c in used]
        try:
            values = tuple(float(cells[k]) for k in where)
        except ValueError:
            values = (np.nan,) * len(used)
        rows = np.array([values], dtype=[(c.key, "f8") for c in used])
        rules.scrub_place(rows, place, name, scrubber)
        for k, column in zip(where, used, strict=True):
            digits = 2 if column in place.altitudes else 7
            clean[k] = f"{float(np.nan_to_num(rows[column.key][0])):.{digits}f}"
    for k, label in enumerate(labels):
        if rules.is_identity(label) and clean[k] not in ("", "0"):
            scrubber.note(rules.IDENTITY, f"{name}.{label}", 1)
            clean[k] = "0"
    if name == "MSG":
        clean[-1] = rules.redact(cells[-1].encode()).decode("utf-8", "replace")
        scrubber.note(rules.TEXT, name, clean != cells)
    if name == "PARM" and {"Name", "Value"} <= set(labels):
        parameter = cells[labels.index("Name")]
        if rules.is_private_parameter(parameter):
            for label in {"Value", "Default"} & set(labels):
                clean[labels.index(label)] = "0"
            scrubber.note(rules.PARAMETER, f"PARM {parameter}", clean != cells)
    return clean
