"""A run's models against each other on its held-out part: the comparison, its table, JSON and page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from flysid.catalogue import FlightFacts
from flysid.errors import DataError, StoreError, UsageError
from flysid.extras import Extra, Missing, extra
from flysid.files import replacing_folder, write_atomically
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.lake import open as open_lake
from flysid.loops.judged import Judged, judge, states_gains
from flysid.progress import tell
from flysid.showing import fold
from flysid.validate.compare.condition import matching_channels
from flysid.validate.compare.words import one_line, physics_words
from flysid.validate.compare_models import Comparison, across_channels, compare
from flysid.validate.diagnose.caution import Caution
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.runs.fitone import nothing_done
from flysid.validate.runs.judgedparts import chosen_lake, restrict
from flysid.validate.runs.run import (
    Beside,
    FitSettings,
    HeldOut,
    Run,
    asked_for,
    held_out,
    run_file,
    with_models,
)
from flysid.validate.show.document import plain, to_json
from flysid.validate.show.page.context import ReportContext
from flysid.validate.show.page.html import plain_page
from flysid.validate.show.page.narrative import worse_than_constant
from flysid.validate.show.page.page import render
from flysid.validate.show.paperfigures import require_matplotlib, write_figures
from flysid.validate.show.tables import to_csv, to_markdown
from flysid.validate.show.terminal import summary, table

PAGE = "report.html"
DOCUMENT = "report.json"
REPORT = "report"
"""Folder of the report inside a run, where none is named."""
FIT_TIME = ": fit time"  # on the page only: equal runs give equal documents


@dataclass(frozen=True)
class Judgement:
    """What was found on the held-out part.

    Attributes
    ----------
    comparisons : by channel, corrected over channels.
    skipped : channels that are not in `comparisons`, with the reason.
    context : all that the page is drawn from.
    unjudged : those of `skipped` that were fitted, and should have been judged.
    """

    run: Run
    comparisons: Mapping[str, Comparison]
    skipped: Mapping[str, str]
    context: ReportContext
    unjudged: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """The comparison as JSON types: {"channels": {NAME: {HORIZON: {...}}}, ...}.

        "missing" holds a sentence on every extra that could not be given; it is not there where none is.
        """
        context = self.context
        with context.missing.gathering():
            found = to_json(self.comparisons, context.diagnoses, context.doubts) | {
                "skipped": dict(self.skipped),
                "provenance": {k: v for k, v in context.provenance.items() if not k.endswith(FIT_TIME)},
                "gains": extra(Extra.GAINS, lambda: plain([j.to_dict() for j in context.loops]), ()),
                "fit_seconds": {name: dict(times) for name, times in context.fit_seconds.items()},
            }
        return found | context.missing.to_dict()

    @property
    def table(self) -> str:
        """The comparison for a terminal: every model, channel and horizon, verdicts in words, warnings."""
        poor = "\n".join(worse_than_constant(self.comparisons))
        with self.context.missing.gathering():
            physics = extra(Extra.PHYSICS, self._physics, "")
            beside = [physics, *self._grave(), *self._simpler()]
        missing = "\n".join(fold(one_line(words)) for words in self.context.missing.sentences)
        parts = [table(self.comparisons), poor, summary(self.comparisons), *beside, missing]
        return "\n\n".join(part for part in parts if part)

    def _physics(self) -> str:
        return "\n".join(line for c in self.comparisons.values() for line in physics_words(c))

    def _grave(self) -> list[str]:
        """Dangers and warnings; notes are on the page."""
        grave = [c for c in self.cautions if c.level in ("danger", "warning")]
        lines = [f"caution: {c.text} Try: {c.todo}" for c in grave]
        return ["\n".join(fold(one_line(line)) for line in lines)] if lines else []

    def _simpler(self) -> list[str]:
        """The cheapest way to fewer words of every channel with several rules."""
        lines = []
        for channel, d in self.context.diagnoses.items():
            checks = d.checks.get(self.comparisons[channel].contender or "")
            if checks is not None and checks.simpler:
                lines.append(f"{channel}: simpler rules: {checks.simpler[0]} RMSE on the training flights")
        return ["\n".join(fold(one_line(line)) for line in lines)] if lines else []

    def text(self, form: str = "table") -> str:
        """The comparison as "table", "json", "markdown" or "csv", without a line break at the end.

        Raises
        ------
        UsageError : another form.
        """
        forms: dict[str, Callable[[], str]] = {
            "table": lambda: self.table,
            "json": lambda: json.dumps(self.document, indent=1, allow_nan=False),
            "markdown": self._markdown,
            "csv": lambda: to_csv(self.comparisons),
        }
        if form not in forms:
            raise UsageError(f"no form {form!r} of a comparison", hint=f"one of {', '.join(forms)}")
        return forms[form]().rstrip("\n")

    def _markdown(self) -> str:
        return to_markdown(self.comparisons, self.context.fit_seconds, self.cautions, self.skipped)

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """What to beware of, worst first; as on the page."""
        with self.context.missing.gathering():
            return cautions(self.comparisons, self.context.diagnoses, self.context.doubts)

    def violations(self, condition: str) -> dict[str, str]:
        """The channels on which a `--fail-if` condition holds, each with why it could not be judged, or "".

        Raises UsageError where it is not understood.
        """
        return matching_channels(condition, self.document)


def judge_run(
    run: Run,
    data: str | Path | None = None,
    only: Selection | None = None,
    beside: Beside = MappingProxyType({}),
) -> Judgement:
    """Compare every channel of a run on its held-out part; tells of its progress (`flysid.progress`).

    Parameters
    ----------
    data : the ingested folder, where it moved since the fit.
    only : judge on these of the held-out flights and stretches alone.
    beside : further models, by channel and label, that are judged on the same flights as the run's.

    Raises
    ------
    DataError : no channel can be judged, or the data differs from what was fitted.
    StoreError, UsageError : the run or the data folder cannot be read.
    """
    tell("aligning the held-out part", share=0.0)
    chosen = None if only is None else chosen_lake(run, data, only)  # from the catalogue: before tables
    missing = Missing(*run.missing)
    with missing.gathering():
        held = [with_models(item, beside.get(item.channel.name, {})) for item in held_out(run, data)]
    judged_with = [] if only is None else [f"judged with {' '.join(only.options)}"]
    remark = "; ".join([*([run.settings.remark] if run.settings.remark else []), *judged_with])
    comparisons: dict[str, Comparison] = {}
    failed: dict[str, DataError] = {}
    for i, item in enumerate(held):
        tell("comparing on held-out segments", channel=item.channel.name, share=(i + 1) / (len(held) + 1))
        try:
            judged = item if chosen is None else restrict(item, chosen)
            comparisons[item.channel.name] = compare(
                item.models,
                judged.test,
                baseline=item.channel.baseline,
                contender=asked_for(run.settings.labels, item.models, item.channel.baseline),
                seen=item.seen,
                turns=judged.turns,
            )
        except DataError as error:
            failed[item.channel.name] = error
    if not comparisons:
        raise nothing_done(run.recipe, "judged", {name: str(error) for name, error in failed.items()})
    corrected = across_channels(comparisons)
    skipped = {**run.skipped, **{name: error.advice for name, error in failed.items()}}
    with missing.gathering():
        context = _context(run, corrected, held, remark, data)
        loops = extra(Extra.GAINS, partial(_loops, run, data), ())
    context = replace(context, skipped=skipped, loops=loops, missing=missing)
    return Judgement(run, corrected, skipped, context, tuple(failed))


def write_judgement(judgement: Judgement, folder: Path, figures: str | None = None) -> Path:
    """Write report.html and report.json; returns the page's path. The folder appears whole.

    Parameters
    ----------
    figures : "pdf", "svg" or "png": figures for a paper beside the page, one per channel and output.

    Raises
    ------
    UsageError : matplotlib is needed and not installed. WriteError : nothing can be written there.
    """
    with replacing_folder(folder) as incoming:
        judgement.document  # noqa: B018 - all but pictures is tried here, and told
        tell("drawing the page", share=0.9)
        if figures is not None:
            require_matplotlib()
            _draw(judgement, incoming, figures)
        write_atomically(incoming / PAGE, _page(judgement).encode())
        write_atomically(incoming / DOCUMENT, _written(judgement))
    return folder / PAGE


def _draw(judgement: Judgement, folder: Path, kind: str) -> None:
    context = judgement.context
    with context.missing.gathering():
        extra(Extra.FIGURES, partial(write_figures, folder, context, kind), ())


def _page(judgement: Judgement) -> str:
    """The page; where it breaks as a whole, the comparison as it is printed."""
    context = judgement.context
    with context.missing.gathering():
        page = extra(Extra.PAGE, partial(render, context), "")
    return page or plain_page(judgement.table)


def remember(judgement: Judgement) -> None:
    """Leave the document in the run, where `flysid runs` looks; one that cannot be written stays as it is."""
    extra(Extra.REMEMBERED, partial(_remember, judgement), None)


def _remember(judgement: Judgement) -> None:
    with suppress(OSError, StoreError):
        place = run_file(judgement.run.folder, REPORT)
        place.mkdir(exist_ok=True)
        write_atomically(place / DOCUMENT, _written(judgement))


def _written(judgement: Judgement) -> bytes:
    return (json.dumps(judgement.document, indent=1, allow_nan=False) + "\n").encode()


def _context(
    run: Run,
    comparisons: Mapping[str, Comparison],
    held: list[HeldOut],
    remark: str,
    data: str | Path | None,
) -> ReportContext:
    return ReportContext(
        comparisons=comparisons,
        train={h.channel.name: h.train for h in held},
        command=f"{fit_command(run)} -o RUN && flysid validate RUN",
        provenance=_provenance(run, held),
        remark=remark,
        fit_seconds={h.channel.name: dict(h.channel.fit_seconds) for h in held},
        flights=extra(Extra.FLIGHTS, partial(_flights, run, data), ()),
        doubts={h.channel.name: h.channel.doubts for h in held if h.channel.name in comparisons},
    )


def _flights(run: Run, data: str | Path | None) -> tuple[FlightFacts, ...]:
    """What the catalogue knows of the run's flights; a dataset file has none."""
    return open_lake(data or run.data).only(run.flights).facts if run.recipe else ()


