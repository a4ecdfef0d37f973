"""The layout of a table in text: its separator, its columns with units, and which of them is the time.

    # comments, blank lines
    time_s,pitch_cmd [deg],v_x [m/s]
    0.00,1.5,0.012

The separator is the one of comma, semicolon, tab, bar and blanks that leaves the most numbers; blanks that
stand between words of a cell are none where another sign splits as many lines. The first of the lines that it
splits alike is the header unless it holds numbers where the lines below do; then the comment right above may
be the header, as NumPy and ROS write it, or a line that damage took out of the table. Of several lines of
names the last one names, and those above tell equal names apart. Units stand in brackets, or in a line of
their own below the names. Other lines above a header are facts about the log.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import takewhile

from flysid.ingest.formats.common.stamps import is_stamp
from flysid.ingest.formats.common.table_columns import (
    named_and_measured,
    names_in_groups,
    once_each,
    unit_in,
)
from flysid.ingest.formats.common.table_kinds import Column, columns_of
from flysid.ingest.formats.common.table_numbers import MISSING, MOSTLY, are_plain, is_number
from flysid.ingest.formats.common.time_columns import (
    TimeColumn,
    find_time,
    unused_times,
)

BLANKS = b" "  # any number of them, and of tabs
SEPARATORS = (b",", b";", b"\t", b"|", BLANKS)
COMMENT = ("#", "%")
_CELL = re.compile(r'(?:"[^"]*"|\S)+')
# GPS sentences and JSON, whose commas separate no columns
_OTHER_TEXT = re.compile(r"^\s*([$!][A-Z]{2}[A-Z0-9]{1,},|[\[{]\s*([\[{\"\d-]|$))")
LONGEST_UNIT = 12
ERASED = b"\xff"
_LETTER = re.compile(r"[^\W\d_]")
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")
_WIDE_BLANK = re.compile(r"\s{2,}|\t")  # between names of which some are two words


@dataclass(frozen=True)
class Layout:
    """How to read the lines of a table.

    Attributes
    ----------
    separator : one byte.
    start : where the first row begins in the file.
    header : where the header begins; -1 where the table has none.
    columns : one per cell of a line.
    time : None where no column tells the time: rows are numbered.
    unused_times : columns that are called a time, where none tells it, and why.
    """

    separator: bytes
    start: int
    header: int
    columns: tuple[Column, ...]
    time: TimeColumn | None
    unused_times: Mapping[str, str] = field(default_factory=dict)

    @property
    def decimal(self) -> str:
        """The decimal sign of the table: a comma where one of its columns has commas."""
        return "," if any(c.style.decimal == "," for c in self.columns if not c.is_text) else "."

    def is_plain(self, index: int) -> bool:
        """Whether the cells of a column are numbers that are read at once, without a look at their text."""
        column = self.columns[index]
        return not column.is_text and column.style.is_plain and column.style.decimal == self.decimal


@dataclass(frozen=True)
class _Table:
    """The lines that a separator splits alike: their places and cells.

    Of the rows that are judged: the share of cells that are values, and the columns where most are.
    """

    separator: bytes
    places: list[int]
    rows: list[list[str]]
    told: float
    columns: list[int]


@dataclass(frozen=True)
class _Line:
    """A line of the head: its place, its text, and whether damage was left out of that."""

    at: int
    text: str
    is_damaged: bool = False


@dataclass(frozen=True)
class _Head:
    """The lines of the head: those of a table, maybe, and their bytes; comments without their marks."""

    lines: list[_Line]
    comments: list[_Line]
    size: int


@dataclass(frozen=True)
class _Header:
    """(name, unit) of every column, the rows below, where the first begins, and where the header does."""

    named: list[tuple[str, str]]
    rows: list[list[str]]
    start: int
    at: int = -1


@lru_cache(maxsize=4)  # detection asks twice before the reader does
def layout_of(head: bytes) -> Layout | None:
    """The layout of a table whose first bytes these are; None where they are no table of numbers.

    At least half of these bytes must stand in the table's lines: two lines alike in a binary file, or in
    another kind of text, are none.
    """
    found = _lines(head)
    sound = [line for line in found.lines if not line.is_damaged]
    if not sound or _OTHER_TEXT.match(sound[0].text):
        return None
    tables = [t for s in SEPARATORS if (t := _table(sound, found.size, s)) is not None]
    if not tables:
        return None
    signed = [t for t in tables if t.separator != BLANKS and 2 * t.told >= 1]
    most = max((len(t.rows) for t in signed), default=0)
    chosen = signed if most and all(most >= len(t.rows) for t in tables) else tables
    table = max(chosen, key=lambda t: (t.told, len(t.rows), len(t.rows[0])))
    header = _header(table, found)
    columns = columns_of(header.named, header.rows)
    time = find_time(columns, header.rows)
    times = time.parts if time is not None else ()
    if all(column.is_text for i, column in enumerate(columns) if i not in times):
        return None
    unused = unused_times(columns, header.rows) if time is None else {}
    return Layout(table.separator, header.start, header.at, tuple(columns), time, unused)


def _table(lines: Sequence[_Line], size: int, separator: bytes) -> _Table | None:
    """The lines that a separator splits alike, if they are a table; words between blanks are none."""
    split = [(line, cells_of(line.text, separator)) for line in lines if _is_split(line.text, separator)]
    counts = Counter(len(row) for _, row in split)
    counts.pop(1, None)
    cells, alike = max(counts.items(), key=lambda c: c[1], default=(0, 0))
    whole = [each for each in split if len(each[1]) == cells]
    if alike < 2 or 2 * sum(len(line.text) + 1 for line, _ in whole) < size:
        return None
    rows = [row for _, row in whole]
    below = _judged(rows)
    values = [_count_values(column) for column in zip(*below, strict=True)]
    told = sum(values) / (cells * len(below))
    if separator == BLANKS and told < MOSTLY:
        return None
    columns = [i for i, count in enumerate(values) if 2 * count >= len(below)]
    return _Table(separator, [line.at for line, _ in whole], rows, told, columns)


def _is_split(text: str, separator: bytes) -> bool:
    """Whether a line may have more than one cell."""
    return len(text.split(None, 1)) > 1 if separator == BLANKS else separator.decode() in text


def _count_values(cells: Sequence[str]) -> int:
    """How many cells of a column are values; a column of plain numbers is seen at once."""
    return len(cells) if are_plain(cells) else sum(map(_is_value, cells))


def _lines(head: bytes) -> _Head:
    """The whole lines of the head that are not blank, without what makes them unprintable."""
    found = []
    comments = []
    at = 0
    size = 0
    for raw in head.split(b"\n")[:-1]:
        line = raw.removeprefix(b"\xef\xbb\xbf") if at == 0 else raw
        text = text_of(line)
        if text.startswith(COMMENT):
            comments.append(_Line(at, text.lstrip("#% \t")))
        elif text.strip() and not is_instruction(text):
            size += len(raw) + 1
            is_sound = is_printable(line)
            found.append(_Line(at, text if is_sound else _cleaned(line), not is_sound))
        at += len(raw) + 1
    return _Head(found, comments, size)


def _cleaned(line: bytes) -> str:
    """The text of a line without erased flash in front, and without control characters."""
    return _CONTROL.sub("", text_of(line.lstrip(ERASED)))


def text_of(line: bytes) -> str:
    """A line as text: UTF-8, or Windows' letters of the west of Europe, as spreadsheets there write them."""
    try:
        return line.decode().strip("\r")
    except UnicodeDecodeError:
        return line.decode("cp1252", "replace").strip("\r")


