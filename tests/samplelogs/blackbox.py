"""A writer of blackbox logs with every encoding and predictor, and a small file of two logs.

Written from the description of the format, apart from the reader: values go in, what the firmware would write
comes out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

from tests.samplelogs import Record, record_at

SUFFIX = ".bbl"
UNCHECKED = True
HARMLESS = b"\x00\xff"
RESYNC_BYTES = 700
START = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"
END = b"E\xffEnd of log\x00"
SETTINGS = {
    "Firmware type": "Cleanflight",
    "Firmware revision": "Betaflight 4.2.9 (e097f4ab7) STM32F7X2",
    "Log start datetime": "2026-02-05T21:44:46.932+00:00",
    "Craft name": "Test quad",
    "I interval": "16",
    "P interval": "1/2",
    "minthrottle": "1070",
    "gyro_scale": "0x3f800000",
    "motorOutput": "158,2047",
    "acc_1G": "2048",
    "vbatref": "2490",
    "looptime": "125",
    "rollPID": "47,85,38",
}
DECIDING = ("Data version", "Field", "I interval", "P interval", "minthrottle", "motorOutput", "vbatref")


# ------------------------------------------------------------------------------------------ encodings


def wrapped(value: int) -> int:
    """As a signed number of 32 bits."""
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def unsigned_vb(value: int) -> bytes:
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def signed_vb(value: int) -> bytes:
    return unsigned_vb(value << 1 ^ value >> 31)


def _fits(values: Sequence[int], bits: Sequence[int]) -> bool:
    return all(-(1 << b - 1) <= v < 1 << b - 1 for v, b in zip(values, bits, strict=True))


def _packed(parts: Sequence[tuple[int, int]]) -> bytes:
    """(value, bits) one after the other, the highest bit first, filled up to a byte."""
    number, size = 0, 0
    for value, bits in parts:
        number = number << bits | value & (1 << bits) - 1
        size += bits
    spare = -size % 8
    return (number << spare).to_bytes((size + spare) // 8, "big")


def tag2(values: Sequence[int], variable: bool) -> bytes:
    """TAG2_3S32, or TAG2_3SVARIABLE."""
    a, b, c = values
    if _fits(values, (2, 2, 2)):
        return _packed([(0, 2), (a, 2), (b, 2), (c, 2)])
    if variable and _fits(values, (5, 5, 4)):
        return _packed([(1, 2), (a, 5), (b, 5), (c, 4)])
    if variable and _fits(values, (8, 7, 7)):
        return _packed([(2, 2), (a, 8), (b, 7), (c, 7)])
    if not variable and _fits(values, (4, 4, 4)):
        return _packed([(1, 2), (0, 2), (a, 4), (b, 4), (c, 4)])
    if not variable and _fits(values, (6, 6, 6)):
        return _packed([(2, 2), (a, 6), (0, 2), (b, 6), (0, 2), (c, 6)])
    sizes = [next(n for n in (1, 2, 3, 4) if _fits([v], [8 * n])) for v in values]
    tag = 0xC0 | sum(n - 1 << 2 * k for k, n in enumerate(sizes))
    little = [(v & (1 << 8 * n) - 1).to_bytes(n, "little") for v, n in zip(values, sizes, strict=True)]
    return bytes([tag]) + b"".join(little)


def tag8_4s16(values: Sequence[int], version: int) -> bytes:
    if version < 2:
        return _old_tag8_4s16(values)
    kinds = [
        0 if v == 0 else next(k for k, b in ((1, 4), (2, 8), (3, 16)) if _fits([v], [b])) for v in values
    ]
    tag = sum(kind << 2 * k for k, kind in enumerate(kinds))
    return bytes([tag]) + _packed([(v, 2 << k) for v, k in zip(values, kinds, strict=True) if k])


def _old_tag8_4s16(values: Sequence[int]) -> bytes:
    tag, out, k = 0, b"", 0
    while k < 4:
        value = values[k]
        if k < 3 and _fits([value, values[k + 1]], [4, 4]) and (value or values[k + 1]):
            tag |= 0b0101 << 2 * k
            out += bytes([value & 0xF | (values[k + 1] & 0xF) << 4])
            k += 2
            continue
        kind = 0 if value == 0 else 2 if _fits([value], [8]) else 3
        tag |= kind << 2 * k
        out += (b"", b"", struct.pack("<b", value) if kind == 2 else b"", struct.pack("<h", value))[kind]
        k += 1
    return bytes([tag]) + out


def tag8_8svb(values: Sequence[int]) -> bytes:
    if len(values) == 1:
        return signed_vb(values[0])
    tag = sum(1 << k for k, v in enumerate(values) if v)
    return bytes([tag]) + b"".join(signed_vb(v) for v in values if v)


def groups(encodings: Sequence[int]) -> list[tuple[int, int, int]]:
    """(first field, number of fields, encoding) of what is written at once."""
    found, k = [], 0
    while k < len(encodings):
        span = {7: 3, 8: 4, 10: 3}.get(encodings[k], 1)
        if encodings[k] == 6:
            run = next((j for j, e in enumerate(encodings[k:]) if e != 6), len(encodings) - k)
            span = min(run, 8)
        found.append((k, span, encodings[k]))
        k += span
    return found


def encoded(values: Sequence[int], encodings: Sequence[int], version: int = 2) -> bytes:
    """Differences as the firmware writes them, in groups where the encoding has groups."""
    write: dict[int, Callable[[Sequence[int]], bytes]] = {
        0: lambda v: signed_vb(v[0]),
        1: lambda v: unsigned_vb(v[0]),
        3: lambda v: unsigned_vb(-v[0] & 0x3FFF),
        6: tag8_8svb,
        7: lambda v: tag2(v, False),
        8: lambda v: tag8_4s16(v, version),
        9: lambda _: b"",
        10: lambda v: tag2(v, True),
    }
    filled = [*values, 0, 0, 0]
    return b"".join(write[code](filled[k : k + span]) for k, span, code in groups(encodings))


# ------------------------------------------------------------------------------------------- predictors


@dataclass(frozen=True)
class Fields:
    """The fields of one kind of frame."""

    names: Sequence[str]
    signed: Sequence[int]
    predictor: Sequence[int]
    encoding: Sequence[int]

    def lines(self, kind: str) -> list[bytes]:
        rows = {
            "name": self.names,
            "signed": self.signed,
            "predictor": self.predictor,
            "encoding": self.encoding,
        }
        chosen = [w for w in rows if kind != "P" or w in ("predictor", "encoding")]
        return [f"H Field {kind} {w}:{','.join(map(str, rows[w]))}\n".encode() for w in chosen]


@dataclass
class Writer:
    """Writes the frames of one log; `kinds` by letter, P with the names and signs of I."""

    kinds: Mapping[str, Fields]
    settings: Mapping[str, str]
    version: int = 2
    history: list[Sequence[int]] = field(default_factory=list)
    home: Sequence[int] = (0, 0)
    before: dict[str, Sequence[int]] = field(default_factory=dict)

    def header(self) -> list[bytes]:
        lines = [START, f"H Data version:{self.version}\n".encode()]
        for kind, fields in self.kinds.items():
            lines += fields.lines(kind)
        return lines + [f"H {name}:{text}\n".encode() for name, text in self.settings.items()]

    def setting(self, name: str) -> int:
        return int(self.settings[name].split(",")[0])

    def due(self, iteration: int) -> int:
        """The next iteration that is logged."""
        every = self.setting("I interval")
        share, of = (int(n) for n in self.settings["P interval"].split("/"))
        iteration += 1
        while not ((iteration % every + share - 1) % of < share):
            iteration += 1
        return iteration

    def prediction(self, kind: str, k: int, values: Sequence[int]) -> int:
        """What field k is predicted to be; `values` are the frame's own so far."""
        fields = self.kinds[kind]
        code = fields.predictor[k]
        last: Sequence[int] = [0] * len(fields.names)
        older = last
        if kind == "P":
            last, older = self.history[-1], self.history[-2]
        elif kind in self.before:
            last = self.before[kind]
        if code == 3:
            total = last[k] + older[k]
            if fields.signed[k]:
                return math.trunc(wrapped(total) / 2)
            return total % (1 << 32) // 2
        if code == 5:
            return values[fields.names.index("motor[0]")]
        if code == 6:
            return self.due(last[k])
        if code == 7:
            return self.home[[j for j, p in enumerate(fields.predictor) if p == 7].index(k)]
        if code == 10:
            return self.history[-1][list(self.kinds["I"].names).index("time")]
        if code in (4, 9, 11):
            return self.setting({4: "minthrottle", 9: "vbatref", 11: "motorOutput"}[code])
        return {0: 0, 1: last[k], 2: 2 * last[k] - older[k], 8: 1500}[code]

    def frame(self, kind: str, values: Sequence[int]) -> bytes:
        """A frame with these values (unsigned ones below 2^32); it becomes history."""
        fields = self.kinds[kind]
        raw = [wrapped(v - self.prediction(kind, k, values)) for k, v in enumerate(values)]
        kept = [9 if p == 6 else e for p, e in zip(fields.predictor, fields.encoding, strict=True)]
        if kind == "I":
            self.history = [list(values)] * 2
        elif kind == "P":
            self.history = [self.history[-1], list(values)]
        elif kind == "H":
            self.home = list(values)
        else:
            self.before[kind] = list(values)
        return kind.encode() + encoded(raw, kept, self.version)


