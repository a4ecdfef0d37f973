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
class Words:
    """What the command line says of the channels: a recipe, or from which fields to which."""

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
class Asked:
    """What a verb is asked to do with flights, as far as it can be wrong before they are read.

    Attributes
    ----------
    channels : of the recipe; empty: all.
    held : parts of flights that are held out.
    chooses : whether the verb finds a recipe by itself where neither one nor fields are given.
    """

    words: Words
    selection: Selection
    channels: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    chooses: bool = False

    @property
    def is_open(self) -> bool:
        """Whether a recipe is still to be chosen."""
        return self.chooses and not (self.words.recipe or self.words.inputs)


def check_source(data: Path, asked: Asked) -> FoundLogs | None:
    """The logs that are to be read; None of an ingested folder.

    Raises
    ------
    UsageError : what the command line names cannot be; neither a recipe nor fields, or both; no such file
        or folder, or no log in it; a unit of time for an ingested folder.
    RecipeError : no such recipe, or it has no such channel.
    """
    check_words(asked.words, asked.channels)
    if asked.is_open and asked.channels:
        from flysid.ingest.lake.recipe_choice import check_shipped_channels

        check_shipped_channels(asked.channels)
    if is_ingested(data):
        refuse_reading_again(data, asked.words)
        return None
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.workers import Bounds

    logs = find_logs([data], Bounds())
    check_flights(logs, data, asked.selection, asked.held)
    if not asked.chooses:
        refuse_without_words(asked.words, logs, data)
    return logs


def check_words(words: Words, channels: Sequence[str]) -> None:
    """Raise UsageError where a recipe or fields cannot be meant as they are given.

    A recipe is read, and has the channels; of fields there is an input and an output.
    """
    fields = words.inputs or words.outputs
    if words.recipe and (fields or words.dt is not None):
        raise UsageError(
            "--recipe and --from, --to or --dt are mutually exclusive", hint="leave out one or the other"
        )
    if words.recipe:
        from flysid.ingest.align.recipe import load_recipe

        load_recipe(words.recipe).chosen(channels)
    elif fields and not (words.inputs and words.outputs):
        lacking = "--to FIELD" if words.inputs else "--from FIELD"
        raise UsageError(
            f"no {'output' if words.inputs else 'input'} is named",
            hint=f"add {lacking}; 'flysid show LOG --fields' lists the fields",
        )
    elif both := sorted({*words.inputs} & {*words.outputs}):
        raise UsageError(f"{both[0]!r} is both input and output", hint="--to takes what answers --from")
    elif words.dt is not None and not fields:
        from flysid.ingest.align.quick import NEITHER

        raise UsageError(NEITHER, hint="--dt is of a table's fields: add --from FIELD --to FIELD")


def check_flights(logs: FoundLogs, place: Path, selection: Selection, held: Sequence[str] = ()) -> None:
    """Raise UsageError where flights are named that none of the logs can become: ids begin with logs' names.

    Parameters
    ----------
    place : where the user finds the logs.
    held : parts of flights to hold out, as `parse_part` reads them.
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


def refuse_without_words(words: Words, logs: FoundLogs, place: Path) -> None:
    """Raise UsageError where neither a recipe nor fields are given: the first log tells which fit."""
    if words.recipe or words.inputs:
        return
    from flysid.ingest.align.quick import NEITHER
    from flysid.ingest.lake.beginning import recipes_by_beginning

    fitting = recipes_by_beginning(logs.paths[0], words.limits) if logs.paths else {}
    if fitting:
        hint = f"--recipe {', or --recipe '.join(fitting)}; 'flysid ls {place} --suggest' says how well"
    else:
        hint = (
            f"--recipe R, or --from FIELD --to FIELD; 'flysid recipes --for {place}' lists the recipes that "
            f"fit, 'flysid show {place} --fields' the fields"
        )
    raise UsageError(NEITHER, path=place, hint=hint)


def refuse_reading_again(data: Path, words: Words) -> None:
    """Raise UsageError where words say how to read what has been read."""
    if words.time_unit or words.date_order or words.format:
        raise UsageError(
            "ingested data already have their format and times",
            path=data,
            hint="flysid ingest --format, --time-unit or --date-order reads a log again",
        )


def is_ingested(data: Path) -> bool:
    """Whether `flysid ingest` made this folder; anything else names logs."""
    from flysid.manifest import DATA_FILE

    return (data / DATA_FILE).is_file()
