"""The layout of a table in text: its separator, its columns with units, and which of them is the time.

    # comments, blank lines
    time_s,pitch_cmd [deg],v_x [m/s]
    0.00,1.5,0.012

The separator is the one of comma, semicolon and tab that splits most lines alike. The first such line is the
header unless it holds numbers only; units stand in brackets, or in a line of their own below the header.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.common.units import factor, is_known

SEPARATORS = (b",", b";", b"\t")
ZONE = r"(Z|[+-]\d\d:?\d\d)"
STAMP = rf"^\d{{4}}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d{{1,9}})?)?{ZONE}?$"
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
MISSING = frozenset(
    {"", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"}
)
MOSTLY = 0.9  # of the cells of a column of numbers are numbers
_NUMBER = re.compile(NUMBER)
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+$")
_STAMP = re.compile(STAMP)
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]([^\])]*)[\])]$")
_TIME_UNITS = {
    "s": "s",
    "sec": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "us": "us",
    "usec": "us",
    "ns": "ns",
}
_TIME_NAME = re.compile(
    r"^_*(t|time|timestamp|seconds|elapsed([ _]?time)?|date([ _]?time)?|utc|time[ _]?boot"
    r"|tempo|temps|tiempo|zeit)"
    r"([ _](s|sec|seconds|ms|msec|us|usec|ns))?$"
)


@dataclass(frozen=True)
class Column:
    """A column: its name without the unit, its unit where one is stated and known, and whether it is text."""

    name: str
    unit: str = ""
    is_text: bool = False


@dataclass(frozen=True)
class TimeColumn:
    """Which column tells the time: in nanoseconds per unit, or (0) as date and time of day.

    `source` says so in words, with how the unit is known.
    """

    index: int
    unit_ns: int
    source: str


@dataclass(frozen=True)
class Layout:
    """How to read the lines of a table.

    Attributes
    ----------
    separator : one byte.
    decimal_comma : 1,5 means 1.5.
    start : where the first row begins in the file.
    columns : one per cell of a line.
    time : None where no column tells the time: rows are numbered.
    """

    separator: bytes
    decimal_comma: bool
    start: int
    columns: tuple[Column, ...]
    time: TimeColumn | None


def layout_of(head: bytes) -> Layout | None:
    """The layout of a table whose first bytes these are; None where they are no table of numbers."""
    lines = _lines(head)
    ranked = [(*_commonest(lines, s), s) for s in SEPARATORS]
    alike, cells, separator = max(ranked, key=lambda r: (r[0], r[1]), default=(0, 0, b","))
    if alike < 2:
        return None
    table = [(at, _cells(line, separator)) for at, line in lines]
    table = [(at, row) for at, row in table if len(row) == cells]
    names, rows, start = _header(table)
    decimal_comma = separator != b"," and _has_decimal_commas(rows)
    kinds = [_is_text([row[i] for row in rows], decimal_comma) for i in range(cells)]
    columns = tuple(Column(n, u, t) for (n, u), t in zip(names, kinds, strict=True))
    time = _time_column(columns, rows, decimal_comma)
    if sum(not c.is_text for i, c in enumerate(columns) if time is None or i != time.index) == 0:
        return None
    return Layout(separator, decimal_comma, start, columns, time)


def _lines(head: bytes) -> list[tuple[int, str]]:
    """(place, text) of the whole lines of the head that are neither blank nor comments."""
    found, at = [], 0
    for raw in head.split(b"\n")[:-1]:
        line = raw.removeprefix(b"\xef\xbb\xbf") if at == 0 else raw
        text = line.decode("utf-8", "replace").strip("\r")
        if text.strip() and text[0] not in "#%" and text.replace("\t", "").isprintable():
            found.append((at, text))
        at += len(raw) + 1
    return found


def _commonest(lines: Sequence[tuple[int, str]], separator: bytes) -> tuple[int, int]:
    """How many lines have the commonest number of cells above one, and that number."""
    counts = Counter(len(_cells(line, separator)) for _, line in lines)
    counts.pop(1, None)
    cells, alike = max(counts.items(), key=lambda c: c[1], default=(0, 0))
    return alike, cells


def _cells(line: str, separator: bytes) -> list[str]:
    """The cells of a line; a separator inside quotes separates nothing."""
    sign, parts, quoted = separator.decode(), [""], False
    for piece in re.split(f'(["{re.escape(sign)}])', line):
        if piece == '"':
            quoted = not quoted
        elif piece == sign and not quoted:
            parts.append("")
        else:
            parts[-1] += piece
    return [part.strip() for part in parts]


def _header(
    table: Sequence[tuple[int, list[str]]],
) -> tuple[list[tuple[str, str]], list[list[str]], int]:
    """(name, unit) of every column, the rows below, and where the first row or the header begins."""
    first, rows = table[0][1], [row for _, row in table]
    if all(_NUMBER.match(c) or c in MISSING or _DECIMAL_COMMA.match(c) or _STAMP.match(c) for c in first):
        return [(f"c{i + 1}", "") for i in range(len(first))], rows, table[0][0]
    named = [_name_and_unit(cell, i) for i, cell in enumerate(first)]
    if len(rows) > 2 and any(rows[1]) and all(is_known(c.strip("[]()")) for c in rows[1]):
        named = [(n, u or c.strip("[]()")) for (n, u), c in zip(named, rows[1], strict=True)]
        return _once(named), rows[2:], table[2][0]
    return _once(named), rows[1:], table[1][0] if len(table) > 1 else table[0][0]


def _name_and_unit(cell: str, index: int) -> tuple[str, str]:
    match = _BRACKETS.match(cell)
    if match and match[1] and is_known(match[2].strip()):
        return match[1], match[2].strip()
    return cell or f"c{index + 1}", ""


def _once(named: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Names that occur again get a number."""
    seen: Counter[str] = Counter()
    found = []
    for name, unit in named:
        seen[name] += 1
        found.append((name if seen[name] == 1 else f"{name}_{seen[name]}", unit))
    return found


