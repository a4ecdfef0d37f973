"""The CPU time of the doors, printed when the tests have ended."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

BUDGET_S = 120.0
"""What all doors together may cost."""
PROPERTY = "cpu_s"


def lines(reports: Iterable[Any]) -> list[str]:
    """What each door cost, the most expensive first, and all together."""
    costs: Mapping[str, float] = {
        report.nodeid.partition("::")[2]: dict(report.user_properties)[PROPERTY]
        for report in reports
        if PROPERTY in dict(getattr(report, "user_properties", ()))
    }
    return _table(sorted(costs.items(), key=lambda item: -item[1])) if costs else []


def _table(costs: Sequence[tuple[str, float]]) -> list[str]:
    total = sum(cost for _, cost in costs)
    rows = [f"{cost:7.1f} s  {name}" for name, cost in costs]
    return [*rows, f"{total:7.1f} s of CPU for all doors; the budget is {BUDGET_S:.0f} s"]
