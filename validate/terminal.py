"""Comparisons as plain text for a terminal; the caller prints it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flysid.validate.comparison import Comparison, Entry
from flysid.validate.trials import FREE_RUN
from flysid.validate.verdict import Verdict
from flysid.validate.words import (
    change_words,
    horizon_words,
    interval_words,
    number,
    one_line,
    percentage,
    verdict_words,
)

HEADER = (
    "CHANNEL", "HORIZON", "MODEL", "RMSE", "UNIT", "FIT %", "VAF %", "CHANGE", "95 %", "RULES", "PARAMS",
    "FIT S", "VERDICT",
)  # fmt: skip
RIGHT = {3, 5, 6, 7, 9, 10, 11}
Seconds = Mapping[str, Mapping[str, float]]


def table(comparisons: Mapping[str, Comparison], fit_seconds: Seconds | None = None) -> str:
    """Every model in free run, the best first; at other horizons the two models of the headline.

    One line each, no line break at the end. `fit_seconds` is wall time by channel and model.
    """
    rows: list[Sequence[str]] = [HEADER]
    for channel, comparison in comparisons.items():
        several = len(comparison.test.outputs) > 1
        for entry in comparison.entries:
            label = one_line(f"{channel}/{entry.output.name}" if several else channel)
            rows += _rows(entry, label, comparison, (fit_seconds or {}).get(channel, {}))
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    return "\n".join(_line(row, widths) for row in rows)


def summary(comparisons: Mapping[str, Comparison]) -> str:
    """One line per channel and output: verdict, RMSE from and to, change, interval, what it rests on."""
    rows = summary_cells(comparisons)
    if not rows:
        return ""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in rows)


def summary_cells(comparisons: Mapping[str, Comparison]) -> list[Sequence[str]]:
    """Output, verdict, RMSE from and to at its horizon, change, interval, units; per channel and output."""
    rows: list[Sequence[str]] = []
    outputs = [output for c in comparisons.values() for output in c.verdict]
    for channel, comparison in comparisons.items():
        for output, pair in comparison.verdict.items():
            entry = comparison.entry(output, comparison.head)
            horizon = horizon_words(entry.horizon, comparison.dt_s)
            from_, to = map(number, (pair.evidence.rmse_baseline, pair.evidence.rmse_model))
            rows.append(
                (
                    one_line(output if outputs.count(output) == 1 else f"{channel}/{output}"),
                    verdict_words(pair),
                    f"{horizon}: RMSE {from_} -> {to} {one_line(entry.output.unit)}".rstrip(),
                    change_words(pair),
                    interval_words(pair),
                    f"({pair.units} {pair.unit})" if pair.ci95 else "",
                )
            )
    return rows


def shown_models(entry: Entry, comparison: Comparison) -> list[str]:
    """Models worth a line in a table for people, the best first: all in free run, else the headline's two."""
    ranked = sorted(entry.models, key=lambda m: entry.models[m].scores.rmse)
    if entry.horizon == comparison.head or comparison.contender is None:
        return ranked
    return [m for m in ranked if m in (comparison.baseline, comparison.contender)]


def standing(name: str, entry: Entry, comparison: Comparison) -> str:
    """A model's verdict in words; "baseline" and "reference" for what no verdict is about."""
    pair = entry.pairs.get(name)
    if pair is None:
        return "baseline"
    if comparison.models[name].reference and pair.verdict is not Verdict.BETTER:
        return "reference"
    return verdict_words(pair)


def _rows(
    entry: Entry, label: str, comparison: Comparison, seconds: Mapping[str, float]
) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for name in shown_models(entry, comparison):
        score = entry.models[name]
        pair = entry.pairs.get(name)
        info = comparison.models[name]
        s = score.scores
        verdict = standing(name, entry, comparison)
        headline = entry.horizon == comparison.head
        if score.diverged and entry.horizon == FREE_RUN:
            first = score.diverged[0]
            verdict += (
                f" (diverged at t = {first.diverged_s:.1f} s, {one_line(comparison.segments[first.segment])})"
            )
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
                str(info.n_rules) if headline and not info.reference else "",
                str(info.n_parameters) if headline else "",
                f"{seconds[name]:.1f}" if headline and name in seconds else "",
                verdict,
            )
        )
    return rows


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    cells = [
        c.rjust(w) if i in RIGHT else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))
    ]
    return "  ".join(cells).rstrip()
