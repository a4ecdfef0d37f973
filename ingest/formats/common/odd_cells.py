"""Cells that are no numbers, in columns of numbers: how many, in which rows, and what the first one says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from flysid.ingest.formats.common.tally import Tally

SHOWN = 5


@dataclass
class _Odd:
    """Those of one column."""

    example: str
    count: int = 0
    rows: list[int] = field(default_factory=list)


class OddCells:
    """Collects odd cells by column, batch after batch, and tells a Tally of them at the end."""

    def __init__(self) -> None:
        self._found: dict[str, _Odd] = {}

    def note(self, name: str, rows: Iterable[int], example: str) -> None:
        """Cells of a column that could not be kept.

        Parameters
        ----------
        rows : numbers of their rows, 1 for the first of the table.
        example : what the first one says.
        """
        odd = self._found.setdefault(name, _Odd(example))
        for row in rows:
            odd.count += 1
            if len(odd.rows) < SHOWN:
                odd.rows.append(row)

    def tell(self, tally: Tally, *, prefix: str = "", before: int = 0, place: str = "row") -> None:
        """Count them as records that could not be decoded, and say where they are.

        Parameters
        ----------
        prefix : of the columns' names. before : rows ahead of those that were noted. place : in a word.
        """
        for name, odd in self._found.items():
            first, *others = (f"{before + row:,}" for row in odd.rows)
            why = f"{odd.example[:40]!r} in {place} {first} is not a number"
            left = odd.count - len(odd.rows)
            more = f" and {left:,} more" if left else ""
            also = (
                f"; nor in {place}{'s' if len(others) > 1 else ''} {', '.join(others)}{more}"
                if others
                else ""
            )
            tally.undecode(prefix + name, odd.count, why + also)
