"""What the columns of a table hold: numbers in one style, or text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from operator import or_

import numpy as np
import pyarrow as pa

from flysid.ingest.formats.common.arrow_arrays import strings
from flysid.ingest.formats.common.table_columns import nameless, unit_in
from flysid.ingest.formats.common.table_numbers import (
    MISSING,
    PLAIN,
    PLAIN_SIGNS,
    Signs,
    Style,
    are_plain,
    floats,
    may_group,
    numbers_in,
    signs_of,
    style_of,
)
from flysid.stretch import FloatArray

_DIGIT = re.compile("[0-9]")


@dataclass(frozen=True)
class Column:
    """A column: its name without the unit, its unit if known, whether it is text, how it spells numbers."""

    name: str
    unit: str = ""
    is_text: bool = False
    style: Style = PLAIN


def array_of(values: pa.Array) -> FloatArray:
    """(n,) numbers, NaN where they are missing."""
    return np.asarray(values.to_numpy(zero_copy_only=False))


def columns_of(named: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]]) -> list[Column]:
    """Columns with their kind, as most of their cells in the first rows tell it.

    Parameters
    ----------
    named : (name, unit) of each.
    rows : cells of the first rows.
    """
    told = [[row[i] for row in rows if row[i] not in MISSING] for i in range(len(named))]
    plain = [_are_numbers(cells) and not may_group(cells) for cells in told]
    words = [not is_plain and _holds_words(cells) for cells, is_plain in zip(told, plain, strict=True)]
    table = PLAIN_SIGNS
    if not all(map(or_, plain, words)):
        numbers = [cells for cells, is_text in zip(told, words, strict=True) if not is_text]
        table = signs_of([cell for cells in numbers for cell in cells])
    found = []
    for (name, unit), cells, is_plain, is_text in zip(named, told, plain, words, strict=True):
        if is_text or (is_plain and not table.commas):
            found.append(Column(name, unit, is_text))
        else:
            found.append(_column(name, unit, cells, table))
    return found


def _are_numbers(cells: Sequence[str]) -> bool:
    """Whether all cells are numbers in the plain style, or infinite."""
    return are_plain(cells) or not floats(strings(cells), PLAIN)[1].any()


def _holds_words(cells: Sequence[str]) -> bool:
    """Whether most cells cannot be numbers, in whatever style."""
    return 2 * sum(map(bool, map(_DIGIT.search, cells))) < len(cells)


def values_of(rows: Sequence[Sequence[str]], index: int, style: Style) -> FloatArray:
    """(n,) the numbers of a column in the first rows; NaN where a cell is none."""
    return array_of(floats(strings([row[index] for row in rows]), style)[0]).astype(np.float64)


def _column(name: str, unit: str, cells: Sequence[str], table: Signs) -> Column:
    """A column is text where fewer than half of its cells are numbers."""
    style = style_of(cells, table)
    count = len(numbers_in(cells, style)) if cells else 0
    if 2 * count < len(cells):
        return Column(name, unit, is_text=True)
    return Column(name, unit or unit_in(style.unit) or "", style=style)


def nameless_numbers(columns: Sequence[Column], rows: Sequence[Sequence[str]], index: int) -> FloatArray:
    """(n,) the values of a column without a name; empty where it has one, or where a cell is no number."""
    if index >= len(columns) or columns[index].name != nameless(index) or columns[index].is_text:
        return np.empty(0)
    cells = [row[index] for row in rows]
    return np.array(list(map(float, cells))) if are_plain(cells) else np.empty(0)
