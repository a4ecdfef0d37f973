"""Links to vehicles: UDP, TCP, serial. They receive; they send only on request.

    udp:HOST:PORT      listens there (0.0.0.0 for all interfaces)
    udpout:HOST:PORT   sends to a server there first, which then answers
    tcp:HOST:PORT      connects, again and again where it must
    serial:DEVICE:BAUD a serial port (57600 where BAUD is left out)

Times of arrival are the kernel's for datagrams. For streams they are the moment of reading.
"""

from __future__ import annotations

import errno
import os
import re
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flysid.errors import UsageError
from flysid.live.batches import ADDRESS, Arrival, BatchReceiver, dropped_by_kernel, is_offered

FORMS = "udp:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
WANTED_BUFFER = 8 << 20
READ_AT_ONCE = 1 << 16
SO_RCVBUFFORCE = 33
RETRY_S = 1.0
PEERS_ANSWERED = 64


@dataclass(frozen=True)
class Target:
    """A link as it was named: its kind, and host and port or device and speed."""

    text: str
    kind: str
    place: str
    number: int


def parse_link(text: str) -> Target:
    """Read a link's name; raises UsageError where it is not understood."""
    kind, _, rest = text.partition(":")
    if kind in ("udp", "udpout", "tcp"):
        host, _, port = rest.rpartition(":")
        if port.isdigit() and 0 < int(port) < 65536:
            return Target(text, kind, host.strip("[]") or "0.0.0.0", int(port))
    elif kind == "serial" and rest:
        device, _, speed = rest.rpartition(":")
        if device and speed.isdigit():
            return Target(text, kind, device, int(speed))
        return Target(text, kind, rest, 57_600)
    raise UsageError(f"no link {text!r}", hint=FORMS)


class Link(ABC):
    """One link: what it receives, and what became of it.

    `target`: as it was named.
    `state`: "open", or what is wrong and what is done about it.
    `buffer`: bytes of the socket's buffer as granted; None where there is none to ask for.
    `keeps_datagrams`: whether bytes come in datagrams.
    """

    keeps_datagrams = False

    def __init__(self, target: Target) -> None:
        self.target = target
        self.state = "open"
        self.buffer: int | None = None

    @abstractmethod
    def fileno(self) -> int:
        """The handle to wait for; -1 while the link is down."""

    @abstractmethod
    def receive(self) -> tuple[list[Arrival], bool]:
        """What has arrived, and whether more may wait; never waits itself."""

    @abstractmethod
    def send(self, content: bytes) -> None:
        """Send to everyone who is known on this link; what cannot be sent is lost."""

    @abstractmethod
    def close(self) -> None: ...

    def revive(self) -> None:
        """Try to open the link again where it is down; called now and then."""
        return

    def dropped(self) -> int | None:
        """Datagrams that this host had no room for; None where nobody counts."""
        return None

    def peer_name(self, peer: bytes) -> str:
        """An address for people."""
        return peer.decode() if peer else self.target.text


