"""Where the studio keeps what it makes: one folder beside the data, nothing in a database."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flysid.errors import UsageError
from flysid.files import remove_left_behind, writing_to
from flysid.foreign import inner_path

VIEWS = ".views-"
"""Begins the names of folders that hold what a studio has drawn, for as long as it runs."""


class NotThere(UsageError):
    """The requested thing does not exist (404)."""


@dataclass(frozen=True)
class Workspace:
    """The ingested folder, and `DATA.studio` beside it.

    `data`: the ingested folder.
    `more_runs`: further folders in which runs are looked for.
    """

    data: Path
    more_runs: tuple[Path, ...] = ()

    @property
    def folder(self) -> Path:
        return self.data.with_name(f"{self.data.name}.studio")

    @property
    def uploads(self) -> Path:
        return self.folder / "uploads"

    @property
    def jobs(self) -> Path:
        return self.folder / "jobs"

    @property
    def runs(self) -> Path:
        return self.folder / "runs"

    @property
    def recipes(self) -> Path:
        return self.folder / "recipes"

    def run_folders(self) -> dict[str, Path]:
        """Runs by a short id of their place: the studio's own, those beside the data, and further ones."""
        from flysid.validate.runs.history import walk
        from flysid.validate.runs.run import RUN_FILE

        beside = (p.parent for p in self.data.absolute().parent.glob(f"*/{RUN_FILE}"))
        further = (run for folder in (self.runs, *self.more_runs) for run in walk(folder))
        return {short_id(folder): folder for folder in (*beside, *further)}

    def run(self, run_id: str) -> Path:
        """The folder of a run; raises NotThere."""
        found = self.run_folders().get(run_id)
        if found is None:
            raise NotThere(f"no run {run_id!r}", path=self.folder)
        return found

    def recipe_of_run(self, run_id: str) -> Path:
        """The recipe that a run was fitted by, as it was; raises NotThere."""
        from flysid.validate.runs.run import RECIPE_FILE, run_file

        path = run_file(self.run(run_id), RECIPE_FILE)
        if not path.is_file():
            raise NotThere("the run has no recipe", path=path.parent)
        return path


_NAME = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9._-]{1,160}")


def is_name(text: str) -> bool:
    """Whether a text can be the name of a folder that the studio or ingestion has made."""
    return _NAME.fullmatch(text) is not None


def short_id(path: Path) -> str:
    """Eight letters that stand for a place."""
    return hashlib.sha256(str(path.absolute()).encode()).hexdigest()[:8]


def open_workspace(data: Path, more_runs: Sequence[Path] = ()) -> Workspace:
    """Make the folders that are missing.

    Raises UsageError: `data` exists and is not an ingested folder. Raises WriteError: the folders cannot be
    made. Raises StoreError: one of them is a link that leads elsewhere.
    """
    if data.is_file():
        raise UsageError(
            "a log, not a folder of flights",
            path=data,
            hint=f"flysid ingest {data} -o data; flysid studio data",
        )
    from flysid.store import create_data_folder, tidy

    tidy(create_data_folder(data))
    workspace = Workspace(data, tuple(more_runs))
    for folder in (workspace.uploads, workspace.jobs, workspace.runs, workspace.recipes):
        inner_path(workspace.folder, folder.name, workspace.folder)
        with writing_to(folder):
            folder.mkdir(parents=True, exist_ok=True)
    remove_left_behind(workspace.folder, VIEWS)
    return workspace
