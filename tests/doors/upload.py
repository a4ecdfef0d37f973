"""`python -m tests.doors.upload FOLDER ADDRESS`: the logs of a folder, each below the name of its vehicle."""

from __future__ import annotations

import sys
from pathlib import Path

from flysid.place import Place

if __name__ == "__main__":
    folder, address = sys.argv[1:]
    place = Place(address)
    for log in sorted(Path(folder).iterdir()):
        vehicle = log.name.partition("-")[0]
        place.put(f"{vehicle}/{log.name}", log.read_bytes())