def _loops(run: Run, data: str | Path | None) -> tuple[Judged, ...]:
    """What the gains in the logs of the run's flights mean; nothing where no axis could be judged."""
    if not run.recipe:
        return ()
    logs = [log for log in open_lake(data or run.data).only(run.flights).logs if states_gains(log)]
    if logs:
        tell("measuring the loops of the logged gains")
    found = judge(logs)
    return tuple(found) if any(j.margins is not None for j in found) else ()


def fit_command(run: Run) -> str:
    """The command line that fits the run again, without its folder.

    Every word is quoted: a run may be a stranger's, and the line is there to be copied into a shell.
    """
    settings = run.settings
    words: list[tuple[str, object]] = [("--recipe", run.recipe)] if run.recipe else []
    words += [("--holdout", part) for part in settings.held] or [("--holdout", f"{settings.holdout:g}")]
    words += [("--by", settings.by), ("--seed", settings.seed), ("--rules", settings.rules)]
    words += [("--antecedent", name) for name in settings.antecedents]
    words += [("--channel", name) for name in settings.channels]
    more: list[tuple[str, object]] = [("--models", ",".join(settings.models))] if settings.models else []
    more += [("--effort", settings.effort)] if settings.effort != FitSettings.effort else []
    own = settings.flight_offsets
    more += [("--flight-offsets", own)] if own != FitSettings.flight_offsets else []
    rotates = [] if settings.rotate else ["--no-rotate"]
    memory = [] if settings.memory_mb == FitSettings.memory_mb else [f"--memory {settings.memory_mb:g}"]
    return " ".join(
        ["flysid fit DATA", *_quoted(words), *settings.selection.options, *_quoted(more), *rotates, *memory]
    )


