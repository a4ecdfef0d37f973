"""Static rules as the paper prints them: If-Then rules (tables 1, 3, 5), numbers and centres (2, 4, 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flysid.model.rules.phrases import equation

LOST = "lost in print"


@dataclass(frozen=True)
class Row:
    """One rule for one output.

    `gains`, `offset`: the consequent; one gain per input.
    `centre`: of the rule's set, one number per input; None where it is not known.
    """

    gains: tuple[float, ...]
    offset: float
    centre: tuple[float, ...] | None


def if_then(rows: Sequence[Row], inputs: Sequence[str] = ("u",), output: str = "y") -> list[str]:
    """ "1. If u is A1 then y = 0.1 u - 0.022": tables 1, 3 and 5."""
    return [
        f"{at}. If {' and '.join(f'{name} is A{at}' for name in inputs)} then "
        + equation(output, row.gains, inputs, row.offset)
        for at, row in enumerate(rows, start=1)
    ]


def parameters(rows: Sequence[Row]) -> list[str]:
    """Rule number, consequent, offset, centre of the cluster, under their heads: tables 2, 4 and 6."""
    cells = [
        (
            f"{at}.",
            _powers(row.gains),
            _powers([row.offset]),
            LOST if row.centre is None else _powers(row.centre),
        )
        for at, row in enumerate(rows, start=1)
    ]
    table = [("Rule#", "Consequent", "Offset", "Centre of cluster"), *cells]
    width = [max(len(line[j]) for line in table) for j in range(4)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)).rstrip() for line in table]


def _powers(values: Sequence[float]) -> str:
    """Two digits and a power of ten, as the paper prints them."""
    return ", ".join(f"{value:.1e}" for value in values)