class UdpLink(Link):
    """A UDP socket that listens (`udp:`) or sends first (`udpout:`)."""

    keeps_datagrams = True

    def __init__(self, target: Target, buffer: int | None = None) -> None:
        super().__init__(target)
        family, _, _, _, address = _resolve(target, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._peers: dict[bytes, tuple[Any, ...]] = {}
        self.buffer = _ask_for_buffer(self._socket, buffer)
        self._socket.setblocking(False)
        try:
            if target.kind == "udp":
                self._socket.bind(address)
            else:
                self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            raise _refusal(target, error) from error
        self._batches = BatchReceiver(self._socket) if is_offered() else None

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> tuple[list[Arrival], bool]:
        if self._batches is None:
            return self._receive_one()
        arrivals, more = self._batches.receive()
        for arrival in arrivals:
            self._know(arrival.peer, _address(arrival.peer))
        return arrivals, more

    def _receive_one(self) -> tuple[list[Arrival], bool]:
        """One datagram, where there is no recvmmsg."""
        try:
            content, address = self._socket.recvfrom(READ_AT_ONCE)
        except OSError:
            return [], False
        peer = f"{address[0]}:{address[1]}".encode()
        self._know(peer, address)
        return [_arrival(content, peer)], True

    def _know(self, peer: bytes, address: tuple[Any, ...]) -> None:
        """Addresses to answer with heartbeats; a flood of addresses is not kept."""
        if len(self._peers) < PEERS_ANSWERED:
            self._peers.setdefault(peer, address)

    def send(self, content: bytes) -> None:
        try:
            if self.target.kind == "udpout":
                self._socket.send(content)
                return
            for address in self._peers.values():
                self._socket.sendto(content, address)
        except OSError:
            return  # nobody there yet; the next heartbeat tries again

    def close(self) -> None:
        self._socket.close()

    def dropped(self) -> int | None:
        return dropped_by_kernel(self._socket)

    def peer_name(self, peer: bytes) -> str:
        if self._batches is None:
            return super().peer_name(peer)
        host, port = _address(peer)
        return f"{host}:{port}"


class StreamLink(Link):
    """A link without datagrams that may break and come back."""

    def __init__(self, target: Target) -> None:
        super().__init__(target)
        self._handle = -1
        self._next_try = 0.0

    @abstractmethod
    def _open(self) -> int:
        """A new handle that does not block; -1 while it is being made. Raises OSError."""

    def fileno(self) -> int:
        return self._handle

    def revive(self) -> None:
        if self._handle >= 0 or time.monotonic() < self._next_try:
            return
        self._next_try = time.monotonic() + RETRY_S
        try:
            self._handle = self._open()
            self.state = "open"
        except OSError as error:
            self.state = f"down, tried every second: {error.strerror or error}"

    def receive(self) -> tuple[list[Arrival], bool]:
        try:
            content = os.read(self._handle, READ_AT_ONCE)
        except BlockingIOError:
            return [], False
        except OSError as error:
            self._fail(error.strerror or str(error))
            return [], False
        if not content:
            self._fail("closed by the other side")
            return [], False
        return [_arrival(content, b"")], len(content) == READ_AT_ONCE

    def _fail(self, reason: str) -> None:
        self.close()
        self.state = f"down, tried every second: {reason}"

    def send(self, content: bytes) -> None:
        if self._handle >= 0:
            try:
                os.write(self._handle, content)
            except OSError:
                return  # reading will find what is wrong

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
        self._handle = -1


class TcpLink(StreamLink):
    """A connection to a TCP server."""

    def __init__(self, target: Target) -> None:
        super().__init__(target)
        _resolve(target, socket.SOCK_STREAM)
        self.revive()

    def _open(self) -> int:
        family, _, _, _, address = _resolve(self.target, socket.SOCK_STREAM)
        with socket.socket(family, socket.SOCK_STREAM) as made:
            made.settimeout(RETRY_S)
            made.connect(address)
            made.setblocking(False)
            return made.detach()


class SerialLink(StreamLink):
    """A serial port, raw, 8N1."""

    def __init__(self, target: Target) -> None:
        super().__init__(target)
        if not Path(target.place).exists():
            there = ", ".join(sorted(map(str, Path("/dev").glob("tty[AU]*"))))
            hint = f"one of {there}" if there else "connect it; no /dev/ttyUSB, ttyACM or ttyAMA is there"
            raise UsageError(f"no serial port {target.place}", hint=hint)
        self._handle = self._opened()

    def _opened(self) -> int:
        try:
            return self._open()
        except OSError as error:
            raise _refusal(self.target, error) from error

    def _open(self) -> int:
        import termios
        import tty

        speed = getattr(termios, f"B{self.target.number}", None)
        if speed is None:
            known = sorted(int(name[1:]) for name in dir(termios) if re.fullmatch(r"B[1-9]\d+", name))
            raise UsageError(
                f"not a speed: {self.target.number}", hint="one of " + ", ".join(map(str, known[-14:]))
            )
        handle = os.open(self.target.place, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(handle)
            settings = termios.tcgetattr(handle)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = speed
            termios.tcsetattr(handle, termios.TCSANOW, settings)
        except termios.error as error:
            os.close(handle)
            raise OSError(errno.ENOTTY, "not a serial port") from error
        return handle


KINDS: dict[str, Callable[[Target], Link]] = {
    "tcp": TcpLink,
    "serial": SerialLink,
}


def open_link(text: str, *, buffer: int | None = None, sends: bool = False) -> Link:
    """Open the link that `text` names.

    `buffer`: bytes of socket buffer to ask for; as much as can be had where None.
    `sends`: whether heartbeats will be sent: a `udpout:` link hears nothing without.
    Raises UsageError: not understood, in use, not there, or not allowed.
    """
    target = parse_link(text)
    if target.kind == "udpout" and not sends:
        raise UsageError(
            f"{text} would receive nothing: the other side sends only to hosts that it has heard",
            hint="add --heartbeat",
        )
    if target.kind in KINDS:
        return KINDS[target.kind](target)
    return UdpLink(target, buffer)


def buffer_advice(link: Link) -> str:
    """What to do about a socket buffer that is smaller than wished for; empty where it is not."""
    if link.buffer is None or link.buffer >= WANTED_BUFFER:
        return ""
    command = f"sysctl -w net.core.rmem_max={WANTED_BUFFER // 2}"
    remedy = f"; for more: {command}" if sys.platform == "linux" else ""
    return f"{link.target.text}: the socket's buffer is {link.buffer:,} bytes{remedy}"


def _ask_for_buffer(udp: socket.socket, wanted: int | None) -> int:
    """Ask for a large buffer, beyond the system's limit where that is allowed; the bytes granted."""
    size = WANTED_BUFFER if wanted is None else wanted
    if wanted is None and sys.platform == "linux":
        try:
            udp.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size // 2)  # the kernel doubles it
        except PermissionError:
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size // 2)
    else:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size // 2)
    return udp.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def _arrival(content: bytes, peer: bytes) -> Arrival:
    raw = np.frombuffer(bytearray(content), np.uint8)  # writable, as datagrams are: one compilation
    return Arrival(peer, raw, np.array([len(raw)]), np.array([time.time_ns() // 1000]))


def _address(peer: bytes) -> tuple[str, int]:
    """Host and port of a sockaddr_in or sockaddr_in6."""
    port = int.from_bytes(peer[2:4], "big")
    if len(peer) == ADDRESS:
        return socket.inet_ntop(socket.AF_INET6, peer[8:24]), port
    return socket.inet_ntop(socket.AF_INET, peer[4:8]), port


def _resolve(target: Target, kind: int) -> tuple[int, int, int, str, tuple[Any, ...]]:
    try:
        found = socket.getaddrinfo(target.place, target.number, type=kind)[0]
    except OSError as error:
        raise UsageError(f"no host {target.place!r}: {error.strerror}", hint=FORMS) from error
    return found


def _refusal(target: Target, error: OSError) -> UsageError:
    hints = {
        errno.EADDRINUSE: "another program listens there: end it, choose another port, or let mavlink-router "
        "serve both",
        errno.EACCES: "ports below 1024 and serial ports need rights (for a serial port: group dialout)",
        errno.EADDRNOTAVAIL: "0.0.0.0 listens on all of this host's addresses",
        errno.EBUSY: "another program holds it",
    }
    reason = error.strerror or str(error)
    return UsageError(f"{target.text} cannot be opened: {reason}", hint=hints.get(error.errno or 0, FORMS))
