"""Numbers, lists and tables as people read them: for a terminal, a Python prompt, a notebook and the page."""

from __future__ import annotations

import difflib
import html
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

MOST_LINES = 20
WIDTH = 100
"""Columns of what a terminal shows."""


def counted(count: int, noun: str) -> str:
    """A number and its noun: "1 boot", "2,000 boots"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def number(value: float | None, digits: int = 3) -> str:
    """`digits` significant digits without an exponent where that is short; "-" for None or not finite."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{places}f}"
    return f"{value:.{digits - 1}e}"


def percent(value: float, places: int = 0) -> str:
    """A signed percentage with a true minus; "> +1000 %" where the number says nothing more."""
    if value > 1000.0:
        return "> +1000 %"
    text = f"{value:+.{places}f}"
    if float(text) == 0.0:
        text = f"{0.0:.{places}f}"
    return text.replace("-", "−") + " %"


def percentage(value: float | None) -> str:
    """One decimal and a true minus, without the sign of per cent; "-" for None, "< −999" below that."""
    if value is None or not math.isfinite(value):
        return "-"
    return "< −999" if value < -999.0 else f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def list_words(parts: Sequence[str]) -> str:
    """ "a", "a and b", "a, b and c"; "" of none."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else "".join(parts)


def significant(value: float, digits: int = 3) -> str:
    """So many significant digits, without an exponent where that is short: "1050", "0.0034", "2.5e+07"."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.15g}" if 1e-4 <= abs(rounded) < 1e6 else f"{rounded:.{digits}g}"


def clock(seconds: float, *, padded: bool = False) -> str:
    """Minutes and seconds since a beginning, with hours where there are any: "8:05", "1:02:05".

    Whole seconds, rounded to the nearest. Padded, minutes have two digits for a column: "08:05".
    """
    minutes, rest = divmod(max(0, round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours}:{minutes:02d}:{rest:02d}"
    return f"{minutes:0{2 if padded else 1}d}:{rest:02d}"


def duration(seconds: float) -> str:
    """How long something takes, to the second below an hour: "40 s", "3 min 20 s", "2 h 5 min"."""
    whole = max(0, round(seconds))
    if whole < 100:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def rough_duration(seconds: float) -> str:
    """How long something took, for a sentence: "42 s", "9 min", "1.5 h"."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def first_of(names: Sequence[str], most: int) -> str:
    """The first names, and how many more there are: "a, b, c and 4 more"."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest:,} more" if rest > 0 else "")


def one_of(known: Sequence[str], name: str) -> str:
    """What there is, and what `name`, which is not there, may mean: "one of a, b; did you mean 'a'?"."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"; did you mean {near[0]!r}?" if near else ""
    return f"one of {', '.join(known)}{meant}"


def fold(line: str) -> str:
    """A line within the width; what is longer goes on below, set in. No word is broken."""
    if len(line) <= WIDTH:
        return line
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


@dataclass(frozen=True)
class Table:
    """A title, headings and rows of cells."""

    title: str
    headings: tuple[str, ...]
    rows: Sequence[Sequence[str]]


class Shown:
    """An object that shows itself as a table; `_table` names it."""

    def _table(self) -> Table:
        raise NotImplementedError

    def __repr__(self) -> str:
        return as_text(self._table())

    def _repr_html_(self) -> str:
        return as_html(self._table())


def align(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines, every column as wide as its widest cell."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def as_text(table: Table) -> str:
    """At most twenty lines; rows that do not fit are counted."""
    rows, left_out = _fitting(table)
    lines = align([table.headings, *([_cut(cell) for cell in row] for row in rows)])
    return "\n".join([_line(table.title), *(lines if rows else []), *left_out])


def as_html(table: Table) -> str:
    """The same as an HTML table."""
    rows, left_out = _fitting(table)
    head = "".join(f"<th>{html.escape(h)}</th>" for h in table.headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_cut(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    foot = "".join(f"<p>{html.escape(line)}</p>" for line in left_out)
    return (
        f"<div><p>{html.escape(_line(table.title))}</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{foot}</div>"
    )


def first_lines(text: str) -> str:
    """The first twenty lines of a text; what is left out is counted."""
    lines = text.splitlines()
    if len(lines) <= MOST_LINES:
        return text
    return "\n".join(
        [*lines[: MOST_LINES - 1], f"... and {len(lines) - MOST_LINES + 1} lines more: print() it"]
    )


def _fitting(table: Table) -> tuple[Sequence[Sequence[str]], list[str]]:
    room = MOST_LINES - 2
    if len(table.rows) <= room:
        return table.rows, []
    return table.rows[: room - 1], [f"... and {len(table.rows) - room + 1:,} more"]


def _line(text: str) -> str:
    return " ".join(text.split())


def _cut(cell: str, *, widest: int = 48) -> str:
    cell = _line(cell)
    return cell if len(cell) <= widest else f"{cell[: widest - 1]}…"
