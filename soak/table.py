"""Outcomes of campaigns as the table in `docs/reliability.md`; lines of campaigns that did not run stay."""

from __future__ import annotations

from soak import Campaign, Outcome

BEGIN = "<!-- soak: begin -->"
END = "<!-- soak: end -->"
HEAD = (
    "| # | campaign | subject | trials | rows kept | refused | failures "
    "| peak MB | slowest s | remark | date |\n|---|---|---|---|---|---|---|---|---|---|---|"
)
Line = tuple[str, ...]


def line(campaign: Campaign, outcome: Outcome, date: str) -> Line:
    """The cells of one line."""
    return (
        str(campaign.row),
        campaign.name,
        outcome.subject,
        f"{outcome.trials:,}",
        kept(outcome),
        f"{outcome.raised:,}",
        f"{len(outcome.failures):,}",
        "" if outcome.peak_mb is None else f"{outcome.peak_mb:.0f}",
        "" if outcome.slowest_s is None else f"{outcome.slowest_s:.2g}",
        outcome.remark.replace("|", "/"),
        date,
    )


def kept(outcome: Outcome) -> str:
    """Share of the rows that were kept, in words."""
    if outcome.kept is None:
        return ""
    whole = outcome.kept + (outcome.lost or 0)
    return f"{outcome.kept:,} of {whole:,} ({100 * outcome.kept / whole:.3f} %)" if whole else "0"


def merge(page: str, fresh: list[Line], part: bool = False) -> str:
    """`page` with the lines of the campaigns in `fresh` replaced; of a `part`, those of their subjects only.

    Raises ValueError without its marks.
    """
    before, began, rest = page.partition(BEGIN)
    table, ended, after = rest.partition(END)
    if not began or not ended:
        raise ValueError(f"the page has no {BEGIN} ... {END}")
    width = 3 if part else 2
    names = {cells[1:width] for cells in fresh}
    lines = [cells for cells in parse(table) if cells[1:width] not in names] + fresh
    lines.sort(key=lambda cells: (int(cells[0]), cells[1], cells[2]))
    body = "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
    return f"{before}{BEGIN}\n{HEAD}\n{body}\n{END}{after}"


def parse(table: str) -> list[Line]:
    """Lines of a table that `merge` wrote."""
    rows = [row.strip().strip("|").split("|") for row in table.splitlines() if row.startswith("| ")]
    cells = [tuple(cell.strip() for cell in row) for row in rows]
    return [row for row in cells if row[0].isdigit()]
