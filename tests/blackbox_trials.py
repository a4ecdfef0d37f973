"""Blackbox logs of INAV, EmuFlight and Rotorflight, by their firmwares' tables of fields, with random values.

Every number that was written must come back. The tables are those of the firmwares' `blackbox.c` (INAV 8,
EmuFlight 0.4, Rotorflight 2) with all their fields; the frames come from `writing`, which is apart from the
reader. `tests/ingest/formats/test_blackbox_forks.py` has another decoder read them, too.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.blackbox.writing import Fields, Writer
from flysid.ingest.formats.registry import find_format
from soak import Outcome

FRAMES = 200
END = b"E\xffEnd of log\x00"
THROTTLE = (1070, 2000)
BATTERY = (2000, 2480)
STEPS = (0, 1, 1, 3, 20, 120, 3000)
VB, UVB, NEG14, TAG8, TAG2, TAG4, NOTHING = 0, 1, 3, 6, 7, 8, 9  # encodings
ZERO, LAST, LINE, MEAN, THROTTLE_LOW, MOTOR_0, NEXT, CENTRE, VBAT, MOTOR_LOW = 0, 1, 2, 3, 4, 5, 6, 8, 9, 11


class Field(NamedTuple):
    """A field of the main frames: is it signed; predictor and encoding in I frames, and in P frames."""

    name: str
    signed: int
    intra: tuple[int, int]
    inter: tuple[int, int]


def fields(name: str, count: int, signed: int, intra: tuple[int, int], inter: tuple[int, int]) -> list[Field]:
    """Several fields of one name with their indices; one without any."""
    names = [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]
    return [Field(each, signed, intra, inter) for each in names]


def smooth(name: str, count: int = 1) -> list[Field]:
    return fields(name, count, 1, (ZERO, VB), (LAST, VB))


def noisy(name: str, count: int = 1) -> list[Field]:
    return fields(name, count, 1, (ZERO, VB), (MEAN, VB))


def grouped(name: str, encoding: int, count: int = 1) -> list[Field]:
    return fields(name, count, 1, (ZERO, VB), (LAST, encoding))


def counted(name: str, count: int = 1, predictor: int = LAST) -> list[Field]:
    return fields(name, count, 0, (ZERO, UVB), (predictor, VB))


def motors(count: int, lowest: int) -> list[Field]:
    others = [Field(f"motor[{k}]", 0, (MOTOR_0, VB), (MEAN, VB)) for k in range(1, count)]
    return [Field("motor[0]", 0, (lowest, UVB), (MEAN, VB)), *others]


def all_of(*parts: Sequence[Field]) -> list[Field]:
    return [each for part in parts for each in part]


CLOCK = [
    Field("loopIteration", 0, (ZERO, UVB), (NEXT, NOTHING)),
    Field("time", 0, (ZERO, UVB), (LINE, VB)),
]
STICKS = [
    *grouped("rcCommand", TAG4, 4)[:3],
    Field("rcCommand[3]", 0, (THROTTLE_LOW, UVB), (LAST, TAG4)),
]
SENSORS = all_of(
    grouped("magADC", TAG8, 3),
    grouped("BaroAlt", TAG8),
    grouped("surfaceRaw", TAG8),
    [Field("rssi", 0, (ZERO, UVB), (LAST, TAG8))],
)
INAV = all_of(
    CLOCK,
    smooth("axisRate", 3),
    smooth("axisP", 3),
    grouped("axisI", TAG2, 3),
    smooth("axisD", 3),
    smooth("axisF", 3),
    smooth("mcPosAxisP", 3),
    *(smooth(f"mcVelAxis{term}", 3) for term in ("P", "I", "D", "FF", "Out")),
    *(smooth(f"mcSurface{term}") for term in ("P", "I", "D", "Out")),
    grouped("rcData", TAG4, 4),
    STICKS,
    [Field("vbat", 0, (VBAT, NEG14), (LAST, TAG8))],
    grouped("amperage", TAG8),
    SENSORS,
    noisy("gyroADC", 3),
    noisy("gyroRaw", 3),
    *(counted(f"gyroPeak{axis}", 3, MEAN) for axis in ("Roll", "Pitch", "Yaw")),
    noisy("accSmooth", 3),
    counted("accVib", 1, MEAN),
    noisy("attitude", 3),
    noisy("debug", 8),
    motors(4, THROTTLE_LOW),
    fields("servo", 26, 0, (CENTRE, VB), (MEAN, VB)),
    smooth("navState"),
    [Field("navFlags", 0, (ZERO, VB), (LAST, VB))],
    smooth("navEPH"),
    smooth("navEPV"),
    smooth("navPos", 3),
    noisy("navVel", 3),
    noisy("navTgtVel", 3),
    smooth("navTgtPos", 3),
)
EMUFLIGHT = all_of(
    CLOCK,
    smooth("axisP", 3),
    grouped("axisI", TAG2, 3),
    smooth("axisD", 3),
    smooth("axisF", 3),
    STICKS,
    grouped("setpoint", TAG4, 4),
    [Field("vbatLatest", 0, (VBAT, NEG14), (LAST, TAG8))],
    grouped("amperageLatest", TAG8),
    SENSORS,
    noisy("gyroADC", 3),
    noisy("accSmooth", 3),
    noisy("debug", 4),
    motors(8, MOTOR_LOW),
    [Field("servo[5]", 0, (CENTRE, VB), (LAST, VB))],
)
ROTORFLIGHT = all_of(
    CLOCK,
    grouped("rcCommand", TAG4, 4),
    [Field("rcCommand[4]", 0, (ZERO, UVB), (LAST, VB))],
    grouped("setpoint", TAG4, 4),
    grouped("mixer", TAG4, 4),
    *(grouped(f"axis{term}", TAG2, 3) for term in "PIDFBO"),
    grouped("attitude", TAG2, 3),
    noisy("gyroRAW", 3),
    noisy("gyroADC", 3),
    noisy("accADC", 3),
    grouped("magADC", TAG8, 3),
    grouped("altitude", TAG8),
    grouped("vario", TAG8),
    [Field("rssi", 0, (ZERO, UVB), (LAST, TAG8)), Field("Vbat", 0, (VBAT, NEG14), (LAST, VB))],
    *map(counted, ("Ibat", "Vbec", "Vbus", "EscV", "EscI", "EscCap", "EscRPM", "EscThr", "EscPwm")),
    *map(counted, ("BecV", "BecI", "Esc2V", "Esc2I", "Esc2Cap", "Esc2RPM")),
    *(grouped(name, TAG8) for name in ("Tmcu", "Tesc", "Tbec", "Tesc2")),
    *(grouped(f"gov{term}", TAG4) for term in "PIDF"),
    smooth("govSum"),
    counted("govTarget"),
    counted("govRequest"),
    counted("headspeed", 1, MEAN),
    counted("tailspeed", 1, MEAN),
    noisy("motor", 4),
    fields("servo", 8, 0, (CENTRE, VB), (MEAN, VB)),
    smooth("debug", 8),
)
FIRMWARES = {
    "INAV 8.0.0 (1234abcd) F722": (INAV, "1/2"),
    "EmuFlight 0.4.3 (1234abcd) F405": (EMUFLIGHT, "1/1"),
    "Rotorflight 4.5.0 (1234abcd) NEXUS": (ROTORFLIGHT, "1/4"),
}
SLOW = Fields(
    ["flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid"],
    [0] * 5,
    [0] * 5,
    [UVB, UVB, TAG2, TAG2, TAG2],
)
HOME = Fields(["GPS_home[0]", "GPS_home[1]"], [1, 1], [0, 0], [VB, VB])
GPS = Fields(
    ["time", "GPS_numSat", "GPS_coord[0]", "GPS_coord[1]", "GPS_altitude", "GPS_speed", "GPS_ground_course"],
    [0, 0, 1, 1, 0, 0, 0],
    [10, 0, 7, 7, 0, 0, 0],
    [UVB, UVB, VB, VB, UVB, UVB, UVB],
)
STREAMS = {"main": "main", "S": "slow", "G": "gps", "H": "home"}


@dataclass(frozen=True)
class Trial:
    """A log, and what was written: stream -> names of its columns, and the rows."""

    revision: str
    blob: bytes
    names: dict[str, list[str]]
    rows: dict[str, list[list[int]]]


def draw(seed: int) -> Trial:
    """The log that a seed draws."""
    rng = random.Random(seed)
    revision = list(FIRMWARES)[seed % len(FIRMWARES)]
    table, interval = FIRMWARES[revision]
    names = [field.name for field in table]
    signed = [field.signed for field in table]
    kinds = {
        "I": Fields(names, signed, [f.intra[0] for f in table], [f.intra[1] for f in table]),
        "P": Fields(names, signed, [f.inter[0] for f in table], [f.inter[1] for f in table]),
        "S": SLOW,
        "H": HOME,
        "G": GPS,
    }
    settings = {
        "Firmware type": "Cleanflight",
        "Firmware revision": revision,
        "I interval": "32",
        "P interval": interval,
        "minthrottle": "1070",
        "motorOutput": "158,2047",
        "vbatref": "2490",
        "gyro_scale": "0x3f800000",
        "acc_1G": "2048",
        "looptime": "500",
    }
    writer = Writer(kinds, settings)
    out = writer.header()
    rows: dict[str, list[list[int]]] = {name: [] for name in STREAMS.values()}
    iteration, micros = 0, 1_000_000
    values = [0 if field.signed else 1200 for field in table]
    for k in range(FRAMES):
        values = [
            iteration,
            micros,
            *(_next(rng, f, v) for f, v in zip(table[2:], values[2:], strict=True)),
        ]
        out.append(writer.frame("I" if iteration % 32 == 0 else "P", values))
        rows["main"].append(values)
        for letter, row in _beside(rng, k, micros):
            out.append(writer.frame(letter, row))
            rows[STREAMS[letter]].append(row)
        due = writer.due(iteration)
        micros += 500 * (due - iteration) + rng.randint(-3, 3)
        iteration = due
    columns = {"main": names, "slow": SLOW.names, "gps": GPS.names, "home": HOME.names}
    return Trial(revision, b"".join([*out, END]), {key: list(value) for key, value in columns.items()}, rows)


def _next(rng: random.Random, field: Field, last: int) -> int:
    """The next value of a field: it stays, creeps or leaps, within what the firmware can hold."""
    step = rng.choice(STEPS)
    value = last + rng.randint(-step, step)
    if field.intra[0] == VBAT:
        return min(max(value, BATTERY[0]), BATTERY[1])
    if field.name == "rcCommand[3]" and not field.signed:
        return min(max(value, THROTTLE[0]), THROTTLE[1])
    if field.name.startswith("motor") and not field.signed:
        return max(value, THROTTLE[0])
    if field.inter[1] == TAG4:
        return min(max(value, -30_000), 30_000)
    return value if field.signed else max(0, value)


def _beside(rng: random.Random, k: int, micros: int) -> Iterator[tuple[str, list[int]]]:
    """Frames between the main ones."""
    if k % 50 == 0:
        yield "S", [rng.getrandbits(32), rng.getrandbits(4), rng.randint(0, 6), 1, k % 2]
        yield "H", [491_234_567 + k, -12_345_678 - k]
    if k % 10 == 5:
        moved = [rng.randint(-5000, 5000) for _ in range(2)]
        yield (
            "G",
            [micros, rng.randint(0, 30), 491_234_567 + moved[0], -12_345_678 + moved[1], 123 + k, k, 10 * k],
        )


def faults(trial: Trial) -> Iterator[str]:
    """Streams whose numbers are not those that were written."""
    flight = read(trial)
    if flight.damage.lossy:
        yield f"{trial.revision}: lost: {flight.damage}"
    for stream, names in trial.names.items():
        columns = [names_in(flight, stream, name) for name in names]
        got = [list(row) for row in zip(*columns, strict=True)]
        if got != trial.rows[stream]:
            unlike = sum(a != b for a, b in zip(got, trial.rows[stream], strict=False))
            yield f"{trial.revision}: {stream}: {unlike} rows unlike, {len(got)} of {len(trial.rows[stream])}"


def names_in(flight: Flight, stream: str, name: str) -> list[int]:
    """The numbers of a column."""
    return [int(value) for value in flight[stream][name].to_pylist()]


def read(trial: Trial) -> Flight:
    """The log as flysid reads it."""
    return collect(memoryview(trial.blob), "t.bbl", find_format("blackbox"), Limits())


def trials(count: int, goes_on: Callable[[], bool], first_seed: int = 0) -> Outcome:
    """Draw and judge logs, one seed each."""
    outcome = Outcome("blackbox")
    outcome.judge(
        range(first_seed, first_seed + count), goes_on, draw, faults, lambda trial: len(trial.rows["main"])
    )
    return outcome
