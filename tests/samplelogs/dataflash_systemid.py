"""A DataFlash log of ArduPilot's SYSTEMID mode on the roll mixer: chirp, rate controller and gyro.

The loop is that of `bench.closed_loop`: 3333 / (s (s + 33.3)) with 7.5 ms of dead time, P + I around it.
"""

from __future__ import annotations

from bench.closed_loop import Loop
from tests.samplelogs.dataflash import TYPES, fmt, pack

SECONDS = 40.0
KINDS = {
    20: ("SIDS", "QBfff", "TimeUS,Ax,Mag,FSt,FSp"),
    21: ("SIDD", "Qffffffff", "TimeUS,Time,Targ,F,Gx,Gy,Gz,Ax,Az"),
    22: ("RATE", "Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut"),
}
UNITS = {21: ("ss-zkkkoo", "F--------"), 22: ("skk-kk-kk-", "F---------")}


def build(seed: int = 1) -> bytes:
    """Formats and units first, then a run on SID_AXIS 10 (roll mixer), 400 Hz, ten seconds after start."""
    types = {number: kind for number, kind in TYPES.items() if number >= 128} | {12: TYPES[12]} | KINDS
    out = [fmt(number, types) for number in types]
    letters = {"s": "s", "k": "deg/s", "o": "m/s/s", "z": "Hz"}
    out += [pack(129, 1, ord(letter), unit) for letter, unit in letters.items()]
    out += [pack(131, 1, ord(letter), factor) for letter, factor in (("F", 1e-6), ("-", 0.0))]
    out += [pack(130, 1, number, units, factors) for number, (units, factors) in UNITS.items()]
    out.append(pack(12, 1, "ArduCopter V4.5.1 (0123abcd)"))
    flown = Loop(0.1, seconds=SECONDS).flown(seed)
    segment = flown.segments[0]
    begin_us = 10_000_000
    out.append(pack(20, begin_us - 1000, 10, 0.5, 0.5, 12.0, types=types))
    for i, ((total, chirp), rate) in enumerate(zip(segment.u, segment.y[:, 0], strict=True)):
        us = begin_us + round(1e6 * i * flown.dt_s)
        out.append(pack(21, us, i * flown.dt_s, chirp, 0.0, rate, 0.0, 0.0, 0.0, -9.8, types=types))
        out.append(pack(22, us, 0.0, rate, total, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, types=types))
    return b"".join(out)
