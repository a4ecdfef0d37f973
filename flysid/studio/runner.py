"""One job: `python -m flysid.studio.runner flysid FOLDER` runs FOLDER/job.json's words, notes how that ended.

Its progress goes to stderr as JSON. The note is what a later studio finds of a job that another began.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from flysid.files import write_atomically

NOTE = "ended.json"
WITHOUT_PROGRESS = ("synth",)
"""Verbs that are done before anybody asks how far they are."""


def main(program: str, folder: Path) -> None:
    """Run a module with the job's words, as `python -m` does; write the exit code when it has ended."""
    command = [sys.executable, "-m", program, *words_of(folder)]
    note(folder, subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode)


def words_of(folder: Path) -> list[str]:
    """The words of the command, after `flysid`."""
    words: list[str] = json.loads((folder / "job.json").read_text("utf-8"))["words"]
    return words if words[0] in WITHOUT_PROGRESS else [*words, "--progress", "json"]


def note(folder: Path, code: int) -> None:
    """Note the exit code of a command that has ended."""
    write_atomically(folder / NOTE, json.dumps({"code": code}).encode())


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
