"""A recording -> ArduPilot DataFlash log (.bin): the log that the vehicle itself would have written.

Every message begins with A3 95 and its type; definitions come first: FMT (types and labels), UNIT and MULT
(what the letters of FMTU mean), FMTU (units of each message). Messages are those of ArduCopter 4: ATT
(desired and measured attitude, 0.01 deg), XKF1 (velocity and position, north-east-down), CTUN (desired and
measured climb, cm/s), MODE and MSG. There is no radio: nothing arrives late, and drop-outs are the
logger's.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.ingest.synth.telemetry import (
    IntArray,
    Recording,
    Telemetry,
    as_bytes,
    heard,
    in_sending_order,
    throttle,
)

HEAD = b"\xa3\x95"
FMT = 128
CODES = {"Q": "<u8", "B": "u1", "h": "<i2", "c": "<i2", "C": "<u2", "e": "<i4", "f": "<f4", "Z": "S64",
         "N": "S16", "n": "S4", "b": "i1", "d": "<f8", "H": "<u2", "I": "<u4", "L": "<i4"}  # fmt: skip
UNITS = {
    "s": "s",
    "d": "deg",
    "h": "degheading",
    "m": "m",
    "n": "m/s",
    "z": "Hz",
    "#": "instance",
    "k": "deg/s",
    "E": "rad/s",
    "o": "m/s/s",
    "v": "V",
    "A": "A",
    "a": "Ah",
    "q": "rpm",
    "Y": "us",
    "G": "Gauss",
    "D": "deglatitude",
    "U": "deglongitude",
    "O": "degC",
    "%": "%",
}
MULTS = {"-": 0.0, "0": 1.0, "A": 0.1, "B": 0.01, "C": 0.001, "F": 1e-6, "G": 1e-7}
GUIDED = 4


@dataclass(frozen=True)
class MessageKind:
    """One message definition: type number, name, format characters, labels, unit and multiplier letters."""

    number: int
    name: str
    format: str
    labels: str
    units: str
    mults: str

    @property
    def dtype(self) -> np.dtype[np.void]:
        fields = [(label, CODES[c]) for label, c in zip(self.labels.split(","), self.format, strict=True)]
        return np.dtype([("_head", "S2"), ("_type", "u1"), *fields])

    def rows(self, n: int) -> npt.NDArray[np.void]:
        """n messages with nothing in them but their headers."""
        rows = np.zeros(n, dtype=self.dtype)
        rows["_head"] = HEAD
        rows["_type"] = self.number
        return rows


DEFINED = MessageKind(FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----")
UNIT = MessageKind(129, "UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--")
MULT = MessageKind(130, "MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--")
FMTU = MessageKind(131, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---")
MSG = MessageKind(132, "MSG", "QZ", "TimeUS,Message", "s-", "F-")
MODE = MessageKind(133, "MODE", "QBBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---")
ATT = MessageKind(
    134,
    "ATT",
    "QccccCCCCB",
    "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF",
    "sddddhhdh-",
    "FBBBBBBBB-",
)
XKF1 = MessageKind(
    135,
    "XKF1",
    "QBccCfffffff",
    "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD",
    "s#ddhnnnnmmm",
    "F-BBB0000000",
)
CTUN = MessageKind(
    136,
    "CTUN",
    "Qffffffefffhhf",
    "TimeUS,ThI,ABst,ThO,ThH,DAlt,Alt,BAlt,DSAlt,SAlt,TAlt,DCRt,CRt,N",
    "s----mmmmmmnnz",
    "F----00B000BB-",
)
KINDS = (DEFINED, UNIT, MULT, FMTU, MSG, MODE, ATT, XKF1, CTUN)


def dataflash_bytes(recording: Recording) -> bytes:
    """The whole log. Attitude and climb demands are logged with the state, as ArduPilot samples them."""
    first_us = int(recording.state.time_ns[0]) // 1000
    held = _held(recording.command, recording.state.time_ns)
    streams = [_attitude(recording.state, held), _estimate(recording.state), _climb(recording, held)]
    times = [recording.state.time_ns] * len(streams)
    due, kind, row = in_sending_order(*times)
    raw = [as_bytes(rows) for rows in streams]
    kept = np.flatnonzero(heard(recording, due)).tolist()
    return b"".join([definitions(KINDS, first_us), _start(first_us), *(raw[kind[i]][row[i]] for i in kept)])


def _held(command: Telemetry, time_ns: IntArray) -> dict[str, FloatArray]:
    """The command in force at each time."""
    at = np.maximum(np.searchsorted(command.time_ns, time_ns, side="right") - 1, 0)
    return {name: values[at] for name, values in command.values.items()}


def definitions(kinds: Sequence[MessageKind], time_us: int) -> bytes:
    """What the log's messages are: their fields, units and multipliers."""
    rows: list[bytes] = []
    for k in kinds:
        size = k.dtype.itemsize
        rows.append(
            HEAD
            + struct.pack(
                "<BBB4s16s64s", FMT, k.number, size, k.name.encode(), k.format.encode(), k.labels.encode()
            )
        )
    rows += [message_bytes(UNIT, time_us, ord(letter), name.encode()) for letter, name in UNITS.items()]
    rows += [message_bytes(MULT, time_us, ord(letter), factor) for letter, factor in MULTS.items()]
    rows += [message_bytes(FMTU, time_us, k.number, k.units.encode(), k.mults.encode()) for k in kinds]
    return b"".join(rows)


