"""What verbs read may be at an address: a lake, or a log in an object store."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from flysid.errors import UsageError


class SourcePath(click.Path):
    """A path, or an address whose content is had as a path: a lake by its mirror, a log as a copy."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from flysid.place import is_address

        return here(value) if is_address(value) else super().convert(value, param, ctx)


SOURCE = SourcePath()


def here(address: str) -> Path:
    """The mirror of the lake at an address, or a copy of the log that is there.

    Raises UsageError: neither is there.
    """
    from flysid.ingest.formats.rosbag2.side_files import names_beside
    from flysid.manifest import DATA_FILE, check_lake
    from flysid.mirror import log_at
    from flysid.place import Place
    from flysid.store import mirror_of

    place = Place(address.rstrip("/"))
    document = place.read_if_there(DATA_FILE)
    if document is not None:
        check_lake(document, str(place))
        return mirror_of(str(place))
    found = log_at(place, names_beside)
    if found is None:
        raise UsageError(
            "neither a log nor a lake",
            path=address,
            hint=f"a folder of logs: flysid ingest {address} -o s3://LAKE",
        )
    return found
