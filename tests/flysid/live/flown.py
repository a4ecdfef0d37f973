"""A vehicle that is recorded and watched: a log played to a link."""

from __future__ import annotations

import socket
import time
from pathlib import Path

from flysid.ingest.formats.mavlink.frames import read_header

FAULT_S = 40.0  # into the faulty flight


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
