"""Numbers in text: decimal points and commas, signs between thousands, units behind, words for missing ones.

1.5   1,5   1,234.5   1.234,5   1'234.5   1 234,5   12,34,567.8   +2e-3   1.5D+02   12.5 V   45 %   NaN   #N/A
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from flysid.ingest.formats.common.arrow_arrays import numeric, strings, whole_numbers
from flysid.ingest.formats.common.table_columns import unit_in

BoolArray = npt.NDArray[np.bool_]
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
INFINITE = frozenset({"inf", "-inf", "Inf", "-Inf", "INF", "-INF", "infinity", "-infinity"}) | frozenset(
    {"Infinity", "-Infinity", "1.#INF", "-1.#INF"}
)
MISSING = frozenset(
    {"", "nan", "NaN", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "#N/A", "#N/A N/A", "#NA", "<NA>"}
    | {"null", "NULL", "None", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND", "--.--"}
)
"""What programs write where there is no number: pandas, Excel, databases, QGroundControl, old C libraries."""
HALF = 0.5
MOSTLY = 0.9
"""Of the cells that shall tell how a column is to be read."""
MINUS = "\u2212"
"""What typesetting, Matplotlib and some spreadsheets write for a minus."""
_SIGN = f"[+{MINUS}-]?"
_NUMBER = re.compile(rf"^{_SIGN}(\d+\.?\d*|\.\d+)([eE][+-]?\d+|[dD][+-]\d+)?$")
_NUMBER_SIGNS = re.compile("[0-9.eE+-]*")  # what Python makes a number of these, Arrow reads, too
_FORTRAN = r"^([+-]?[\d.]*\d\.?)[dD]([+-]\d+)$"
_WITH_POINT = re.compile(rf"^{_SIGN}\d*\.\d+([eE][+-]?\d+)?$")
_WITH_COMMA = re.compile(rf"^{_SIGN}\d*,\d+([eE][+-]?\d+)?$")
_SPACES = " \u00a0\u2007\u2009\u202f'\u2019"  # between thousands: thin and no-break blanks, apostrophes
_LAKHS = r"[1-9]\d?(,\d\d)+,\d{3}"  # as India groups digits: 12,34,567
_THOUSANDS = {
    ",": rf"([1-9]\d{{0,2}}(,\d{{3}})+|{_LAKHS})",
    ".": r"[1-9]\d{0,2}([.]\d{3})+",
    _SPACES: rf"[1-9]\d{{0,2}}([{_SPACES}]\d{{3}})+",
}
_GROUPED = {sign: re.compile(rf"^{_SIGN}{shape}$") for sign, shape in _THOUSANDS.items()}
_BOTH = {  # thousands, then the decimal sign
    sign: re.compile(rf"^{_SIGN}{_THOUSANDS[sign]}[{other}]\d+$")
    for sign, other in ((",", "."), (".", ","), (_SPACES, ".,"))
}
_CERTAIN = {  # between thousands: before the decimal sign, or twice
    sign: re.compile(rf"^{_SIGN}({_THOUSANDS[sign]}([{sign}]\d{{3}}|[{other}]\d+){more})$")
    for sign, other, more in ((",", ".", f"|{_LAKHS}"), (".", ",", ""))
}
_MEASURED = re.compile(rf"^({_SIGN}[\d.,{_SPACES}]*\d(?:[eE][+-]?\d+)?)\s*([^\s\d.,+-][^\s\d]*)$")


@dataclass(frozen=True)
class Style:
    """How a column spells its numbers.

    Attributes
    ----------
    decimal : "." or ",".
    thousands : the signs that may stand between thousands; "" for none.
    unit : that stands behind every number, as it is written; "" for none.
    """

    decimal: str = "."
    thousands: str = ""
    unit: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether nothing stands in a number but digits and its decimal sign."""
        return not self.thousands and not self.unit


PLAIN = Style()


@dataclass(frozen=True)
class Signs:
    """What the numbers of a whole table leave no doubt of: that it has decimal points, that it has commas."""

    points: bool
    commas: bool


PLAIN_SIGNS = Signs(points=True, commas=False)


def signs_of(cells: Sequence[str]) -> Signs:
    """What decimal signs some cells have for certain: those that cannot stand between thousands."""
    bare = [match[1].rstrip() if (match := _MEASURED.match(c)) and unit_in(match[2]) else c for c in cells]
    with_comma = [cell for cell in bare if "," in cell]
    with_point = [cell for cell in bare if "." in cell]
    points = any(_WITH_POINT.match(c) and not _GROUPED["."].match(c) for c in with_point)
    commas = any(_WITH_COMMA.match(c) and not _GROUPED[","].match(c) for c in with_comma)
    points |= any("." in cell for cell in bare if _BOTH[_SPACES].match(cell))
    commas |= any("," in cell for cell in bare if _BOTH[_SPACES].match(cell))
    thousands = {
        sign: any(map(_CERTAIN[sign].match, cells)) for sign, cells in ((",", with_comma), (".", with_point))
    }
    return Signs(points or thousands[","], commas or thousands["."])


def style_of(cells: Sequence[str], table: Signs) -> Style:
    """How the numbers among a column's cells are spelled.

    Parameters
    ----------
    cells : without those that are missing.
    table : what the columns beside it tell of decimal signs, where its own cells leave two readings.

    Examples
    --------
    >>> style_of(["998", "999", "1,000"], Signs(points=False, commas=False)).thousands
    ','
    """
    unit = _unit_behind_all(cells)
    bare = [_without(cell, unit) for cell in cells] if unit else cells
    own = signs_of(bare)
    spaced = any(_GROUPED[_SPACES].match(c) or _BOTH[_SPACES].match(c) for c in bare)
    decimal = _decimal_in_doubt(bare, table)
    if own.points != own.commas:
        decimal = "." if own.points else ","
    other = "," if decimal == "." else "."
    grouped = any(_GROUPED[other].match(c) or _BOTH[other].match(c) for c in bare)
    return Style(decimal, (other if grouped else "") + (_SPACES if spaced else ""), unit)


