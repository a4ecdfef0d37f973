"""Fly against the clock and send MAVLink over UDP, so that a real ground station or recorder listens to it.

Messages are those of the telemetry log, in the same order; each is sent when the vehicle's clock has come
to it. Nothing is received. The link is local: no jitter is added, the network makes its own.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from flysid.errors import UsageError
from flysid.ingest.synth.synth import Order, flight_names, fly_one
from flysid.ingest.synth.telemetry import Recording


def parse_target(text: str) -> tuple[str, int]:
    """Host and port of udp:HOST:PORT; raises UsageError for anything else."""
    parts = text.split(":")
    if len(parts) != 3 or parts[0] != "udp" or not parts[1] or not parts[2].isdigit():
        raise UsageError(f"no live target {text!r}", hint="udp:HOST:PORT, e.g. udp:127.0.0.1:14550")
    port = int(parts[2])
    if not 0 < port < 65536:
        raise UsageError(f"no port {port}", hint="1 to 65535")
    return parts[1], port


@dataclass(frozen=True)
class Pace:
    """How time passes: the vehicle's clock runs `speed` times as fast as the wall's."""

    speed: float = 1.0
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        if not 0.0 < self.speed <= 1000.0:
            raise UsageError(f"a speed of {self.speed:g}", hint="above 0, at most 1000")


REAL_TIME = Pace()


def fly_live(order: Order, target: str, pace: Pace = REAL_TIME) -> int:
    """Fly the order, flight after flight, and send its messages; returns how many were sent.

    Raises UsageError where the target ("udp:HOST:PORT") is not understood or cannot be reached.
    """
    address = parse_target(target)
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for index in range(len(flight_names(order))):
            sent += _send(fly_one(order, index), link, address, pace)
    return sent


def _send(recording: Recording, link: socket.socket, address: tuple[str, int], pace: Pace) -> int:
    """One flight; late messages go out at once, in order."""
    from flysid.ingest.synth.writers.mavlink import timed_frames

    count = 0
    start = pace.clock()
    first_ns = int(recording.state.time_ns[0])
    for due_ns, frame in timed_frames(recording):
        wait = start + (due_ns - first_ns) * 1e-9 / pace.speed - pace.clock()
        if wait > 0.0:
            pace.sleep(wait)
        try:
            link.sendto(frame, address)
        except OSError as error:
            raise UsageError(f"cannot send to {address[0]}:{address[1]}: {error.strerror}") from error
        count += 1
    return count
