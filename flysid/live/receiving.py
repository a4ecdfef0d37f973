"""All links in one loop: bytes to frames, frames to a tlog's records, everything counted."""

from __future__ import annotations

import selectors
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flysid.facts.link import LinkLoss
from flysid.ingest.formats.mavlink.frames import read_header
from flysid.live.batches import Arrival, gather
from flysid.live.framing import Cut, Framer
from flysid.live.ledger import Ledger
from flysid.live.links import Link, buffer_advice
from flysid.live.signing import Guard
from flysid.live.spool import SpoolPiece, whole_records

NAP_S = 0.01  # datagrams gather meanwhile: a pass costs as much for one as for twenty
LOOK_S = 0.2
TEND_S = 1.0
PEERS = 256  # of one link; a flood from made-up addresses shares one more
HOST_STEP_S = 0.5
SILENT_S = 5.0  # a link from which nothing comes for so long counts as silent


@dataclass
class Peer:
    """Who sends on a link: its address, and the bytes of it that are no frames yet."""

    number: int
    link: Link
    name: str
    framer: Framer
    datagrams: int = 0
    rejected_bytes: int = 0
    bad_checksums: int = 0


@dataclass
class Receiver:
    """Receives on links and gives out records of a tlog.

    `links`: open ones; `close` closes them.
    `sink`: takes what has come, many times a second; must not wait.
    `guard`: judges signatures; None where there is no key.
    `heartbeat`: sent once a second on every link; None to send nothing at all, ever.
    `nap_s`: between passes.
    """

    links: Sequence[Link]
    sink: Callable[[SpoolPiece], None]
    guard: Guard | None = None
    heartbeat: Callable[[], bytes] | None = None
    nap_s: float = NAP_S
    ledger: Ledger = field(default_factory=Ledger)
    clock_steps: list[dict[str, float]] = field(default_factory=list)
    started_s: float = field(default_factory=time.time)
    _peers: dict[tuple[int, bytes], Peer] = field(default_factory=dict)
    _handles: dict[int, int] = field(default_factory=dict)
    _heard: dict[int, tuple[float, float]] = field(default_factory=dict)
    _offset_s: float = field(default_factory=lambda: time.time() - time.monotonic())

    def __post_init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._next_tend = time.monotonic()

    def run(self, stop: threading.Event) -> None:
        """Receive until `stop` is set, then what still waits in the sockets."""
        while not stop.is_set():
            self._tend()
            if self._selector.get_map():
                ready = self._selector.select(LOOK_S)
            else:
                ready = []
                stop.wait(LOOK_S)
            more = [self._take(self.links[key.data]) for key, _ in ready]
            if not any(more):
                time.sleep(self.nap_s)
        for link in self.links:
            while link.fileno() >= 0 and self._take(link):
                continue
        for peer in self._peers.values():
            self._enter(peer, peer.framer.finish())

    def close(self) -> None:
        """Close the links."""
        for link in self.links:
            link.close()
        self._selector.close()

    def _tend(self) -> None:
        """Once a second: links that are down, the host's clock, heartbeats."""
        now = time.monotonic()
        if now < self._next_tend:
            return
        self._next_tend = now + TEND_S
        for number, link in enumerate(self.links):
            link.revive()
            self._watch(number, link)
            if self.heartbeat is not None:
                link.send(self.heartbeat())
        step_s = time.time() - time.monotonic() - self._offset_s
        if abs(step_s) > HOST_STEP_S:
            self.ledger.shift_clock(int(step_s * 1e6))
            self.clock_steps.append({"at_s": time.time(), "step_s": round(step_s, 3)})
            self._offset_s += step_s

    def _watch(self, number: int, link: Link) -> None:
        """Wait for the link's handle, whichever it is now."""
        handle = link.fileno()
        known = self._handles.get(number, -1)
        if handle == known:
            return
        if known >= 0:
            self._selector.unregister(known)
        if handle >= 0:
            self._selector.register(handle, selectors.EVENT_READ, number)
        self._handles[number] = handle

    def _take(self, link: Link) -> bool:
        """Receive once on a link; whether more may wait."""
        arrivals, more = link.receive()
        number = self.links.index(link)
        if arrivals:
            self._heard[number] = time.monotonic(), time.time()
        for arrival in arrivals:
            peer = self._peer(number, link, arrival.peer)
            peer.datagrams += len(arrival.ends)
            self._enter(peer, peer.framer.cut(arrival))
        if link.fileno() != self._handles.get(number, -1):
            self._watch(number, link)
        return more

    def _peer(self, number: int, link: Link, address: bytes) -> Peer:
        key = (number, address)
        if key in self._peers:
            return self._peers[key]
        name = link.peer_name(address)
        if sum(k[0] == number for k in self._peers) >= PEERS:
            key = (number, b"others")
            name = "others"
        if key not in self._peers:
            self._peers[key] = Peer(len(self._peers), link, name, Framer(link.keeps_datagrams))
        return self._peers[key]

    def _enter(self, peer: Peer, cut: Cut) -> None:
        """Frames of one arrival: judged, counted, given out."""
        peer.bad_checksums += cut.bad_checksums
        self._reject(peer, cut.rejected)
        starts = cut.starts
        if self.guard is not None and len(starts):
            accepted = self.guard.accepted(peer.number, cut.raw, starts)
            for q in starts[~accepted].tolist():
                head = read_header(cut.raw.data, q)
                assert head is not None
                self.sink(SpoolPiece(cut.raw[q : head.end].tobytes(), 0))
            starts = starts[accepted]
        if not len(starts):
            return
        records, boot = self.ledger.enter(peer.number, cut.raw, starts, cut.ends, cut.stamps_us)
        if boot > 0:
            before = whole_records(records, boot)[1]
            self.sink(SpoolPiece(records[:boot], before, peer=peer.number))
            self.sink(SpoolPiece(records[boot:], len(starts) - before, boots=True, peer=peer.number))
        else:
            self.sink(SpoolPiece(records, len(starts), boots=boot == 0, peer=peer.number))

    def _reject(self, peer: Peer, content: bytes) -> None:
        if content:
            peer.rejected_bytes += len(content)
            self.sink(SpoolPiece(content, 0))

    def facts(self) -> dict[str, Any]:
        """What has come so far, per link, peer and system; see docs/recording.md."""
        refused = dict(self.guard.refused) if self.guard else {}
        links = []
        for number, link in enumerate(self.links):
            peers = [peer for key, peer in list(self._peers.items()) if key[0] == number]
            links.append(
                {
                    "link": link.target.text,
                    "state": link.state,
                    "silent_s": self._silent_s(number),
                    "buffer_bytes": link.buffer,
                    "dropped_by_host": link.dropped() if link.fileno() >= 0 else None,
                    "peers": [_peer_facts(peer, self.ledger, refused) for peer in peers],
                }
            )
        return {
            "started_s": round(self.started_s, 3),
            "updated_s": round(time.time(), 3),
            "host_clock_steps": self.clock_steps,
            "signing": None if self.guard is None else {"unsigned": self.guard.unsigned},
            "senders_without_a_row": int(self.ledger.senders[0]["frames"]),
            "links": links,
            "warnings": self.warnings(),
        }

    def _silent_s(self, number: int) -> float | None:
        """Seconds since something came on a link; None where nothing has."""
        heard = self._heard.get(number)
        return None if heard is None else round(time.monotonic() - heard[0], 1)

    def warnings(self) -> list[str]:
        """What a person should know: links that are down or silent, clocks that were set, and the like."""
        notices = [text for text in map(buffer_advice, self.links) if text]
        notices += [f"{link.target.text}: {link.state}" for link in self.links if link.state != "open"]
        for number, link in enumerate(self.links):
            silent_s = self._silent_s(number)
            if silent_s is not None and silent_s > SILENT_S:
                since = time.strftime("%H:%M:%S", time.localtime(self._heard[number][1]))
                notices.append(f"{link.target.text}: silent since {since}")
        names = {p.number: p.name for p in list(self._peers.values())}
        senders = self.ledger.senders[1:]
        notices += [
            f"the clock of this host was set by {step['step_s']:+.3g} s" for step in list(self.clock_steps)
        ]
        return notices + stepped_clocks(self.ledger) + doubled_systems(senders, names)


