"""Logs as a review reads them, from a log, a folder of logs or an ingested folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.cli.checks import Words
from flysid.cli.source import READING_OF_A_LOOK, opened_flights

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.reviews.logged import LoggedFlight


@contextmanager
def reviewed_logs(source: Path, told: Words, selection: Selection) -> Iterator[list[LoggedFlight]]:
    """The chosen flights; they can be read within this block.

    Raises
    ------
    UsageError, FormatError : see `flysid.cli.source.opened_flights`.
    """
    from flysid.ingest.lake.chosen_flights import select
    from flysid.progress import part
    from flysid.reviews.logged import LoggedFlight

    with opened_flights(source, told, selection=selection) as lake, part(READING_OF_A_LOOK):
        yield [
            LoggedFlight(log, log.manifest.damage, log.manifest.source.name)
            for log in select(lake, selection).logs
        ]
