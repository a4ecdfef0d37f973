"""What can be known wrong of a command line before any log is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.ingest.formats.base import Limits
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.ingest.lake.finding import FoundLogs

SHOWN = 8
"""Names of logs in a message."""


@dataclass(frozen=True)
class Reading:
    """How a source is read: by a recipe or from fields to fields, and what its times, dates and bytes are."""

    recipe: str = ""
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    dt: float | None = None
    time_unit: str = ""
    date_order: str = ""
    format: str = ""

    @property
    def limits(self) -> Limits:
        """How a log is to be read."""
        from flysid.ingest.formats.base import Limits

        return Limits(time_unit=self.time_unit, date_order=self.date_order, format=self.format)


@dataclass(frozen=True)
class Request:
    """A verb's request about flights, checked as far as possible before they are read.

    `channels`: of the recipe; empty: all.
    `held`: parts of flights that are held out.
    `chooses`: whether the verb finds a recipe by itself where neither one nor fields are given.
    """

    reading: Reading
    selection: Selection
    channels: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    chooses: bool = False

    @property
    def is_open(self) -> bool:
        """Whether a recipe is still to be chosen."""
        return self.chooses and not (self.reading.recipe or self.reading.inputs)


def check_source(data: Path, request: Request) -> FoundLogs | None:
    """The logs that are to be read; None of an ingested folder.

    Raises UsageError: what the command line names cannot be; neither a recipe nor fields, or both; no such
    file or folder, or no log in it; a unit of time for an ingested folder. Raises RecipeError: no such
    recipe, or it has no such channel.
    """
    check_reading(request.reading, request.channels)
    if request.is_open and request.channels:
        from flysid.ingest.lake.recipe_choice import check_shipped_channels

        check_shipped_channels(request.channels)
    if is_ingested(data):
        refuse_reading_again(data, request.reading)
        return None
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.workers import Bounds

    logs = find_logs([data], Bounds())
    check_flights(logs, data, request.selection, request.held)
    if not request.chooses:
        require_recipe(request.reading, logs, data)
    return logs


def check_reading(reading: Reading, channels: Sequence[str]) -> None:
    """Raise UsageError where a recipe or fields cannot be meant as they are given.

    A recipe is read, and has the channels; of fields there is an input and an output.
    """
    fields = reading.inputs or reading.outputs
    if reading.recipe and (fields or reading.dt is not None):
        raise UsageError(
            "--recipe and --from, --to or --dt are mutually exclusive", hint="leave out one or the other"
        )
    if reading.recipe:
        from flysid.ingest.align.recipe import load_recipe

        load_recipe(reading.recipe).chosen(channels)
    elif fields and not (reading.inputs and reading.outputs):
        lacking = "--to FIELD" if reading.inputs else "--from FIELD"
        raise UsageError(
            f"no {'output' if reading.inputs else 'input'} is named",
            hint=f"add {lacking}; 'flysid show LOG --fields' lists the fields",
        )
    elif both := sorted({*reading.inputs} & {*reading.outputs}):
        raise UsageError(f"{both[0]!r} is both input and output", hint="--to takes what answers --from")
    elif reading.dt is not None and not fields:
        from flysid.ingest.align.quick import NEITHER

        raise UsageError(NEITHER, hint="--dt is of a table's fields: add --from FIELD --to FIELD")


def check_flights(logs: FoundLogs, place: Path, selection: Selection, held: Sequence[str] = ()) -> None:
    """Raise UsageError where flights are named that none of the logs can become: ids begin with logs' names.

    `place`: where the user finds the logs.
    `held`: parts of flights to hold out, as `parse_part` reads them.
    """
    from flysid.files import slug
    from flysid.ingest.formats.common.packed_names import own_name
    from flysid.ingest.lake.stretches import parse_part
    from flysid.showing import first_of, one_of

    parts = [parse_part(text).flight for text in (*selection.stretches.without, *held)]
    stems = list(dict.fromkeys(slug(Path(own_name(path.name)).stem) for path in logs.paths))
    for name in (*selection.flights, *selection.exclude, *parts):
        if not any(_may_name(name, stem) for stem in stems):
            few = len(stems) <= SHOWN
            hint = one_of(stems, name) if few else f"one of {first_of(sorted(stems), SHOWN)}"
            raise UsageError(f"no flight {name!r}", path=place, hint=hint)


def _may_name(name: str, stem: str) -> bool:
    """Whether a name may be the beginning of the id that a log with this stem gets: STEM-HASH."""
    return stem.startswith(name) or re.fullmatch(rf"{re.escape(stem)}(-[0-9a-f]*)?", name) is not None


def require_recipe(reading: Reading, logs: FoundLogs, place: Path) -> None:
    """Raise UsageError where neither a recipe nor fields are given: the first log tells which fit."""
    if reading.recipe or reading.inputs:
        return
    from flysid.ingest.align.quick import NEITHER
    from flysid.ingest.lake.beginning import recipes_by_beginning

    fitting = recipes_by_beginning(logs.paths[0], reading.limits) if logs.paths else {}
    if fitting:
        hint = f"--recipe {', or --recipe '.join(fitting)}; 'flysid ls {place} --suggest' says how well"
    else:
        hint = (
            f"--recipe R, or --from FIELD --to FIELD; 'flysid recipes --for {place}' lists the recipes that "
            f"fit, 'flysid show {place} --fields' the fields"
        )
    raise UsageError(NEITHER, path=place, hint=hint)


def refuse_reading_again(data: Path, reading: Reading) -> None:
    """Raise UsageError where words say how to read what has been read."""
    if reading.time_unit or reading.date_order or reading.format:
        raise UsageError(
            "ingested data already have their format and times",
            path=data,
            hint="flysid ingest --format, --time-unit or --date-order reads a log again",
        )


def is_ingested(data: Path) -> bool:
    """Whether `flysid ingest` made this folder; anything else names logs."""
    from flysid.manifest import DATA_FILE

    return (data / DATA_FILE).is_file()
