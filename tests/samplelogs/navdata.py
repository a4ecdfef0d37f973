"""AR.Drone packets, captures and commands made here; the sample log of the contract tests."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np

from tests.samplelogs import Record

SUFFIX = ".navdata"
DEMO = 0
TIME = 1
REFERENCES = 6
PWM = 9
ALTITUDE = 10
DETECT = 16


def option(tag: int, body: bytes) -> bytes:
    return struct.pack("<HH", tag, len(body) + 4) + body


def packet(sequence: int, options: Mapping[int, bytes], state: int = 0xF800094) -> bytes:
    """A packet with its checksum."""
    head = struct.pack("<4I", 0x55667788, state, sequence, 1)
    body = head + b"".join(option(tag, raw) for tag, raw in options.items())
    return body + option(0xFFFF, struct.pack("<I", sum(body) & 0xFFFFFFFF))


def clock(time_us: int) -> bytes:
    """The option `time`: 11 bits of seconds, 21 of microseconds."""
    seconds, micros = divmod(time_us, 1_000_000)
    return struct.pack("<I", (seconds % 2048) << 21 | micros)


def demo(k: int) -> bytes:
    """theta, phi, psi in millidegrees; altitude in mm; vx, vy, vz in mm/s."""
    head = struct.pack("<HHI3fi3fI", 0, 3, 80, 100.0 * k, -50.0 * k, 7.0, 1000 + k, k, -k, 0.5 * k, k)
    return head + bytes(36 + 12 + 8 + 36 + 12)


def references(k: int) -> bytes:
    return struct.pack("<8i6fI5fi", k, -k, *range(6), *(0.5 * j for j in range(6)), 1, *([0.25] * 5), k)


def flight(count: int, start_us: int = 5_000_000, first: int = 1) -> list[bytes]:
    """Packets at 200 Hz, every fifth without references."""
    found = []
    for k in range(count):
        options = {DEMO: demo(k), TIME: clock(start_us + 5000 * k)}
        if k % 5:
            options[REFERENCES] = references(k)
        if k % 20 == 3:
            options[DETECT] = bytes(324)
        found.append(packet(first + k, options))
    return found


def build() -> bytes:
    return b"".join(flight(40))


def records(blob: bytes) -> list[Record]:
    """A packet gives a row of the header and one per option, but none for vision_detect."""
    found = []
    at = 0
    while at < len(blob):
        rows = 1
        place = at + 16
        while True:
            tag, size = struct.unpack_from("<HH", blob, place)
            place += size
            if tag == 0xFFFF:
                break
            rows += tag != DETECT
        found.append(Record(at, place, rows))
        at = place
    return found


def udp(payload: bytes, source: int, target: int, number: int = 0) -> list[bytes]:
    """IPv4 packets of a datagram, in fragments of at most 1480 bytes."""
    whole = struct.pack(">4H", source, target, len(payload) + 8, 0) + payload
    found = []
    for at in range(0, len(whole), 1480):
        piece = whole[at : at + 1480]
        more = 0x2000 if at + 1480 < len(whole) else 0
        size = 20 + len(piece)
        flags = more | at // 8
        head = struct.pack(
            ">BBHHHBBH4s4s", 0x45, 0, size, number, flags, 64, 17, 0, b"\xc0\xa8\1\1", b"\xc0\xa8\1\2"
        )
        found.append(head + piece)
    return found


LINKS = {1: bytes(12) + b"\x08\x00", 113: bytes(14) + b"\x08\x00", 276: b"\x08\x00" + bytes(18), 101: b""}


def pcap(
    datagrams: Sequence[tuple[int, Sequence[bytes]]], *, order: str = "<", nano: bool = False, link: int = 1
) -> bytes:
    """A capture of (time in ns, IPv4 packets)."""
    magic = 0xA1B23C4D if nano else 0xA1B2C3D4
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)]
    for time_ns, packets in datagrams:
        seconds, rest = divmod(time_ns, 10**9)
        for raw in packets:
            frame = LINKS[link] + raw
            fraction = rest if nano else rest // 1000
            parts.append(struct.pack(order + "4I", seconds, fraction, len(frame), len(frame)) + frame)
    return b"".join(parts)


def pcmd(sequence: int, fractions: Sequence[float]) -> bytes:
    """AT*PCMD with the float bits as signed integers."""
    bits = np.array(fractions, dtype=np.float32).view(np.int32).tolist()
    return f"AT*PCMD={sequence},1,{','.join(map(str, bits))}\r".encode()


def config(sequence: int, key: str, value: str) -> bytes:
    return f'AT*CONFIG={sequence},"{key}","{value}"\r'.encode()