# ------------------------------------------------------------------------------------------- the sample

MAIN = Fields(
    ["loopIteration", "time", "axisP[0]", "axisI[0]", "axisI[1]", "axisI[2]", "rcCommand[0]", "rcCommand[1]",
     "rcCommand[2]", "rcCommand[3]", "vbatLatest", "amperageLatest", "rssi", "gyroADC[0]", "gyroADC[1]",
     "gyroADC[2]", "debug[0]", "debug[1]", "debug[2]", "motor[0]", "motor[1]"],
    [0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 1, 0, 1, 1, 1, 1, 1, 1, 0, 0],
    [0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 9, 0, 8, 0, 0, 0, 0, 0, 0, 11, 5],
    [1, 1, 0, 0, 0, 0, 0, 0, 0, 1, 3, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0],
)  # fmt: skip
INTER = Fields(
    MAIN.names,
    MAIN.signed,
    [6, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 3, 3, 3, 1, 1, 1, 3, 3],
    [9, 0, 0, 7, 7, 7, 8, 8, 8, 8, 6, 6, 6, 0, 0, 0, 10, 10, 10, 0, 0],
)
SLOW = Fields(
    ["flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"],
    [0] * 5, [0] * 5, [1, 1, 7, 7, 7],
)  # fmt: skip
GPS = Fields(
    ["time", "GPS_numSat", "GPS_coord[0]", "GPS_coord[1]", "GPS_altitude", "GPS_speed"],
    [0, 0, 1, 1, 0, 0], [10, 0, 7, 7, 0, 0], [1, 1, 0, 0, 1, 1],
)  # fmt: skip
HOME = Fields(["GPS_home[0]", "GPS_home[1]"], [1, 1], [0, 0], [0, 0])
KINDS = {"I": MAIN, "P": INTER, "H": HOME, "G": GPS, "S": SLOW}
HOME_DEGREES = (481234567, -1227654321)