def _decimal_in_doubt(cells: Sequence[str], table: Signs) -> str:
    """The decimal sign of numbers that have three digits behind every sign, or none.

    Where hundreds stand beside them without any digit behind, those three are thousands.
    """
    commas = any(_GROUPED[","].match(c) for c in cells)
    points = any(_GROUPED["."].match(c) for c in cells)
    if commas == points:
        return "," if table.commas and not table.points else "."
    mine, other = (table.commas, table.points) if commas else (table.points, table.commas)
    bare = (cell.lstrip(f"+{MINUS}-") for cell in cells)
    hundreds = any(len(digits) == 3 and digits.isdecimal() for digits in bare)
    is_group = hundreds or (other and not mine)
    return "," if commas != is_group else "."


def _unit_behind_all(cells: Sequence[str]) -> str:
    """The unit that stands behind most cells; "" where none that is known does."""
    found = Counter(match[2] for cell in cells if (match := _MEASURED.match(cell)))
    unit, count = found.most_common(1)[0] if found else ("", 0)
    bare = sum(bool(_NUMBER.match(cell) or _WITH_COMMA.match(cell)) for cell in cells) if found else 0
    is_usual = count >= MOSTLY * (bare + found.total()) and count >= HALF * len(cells)
    return unit if is_usual and unit_in(unit) else ""


def _without(cell: str, unit: str) -> str:
    return cell.removesuffix(unit).rstrip()


def may_group(cells: Sequence[str]) -> bool:
    """Whether the points in numbers may all stand between thousands: 1.234 beside 567."""
    short = (not cell.partition(".")[1] or _GROUPED["."].match(cell) for cell in cells)
    return all(short) and any("." in cell for cell in cells)


def are_plain(cells: Sequence[str]) -> bool:
    """Whether every cell is a finite number that Arrow reads as it is; hardly slower than one look at each.

    Examples
    --------
    >>> are_plain(["1", "-.5", "2e-3"]), are_plain(["1", ""]), are_plain(["1e400"])
    (True, False, False)
    """
    if not _NUMBER_SIGNS.fullmatch("".join(cells)):
        return False
    try:
        return all(map(isfinite, map(float, cells)))
    except ValueError:
        return False


def is_number(cell: str) -> bool:
    """Whether a cell is a number in any style."""
    if _NUMBER.match(cell) or _WITH_COMMA.match(cell) or cell in INFINITE:
        return True
    match = _MEASURED.match(cell)
    bare = match[1].rstrip() if match and unit_in(match[2]) else cell
    shapes = (_NUMBER, _WITH_COMMA, *_GROUPED.values(), *_BOTH.values())
    return any(shape.match(bare) for shape in shapes)


def numbers_in(cells: Sequence[str], style: Style = PLAIN) -> list[float]:
    """The values of those cells that are finite numbers."""
    values = floats(strings(cells), style)[0].drop_null()
    return [value for value in values.to_pylist() if np.isfinite(value)]


def floats(text: pa.Array, style: Style) -> tuple[pa.Array, BoolArray]:
    """(n,) numbers, null where missing; and where a cell is neither a number nor missing.

    Parameters
    ----------
    text : (n,) strings without blanks around them.
    """
    bare = _bare(text, style)  # no scalar is made of Python's numbers: the first one would import pandas
    is_infinite = pc.is_in(text, strings(sorted(INFINITE)))
    is_plain = pc.match_substring_regex(bare, NUMBER)
    values = pc.if_else(is_plain, bare, pa.nulls(1, pa.string())[0]).cast(pa.float64())
    is_finite = pc.and_kleene(is_plain, pc.is_finite(values))  # 1e400 fits no float
    values = pc.if_else(is_finite, values, pa.nulls(1, pa.float64())[0])
    if pc.any(is_infinite).as_py():
        ends = numeric(np.array([-np.inf, np.inf]))
        sign = pc.if_else(pc.starts_with(text, "-"), ends[0], ends[1])
        values = pc.if_else(is_infinite, sign, values)
    told = pc.or_(pc.or_(is_finite, is_infinite), pc.is_in(text, strings(sorted(MISSING))))
    wrong = pc.and_kleene(pc.is_valid(told), pc.invert(told)).cast(pa.uint8())
    return values, whole_numbers(wrong).astype(bool)


def _bare(text: pa.Array, style: Style) -> pa.Array:
    """Numbers of a style as the plain ones that Arrow reads."""
    text = pc.replace_substring(text, MINUS, "-")
    text = pc.replace_substring_regex(text, _FORTRAN, r"\1e\2")
    if style.unit:
        ending = re.escape(style.unit)
        text = pc.replace_substring_regex(text, rf"^(.*\d)\s*{ending}$", r"\1")
    if style.thousands:
        sign = re.escape(style.thousands)
        groups = rf"\d{{1,3}}([{sign}]\d{{3}})+|\d{{1,2}}([{sign}]\d\d)+[{sign}]\d{{3}}"
        grouped = pc.match_substring_regex(text, rf"^[+-]?({groups})([.,]\d+)?$")
        text = pc.if_else(grouped, pc.replace_substring_regex(text, rf"[{sign}]", ""), text)
    if style.decimal == ",":
        has_point = pc.match_substring(text, ".")
        text = pc.if_else(has_point, text, pc.replace_substring(text, ",", "."))
    return pc.utf8_ltrim(text, characters="+")