def _quoted(words: Sequence[tuple[str, object]]) -> list[str]:
    return [f"{option} {shlex.quote(str(value))}" for option, value in words]


def split_words(split: Mapping[str, Any]) -> str:
    """ "by flight, 30 % held out, seed 7"."""
    return f"by {split['by']}, {100.0 * split['holdout']:.0f} % held out, seed {split['seed']}"


def _provenance(run: Run, held: list[HeldOut]) -> dict[str, str]:
    found = {"recipe": run.recipe, "flights": ", ".join(run.flights)}
    if options := run.settings.selection.options:
        found["chosen"] = " ".join(options)
    for item in held:
        split = item.channel.split
        name = item.channel.name
        found[f"{name}: split"] = split_words(split)
        if item.turns:
            found[f"{name}: verdict"] = (
                f"all flights left out in turn, in {len(item.turns)} folds; models from the split"
            )
        found[f"{name}: data sha256"] = str(split["data_sha256"])
        found[f"{name}: held-out sha256"] = str(split["test_sha256"])
        aligned = (line.strip().replace("; ", ", ") for line in item.channel.aligned)  # folded line by line
        found[f"{name}: alignment"] = "; ".join(aligned)
        found[f"{name}: baseline"] = f"{item.channel.baseline}; {item.channel.chosen}".removesuffix("; ")
        found[name + FIT_TIME] = ", ".join(f"{k} {v:.2f} s" for k, v in item.channel.fit_seconds.items())
        if item.channel.dead_times:
            found[f"{name}: dead time"] = "; ".join(item.channel.dead_times)
        for label in sorted(set(item.models) - set(item.channel.models)):
            found[f"{name}: {label}"] = " ".join(item.models[label].notes)
        for label, why in item.channel.failed.items():
            found[f"{name}: {label} not fitted"] = why
    return found | {f"version of {k}": v for k, v in run.versions.items()}
