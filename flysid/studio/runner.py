"""One job: `python -m flysid.studio.runner FOLDER` runs the command of FOLDER/job.json, notes how it ended.

Its progress goes to stderr as JSON. The note is what a later studio finds of a job that another began.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from flysid.files import write_atomically

NOTE = "ended.json"


def main(folder: Path) -> None:
    """Run the command line with the job's words; write the exit code when it has ended."""
    words = json.loads((folder / "job.json").read_text("utf-8"))["words"]
    command = [sys.executable, "-m", "flysid", *words, "--progress", "json"]
    ended = subprocess.run(command, stdin=subprocess.DEVNULL, check=False)
    write_atomically(folder / NOTE, json.dumps({"code": ended.returncode}).encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