def main_values(k: int, iteration: int, start_us: int) -> list[int]:
    """The k-th main frame: sines of the size that a quadrotor shows, a time that jitters."""
    time_us = (start_us + 500 * iteration + 7 * (k * k % 5)) % (1 << 32)
    wave = [round(90 * math.sin(0.11 * k + phase)) for phase in range(9)]
    motors = [400 + wave[0], max(0, 380 - wave[1] * 5)]
    debug = [wave[6] * (k % 3), wave[7], k % 7 - 3]
    throttle = 1070 - 30 * (k % 40 == 0) + abs(wave[8])
    sticks = [wave[3] // 4, wave[4] * 3, -wave[5]]
    power = [2480 - k // 50, 300 + wave[2], 900]
    return [iteration, time_us, wave[0], *wave[1:4], *sticks, throttle, *power, *wave[4:7], *debug, *motors]


@dataclass(frozen=True)
class Piece:
    """Some bytes of the sample: `group` numbers I frames with what follows them; header pieces have none."""

    raw: bytes
    rows: int
    log: int
    group: int = -1


def _log(number: int, start_us: int, frames: int) -> list[Piece]:
    """One log: header, frames, events; the recorder pauses once."""
    writer = Writer(KINDS, SETTINGS)
    pieces = [Piece(line, 1, number) for line in writer.header()] + [Piece(b"H \n", 0, number)]
    iteration, group = 0, 0

    def add(raw: bytes) -> None:
        pieces.append(Piece(raw, 1, number, group))

    add(b"E\x00" + unsigned_vb(start_us))
    add(writer.frame("S", [1, 3, 0, 1, 1]))
    for k in range(frames):
        is_first = iteration % 16 == 0
        group += is_first
        add(writer.frame("I" if is_first else "P", main_values(k, iteration, start_us)))
        iteration = writer.due(iteration)
        if k == 3:
            add(writer.frame("H", HOME_DEGREES))
        if k % 20 == 5:
            place = [HOME_DEGREES[0] + 3 * k, HOME_DEGREES[1] - 2 * k]
            add(writer.frame("G", [(writer.history[-1][1] + 100) % (1 << 32), 9, *place, 120 + k, 300]))
        if k == 100:
            add(writer.frame("S", [5, 3, 0, 1, 1]))
            add(b"E\x1e" + unsigned_vb(5) + unsigned_vb(1))
            add(b"E\x0d\x05" + signed_vb(-7))
            add(b"E\x0d\x85" + struct.pack("<f", 1.5))
        if k == 8 * 20 - 1:
            iteration += 160
            add(b"E\x0e" + unsigned_vb(iteration) + unsigned_vb(start_us + 500 * iteration))
    add(b"E\x0f\x04")
    pieces.append(Piece(END, 1, number, group))
    return pieces


@cache
def pieces() -> tuple[Piece, ...]:
    """The whole file piece by piece: two logs, the second with a clock that wraps."""
    return (*_log(0, 150_000_000, 320), *_log(1, (1 << 32) - 90_000, 200))


def build() -> bytes:
    return b"".join(piece.raw for piece in pieces())


def records(blob: bytes) -> list[Record]:  # noqa: ARG001
    found, at = [], 0
    for piece in pieces():
        found.append(Record(at, at + len(piece.raw), piece.rows))
        at += len(piece.raw)
    return found


@cache
def _risks() -> tuple[int, ...]:
    """Rows at risk where the piece of the same number is damaged.

    A frame risks its group, and an I frame the one before it: what does not go on from an I frame is not
    kept. A home frame risks the positions behind it; a line that decides how frames are read all of its log;
    the last two lines what stands before the first I frame: frames count from there where the header's end
    is not clear.
    """
    found = []
    everything = pieces()
    for piece in everything:
        own = [p for p in everything if p.log == piece.log]
        name = piece.raw.partition(b":")[0].removeprefix(b"H ").decode("latin-1")
        if piece.group < 0:
            decides = piece.raw == START or name.startswith(DECIDING)
            is_late = piece.raw in (b"H \n", f"H rollPID:{SETTINGS['rollPID']}\n".encode())
            risk = sum(p.rows for p in own if decides or (is_late and p.group == 0)) + piece.rows
        else:
            near = (piece.group, piece.group - 1) if piece.raw[:1] == b"I" else (piece.group,)
            risk = sum(p.rows for p in own if p.group in near)
            if any(p.raw[:1] == b"H" for p in own if p.group in near):
                risk += sum(p.raw[:1] == b"G" for p in own)
        found.append(risk)
    return tuple(found)


def at_risk(blob: bytes, byte: int) -> int:
    """Rows that damage to this byte may cost; a line's last byte holds it apart from the next."""
    found = records(blob)
    hit = record_at(found, byte)
    number = found.index(hit)
    if pieces()[number].raw == START and not pieces()[number].log:
        return sum(r.rows for r in found)
    risks = _risks()
    if byte == hit.end - 1 and pieces()[number].group < 0:
        return max(risks[number], risks[number + 1])
    return risks[number]
