"""A small blackbox file of two logs, with every encoding and predictor."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import cache

from flysid.ingest.formats.blackbox.header import START
from flysid.ingest.formats.blackbox.writing import Fields, Writer, signed_vb, unsigned_vb
from tests.samplelogs import Record, record_at

SUFFIX = ".bbl"
UNCHECKED = True
HARMLESS = b"\x00\xff"
RESYNC_BYTES = 700
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
    iteration = 0
    group = 0

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
    found = []
    at = 0
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
