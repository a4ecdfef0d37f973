"""Comparisons as Markdown for a pull request, CSV for a spreadsheet, and a table for a notebook.

Names come from logs: Markdown's signs are escaped, and a CSV cell that a spreadsheet would run as a formula
(=, +, -, @ at its start) gets a leading apostrophe, except numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from flysid.escaping import csv_line, markdown, one_line
from flysid.showing import number, percentage
from flysid.validate.compare.comparison import Comparison, Entry, Pair
from flysid.validate.compare.metrics import Scores
from flysid.validate.compare.words import change_words, horizon_words, interval_words
from flysid.validate.diagnose.caution import Caution
from flysid.validate.show.terminal import of_which, shown_models, standing, summary_cells

CSV_HEADER = (
    "channel", "output", "unit", "horizon", "model", "segment", "flight", "n", "rmse", "mae", "worst", "bias",
    "fit_pct", "vaf_pct", "r2", "diverged_s", "change_pct", "ci95_low", "ci95_high", "p_holm", "verdict",
    "short_of",
)  # fmt: skip


Cell = str | float | int | None
Seconds = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class _Row:
    """One model of one entry, in the order of its error."""

    channel: str
    entry: Entry
    model: str
    pair: Pair | None
    comparison: Comparison
    seconds: float | None = None

    @property
    def sized(self) -> bool:
        """Size and fit time stand in the lines of the headline's horizon only."""
        return self.entry.horizon == self.comparison.head


HEADINGS = (
    "channel", "horizon", "model", "RMSE", "fit %", "VAF %", "change in RMSE", "95 %", "rules", "parameters",
    "fit time, s", "verdict",
)  # fmt: skip


def _rank(
    comparisons: Mapping[str, Comparison], seconds: Seconds | None = None, every: bool = False
) -> Iterator[_Row]:
    """Rows for people; with `every`, of all models at all horizons."""
    for channel, c in comparisons.items():
        times = (seconds or {}).get(channel, {})
        for entry in c.entries:
            several = len(c.test.outputs) > 1
            label = f"{channel}/{entry.output.name}" if several else channel
            models = sorted(entry.models, key=lambda m: entry.models[m].scores.rmse)
            for model in models if every else shown_models(entry, c):
                yield _Row(label, entry, model, entry.pairs.get(model), c, times.get(model))


def to_markdown(
    comparisons: Mapping[str, Comparison],
    seconds: Seconds | None = None,
    cautions: Sequence[Caution] = (),
    skipped: Mapping[str, str] | None = None,
) -> str:
    """Verdicts line by line, what to beware of, and the table; GitHub's dialect, ends with a line break.

    All models stand in free run, the best first, and the headline's two at the other horizons. `skipped` are
    channels that no verdict is about, with the reason.
    """
    said = [
        f"- **{markdown(name)}**: {_sentence(cells, markdown)}" for name, *cells in summary_cells(comparisons)
    ]
    said += [f"- **{markdown(name)}**: not judged: {markdown(why)}" for name, why in (skipped or {}).items()]
    which = " ".join(of_which(comparisons))
    said += [f"- {which}"] if which else []
    if cautions:
        said += ["", "Before you rely on this:", ""]
        said += [f"- {c.level}: {markdown(f'{c.text} {c.todo}'.strip())}" for c in cautions]
    lines = [f"| {' | '.join(HEADINGS)} |", "|---|---|---|---:|---:|---:|---:|---|---:|---:|---:|---|"]
    lines += [f"| {' | '.join(_cells(row, markdown))} |" for row in _rank(comparisons, seconds)]
    return "\n".join([*said, "", *lines] if said else lines) + "\n"


def _sentence(cells: Sequence[str], escape: Callable[[str], str]) -> str:
    """ "TS better; free run: RMSE 0.16 → 0.04 m/s, −78 % [−86, −60]"."""
    verdict, rmse, *change = (escape(c.replace("->", "→")) for c in cells)
    return f"{verdict}; {rmse}, {' '.join(change)}".rstrip(", ")


def _cells(row: _Row, escape: Callable[[str], str]) -> list[str]:
    """The cells of a row as text."""
    info = row.comparison.models[row.model]
    s = row.entry.models[row.model].scores
    unit = f" {escape(row.entry.output.unit)}" if row.entry.output.unit else ""
    return [
        escape(row.channel),
        horizon_words(row.entry.horizon, row.comparison.dt_s),
        escape(row.model),
        number(s.rmse) + unit,
        percentage(s.fit_pct),
        percentage(s.vaf_pct),
        change_words(row.pair) if row.pair else "",
        interval_words(row.pair) if row.pair else "",
        str(info.n_rules) if row.sized and not info.reference else "",
        str(info.n_parameters) if row.sized else "",
        f"{row.seconds:.1f}" if row.sized and row.seconds is not None else "",
        escape(standing(row.model, row.entry, row.comparison)),
    ]


def to_csv(comparisons: Mapping[str, Comparison]) -> str:
    """One row per model, horizon and segment; before them one for all segments, whose segment is empty."""
    lines = [",".join(CSV_HEADER)]
    for row in _rank(comparisons, every=True):
        score = row.entry.models[row.model]
        head = [row.channel, row.entry.output.name, row.entry.output.unit, row.entry.horizon, row.model]
        first = min((s.diverged_s for s in score.diverged if s.diverged_s is not None), default=None)
        lines.append(csv_line([*head, "", "", *_numbers(score.scores), first, *_judge(row.pair)]))
        for s in score.segments:
            where: list[Cell] = [s.segment + 1, s.flight]
            lines.append(csv_line([*head, *where, *_numbers(s.scores), s.diverged_s, *_judge(None)]))
    return "\n".join([*lines, ""])


def _numbers(s: Scores) -> list[Cell]:
    return [s.n, s.rmse, s.mae, s.worst, s.bias, s.fit_pct, s.vaf_pct, s.r2]


def _judge(pair: Pair | None) -> list[Cell]:
    if pair is None:
        return [""] * 6
    low, high = pair.ci95 or (None, None)
    return [pair.change_pct, low, high, pair.p_holm, str(pair.verdict), " ".join(pair.short_of)]


def to_html(comparisons: Mapping[str, Comparison]) -> Markup:
    """The verdicts and a plain table for a notebook."""
    timed = HEADINGS.index("fit time, s")  # nobody knows it here
    said = Markup("").join(
        Markup("<li><strong>{}</strong>: {}</li>").format(name, _sentence(cells, one_line))
        for name, *cells in summary_cells(comparisons)
    )
    head = Markup("").join(Markup("<th>{}</th>").format(h) for i, h in enumerate(HEADINGS) if i != timed)
    body = Markup("").join(
        Markup("<tr>{}</tr>").format(
            Markup("").join(
                Markup("<td>{}</td>").format(c) for i, c in enumerate(_cells(row, one_line)) if i != timed
            )
        )
        for row in _rank(comparisons)
    )
    table = Markup("<table><thead><tr>{}</tr></thead><tbody>{}</tbody></table>").format(head, body)
    return Markup("<ul>{}</ul>{}").format(said, table) if said else table
