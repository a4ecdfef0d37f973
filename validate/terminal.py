"""Comparisons as plain text for a terminal; the caller prints it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flysid.validate.compare import Comparison, Entry
from flysid.validate.trials import FREE_RUN
from flysid.validate.words import (
    change_words,
    horizon_words,
    interval_words,
    number,
    one_line,
    percentage,
    verdict_words,
)

HEADER = ("CHANNEL", "HORIZON", "MODEL", "RMSE", "UNIT", "FIT %", "VAF %", "CHANGE", "95 %", "VERDICT")


def table(comparisons: Mapping[str, Comparison]) -> str:
    """Every model at every horizon, the best first in free run; one line each, no line break at the end."""
    rows: list[Sequence[str]] = [HEADER]
    for channel, comparison in comparisons.items():
        several = len(comparison.test.outputs) > 1
        for entry in comparison.entries:
            label = one_line(f"{channel}/{entry.output.name}" if several else channel)
            rows += _rows(entry, label, comparison)
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    return "\n".join(_line(row, widths) for row in rows)


def summary(comparisons: Mapping[str, Comparison]) -> str:
    """One line per channel and output: the verdict in free run, RMSE from and to, change and interval."""
    rows: list[Sequence[str]] = []
    for comparison in comparisons.values():
        for output, pair in comparison.verdict.items():
            entry = comparison.entry(output, comparison.horizons[0])
            from_, to = (number(entry.models[m].scores.rmse) for m in (pair.baseline, pair.model))
            rows.append(
                (
                    one_line(output),
                    verdict_words(pair),
                    f"RMSE {from_} -> {to} {one_line(entry.output.unit)}".rstrip(),
                    change_words(pair),
                    interval_words(pair),
                )
            )
    if not rows:
        return ""
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in rows)


def _rows(entry: Entry, label: str, comparison: Comparison) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for name, score in sorted(entry.models.items(), key=lambda item: item[1].scores.rmse):
        pair = entry.pairs.get(name)
        s = score.scores
        verdict = "baseline" if pair is None else verdict_words(pair)
        if score.diverged and entry.horizon == FREE_RUN:
            first = score.diverged[0]
            verdict += f" (diverged at t = {first.diverged_s:.1f} s, segment {first.segment + 1})"
        rows.append(
            (
                label if not rows else "",
                horizon_words(entry.horizon, comparison.dt_s) if not rows else "",
                one_line(name),
                number(s.rmse),
                one_line(entry.output.unit),
                percentage(s.fit_pct),
                percentage(s.vaf_pct),
                "" if pair is None else change_words(pair),
                "" if pair is None else interval_words(pair),
                verdict,
            )
        )
    return rows


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    right = {3, 5, 6, 7}
    cells = [
        c.rjust(w) if i in right else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))
    ]
    return "  ".join(cells).rstrip()
