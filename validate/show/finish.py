"""The finished document of a judgement: text, numbers and pictures, and no model; and how it is written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from flysid.errors import StoreError, UsageError
from flysid.escaping import one_line
from flysid.extras import Extra, Missing, extra
from flysid.files import replacing_folder, write_atomically
from flysid.pictures import require_matplotlib
from flysid.progress import tell
from flysid.showing import fold
from flysid.validate.compare.condition import matching_channels
from flysid.validate.compare.words import physics_words
from flysid.validate.runs.judge import Judgement
from flysid.validate.runs.run import DOCUMENT, PAGE, REPORT, Run, run_file
from flysid.validate.show.page.describe import Page, describe
from flysid.validate.show.page.html import plain_page
from flysid.validate.show.page.narrative import worse_than_constant
from flysid.validate.show.page.page import fill
from flysid.validate.show.paperfigures import figure_files
from flysid.validate.show.tables import to_csv, to_markdown
from flysid.validate.show.terminal import summary, table


@dataclass(frozen=True, eq=False)
class Finished:
    """A judgement as people and programs read it.

    `found`: the JSON document, but for what is missing.
    `paragraphs`: the comparison for a terminal, but for what is missing.
    `forms`: the comparison as "markdown" and "csv".
    `page`: the page; None where none was wanted, or where it broke as a whole.
    `figures`: files of figures for a paper, by name.
    `missing`: sentences on what could not be given beside the comparison.
    `unjudged`: channels that were fitted, and should have been judged.
    """

    found: Mapping[str, Any]
    paragraphs: tuple[str, ...]
    forms: Mapping[str, str]
    page: Page | None = None
    figures: Mapping[str, bytes] = field(default_factory=dict)
    missing: Missing = field(default_factory=Missing)
    unjudged: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """The comparison as JSON types: {"channels": {NAME: {HORIZON: {...}}}, ...}.

        "missing" holds a sentence on every extra that could not be given; it is not there where none is.
        """
        return {**self.found, **self.missing.to_dict()}

    @property
    def table(self) -> str:
        """Every model, channel and horizon for a terminal, verdicts in words, warnings."""
        missing = "\n".join(fold(one_line(words)) for words in self.missing.sentences)
        return "\n\n".join(part for part in (*self.paragraphs, missing) if part)

    def text(self, form: str = "table") -> str:
        """The comparison as "table", "json", "markdown" or "csv", without a line break at the end.

        Raises UsageError: another form.
        """
        if form == "table":
            return self.table.rstrip("\n")
        if form == "json":
            return json.dumps(self.document, indent=1, allow_nan=False)
        if form not in self.forms:
            known = ", ".join(("table", "json", *self.forms))
            raise UsageError(f"no form {form!r} of a comparison", hint=f"one of {known}")
        return self.forms[form].rstrip("\n")

    def violations(self, condition: str) -> dict[str, str]:
        """The channels on which a `--fail-if` condition holds, each with why it could not be judged, or "".

        Raises UsageError where it is not understood.
        """
        return matching_channels(condition, self.document)


def finish(judgement: Judgement, *, page: bool = False, figures: str | None = None) -> Finished:
    """The finished document of a judgement, which needs its models no more.

    `page`: whether the page is described and its pictures are drawn.
    `figures`: "pdf", "svg" or "png": figures for a paper, one per channel and output of the page.
    Raises UsageError: matplotlib is needed and not installed.
    """
    context = judgement.context
    found = judgement.document
    found.pop("missing", None)
    files: Mapping[str, bytes] = {}
    described = None
    if figures is not None:
        require_matplotlib()
    with context.missing.gathering():
        if page:
            tell("drawing the page", share=0.9)
            described = extra(Extra.PAGE, partial(describe, context), None)
        if figures is not None and described is not None:
            files = extra(Extra.FIGURES, partial(figure_files, described, figures), {})
        paragraphs = _paragraphs(judgement)
    forms = {
        "markdown": to_markdown(
            judgement.comparisons, context.fit_seconds, judgement.cautions, judgement.skipped
        ),
        "csv": to_csv(judgement.comparisons),
    }
    return Finished(found, paragraphs, forms, described, files, context.missing, judgement.unjudged)


def write_finished(finished: Finished, folder: Path) -> Path:
    """Write report.html, report.json and figures; returns the page's path. The folder appears whole.

    Where the page breaks as a whole, it is the comparison as it is printed. Raises WriteError: nothing can be
    written there.
    """
    with replacing_folder(folder) as incoming:
        for name, content in finished.figures.items():
            write_atomically(incoming / name, content)
        write_atomically(incoming / PAGE, _page(finished).encode())
        write_atomically(incoming / DOCUMENT, _json(finished))
    return folder / PAGE


def remember(finished: Finished, run: Run) -> None:
    """Leave the document in the run, where `flysid runs` looks; one that cannot be written stays as it is."""
    extra(Extra.REMEMBERED, partial(_remember, finished, run), None)


def _remember(finished: Finished, run: Run) -> None:
    with suppress(OSError, StoreError):
        place = run_file(run.folder, REPORT)
        place.mkdir(exist_ok=True)
        write_atomically(place / DOCUMENT, _json(finished))


def _json(finished: Finished) -> bytes:
    return (finished.text("json") + "\n").encode()


def _page(finished: Finished) -> str:
    page = finished.page
    if page is None:
        return plain_page(finished.table)
    with finished.missing.gathering():
        filled = extra(Extra.PAGE, lambda: fill(page, finished.missing.sentences), "")
    return filled or plain_page(finished.table)


def _paragraphs(judgement: Judgement) -> tuple[str, ...]:
    """The tables, what is worse than a constant, the verdicts, and what to know before relying on them."""
    comparisons = judgement.comparisons
    poor = "\n".join(worse_than_constant(comparisons))
    physics = extra(Extra.PHYSICS, partial(_physics, judgement), "")
    return (
        table(comparisons), poor, summary(comparisons), physics, _grave(judgement), _simpler(judgement)
    )  # fmt: skip


def _physics(judgement: Judgement) -> str:
    return "\n".join(line for c in judgement.comparisons.values() for line in physics_words(c))


def _grave(judgement: Judgement) -> str:
    """Dangers and warnings; notes are on the page."""
    grave = [c for c in judgement.cautions if c.level in ("danger", "warning")]
    return "\n".join(fold(one_line(f"caution: {c.text} Try: {c.todo}")) for c in grave)


def _simpler(judgement: Judgement) -> str:
    """The cheapest way to fewer words of every channel with several rules."""
    lines = []
    for channel, d in judgement.context.diagnoses.items():
        checks = d.checks.get(judgement.comparisons[channel].contender or "")
        if checks is not None and checks.simpler:
            lines.append(f"{channel}: simpler rules: {checks.simpler[0]} RMSE on the training flights")
    return "\n".join(fold(one_line(line)) for line in lines)