def warm_up() -> None:
    """Load the compiled code before links are open: the first compilation takes seconds, and nothing is lost.

    The frame is a heartbeat in MAVLink 1.
    """
    sizes = np.array([17])
    frame = np.array([*bytes.fromhex("fe09 00 01 01 00 00000000 0203 00 00 03 0000")], np.uint8)
    gather(np.zeros((1, 17), np.uint8), sizes, np.zeros((1, 1), np.uint8), np.empty(17, np.uint8))
    Framer(True).cut(Arrival(b"", frame, sizes, sizes))
    Ledger().enter(0, frame, np.array([0]), sizes, sizes)


def stepped_clocks(ledger: Ledger) -> list[str]:
    """Vehicles that were started anew, or whose clock jumped."""
    notices = []
    for row, sender in enumerate(ledger.senders[1:], 1):
        loss = ledger.loss(row)
        name = f"system {sender['system']}.{sender['component']}"
        for count, what in ((loss.boots, "was started anew"), (loss.clock_steps, "set its clock")):
            if count:
                times = "" if count == 1 else f", {count} times"
                notices.append(f"{name} {what}{times}")
    return notices


def doubled_systems(senders: Any, names: dict[int, str]) -> list[str]:
    """Systems that came from several addresses at the same time."""
    notices = []
    for system in np.unique(senders["system"]).tolist():
        mine = senders[senders["system"] == system]
        spans = {}
        for peer in np.unique(mine["peer"]).tolist():
            rows = mine[mine["peer"] == peer]
            spans[peer] = (int(rows["first_us"].min()), int(rows["last_us"].max()))
        at_once = sorted(
            names[a]
            for a, (first, last) in spans.items()
            if any(a != b and first <= end and start <= last for b, (start, end) in spans.items())
        )
        if at_once:
            where = " and ".join(at_once)
            notices.append(f"system {system} comes from {where}: two vehicles with one number, or one twice")
    return notices


