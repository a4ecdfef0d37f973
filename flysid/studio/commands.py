"""What a person would type for what the page asks: every job is such a command."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flysid.errors import UsageError
from flysid.files import slug
from flysid.foreign import inner_path
from flysid.studio.folders import NotThere, Workspace
from flysid.studio.forms import Compare, Fit, Upload, Validate
from flysid.studio.jobs import Jobs, Lane

if TYPE_CHECKING:
    from flysid.studio.channels import Recipes

Planned = tuple[list[str], dict[str, str], list[str]]
"""The words of a command, what its job is about, and the words of the job that follows, if one does."""
SAMPLE = "sample-flight"
SAMPLE_FLIGHT = shlex.split("--plant ardrone --plan pilot --format ulog --duration 60 --no-truth")


def ingest(workspace: Workspace, log: Path, asked: Upload) -> tuple[list[str], Lane, dict[str, str]]:
    """Take a log in."""
    words = ["ingest", str(log), "-o", str(workspace.data), "--jobs", "1"]
    words += ["--format", asked.format] if asked.format else []
    words += ["--time-unit", asked.time_unit] if asked.time_unit else []
    words += ["--date-order", asked.date_order] if asked.date_order else []
    return words, "read", {"upload": log.parent.name, "name": log.name}


def sample(workspace: Workspace) -> Planned:
    """A simulated flight, and what takes it in."""
    workspace.uploads.mkdir(parents=True, exist_ok=True)
    folder = workspace.uploads / _free_name(workspace.uploads, SAMPLE)
    words = ["synth", "-o", str(folder), *SAMPLE_FLIGHT]
    return (
        words,
        {"name": "a simulated flight", "sample": folder.name},
        ["ingest", str(folder), "-o", str(workspace.data)],
    )


def suggestions(jobs: Jobs, workspace: Workspace, flight: str) -> dict[str, Any]:
    """What a flight can identify: from the newest job that has looked, else from one that begins now."""
    words = ["ls", str(workspace.data), "--suggest", "--json", "--flight", flight]
    own = [job for job in jobs.listing() if job.words == tuple(words)]
    job = own[0] if own else jobs.add(words, "read", {"flight": flight})
    if job.state in ("failed", "interrupted", "cancelled"):
        said = jobs.text(job.id, "log").decode("utf-8", "replace").strip()
        if len(own) > 1 or job.state == "failed":
            return {"state": job.state, "reason": said, "suggestions": []}
        job = jobs.add(words, "read", {"flight": flight})
    if job.state != "done":
        return {"state": job.state, "job": job.id, "suggestions": []}
    found = json.loads(jobs.text(job.id, "out"))["suggestions"]
    return {"state": "done", "suggestions": found}


def fit(workspace: Workspace, recipes: Recipes, asked: Fit) -> Planned:
    """A fit, and what judges its run.

    Raises
    ------
    UsageError : neither a recipe nor fields. NotThere : no such recipe.
    """
    if not asked.recipe and not (asked.inputs and asked.outputs):
        raise UsageError(
            "neither a recipe nor fields are given", hint="choose a recipe, or an input and an output"
        )
    words = ["fit", str(workspace.data)]
    words += ["--recipe", recipes.place(asked.recipe)] if asked.recipe else []
    for option, values in (
        ("--from", asked.inputs),
        ("--to", asked.outputs),
        ("--channel", asked.channels),
        ("--flight", asked.flights),
        ("--exclude", asked.exclude),
        ("--mode", asked.modes_flown),
        ("--holdout", asked.holdout),
    ):
        words += [word for value in values for word in (option, value)]
    for option, given in (
        ("--between", asked.between),
        ("--models", asked.models),
        ("--rules", asked.rules),
        ("--effort", asked.effort),
        ("--by", asked.by),
        ("--seed", asked.seed),
    ):
        words += [option, str(given)] if given not in ("", None) else []
    words += ["--keep-mishaps"] if asked.keep_mishaps else []
    run = workspace.runs / _free_name(workspace.runs, asked.name or asked.recipe or asked.outputs[0])
    return [*words, "-o", str(run)], {"run": str(run)}, ["validate", str(run)]


def validate(workspace: Workspace, asked: Validate) -> Planned:
    """The verdict on a run."""
    run = workspace.run(asked.run)
    more = ["--figures", asked.figures, "--force"] if asked.figures else []
    return ["validate", str(run), *more], {"run": str(run)}, []


def compare(workspace: Workspace, asked: Compare) -> Planned:
    """The comparison of two runs."""
    a = workspace.run(asked.a)
    b = workspace.run(asked.b)
    out = workspace.folder / "comparisons" / f"{asked.a}-{asked.b}"
    return ["compare", str(a), str(b), "-o", str(out), "--force"], {"comparison": out.name}, []


def comparison_page(workspace: Workspace, name: str) -> Path:
    """The page of a comparison; raises NotThere."""
    from flysid.validate.runs.run import PAGE

    path = inner_path(workspace.folder, f"comparisons/{name}/{PAGE}", workspace.folder)
    if slug(name) != name or not path.is_file():
        raise NotThere(f"no comparison {name!r}")
    return path


def shown(words: Sequence[str]) -> str:
    """As it is typed."""
    return shlex.join(["flysid", *words])


def _free_name(folder: Path, wish: str) -> str:
    """A name for a run that is not taken: the wish, or the wish and a number."""
    base = slug(Path(wish).stem)
    number = 1
    name = base
    while (folder / name).exists():
        number += 1
        name = f"{base}-{number}"
    return name
