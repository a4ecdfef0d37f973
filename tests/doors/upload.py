"""`python -m tests.doors.upload FOLDER ADDRESS BUCKET...`: logs, each below its vehicle; empty buckets.

Vehicles are numbered from 11 on, so that one is the pages' v017.
"""

from __future__ import annotations

import sys
from pathlib import Path

from flysid.place import Place

BEFORE = 10


def main(folder: str, address: str, *buckets: str) -> None:
    """Upload the logs of a simulated fleet; a bucket is made with an object, which is deleted."""
    for bucket in buckets:
        Place(bucket).put("made", b"")
        Place(bucket).delete(["made"])
    inbox = Place(address)
    for log in sorted(Path(folder).iterdir()):
        number = int(log.name.partition("-")[0].removeprefix("v"))
        inbox.put(f"v{BEFORE + number:03d}/{log.name}", log.read_bytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
