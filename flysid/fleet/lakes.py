"""Lakes in object stores: how they are made and checked, and where things lie in them.

flysid-data.json                    format, version
flights/<hh>/<digits>/              manifest.json, the commit; <generation>/<stream>.parquet
catalog/flights/                    a Delta table: the index (flysid.ingest.lake.flighttable)
quarantine/<version>/<digest>.json  logs that cannot be read, and why; not tried again by this version
duplicates/<digest>.json            logs whose content another log had brought; archives that were taken in
"""

from __future__ import annotations

import json

from flysid.errors import UsageError
from flysid.manifest import DATA_FILE, DATA_FORMAT, LAKE_VERSION, check_lake
from flysid.place import Place

QUARANTINE = "quarantine"
DUPLICATES = "duplicates"
DOCUMENT = json.dumps({"format": DATA_FORMAT, "version": LAKE_VERSION}).encode() + b"\n"


def create_lake(address: str) -> Place:
    """A lake to write to: made where there is none, once its store has shown that it keeps conditions.

    Raises UsageError: something else is there, the store ignores conditions, no permission.
    Raises StoreError: of a newer version. Raises PlaceError: no answer.
    """
    place = Place(address)
    document = place.read_if_there(DATA_FILE)
    if document is None:
        stranger = next(place.list(), None)
        if stranger is not None and stranger.key != DATA_FILE:
            raise UsageError(
                f"not a lake, and not empty: it holds {stranger.key}",
                path=address,
                hint=f"choose another folder: -o {place}/lake",
            )
    else:
        check_lake(document, address)
    place.require_conditions(DATA_FILE, document or DOCUMENT)
    return place


def open_lake(address: str) -> Place:
    """A lake that is there. Raises UsageError where there is none."""
    place = Place(address)
    document = place.read_if_there(DATA_FILE)
    if document is None:
        raise UsageError(
            "no lake there: it has no " + DATA_FILE,
            path=address,
            hint=f"make it with: flysid ingest LOG... -o {place}",
        )
    check_lake(document, address)
    return place