def is_instruction(text: str) -> bool:
    """Whether a line tells a spreadsheet the separator: `sep=;`."""
    return len(text) == 5 and text.lower().startswith("sep=")


def is_printable(line: bytes) -> bool:
    """Whether a line can be a header or a row: no control characters, and no erased flash in front."""
    text = text_of(line)
    return not line.startswith(ERASED) and (text.isprintable() or not _CONTROL.search(text))


def cells_of(line: str, separator: bytes) -> list[str]:
    """The cells of a line; a separator inside quotes separates nothing."""
    if separator == BLANKS:
        return [cell.strip('"') for cell in _CELL.findall(line)]
    if '"' not in line:
        return [part.strip() for part in line.split(separator.decode())]
    sign = separator.decode()
    parts = [""]
    quoted = False
    for piece in re.split(f'(["{re.escape(sign)}])', line):
        if piece == '"':
            quoted = not quoted
        elif piece == sign and not quoted:
            parts.append("")
        else:
            parts[-1] += piece
    return [part.strip() for part in parts]


def _header(table: _Table, head: _Head) -> _Header:
    """The header of a table, and its rows."""
    rows = table.rows
    first = rows[0]
    told = table.columns
    if _names(first, told):
        lines, units, below = _heading(rows, told)
        groups = [rows[i] for i in lines[:-1]]
        start = table.places[below] if len(rows) > below else table.places[0]
        header = names_in_groups(groups, rows[lines[-1]])
        return _Header(_name(header, units), rows[below:], start, table.places[lines[-1]])
    above = [line for line in head.lines if line.at < table.places[0]]
    for line in _lines_above(above):
        names = _fitted(cells_of(line.text, table.separator), rows)
        if not names and table.separator == BLANKS:
            names = _fitted(_WIDE_BLANK.split(line.text.strip()), rows)
        words = [bool(_LETTER.search(names[i])) for i in told if names and names[i]]
        if names and _names(names, told) and 2 * sum(words) >= len(words):
            return _Header(_name(names, []), rows, table.places[0], line.at)
    comments = [cells_of(c.text, table.separator) for c in head.comments if c.at < table.places[0]]
    units = _units(comments[-1]) if comments else []
    named = comments[-2:-1] if units else comments[-1:]
    if named and len(named[0]) == len(first) and not all(map(_is_value, named[0])):
        return _Header(_name(named[0], units), rows, table.places[0], 0)
    return _Header(_name([""] * len(first), units), rows, table.places[0])