def _peer_facts(peer: Peer, ledger: Ledger, refused: dict[tuple[int, str], int]) -> dict[str, Any]:
    senders = ledger.senders
    rows = [row for row in range(1, len(senders)) if senders[row]["peer"] == peer.number]
    return {
        "peer": peer.name,
        "datagrams": peer.datagrams,
        "bytes_that_are_no_frame": peer.rejected_bytes,
        "bad_checksums": peer.bad_checksums,
        "refused": {reason: count for (number, reason), count in refused.items() if number == peer.number},
        "systems": [_sender_facts(senders[row], ledger.loss(row)) for row in rows],
    }


def _sender_facts(row: Any, loss: LinkLoss) -> dict[str, Any]:
    return {
        "system": int(row["system"]),
        "component": int(row["component"]),
        "frames": int(row["frames"]),
        "bytes": int(row["bytes"]),
        "signed": int(row["signed"]),
        "repeated": loss.repeated,
        "lost_by_sequence": loss.lost,
        "lost_in_silence_about": loss.hidden,
        "silences": loss.silences,
        "silent_s": round(loss.silent_us * 1e-6, 3),
        "late": loss.late,
        "boots": loss.boots,
        "clock_steps": loss.clock_steps,
        "first_s": round(int(row["first_us"]) * 1e-6, 6),
        "last_s": round(int(row["last_us"]) * 1e-6, 6),
    }
