"""One job: `python -m flysid.studio.runner FOLDER` runs the command of FOLDER/job.json, notes how it ended.

Its progress goes to stderr as JSON. The note is what a later studio finds of a job that another began.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from flysid.files import write_atomically

NOTE = "ended.json"


def main(folder: Path) -> None:
    """Run the command line with the job's words; write the exit code as the last thing."""
    from flysid.cli import main as run

    words = json.loads((folder / "job.json").read_text("utf-8"))["words"]
    sys.argv = ["flysid", *words, "--progress", "json"]
    code = 1
    try:
        run()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        write_atomically(folder / NOTE, json.dumps({"code": code}).encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
