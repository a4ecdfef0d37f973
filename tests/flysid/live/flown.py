"""A vehicle that is recorded and watched: commands in processes of their own, and a log played to a link."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

from flysid.ingest.formats.mavlink.frames import read_header

ROOT = Path(__file__).resolve().parents[3]
FAULT_S = 40.0  # into the faulty flight


def flysid(*words: object, module: str = "flysid") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", module, *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def play(log: Path, port: int, speed: float) -> None:
    """Send a tlog's frames when their time has come."""
    content = log.read_bytes()
    at = 0
    first = int.from_bytes(content[:8], "big")
    began = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        while at < len(content):
            head = read_header(content, at + 8)
            assert head is not None
            due = (int.from_bytes(content[at : at + 8], "big") - first) * 1e-6 / speed
            time.sleep(max(0.0, due - (time.monotonic() - began)))
            link.sendto(content[at + 8 : head.end], ("127.0.0.1", port))
            at = head.end
