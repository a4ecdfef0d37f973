"""A last line without its end: what of it is sure to be whole.

Many programs put line ends between rows only, so that the last row has none; and a log that was cut ends so,
too. All cells but the last are whole, as a separator follows them. The last one is where its quote is closed,
or where all lines above have as many characters behind the point (or in all, where there is no point) as it
has: a cell that is cut has fewer.
"""

from __future__ import annotations

from collections.abc import Sequence

from flysid.ingest.formats.csv.layouts import BLANKS, cells_of


def last_line(line: bytes, others: Sequence[bytes], separator: bytes, cells: int) -> tuple[bytes, bool]:
    """A last line with an end, and whether its last cell is whole: else that is left empty.

    Parameters
    ----------
    others : the lines above.
    cells : that the table has. A line with fewer gives b"", and so does one whose last cell would be left
        empty between blanks.
    """
    text = line.decode("utf-8", "replace")
    if line.endswith(b"\r"):
        return line + b"\n", True
    if len(cells_of(text, separator)) != cells or text.count('"') % 2:
        return b"", False
    if separator == BLANKS:
        line, others = line.rstrip().replace(b"\t", b" "), [each.replace(b"\t", b" ") for each in others]
    head, mark, last = line.rpartition(separator)
    if last.endswith(b'"'):
        return line + b"\n", True
    shapes = {_shape(other.strip().rpartition(separator)[2]) for other in others if other.strip()}
    if last.strip() and shapes == {_shape(last.strip())}:
        return line + b"\n", True
    return (head + mark + b"\n" if separator != BLANKS else b""), False


def _shape(cell: bytes) -> int:
    """Characters behind the point, or in all; below 0 in all."""
    _, point, fraction = cell.partition(b".")
    return len(fraction) if point else -len(cell)