def message_bytes(kind: MessageKind, *values: object) -> bytes:
    """One message."""
    rows = kind.rows(1)
    rows[0] = (HEAD, kind.number, *values)
    return as_bytes(rows)[0]


def _start(time_us: int) -> bytes:
    text = b"ArduCopter V4.5.7 (simulated by flysid)"
    return message_bytes(MSG, time_us, text) + message_bytes(MODE, time_us, GUIDED, GUIDED, 1)


def _cents(values: FloatArray) -> npt.NDArray[np.int64]:
    return np.round(100.0 * values).astype(np.int64)


def _attitude(state: Telemetry, held: dict[str, FloatArray]) -> npt.NDArray[np.void]:
    rows = ATT.rows(len(state))
    rows["TimeUS"] = state.time_ns // 1000
    rows["DesRoll"], rows["Roll"] = _cents(held["phi_in"]), _cents(state["phi"])
    rows["DesPitch"], rows["Pitch"] = _cents(-held["theta_in"]), _cents(-state["theta"])
    rows["Yaw"] = _cents(state["psi"] % 360.0) % 36000
    return rows


def _estimate(state: Telemetry) -> npt.NDArray[np.void]:
    rows = XKF1.rows(len(state))
    rows["TimeUS"] = state.time_ns // 1000
    rows["Roll"], rows["Pitch"] = _cents(state["phi"]), _cents(-state["theta"])
    rows["Yaw"] = _cents(state["psi"] % 360.0) % 36000
    c = np.cos(np.radians(state["psi"]))
    s = np.sin(np.radians(state["psi"]))
    rows["VN"], rows["VE"] = c * state["vx"] - s * state["vy"], s * state["vx"] + c * state["vy"]
    rows["VD"], rows["dPD"] = -state["vz"], -state["vz"]
    rows["PN"], rows["PE"], rows["PD"] = state["x"], state["y"], -state["z"]
    return rows


def _climb(recording: Recording, held: dict[str, FloatArray]) -> npt.NDArray[np.void]:
    state = recording.state
    rows = CTUN.rows(len(state))
    rows["TimeUS"] = state.time_ns // 1000
    rows["DCRt"], rows["CRt"] = _cents(held["vz_in"]), _cents(state["vz"])
    height = state["z"] + recording.start_height_m
    rows["Alt"], rows["BAlt"] = height, _cents(height)
    rows["ThO"] = throttle(recording, state.time_ns)
    rows["ThH"] = 0.5
    return rows
