"""Small DataFlash logs of a copter, row by row as a test wants them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.logged import LoggedFlight
from tests.samplelogs.dataflash import TYPES, fmt, pack

Floats = npt.NDArray[np.float64]
KINDS = {number: TYPES[number] for number in (128, 12)} | {
    20: ("RATE", "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut"),
    21: ("ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    22: ("RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4"),
    23: ("PARM", "QNf", "TimeUS,Name,Value"),
    24: ("EV", "QB", "TimeUS,Id"),
    25: ("IMU", "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ"),
    26: ("MODE", "QBBB", "TimeUS,Mode,ModeNum,Rsn"),
}
NUMBERS = {name: number for number, (name, _, _) in KINDS.items()}
ARMED, FLYING, LANDED, DISARMED = 10, 28, 18, 11
Columns = Mapping[str, Floats]


def copter_log(
    folder: Path,
    messages: Mapping[str, tuple[Floats, Columns]],
    *,
    parameters: Mapping[str, float] | None = None,
    events: Sequence[tuple[float, int]] = (),
    name: str = "flight.bin",
) -> LoggedFlight:
    """A log read back.

    Parameters
    ----------
    messages : name -> times in s, and columns; what is not given is 0.
    events : seconds and the Id of EV.
    """
    out = [fmt(number, KINDS) for number in KINDS]
    out.append(pack(12, 1, "ArduCopter V4.3.1 (0123abcd)", types=KINDS))
    out += [pack(23, 1, key, value, types=KINDS) for key, value in (parameters or {}).items()]
    rows: list[tuple[int, bytes]] = [(round(1e6 * at), _row("EV", at, {"Id": kind})) for at, kind in events]
    for message, (time_s, columns) in messages.items():
        for i, at in enumerate(time_s.tolist()):
            values = {label: column[i] for label, column in columns.items()}
            rows.append((round(1e6 * at), _row(message, at, values)))
    out += [row for _, row in sorted(rows, key=lambda pair: pair[0])]
    path = folder / name
    path.write_bytes(b"".join(out))
    return LoggedFlight(FlightLog(flysid.read(path)))


def _row(message: str, at: float, values: Mapping[str, float]) -> bytes:
    number = NUMBERS[message]
    _, form, labels = KINDS[number]
    cells = [values.get(label, 0.0) for label in labels.split(",")[1:]]
    kept = [c if code == "f" else int(c) for code, c in zip(form[1:], cells, strict=True)]
    return pack(number, round(1e6 * at), *kept, types=KINDS)


def even(seconds: float, rate_hz: float) -> Floats:
    """(N,) times."""
    return np.arange(1.0, 1.0 + seconds, 1.0 / rate_hz)


def wander(time_s: Floats, seed: int, size: float, slowest_s: float = 0.15) -> Floats:
    """(N,) a setpoint as sticks make it: no faster than this, of this standard deviation."""
    rng = np.random.default_rng(seed)
    f = np.linspace(0.05, 1.0 / (2.0 * np.pi * slowest_s) * 3.0, 60)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(f))
    parts = np.sin(2.0 * np.pi * np.outer(time_s, f) + phases)
    found: Floats = size * parts.sum(axis=1) / parts.sum(axis=1).std()
    return found