def _has_decimal_commas(rows: Sequence[Sequence[str]]) -> bool:
    cells = [cell for row in rows for cell in row]
    return any(map(_DECIMAL_COMMA.match, cells)) and not any("." in c for c in cells if _NUMBER.match(c))


def _is_text(cells: Sequence[str], decimal_comma: bool) -> bool:
    """Whether a column holds words: fewer than nine in ten of its cells are numbers."""
    told = [c for c in cells if c not in MISSING]
    numbers = sum(bool(_NUMBER.match(c.replace(",", ".") if decimal_comma else c)) for c in told)
    return numbers < MOSTLY * len(told)


def _time_column(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], decimal_comma: bool
) -> TimeColumn | None:
    """The first column that is called a time and rises."""
    for index, column in enumerate(columns):
        match = _TIME_NAME.match(column.name.lower())
        if match is None:
            continue
        cells = [row[index].replace(",", ".") if decimal_comma else row[index] for row in rows]
        if column.is_text:
            if sum(bool(_STAMP.match(c)) for c in cells) >= MOSTLY * len(cells):
                return TimeColumn(index, 0, f"{column.name}: date and time of day")
            continue
        values = [float(c) for c in cells if _NUMBER.match(c)]
        if len(values) < MOSTLY * len(cells) or np.mean(np.diff(values, append=np.inf) >= 0) < MOSTLY:
            continue
        stated = column.unit or _TIME_UNITS.get(match[5] or "", "")
        unit = stated or _likely_unit(np.array(values))
        why = "stated" if stated else "by its size and steps"
        return TimeColumn(index, round(factor(unit, "ns")), f"{column.name} in {unit}, {why}")
    return None


def _likely_unit(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    """The unit of a time: from its size where it counts from 1970, else from its steps; fractions: s."""
    if not len(values) or (values % 1).any():
        return "s"
    for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)):
        if np.median(values) > least:
            return unit
    steps = np.diff(values)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    return "s" if step <= 1 or np.median(values) > 1e9 else "ms" if step < 500 else "us"