def _heading(rows: Sequence[Sequence[str]], told: Sequence[int]) -> tuple[list[int], list[str], int]:
    """The lines of names, the units, and how many lines stand above the rows.

    Motion capture, pandas and laboratories write names in several lines: bodies above their coordinates.
    Those are the lines above the first row of numbers that hold no number themselves.
    """
    judged = told or range(len(rows[0]))
    above = list(takewhile(lambda i: not all(_is_value(rows[i][k]) for k in judged), range(len(rows))))
    lines = above if len(above) < len(rows) else above[:1]
    names = [i for i in lines if _is_named_throughout(rows[i], judged)] or [0]
    units = _units(rows[names[-1]]) if len(names) > 1 else []
    if units and all(rows[names[-2]][i] for i, cell in enumerate(rows[names[-1]]) if cell):
        return names[:-1], units, names[-1] + 1
    last = names[-1]
    units = _units(rows[last + 1]) if len(rows) > last + 2 else []
    return names, units, last + (2 if units else 1)


def _is_named_throughout(cells: Sequence[str], judged: Sequence[int]) -> bool:
    """Whether no cell above numbers is a number, and one is a word."""
    filled = [cells[i] for i in judged if cells[i] not in MISSING]
    return not any(map(_is_value, filled)) and any(map(_LETTER.search, filled))


def _lines_above(above: Sequence[_Line]) -> list[_Line]:
    """What may be the header: the lines that a cell in quotes spans ("Roll\\n(deg)"), then the last alone."""
    for first in reversed(range(len(above))):
        parts = above[first:]
        text = " ".join(part.text for part in parts)
        if text.count('"') % 2 == 0:
            whole = _Line(parts[0].at, text, any(part.is_damaged for part in parts))
            return [whole, *above[-1:]]
    return list(above[-1:])


def _judged(rows: list[list[str]], most: int = 100) -> list[list[str]]:
    """The rows that are looked at for what kinds of cells a table has: not those of names and units."""
    below = rows[2:] or rows[1:]
    return below[:: max(1, len(below) // most)]


def _names(cells: Sequence[str], told: Sequence[int]) -> bool:
    """Whether the cells of a line are names: above columns of numbers stands a word; a dash is none."""
    judged = told or range(len(cells))
    return any(not _is_value(cells[i]) and _LETTER.search(cells[i]) for i in judged)


def _fitted(names: list[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The cells of a header that has another number of them than the rows; [] where a fit is a guess.

    Separators may end all rows, or the header; R leaves out the name of the column that numbers its rows.
    """
    count = len(rows[0])
    if len(names) == count:
        return names
    if len(names) == count + 1 and not names[-1]:
        return names[:-1]
    if len(names) != count - 1:
        return []
    if not any(row[-1] for row in rows):
        return [*names, ""]
    is_numbered = all(row[0] == str(number) for number, row in enumerate(rows, 1))
    return ["", *names] if is_numbered else []


def _name(header: Sequence[str], units: Sequence[str]) -> list[tuple[str, str]]:
    """(name, unit) of every column; units of a line of their own come first."""
    named = named_and_measured([cell.strip("'") for cell in header])
    names = once_each([name for name, _ in named])
    if len(units) != len(names):
        units = [""] * len(names)
    return [(name, unit or own) for name, unit, (_, own) in zip(names, units, named, strict=True)]


def _units(cells: Sequence[str]) -> list[str]:
    """The units that a line of cells holds, those that are not known as they are; [] where it has none.

    "1" is a unit, too, but a row of nothing else is one of values; so is one with a number above numbers.
    """
    units = [unit_in(cell) for cell in cells]
    if not any(unit not in (None, "", "1") for unit in units):
        return []
    if any(unit is None and _is_value(cells[i]) and cells[i] not in MISSING for i, unit in enumerate(units)):
        return []
    if any(units[i] is None and len(cells[i]) > LONGEST_UNIT for i in range(len(cells))):
        return []
    return [cell.strip("[]() ") if unit is None else unit for cell, unit in zip(cells, units, strict=True)]


def _is_value(cell: str) -> bool:
    """Whether a cell holds a number, a date, a time, or nothing."""
    return cell in MISSING or is_number(cell) or is_stamp(cell)
