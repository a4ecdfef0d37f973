"""Row 12: 200 logs, 10 of them unreadable in 10 ways, in one `flysid ingest`."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from soak import Budget, Campaign, Outcome
from tests.format_trials import FORMATS, module_of, sample

ROOT = Path(__file__).resolve().parents[1]
LOGS, BAD = 200, 10
TIMEOUT_S = 900


def fill(folder: Path) -> list[str]:
    """190 readable logs of all formats, each of its own content, and 10 others; returns what to ingest."""
    names: list[str] = []
    for k in range(LOGS - BAD):
        kind = FORMATS[k % len(FORMATS)]
        path = folder / f"good{k:03}{module_of(kind).SUFFIX}"
        path.write_bytes(sample(kind) + bytes(k // len(FORMATS)))  # a few stray zeros make each its own
        names.append(str(path))
    return names + [str(path) for path in unreadable(folder)]


def unreadable(folder: Path) -> list[Path]:
    """Empty, cut, of another kind, a folder, a pipe, a socket, a loop, a broken link, a device, a picture."""
    blobs = {"empty.tlog": b"", "cut.mcap": sample("mcap")[:9], "notes.bin": b"notes\n" * 99}
    blobs["picture.ulg"] = b"\x89PNG\r\n\x1a\n" + bytes(500)
    paths = [folder / name for name in blobs]
    for path, blob in zip(paths, blobs.values(), strict=True):
        path.write_bytes(blob)
    others = [
        folder / n for n in ("pipe.tlog", "socket.bin", "loop.ulg", "broken.log", "null.mcap", "zeros.bag")
    ]
    os.mkfifo(others[0])
    with socket.socket(socket.AF_UNIX) as link:
        link.bind(str(others[1]))
    others[2].symlink_to(others[2])
    others[3].symlink_to(folder / "nowhere")
    others[4].symlink_to("/dev/null")
    others[5].write_bytes(bytes(5000))
    return paths + others


def run(budget: Budget) -> Iterator[Outcome]:  # noqa: ARG001 - one trial
    """One outcome."""
    outcome = Outcome("200 logs, 10 unreadable")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        names = fill(folder)
        command = [sys.executable, "-m", "flysid", "ingest", *names, "-o", str(folder / "data")]
        with outcome.trial():
            done = subprocess.run(
                command, cwd=ROOT, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
        ids = done.stdout.split()
        skipped = [line for line in done.stderr.splitlines() if line.startswith("skipped:")]
        outcome.keep(len(ids), LOGS - BAD)
        outcome.remark = f"{len(ids)} ingested, {len(skipped)} named, exit {done.returncode}"
        if (len(ids), len(skipped), done.returncode) != (LOGS - BAD, BAD, 3):
            outcome.failures.append(outcome.remark + ": " + done.stderr[-300:])
        if "Traceback" in done.stderr:
            outcome.failures.append("a traceback")
    yield outcome


CAMPAIGN = Campaign(12, "a batch of 200", run)
