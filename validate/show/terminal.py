"""Comparisons as plain text for a terminal; the caller prints it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flysid.escaping import one_line
from flysid.showing import number, percentage
from flysid.validate.compare.comparison import Comparison, Entry
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare.words import change_words, horizon_words, interval_words, verdict_words

HEADER = ("MODEL", "RMSE", "FIT %", "VAF %", "CHANGE", "95 %", "RULES", "PARAMS", "VERDICT")
RIGHT = {1, 2, 3, 4, 6, 7}


def table(comparisons: Mapping[str, Comparison]) -> str:
    """Every model in free run, the best first; at other horizons the two models of the headline.

    A line each below the output and horizon they are of, then what is of all samples and what of a typical
    flight, where these differ; no line break at the end.
    """
    rows: list[Sequence[str]] = [HEADER]
    titles: dict[int, str] = {}
    notes: dict[int, str] = {}
    for channel, comparison in comparisons.items():
        several = len(comparison.test.outputs) > 1
        for entry in comparison.entries:
            label = one_line(f"{channel}/{entry.output.name}" if several else channel)
            titles[len(rows)] = _title(entry, label, comparison)
            for name in shown_models(entry, comparison):
                rows.append(_row(name, entry, comparison))
                notes[len(rows) - 1] = _divergence(name, entry, comparison)
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    lines = []
    for i, row in enumerate(rows):
        lines += [titles[i]] if i in titles else []
        lines += [_line(row, widths)]
        lines += [f"    {notes[i]}"] if notes.get(i) else []
    return "\n".join([*lines, *of_which(comparisons)])


def of_which(comparisons: Mapping[str, Comparison]) -> list[str]:
    """Where changes are those of a typical flight: that the errors beside them are not; else nothing."""
    pairs = [p for c in comparisons.values() for e in c.entries for p in e.pairs.values()]
    if not any(p.scope.is_unseen and p.change_pct is not None for p in pairs):
        return []
    return [
        "RMSE, FIT and VAF are of all held-out samples together.",
        "CHANGE is of a typical flight (geometric mean of the flights' ratios), not a quotient of two RMSE.",
    ]


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


def standing(name: str, entry: Entry, comparison: Comparison, scoped: bool = True) -> str:
    """A model's verdict in words; "baseline" and "reference" for what no verdict is about.

    `scoped`: with what the verdict is of, where that is not another flight.
    """
    pair = entry.pairs.get(name)
    if pair is None:
        return "baseline"
    if comparison.models[name].reference and pair.verdict is not Verdict.BETTER:
        return "reference"
    return verdict_words(pair, scoped)


def _title(entry: Entry, label: str, comparison: Comparison) -> str:
    """ "roll (deg), free run: verdicts on this flight"."""
    unit = f" ({one_line(entry.output.unit)})" if entry.output.unit else ""
    scope = _scope(entry)
    where = f": verdicts on {scope}" if scope not in (None, Scope.ANOTHER) else ""
    return f"{label}{unit}, {horizon_words(entry.horizon, comparison.dt_s)}{where}"


def _scope(entry: Entry) -> Scope | None:
    """What all verdicts of an entry are of; None where they differ, or there are none."""
    scopes = {pair.scope for pair in entry.pairs.values()}
    return scopes.pop() if len(scopes) == 1 else None


def _row(name: str, entry: Entry, comparison: Comparison) -> Sequence[str]:
    s = entry.models[name].scores
    pair = entry.pairs.get(name)
    info = comparison.models[name]
    headline = entry.horizon == comparison.head
    return (
        one_line(name),
        number(s.rmse),
        percentage(s.fit_pct),
        percentage(s.vaf_pct),
        "" if pair is None else change_words(pair),
        "" if pair is None else interval_words(pair),
        str(info.n_rules) if headline and not info.reference else "",
        str(info.n_parameters) if headline else "",
        standing(name, entry, comparison, scoped=_scope(entry) is None),
    )


def _divergence(name: str, entry: Entry, comparison: Comparison) -> str:
    """When and where a model first diverged in free run; "" where it did not."""
    diverged = entry.models[name].diverged
    if not diverged or entry.horizon != FREE_RUN:
        return ""
    first = diverged[0]
    return f"diverged at t = {first.diverged_s:.1f} s, {one_line(comparison.segments[first.segment])}"


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    cells = [
        c.rjust(w) if i in RIGHT else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))
    ]
    return f"  {'  '.join(cells)}".rstrip()
