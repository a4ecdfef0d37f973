"""Small files of every kind as each version of flysid wrote them: none may ever become unreadable.

`python -m tests.released_files` adds those of the present version, once per release; what is there is never
changed. A folder `v<version>` holds

    models/<example>.json     one of every structure; `expected.json` has their free runs and predictions
    dataset.parquet           a dataset of two segments
    data/                     an ingested folder with one short flight
    run/                      a run fitted to that, with its report
"""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent


def released() -> list[Path]:
    """The folders of all versions, oldest first."""
    return sorted(FOLDER.glob("v*"), key=lambda path: [int(part) for part in path.name[1:].split(".")])
