"""Telemetry with known losses: pauses, outages, late frames, copies, two counters, restarts, two senders."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flysid.flight import Damage
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import find_format
from flysid.live.batches import Arrival
from flysid.live.framing import Framer
from flysid.live.ledger import Ledger
from soak import Outcome

KINDS = (
    "plain",
    "losses",
    "outage",
    "pauses",
    "bursts",
    "loop",
    "lossy loop",
    "late",
    "two radios",
    "restarts",
)
EPOCH_US = 1_700_000_000_000_000
Arrived = list[tuple[int, bytes]]


@dataclass
class Sender:
    """A vehicle that sends attitudes, now and then a heartbeat, all numbered.

    Attributes
    ----------
    each_us : from frame to frame.
    now_us, boot_ms : the time, and the vehicle's own.
    told_every : frames to one that states the vehicle's time.
    """

    system: int
    each_us: int
    rng: random.Random
    now_us: int = EPOCH_US
    boot_ms: float = 60_000.0
    made: int = 0
    told_every: int = 1

    def __post_init__(self) -> None:
        self.link = mavlink.MAVLink(None, self.system, 1)
        self.link.seq = self.rng.randrange(256)

    def wait(self, time_us: int) -> None:
        """Let time pass."""
        self.now_us += time_us
        self.boot_ms += time_us / 1000

    def send(self, wait_us: int | None = None) -> tuple[int, bytes]:
        """One more frame, and when it was sent."""
        self.wait(int(self.each_us * self.rng.uniform(0.5, 1.5)) if wait_us is None else wait_us)
        self.made += 1
        angle = self.rng.uniform(-1.0, 1.0)
        message = mavlink.MAVLink_vfr_hud_message(angle, 0.1, 0, 0, 0, 0)
        if self.made % self.told_every == 0:
            message = mavlink.MAVLink_attitude_message(int(self.boot_ms), angle, 0.1, 0, 0, 0, 0)
        if self.made % 20 == 1:
            message = mavlink.MAVLink_heartbeat_message(2, 3, 209, 0, 4, 3)
        frame = bytes(message.pack(self.link))
        self.link.seq = (self.link.seq + 1) % 256
        return self.now_us, frame

    def restart(self) -> None:
        """Begin anew, a moment later."""
        self.wait(self.rng.choice((1000, 100_000, 3_000_000)))
        self.boot_ms = self.rng.uniform(0.0, 3000.0)
        self.link.seq = 0


@dataclass
class Trial:
    """Telemetry, and what of it was lost and copied, by system."""

    seed: int
    kinds: dict[int, str] = field(default_factory=dict)
    arrived: Arrived = field(default_factory=list)
    lost: dict[str, int] = field(default_factory=dict)
    copies: dict[str, int] = field(default_factory=dict)

    @property
    def blob(self) -> bytes:
        """The log."""
        return b"".join(struct.pack(">Q", at) + frame for at, frame in self.arrived)


def draw(seed: int) -> Trial:
    """The log that a seed draws: of one vehicle, or of two with numbers of their own."""
    rng = random.Random(seed)
    trial = Trial(seed)
    for system in rng.sample(range(1, 200), rng.choice((1, 1, 2))):
        kind = rng.choice(KINDS)
        sender = Sender(system, rng.choice((2_000, 5_000, 20_000)), rng, told_every=rng.choice((1, 3, 10)))
        frames, lost, copies = _made(kind, sender, rng)
        trial.kinds[system] = kind
        trial.arrived += frames
        trial.lost |= {f"{system}.1": lost} if lost else {}
        trial.copies |= {f"{system}.1": copies} if copies else {}
    trial.arrived.sort(key=lambda arrival: arrival[0])
    return trial


def _made(kind: str, sender: Sender, rng: random.Random) -> tuple[Arrived, int, int]:
    """What arrives of a sender, how many frames are lost, and how many are copies."""
    count = rng.randint(300, 1500)
    if kind == "pauses":
        return (
            [sender.send(int(rng.uniform(1e5, 3e6)) if rng.random() < 0.01 else None) for _ in range(count)],
            0,
            0,
        )
    if kind == "bursts":
        size = rng.randint(5, 300)
        return (
            [sender.send(rng.randint(500_000, 1_500_000) if k % size == 0 else 20) for k in range(count)],
            0,
            0,
        )
    if kind == "restarts":
        sender.each_us = 20_000
        sent = []
        for k in range(3):
            sent += [sender.send() for _ in range(600)]
            sender.restart() if k < 2 else None
        return sent, 0, 0
    if kind == "outage":
        sent = [sender.send(int(sender.each_us * rng.uniform(0.9, 1.1))) for _ in range(count + 4000)]
        begin, gap = rng.randint(260, count), rng.randint(1, 900)
        gap += gap % 256 == 0
        return sent[:begin] + sent[begin + gap :], gap, 0
    sent = [sender.send() for _ in range(count)]
    if kind == "two radios":
        other = Sender(sender.system, sender.each_us, rng, boot_ms=60_000.0)
        return sorted(sent + [other.send() for _ in range(count)]), 0, 0
    kept = sent
    if kind in ("losses", "lossy loop"):
        share = rng.uniform(0.005, 0.3)
        kept = [f for k, f in enumerate(sent) if k in (0, count - 1) or rng.random() > share]
    if kind in ("loop", "lossy loop"):
        lag_us = rng.choice((1, 3, 20)) * sender.each_us
        share = rng.choice((1.0, rng.uniform(0.3, 1.0)))
        copies = [(at + lag_us, frame) for at, frame in kept if rng.random() < share]
        return sorted(kept + copies, key=lambda f: f[0]), count - len(kept), len(copies)
    if kind == "late":
        kept = [
            (at + (2 * sender.each_us if 5 < k < count - 10 and rng.random() < 0.05 else 0), f)
            for k, (at, f) in enumerate(sent)
        ]
        kept.sort(key=lambda f: f[0])
    return kept, count - len(kept), 0


def faults(trial: Trial) -> Iterator[str]:
    """Counts that are not the true ones, of the log as read and of its frames as recorded."""
    damage = collect(memoryview(trial.blob), "t.tlog", find_format("tlog"), Limits()).damage
    for name, found in (("read", _counts(damage)), ("recorded", _recorded(trial))):
        if found != (trial.lost, trial.copies):
            yield f"{name}: lost and copied {found}, not {(trial.lost, trial.copies)} ({trial.kinds})"


def _counts(damage: Damage) -> tuple[dict[str, int], dict[str, int]]:
    names = {*damage.sequence_gaps, *damage.silence_gaps}
    lost = {n: damage.sequence_gaps.get(n, 0) + damage.silence_gaps.get(n, 0) for n in names}
    return lost, dict(damage.repeats)


def _recorded(trial: Trial) -> tuple[dict[str, int], dict[str, int]]:
    """The same frames through the ledger of `flysid record`, ten to a pass."""
    ledger = Ledger()
    framer = Framer(True)
    for k in range(0, len(trial.arrived), 10):
        part = trial.arrived[k : k + 10]
        raw = np.frombuffer(b"".join(frame for _, frame in part), np.uint8)
        ends = np.cumsum([len(frame) for _, frame in part])
        cut = framer.cut(Arrival(b"", raw, ends, np.array([at for at, _ in part])))
        ledger.enter(0, cut.raw, cut.starts, cut.ends, cut.stamps_us)
    lost: dict[str, int] = {}
    copies: dict[str, int] = {}
    for row, sender in enumerate(ledger.senders[1:], 1):
        loss, name = ledger.loss(row), f"{sender['system']}.{sender['component']}"
        lost |= {name: loss.missing} if loss.missing else {}
        copies |= {name: loss.repeated} if loss.repeated else {}
    return lost, copies


def trials(count: int, goes_on: Callable[[], bool], first_seed: int = 0) -> Outcome:
    """Draw and judge logs, one seed each."""
    outcome = Outcome("telemetry")
    outcome.judge(
        range(first_seed, first_seed + count), goes_on, draw, faults, lambda trial: len(trial.arrived)
    )
    return outcome
