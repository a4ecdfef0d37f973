"""Runs as the page shows them: verdicts with scope and interval, the page of a run, its models."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from flysid.errors import FlysidError
from flysid.extras import Extra, Missing, extra
from flysid.foreign import read_object
from flysid.studio.folders import NotThere, Workspace
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.runs.history import RunChannel, run_channels
from flysid.validate.runs.run import DOCUMENT, PAGE, REPORT, RUN_FILE, open_run, run_file

_JUDGED = f"{REPORT}/{DOCUMENT}"


def list_runs(workspace: Workspace) -> dict[str, Any]:
    """Every channel of every run, the newest run first, and the runs that cannot be read with the reason."""
    rows: list[dict[str, Any]] = []
    damaged: list[dict[str, str]] = []
    for run_id, folder in workspace.run_folders().items():
        missing = Missing()
        with missing.gathering():
            found = extra(Extra.RUN_LISTED, partial(_listed, run_id, folder), None)
        if isinstance(found, dict):
            rows.append(found)
        else:
            reason = found or " ".join(missing.sentences)
            damaged.append({"run": str(folder), "reason": reason})
    rows.sort(key=lambda row: row["fitted_at"], reverse=True)
    return {"runs": rows, "damaged": damaged}


def _listed(run_id: str, folder: Path) -> dict[str, Any] | str:
    """A run, or why it cannot be read."""
    try:
        return _summarise(run_id, folder)
    except FlysidError as error:
        return error.advice


def describe_run(workspace: Workspace, run_id: str) -> dict[str, Any]:
    """What a run holds: its settings, models, and its report's numbers where it was judged."""
    folder = workspace.run(run_id)
    listed = _summarise(run_id, folder)
    return {**listed, "run": _document(folder, RUN_FILE), "report": _document(folder, _JUDGED)}


def page_of(workspace: Workspace, run_id: str) -> Path:
    """The run's own page; raises NotThere where it was not judged."""
    path = run_file(workspace.run(run_id), f"{REPORT}/{PAGE}")
    if not path.is_file():
        raise NotThere("the run has not been judged", path=path.parent.parent, hint="validate it")
    return path


def file_of(workspace: Workspace, run_id: str, name: str) -> Path:
    """A file of the run's report; raises NotThere."""
    folder = workspace.run(run_id)
    if name not in _files(folder):
        raise NotThere(f"the report has no file {name!r}", path=folder, hint="validate it")
    return run_file(folder, f"{REPORT}/{name}")


def _files(folder: Path) -> list[str]:
    """What the report's folder holds."""
    place = folder / REPORT
    return sorted(path.name for path in place.iterdir() if path.is_file()) if place.is_dir() else []


def model_of(workspace: Workspace, run_id: str, channel: str, label: str) -> bytes:
    """A model's file, as it is; raises NotThere, and StoreError where the run names another file."""
    folder = workspace.run(run_id)
    for found in open_run(folder).channels:
        if found.name == channel and label in found.models:
            path = run_file(folder, found.models[label])
            if not path.is_file():
                raise NotThere("a model of the run is missing", path=path, hint="fit it again")
            return path.read_bytes()
    raise NotThere(f"run {run_id} has no model {label!r} of channel {channel!r}")


def _summarise(run_id: str, folder: Path) -> dict[str, Any]:
    channels = run_channels(folder)
    document = _document(folder, RUN_FILE) or {}
    judged = (_document(folder, _JUDGED) or {}).get("channels", {})
    return {
        "id": run_id,
        "folder": str(folder),
        "name": folder.name,
        "data": str(document.get("data", "")),
        "recipe": channels[0].recipe if channels else "",
        "fitted_at": channels[0].fitted_at if channels else "",
        "settings": document.get("settings", {}),
        "judged": (folder / REPORT / PAGE).is_file(),
        "files": _files(folder),
        "models": {c["name"]: sorted(c["models"]) for c in document.get("channels", [])},
        "channels": [_channel(c, judged.get(c.channel, {}).get(FREE_RUN, {})) for c in channels],
    }


def _channel(channel: RunChannel, free: dict[str, Any]) -> dict[str, Any]:
    return {
        "channel": channel.channel,
        "verdict": channel.verdict,
        "scope": free.get("scope", ""),
        "change_pct": channel.change_pct,
        "interval_pct": free.get("ci95"),
        "rmse": dict(channel.rmse),
        "unit": channel.unit,
        "baseline": channel.baseline,
        "contender": channel.fuzzy,
        "held_out": channel.held_out,
    }


def _document(folder: Path, name: str) -> dict[str, Any] | None:
    path = run_file(folder, name)
    return read_object(path, "a document of a run", "fit it again") if path.is_file() else None
