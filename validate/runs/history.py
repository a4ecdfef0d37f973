"""Run folders side by side: what was fitted, the verdict; ranked where they can be compared.

Errors of two runs say which is better only where both were measured on the same held-out samples, so runs are
ranked within a recipe, a channel and a held-out part (identified by its hash), never across them.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from flysid.errors import StoreError, UsageError
from flysid.files import remedy_unread, why_unread
from flysid.manifest import DATA_FILE
from flysid.model.structures import leaders
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare.words import named
from flysid.validate.runs.run import DOCUMENT, REPORT, RUN_FILE, Run, open_run, run_file

NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class RunChannel:
    """One channel (and output) of a run.

    `folder`: the run's.
    `fitted_at`: when run.json was written, ISO 8601 in UTC.
    `rmse`: label -> free-run RMSE on the held-out part, in `unit`; empty where the run was not judged.
    `verdict`: of the contender against the baseline in free run, or NOT_JUDGED.
    `held_out`: hash of the held-out part, "" where the run was not judged.
    `baseline`: label of the linear model that the verdict is against, "" where the run was not judged.
    `rank`: 1 for the smallest error on this held-out part (best model of each run); None where not judged.
    """

    folder: str
    recipe: str
    channel: str
    fitted_at: str
    rmse: Mapping[str, float]
    unit: str
    change_pct: float | None
    verdict: str
    held_out: str
    baseline: str = ""
    rank: int | None = None

    @property
    def fuzzy(self) -> str | None:
        """Label of the fuzzy model that the verdict is about."""
        return next((label for label in leaders() if label in self.rmse), None)

    @property
    def best(self) -> float:
        """The smallest free-run error of its models; infinite where there is none."""
        return min(self.rmse.values(), default=math.inf)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def find_runs(folders: Sequence[str | Path]) -> list[Path]:
    """Run folders in and below `folders`, sorted; ingested folders and hidden ones are not entered.

    Raises UsageError: one of `folders` does not exist, or no run was found.
    """
    found: dict[Path, None] = {}
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise UsageError("no such folder", path=folder)
        found |= dict.fromkeys(sorted(walk(folder)))
    if not found:
        raise UsageError(
            "no run found",
            path=", ".join(map(str, folders)),
            hint="make one with 'flysid fit DATA --recipe R -o RUN'",
        )
    return list(found)


def walk(folder: Path, *, depth: int = 4) -> Iterator[Path]:
    """Run folders in and below one folder. `depth`: folders below the given one."""
    for place, below, files in os.walk(folder):
        if RUN_FILE in files:
            yield Path(place)
        deep = len(Path(place).relative_to(folder).parts) >= depth
        if deep or RUN_FILE in files or DATA_FILE in files:
            below.clear()
        below[:] = [name for name in below if not name.startswith(".")]


def run_channels(folder: str | Path) -> list[RunChannel]:
    """The channels of one run, with the verdict of the report in its folder where there is one.

    Raises UsageError, StoreError: the run or its report is damaged or of another version.
    """
    run = open_run(folder)
    judged = _judge(run)
    if judged is not None:
        return judged
    return [_leave_unjudged(run, channel.name) for channel in run.channels]


def ranked(channels: Sequence[RunChannel]) -> list[RunChannel]:
    """By recipe, channel and held-out part, there the smallest error first, with ranks filled in."""
    order = sorted(channels, key=lambda c: (*_place(c), c.best, c.folder))
    found: list[RunChannel] = []
    for _, group in groupby(order, key=_place):
        for number, channel in enumerate(group, start=1):
            found.append(replace(channel, rank=number if channel.rmse else None))
    return found


def _place(channel: RunChannel) -> tuple[str, str, bool, str]:
    return channel.recipe, channel.channel, not channel.held_out, channel.held_out


def _leave_unjudged(run: Run, channel: str) -> RunChannel:
    return RunChannel(
        str(run.folder), run.recipe, channel, _fitted_at(run), {}, "", None, NOT_JUDGED, held_out=""
    )


def _fitted_at(run: Run) -> str:
    written = datetime.fromtimestamp((run.folder / RUN_FILE).stat().st_mtime, UTC)
    return written.isoformat(timespec="seconds")


def _judge(run: Run) -> list[RunChannel] | None:
    """The channels as the run's report tells of them; None where there is no report."""
    path = run_file(run.folder, f"{REPORT}/{DOCUMENT}")
    if not path.is_file():
        return None
    try:
        document = json.loads(path.read_text("utf-8"))
        about = document["about"]
        return [
            _channel(run, name, body[FREE_RUN], about[name if name in about else name.rpartition("/")[0]])
            for name, body in document["channels"].items()
        ]
    except OSError as error:
        raise StoreError(
            f"the report cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError) as error:
        raise StoreError(
            "the report of the run is damaged", path=path, hint=f"flysid validate {run.folder} --force"
        ) from error


def _verdict(free: Mapping[str, Any]) -> str:
    """ "better", or "better, not than ARX" where another linear model does as well."""
    words = str(free["verdict"] or free["reason"])
    short = named([str(n) for n in free.get("short_of", ())]) if words == Verdict.BETTER else ""
    return f"{words}, not than {short}" if short else words


def _channel(run: Run, name: str, free: Mapping[str, Any], about: Mapping[str, Any]) -> RunChannel:
    change = free["change_pct"]
    rmse = {str(m): float(s["rmse"]) for m, s in free["models"].items() if s["rmse"] is not None}
    return RunChannel(
        folder=str(run.folder),
        recipe=run.recipe,
        channel=str(name),
        fitted_at=_fitted_at(run),
        rmse=rmse,
        unit=str(free["unit"]),
        change_pct=None if change is None else float(change),
        verdict=_verdict(free),
        held_out=str(about["test_sha256"]),
        baseline=str(about.get("baseline", "arx")),
    )
