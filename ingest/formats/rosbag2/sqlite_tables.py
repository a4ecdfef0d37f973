"""Tables of an SQLite file: their rows by the tree that holds them, and after damage by every page.

A tree is walked from its root. What does not hold together is noted and passed over; if anything was, or a
table's root is unknown, leaf pages that no tree owns are tried as leaves of the table at hand, by the shape
of its rows. Deleted rows on free pages stay deleted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from flysid.ingest.formats.common.tally import Tally
from flysid.ingest.formats.rosbag2.sqlite_pages import Database, Leaf, PageKind, Value

MAX_DEPTH = 24
_COLUMN = re.compile(r'\s*["\[`]?(\w+)')
Row = Sequence[Value]
Test = Callable[[Row], bool]


class Tables:
    """Rows of a file's tables. `faults` (page -> reason) grows while rows are read; `place` follows."""

    def __init__(self, view: memoryview) -> None:
        self.database = Database(view)
        self.faults: dict[int, str] = {}
        self.place = 0
        self._owned = bytearray(self.database.pages + 1)
        self._roots: dict[str, tuple[int, list[str]]] = {}
        for row in self._tree(1, _is_schema):
            kind = row[0]
            name = row[1]
            root = row[3]
            sql = row[4]
            if kind == "table" and isinstance(name, str) and isinstance(root, int) and isinstance(sql, str):
                self._roots.setdefault(name, (root, _column_names(sql)))

    @property
    def names(self) -> list[str]:
        """The names of the tables that the file's schema defines."""
        return list(self._roots)

    def __contains__(self, name: str) -> bool:
        return name in self._roots

    def places(self, name: str, wanted: Sequence[str], default: Sequence[int]) -> list[int]:
        """Where columns stand in the rows of a table; `default` where its definition does not say."""
        known = self._roots[name][1] if name in self._roots else []
        return [known.index(w) for w in wanted] if set(wanted) <= set(known) else list(default)

    def rows(self, name: str, fits: Test) -> Iterator[Row]:
        """Rows of a table that have the shape of its rows; others are faults of their page."""
        if name in self._roots:
            yield from self._tree(self._roots[name][0], fits)

    def stray_rows(self, fits: Test) -> Iterator[Row]:
        """Rows of this shape on leaf pages that nothing owns, if anything is wrong with the file."""
        if not self.faults and not self.is_cut:
            return
        free = self.database.freelist()
        for number in range(2, self.database.pages + 1):
            if not self._owned[number] and number not in free and self.database.kind(number) == PageKind.LEAF:
                self.place = self.database.start(number)
                leaf = self._leaf(number, fits)
                if leaf.cells:
                    self._note(number, leaf.fault)
                yield from (cell.row for cell in leaf.cells)

    @property
    def is_cut(self) -> bool:
        """Whether pages that the file's header counts are missing at its end."""
        file = self.database
        return len(file.view) % file.page_bytes > 0 or file.pages < file.stated_pages

    def settle(self, tally: Tally) -> None:
        """Put what was found wrong into the tally, page by page."""
        file = self.database
        for number in sorted(self.faults):
            at = file.start(number)
            tally.skip(at, min(at + file.page_bytes, len(file.view)), self.faults[number])
        end = file.pages * file.page_bytes
        tally.skip(end, len(file.view), "the file ends inside this page")
        tally.truncated |= self.is_cut

    def _note(self, number: int, fault: str) -> None:
        if fault:
            self.faults.setdefault(number, fault)

    def _tree(self, root: int, fits: Test) -> Iterator[Row]:
        """Rows of the tree at `root`, in order."""
        waiting = [(root, 0, root)]
        while waiting:
            number, depth, parent = waiting.pop()
            if not 1 <= number <= self.database.pages:
                if not self.is_cut:
                    self._note(parent, f"it refers to page {number}, which is not in the file")
                continue
            if self._owned[number] or depth > MAX_DEPTH:
                self._note(parent, f"it refers to page {number}, which belongs elsewhere")
                continue
            kind = self.database.kind(number)
            self.place = max(self.place, self.database.start(number))
            if kind == PageKind.LEAF:
                leaf = self._leaf(number, fits)
                self._note(number, leaf.fault)
                yield from (cell.row for cell in leaf.cells)
            elif kind == PageKind.INNER:
                inner = self.database.inner(number)
                self._owned[number] = 1
                self._note(number, inner.fault)
                waiting += [(child, depth + 1, number) for child in reversed(inner.children)]
            else:
                self._note(number, "not a page of a table")

    def _leaf(self, number: int, fits: Test) -> Leaf:
        """The rows of a leaf that have the right shape; if there are any, the page belongs to this table."""
        leaf = self.database.leaf(number)
        good = [cell for cell in leaf.cells if fits(cell.row)]
        fault = leaf.fault or ("a row of another table" if len(good) < len(leaf.cells) else "")
        if good or not fault:
            self._owned[number] = 1
            for cell in good:
                for page in cell.overflow:
                    self._owned[page] = 1
        return Leaf(tuple(good), fault)


def _is_schema(row: Row) -> bool:
    return len(row) == 5 and isinstance(row[0], str) and isinstance(row[1], str)


def _column_names(sql: str) -> list[str]:
    """Names of the columns of a CREATE TABLE statement, in order."""
    inside = sql.partition("(")[2].rpartition(")")[0]
    found = (_COLUMN.match(part) for part in inside.split(","))
    return [match[1].lower() for match in found if match is not None]
