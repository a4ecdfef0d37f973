"""`python -m tests.link_sender PORT RATE SECONDS [FILE]`: MAVLink 2 over UDP at a steady rate.

Prints how many frames were sent; FILE holds them one behind the other. The sequence counts all frames, so
that what is missing at the other end is missing there.
"""

from __future__ import annotations

import socket
import sys
import time
from pathlib import Path

from pymavlink.dialects.v20 import common

PASS_S = 0.002


def frames(system: int = 1) -> list[bytes]:
    """256 frames, one for each number of the sequence: states, targets, now and then a heartbeat."""
    link = common.MAVLink(None, srcSystem=system, srcComponent=1)
    made = []
    for k in range(256):
        link.seq = k
        kinds = [
            link.attitude_encode(1000, 0.01 * k, 0.02, 0.3, 0.1, 0.2, 0.3),
            link.local_position_ned_encode(1000, 1.0, 2.0, -3.0 - 0.01 * k, 0.1, 0.2, 0.3),
            link.attitude_target_encode(1000, 7, [1.0, 0.0, 0.01 * k, 0.0], 0.1, 0.1, 0.1, 0.5),
        ]
        message = kinds[k % 3] if k % 64 else link.heartbeat_encode(2, 3, 81, 0, 4)
        made.append(bytes(message.pack(link)))
    return made


def send(port: int, rate: float, seconds: float) -> int:
    """Send for so long; returns how many frames."""
    pool = frames()
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        began = time.monotonic()
        while (now := time.monotonic() - began) < seconds:
            for _ in range(sent, int(now * rate)):
                link.send(pool[sent & 0xFF])
                sent += 1
            time.sleep(PASS_S)
    return sent


if __name__ == "__main__":
    count = send(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
    if len(sys.argv) > 4:
        everything = b"".join(frames())
        rest = b"".join(frames()[: count % 256])
        Path(sys.argv[4]).write_bytes(everything * (count // 256) + rest)
    print(count, flush=True)  # noqa: T201
