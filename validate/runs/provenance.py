"""How a run came about, for whoever makes it again: its command line, data, split, seeds and versions."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from flysid.validate.runs.run import FitSettings, HeldOut, Run

FIT_TIME = ": fit time"  # on the page only: equal runs give equal documents


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


def provenance_of(run: Run, held: Sequence[HeldOut]) -> dict[str, str]:
    """Label -> value, as the page shows it under Reproduce."""
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
