"""Pages of an SQLite database file and the cells on them, read without SQLite: the file is hostile.

The library refuses a file whose end is missing and stops at the first page that does not hold together;
here every page stands for itself. Source: "Database File Format", sqlite.org/fileformat2.html. Numbers are
big-endian.

    file header  0 magic, 16 u16 page size (1 means 65,536), 20 u8 reserved per page, 24 u32 change counter,
                 28 u32 pages, 32 u32 first freelist page, 92 u32 change counter that 28 belongs to
    b-tree page  u8 kind, u16 first free block, u16 cells, u16 start of the cells, u8 fragmented bytes,
                 (kind 5: u32 rightmost child), u16 place of every cell; on page 1 behind the file header
    leaf cell    varint payload size, varint row id, payload, (u32 first overflow page)
    inner cell   u32 child, varint row id
    overflow     u32 next page or 0, payload
    payload      varint header size, varint type per column, columns

Left out: indexes, UTF-16 databases, virtual tables. What lies beside the file: `side_files`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

MAGIC = b"SQLite format 3\0"
HEADER_BYTES = 100
DEFAULT_PAGE_BYTES = 4096
MAX_PAYLOAD_BYTES = 1 << 28
SHARED_TIMES = 2  # sound rows do not share overflow pages; damaged ones may not multiply them
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}

Value = int | float | str | bytes | None


class PageKind(IntEnum):
    """B-tree pages of tables: with children, with rows."""

    INNER = 5
    LEAF = 13


class PageError(ValueError):
    """A page or row that does not hold together; the message says why."""


@dataclass(frozen=True)
class Cell:
    """A row on a leaf page: its columns, and the pages that it goes on to (none for most).

    A first column that is an INTEGER PRIMARY KEY is stored as null; the row id stands in its place.
    """

    row: list[Value]
    overflow: tuple[int, ...] = ()


@dataclass(frozen=True)
class Leaf:
    """Rows of a leaf page; `fault` says what is wrong with the page or with rows that are missing here."""

    cells: tuple[Cell, ...]
    fault: str = ""


@dataclass(frozen=True)
class Inner:
    """Children of an inner page, in order; `fault` says what is wrong with it."""

    children: tuple[int, ...]
    fault: str = ""


class Database:
    """The pages of a file, numbered from 1. `stated_pages` is what the header says, 0 where it does not."""

    def __init__(self, view: memoryview) -> None:
        self.view = view
        for self.page_bytes, reserved in _page_sizes(view):
            self.usable = self.page_bytes - reserved
            self.pages = len(view) // self.page_bytes
            self._chained = SHARED_TIMES * self.pages  # overflow pages that may yet be read
            if self._is_sound(1):
                break
        current = len(view) >= HEADER_BYTES and view[24:28] == view[92:96]
        self.stated_pages = _u32(view, 28) if current else 0

    def start(self, number: int) -> int:
        """Where a page begins in the file."""
        return (number - 1) * self.page_bytes

    def page(self, number: int) -> memoryview:
        """The bytes of a page. Raises PageError where the file has none of that number."""
        if not 1 <= number <= self.pages:
            raise PageError(f"page {number} is not in the file")
        at = self.start(number)
        return self.view[at : at + self.usable]

    def kind(self, number: int) -> int:
        """The kind that a page says it is of."""
        return self.page(number)[HEADER_BYTES if number == 1 else 0]

    def _is_sound(self, number: int) -> bool:
        """Whether a page is one of a table and its parts fill it."""
        try:
            return not (self.leaf if self.kind(number) == PageKind.LEAF else self.inner)(number).fault
        except PageError:
            return False

    def leaf(self, number: int) -> Leaf:
        """The rows of a leaf page, as far as they hold together. Raises PageError where it is none."""
        page = self.page(number)
        base = HEADER_BYTES if number == 1 else 0
        if page[base] != PageKind.LEAF:
            raise PageError("not a leaf of a table")
        cells: list[Cell] = []
        taken = 0
        fault = ""
        for at in _places(page, base, 8):
            try:
                cell, end = self._leaf_cell(page, at)
            except PageError as error:
                fault = str(error)
                continue
            cells.append(cell)
            taken += max(end - at, 4)
        return Leaf(tuple(cells), fault or self._uncovered(page, base, 8, taken))

    def inner(self, number: int) -> Inner:
        """The children of an inner page. Raises PageError where it is none."""
        page = self.page(number)
        base = HEADER_BYTES if number == 1 else 0
        if page[base] != PageKind.INNER:
            raise PageError("not an inner page of a table")
        children = []
        taken = 0
        fault = ""
        for at in _places(page, base, 12):
            if at + 5 > len(page):
                continue
            children.append(_u32(page, at))
            try:
                taken += max(varint(page, at + 4)[1] - at, 4)
            except PageError as error:
                fault = str(error)
        children.append(_u32(page, base + 8))
        return Inner(tuple(children), fault or self._uncovered(page, base, 12, taken))

    def freelist(self) -> set[int]:
        """Pages that are in no use; they may hold rows that were deleted."""
        free: set[int] = set()
        trunk = _u32(self.view, 32) if len(self.view) >= HEADER_BYTES else 0
        while 1 <= trunk <= self.pages and trunk not in free:
            free.add(trunk)
            page = self.page(trunk)
            count = min(_u32(page, 4), len(page) // 4 - 2)
            free.update(_u32(page, 8 + 4 * k) for k in range(count))
            trunk = _u32(page, 0)
        return free

    def _leaf_cell(self, page: memoryview, at: int) -> tuple[Cell, int]:
        """The row at `at` and where it ends on the page. Raises PageError."""
        size, at = varint(page, at)
        number, at = varint(page, at)
        if size > MAX_PAYLOAD_BYTES:
            raise PageError(f"a row of {size} bytes")
        local = _local_bytes(size, self.usable)
        end = at + local + (4 if local < size else 0)
        if end > len(page):
            raise PageError("a row runs past the end of its page")
        if local == size:
            return Cell(_key(columns(bytes(page[at:end])), number)), end
        parts, pages = self._overflow(_u32(page, at + local), size - local)
        row = columns(b"".join([page[at : at + local], *parts]))
        return Cell(_key(row, number), pages), end

    def _overflow(self, number: int, size: int) -> tuple[list[memoryview], tuple[int, ...]]:
        """`size` bytes of payload from a chain of overflow pages, and these pages. Raises PageError."""
        parts: list[memoryview] = []
        pages: list[int] = []
        if size > self.pages * self.page_bytes:
            raise PageError(f"a row of {size} bytes more than the file has")
        while size > 0:
            page = self.page(number)
            self._chained -= 1
            if self._chained < 0:
                raise PageError("rows share overflow pages")
            pages.append(number)
            number = _u32(page, 0)
            parts.append(page[4 : 4 + size])
            size -= len(page) - 4
        if number:
            raise PageError("a row's overflow pages continue beyond its end")
        return parts, tuple(pages)

    def _uncovered(self, page: memoryview, base: int, head: int, taken: int) -> str:
        """Why cells, free blocks and fragments do not fill the page exactly; "" where they do."""
        first, cells, content, fragments = _head(page, base)
        free = 0
        at = first
        while at and at + 4 <= len(page) and free < len(page):
            size = int.from_bytes(page[at + 2 : at + 4], "big")
            free += max(size, 4)
            at = int.from_bytes(page[at : at + 2], "big")
        content = content or 65536
        if base + head + 2 * cells <= content and taken + free + fragments == len(page) - content:
            return ""
        return "the rows do not fill the page as its header states"


def varint(data: memoryview | bytes, at: int) -> tuple[int, int]:
    """A number of 1 to 9 bytes, 7 bits each, the highest first, and where it ends. Raises PageError."""
    if at < len(data) and data[at] < 0x80:  # most of them
        return data[at], at + 1
    value = 0
    for k in range(at, min(at + 8, len(data))):
        byte = data[k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, k + 1
    if at + 9 > len(data):
        raise PageError("a number runs past the end")
    return value << 8 | data[at + 8], at + 9


def columns(payload: bytes) -> list[Value]:
    """The values of a row. Raises PageError where they do not fill its payload exactly."""
    head, at = varint(payload, 0)
    if head > len(payload):
        raise PageError("a row's header runs past its end")
    values: list[Value] = []
    place = head
    while at < head:
        kind = payload[at]
        if kind < 0x80:  # spares a call
            at += 1
        else:
            kind, at = varint(payload, at)
        value, place = _value(payload, kind, place)
        values.append(value)
    if at != head or place != len(payload):
        raise PageError("the columns do not fill their row")
    return values


def _value(payload: bytes, kind: int, at: int) -> tuple[Value, int]:
    """The value of type `kind` at `at`, and where it ends."""
    if kind >= 12:
        end = at + (kind - 12) // 2
        raw = payload[at:end]
        if end > len(payload):
            raise PageError("a value runs past the end of its row")
        return (raw.decode("utf-8", "replace") if kind & 1 else raw), end
    if kind in _INTEGERS:
        end = at + _INTEGERS[kind]
        if end > len(payload):
            raise PageError("a value runs past the end of its row")
        return int.from_bytes(payload[at:end], "big", signed=True), end
    if kind in (0, 8, 9):
        return (None, 0, 1)[kind - 7 if kind else 0], at
    if kind == 7:
        import struct

        if at + 8 > len(payload):
            raise PageError("a value runs past the end of its row")
        return float(struct.unpack_from(">d", payload, at)[0]), at + 8
    raise PageError(f"column type {kind} is reserved")


def _key(row: list[Value], number: int) -> list[Value]:
    """The row with its row id in place of a first column of null."""
    return [number, *row[1:]] if row and row[0] is None else row


def _page_sizes(view: memoryview) -> list[tuple[int, int]]:
    """(bytes, reserved bytes) of a page: as the header states, then what else it could be."""
    stated = int.from_bytes(view[16:18], "big")
    size = 65536 if stated == 1 else stated
    reserved = view[20] if len(view) >= HEADER_BYTES else 0
    is_possible = 512 <= size <= 65536 and size & (size - 1) == 0 and reserved <= size - 480
    others = [(DEFAULT_PAGE_BYTES, 0), *((1 << k, 0) for k in range(9, 17))]
    return [(size, reserved), *others] if is_possible else others


def _head(page: memoryview, base: int) -> tuple[int, int, int, int]:
    """First free block, number of cells, start of the cells, fragmented bytes."""
    numbers = [int.from_bytes(page[base + k : base + k + 2], "big") for k in (1, 3, 5)]
    return numbers[0], numbers[1], numbers[2], page[base + 7]


def _places(page: memoryview, base: int, head: int) -> list[int]:
    """Where the cells of a page begin, as far as its pointers reach."""
    count = min(_head(page, base)[1], (len(page) - base - head) // 2)
    start = base + head
    raw = bytes(page[start : start + 2 * count])
    return [raw[k] << 8 | raw[k + 1] for k in range(0, len(raw) - 1, 2)]


def _local_bytes(size: int, usable: int) -> int:
    """Bytes of a payload that lie on the leaf page itself."""
    if size <= usable - 35:
        return size
    least = (usable - 12) * 32 // 255 - 23
    wanted = least + (size - least) % (usable - 4)
    return wanted if wanted <= usable - 35 else least


def _u32(data: memoryview, at: int) -> int:
    return int.from_bytes(data[at : at + 4], "big")
