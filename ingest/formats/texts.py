"""Why text is no log: JSON of other programs, tables in other signs, names without rows.

What a text begins with tells what wrote it, and so how it becomes a table that is read.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flysid.ingest.formats.base import Format
from flysid.ingest.formats.common.table_numbers import is_number
from flysid.ingest.formats.common.transfer import is_text
from flysid.ingest.formats.csv.layouts import SEPARATORS, cells_of

_SHOWN = 60
_OTHER_SIGNS = "~^&:/!"
_FEW = 2  # lines: names and maybe units
_KEYED = re.compile(r"\W*(?:[A-Za-z_][\w.]*\s?[=:]\s?[+-]?[\d.]+(?:e[+-]?\d+)?[\s,;]*){2,}")
_TO_TABLE = ".to_csv('log.csv', index=False)"


@dataclass(frozen=True)
class Cause:
    """What is wrong with a file, what to do, and at which byte it shows."""

    said: str
    hint: str
    byte: int = 0


def cause_of_text(head: bytes, meant: Sequence[Format]) -> Cause | None:
    """Why a text is no log; None where it is no text.

    Parameters
    ----------
    head : its first bytes.
    meant : formats whose names end as its own does.
    """
    if not is_text(head):
        return None
    lines = head.decode("utf-8", "replace").lstrip("\ufeff").splitlines()
    lines = [line.strip() for line in lines if line.strip()]
    whole = lines if head.endswith(b"\n") else lines[:-1]
    line = lines[0] if lines else ""
    shown = repr(line if len(line) <= _SHOWN else line[:_SHOWN] + "...")
    if line[:1] in ("{", "["):
        return _of_json(head, shown)
    if b"\n" not in head and head.strip().count(b"\r"):
        return Cause(
            f"text whose lines end with CR alone, as old programs of the Mac write them: {shown}",
            "turn them: tr '\\r' '\\n' < IN > OUT; or save it again with line ends of Unix or Windows",
            head.index(b"\r"),
        )
    if not head.strip().count(b"\n"):
        return Cause(f"one line of text: {shown}", "give the log itself; a table has rows below its names")
    is_table = any(fmt.name == "csv" for fmt in meant)
    checks: tuple[Callable[[], Cause | None], ...] = (
        lambda: _of_names_in_lines(whole),
        lambda: _of_other_sign(whole),
        lambda: _of_two_tables(whole) if is_table else None,
        lambda: _of_few_lines(lines, shown) if is_table else None,
    )
    found = next(filter(None, (check() for check in checks)), None)
    return found or _of_other_text(is_table, meant, shown)


def _of_other_text(is_table: bool, meant: Sequence[Format], shown: str) -> Cause:
    if is_table:
        return Cause(
            f"text that is no table of numbers: its first line is {shown}",
            "a table has names in one line and numbers in the rows below, all with as many cells",
        )
    what = f"text, where {meant[0].title} is expected" if meant else "text"
    return Cause(
        f"{what}: its first line is {shown}",
        "give the log itself; a table of numbers is read where its name ends in .csv",
    )


def _of_json(head: bytes, shown: str) -> Cause:
    """JSON by what stands in it: a track, events beside a log, rows, columns, or something else."""
    if b'"FeatureCollection"' in head or b'"LineString"' in head:
        return Cause(f"a track in GeoJSON: {shown}", "the autopilot's own log holds more: give that")
    if b'"details_headers"' in head:
        return Cause(
            f"a flight of Parrot's app in JSON: {shown}",
            "with pandas: d = json.load(open(PATH)); "
            f"DataFrame(d['details_data'], columns=d['details_headers']){_TO_TABLE}",
        )
    if re.match(rb'\s*\{"name":\s*"[\w ]+",\s*"time":', head):
        return Cause(
            f"events that blackbox_decode wrote beside its table: {shown}",
            "give the .bbl file, which holds them too, or the .csv file beside it",
        )
    if re.match(rb"\s*\{[^\n]*\}\s*\n\s*\{", head):
        return Cause(
            f"rows in JSON, one object a line, that are no log of mavlogdump: {shown}",
            f"make them a table, with pandas: read_json(PATH, lines=True){_TO_TABLE}",
        )
    if re.match(rb"\s*\[\s*\{", head):
        return Cause(
            f"rows in JSON, in one list: {shown}",
            f"make them a table, with pandas: read_json(PATH){_TO_TABLE}",
        )
    if re.match(rb'\s*\{\s*"[^"]+":\s*\[', head):
        return Cause(
            f"columns in JSON: {shown}", f"make them a table, with pandas: read_json(PATH){_TO_TABLE}"
        )
    if re.match(rb'\s*\{\s*"[^"]+":\s*\{\s*"[^"]+":\s*\[', head):
        return Cause(
            f"columns of several messages in JSON, as viewers export them: {shown}",
            "give the log that it was made of: .bin, .tlog or .ulg",
        )
    return Cause(f"a JSON document that is no log of mavlogdump: {shown}", "give the log itself")


def _of_names_in_lines(lines: Sequence[str]) -> Cause | None:
    """Lines that name each of their numbers."""
    if len(lines) <= _FEW or not all(map(_KEYED.match, lines[1:])):
        return None
    return Cause(
        f"lines that name every number: {lines[0][:_SHOWN]!r}",
        "leave the numbers: sed -E 's/[A-Za-z_][A-Za-z_.0-9]* ?[=:] ?//g' IN > log.csv, "
        "and write the names above them",
    )


def _of_other_sign(lines: Sequence[str]) -> Cause | None:
    """A table whose cells another sign separates."""
    for sign in _OTHER_SIGNS:
        counts = {line.count(sign) for line in lines}
        rows = [cell.rstrip("\\").strip() for line in lines[1:] for cell in line.split(sign)]
        if (
            len(lines) > _FEW
            and len(counts) == 1
            and 0 not in counts
            and 2 * sum(map(is_number, rows)) > len(rows)
        ):
            return Cause(
                f"a table whose cells {sign!r} separates: {lines[0][:_SHOWN]!r}",
                f"read are comma, semicolon, tab, bar and blanks: tr '{sign}' ',' < IN > log.csv",
            )
    return None


def _of_two_tables(lines: Sequence[str]) -> Cause | None:
    """Tables of different widths behind one another."""
    for separator in SEPARATORS:
        widths = [len(cells_of(line, separator)) for line in lines]
        wide = [
            (width, count) for width, count in Counter(widths).most_common(2) if width > 1 and count > _FEW
        ]
        if len(wide) == 2:
            second = max(widths.index(width) for width, _ in wide)
            (one, many), (other, some) = wide
            return Cause(
                f"two tables in one file: {many} lines of {one} cells and {some} of {other}; from line "
                f"{second + 1} on they change",
                f"cut it there: head -n {second} IN > one.csv; tail -n +{second + 1} IN > other.csv",
                sum(len(line.encode()) + 1 for line in lines[:second]),
            )
    return None


def _of_few_lines(lines: Sequence[str], shown: str) -> Cause | None:
    """A header without rows."""
    if len(lines) > _FEW:
        return None
    return Cause(
        f"names without rows: {shown}, and {len(lines) - 1} more line behind it",
        "the recording ended before its first row; or give the file that holds the rows",
    )
