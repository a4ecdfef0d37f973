"""What stands above the rows of a table: header and units, comments, and facts about the log."""

from __future__ import annotations

from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.csv.layouts import (
    COMMENT,
    ERASED,
    Layout,
    cells_of,
    is_instruction,
    is_printable,
    text_of,
)

FACTS = 500  # of a log, at most
FACT_LETTERS = 200
FACT = "header."
DAMAGED = "control characters in the header"


def read_preamble(layout: Layout, before: bytes, tally: Tally) -> dict[str, str]:
    """Facts that lines above the header state, as Blackbox Explorer writes them: `"firmwareRevision","4.4"`.

    Comments, header and units are understood, too; lines above a table without a header are counted, as they
    may be rows, and so are control characters in the header.
    """
    facts: dict[str, str] = {}
    at = 0
    is_open = False  # a cell of the header goes on in the next line
    for raw in before.splitlines(keepends=True):
        line = raw.removeprefix(b"\xef\xbb\xbf").rstrip(b"\r\n")
        text = text_of(line)
        cells = cells_of(text, layout.separator)
        is_row = len(cells) == len(layout.columns) and text.count('"') % 2 == 0
        is_read = (is_row and at >= layout.header) or text.startswith(COMMENT) or is_instruction(text)
        is_header = is_open or at == layout.header
        is_open = is_header and is_open != (text.count('"') % 2 == 1)
        if not line.strip():
            pass
        elif is_header and not is_printable(line):
            _count_damage(raw, at, tally)
        elif at < layout.header and is_printable(line) and not is_read:
            _note(facts, cells)
        elif not is_header and not (is_read and is_printable(line)):
            tally.skip(at, at + len(raw), "a line above the table")
        at += len(raw)
    return facts


def _note(facts: dict[str, str], cells: list[str]) -> None:
    """The first cell of a line names a fact, the others say it; a line of one cell is a title."""
    name, told = (cells[0], cells[1:]) if len(cells) > 1 else ("title", cells)
    key = FACT + (name.strip(': "') or "title")[:FACT_LETTERS]
    value = ", ".join(cell for cell in told if cell)[:FACT_LETTERS]
    if value and (len(facts) < FACTS or key in facts):
        facts[key] = value if key not in facts else f"{facts[key]}; {value}"[:FACT_LETTERS]


def _count_damage(raw: bytes, at: int, tally: Tally) -> None:
    """Count the bytes of a header that are no text."""
    ink = len(raw) - len(raw.lstrip(ERASED))
    tally.skip(at, at + ink, DAMAGED)
    for place, byte in enumerate(raw[ink:].rstrip(b"\r\n"), at + ink):
        if (byte < 32 and byte != 9) or byte == 127:
            tally.skip(place, place + 1, DAMAGED)
