"""What a blackbox header says of its frames: programs for the kernel, and columns with units.

Predictors that add a setting become constants. Units are those of the firmware that wrote the log; where a
version's unit is not known for certain, the column has none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.flight import field_metadata
from flysid.ingest.formats.blackbox import kernel
from flysid.ingest.formats.blackbox.codes import Encoding, EventKind, Predictor
from flysid.ingest.formats.blackbox.header import Definition, Header

MAX_FIELDS = 250  # a frame has 256 bytes at most
SPANS: dict[int, int] = {Encoding.TAG2_3S32: 3, Encoding.TAG2_3SVARIABLE: 3, Encoding.TAG8_4S16: 4}
ENCODINGS = frozenset(
    {Encoding.SIGNED_VB, Encoding.UNSIGNED_VB, Encoding.NEG_14BIT, Encoding.TAG8_8SVB, Encoding.NULL, *SPANS}
)
KINDS = "IPSGH"
YES_OR_NO = ("rxSignalReceived", "rxFlightChannelsValid")
STREAMS = {"I": "main", "S": "slow", "G": "gps", "H": "home"}
EVENTS = {
    EventKind.SYNC: "sync beep",
    EventKind.ADJUSTMENT: "adjustment",
    EventKind.RESUME: "logging resumed",
    EventKind.DISARM: "disarm",
    EventKind.MODE: "flight mode",
    EventKind.IMU_FAILURE: "IMU failure",
    50: "governor state",
    51: "rescue state",
    52: "airborne state",
    EventKind.CUSTOM_DATA: "custom data",
    EventKind.CUSTOM_STRING: "custom string",
    EventKind.END: "end of log",
}
FAILSAFE = dict(
    enumerate(("idle", "signal lost", "landing", "landed", "monitoring", "recovered", "GPS rescue"))
)


class LayoutError(ValueError):
    """A header that frames cannot be read by; the message says why."""


@dataclass(frozen=True)
class Layout:
    """How the frames of one log are read: its definitions by letter, the program, the kernel's settings."""

    definitions: Mapping[str, Definition]
    program: kernel.Program
    settings: Mapping[str, int]


def layout_of(header: Header) -> Layout:
    """The layout of a log's frames.

    Raises
    ------
    LayoutError : no I frames are defined, they have no time, or a field is written in no known way.
    """
    definitions = {k: d for k in KINDS if (d := header.definition(k)) is not None}
    stated = [k for k in KINDS if header.text(f"Field {k} encoding", f"Field {k} name")]
    lacking = [k for k in stated if k not in definitions]
    if "I" not in definitions or "P" in lacking:
        raise LayoutError("the fields of its frames are not defined")
    names = definitions["I"].names
    if "time" not in names:
        raise LayoutError("its frames have no field 'time'")
    for kind, definition in definitions.items():
        _check(kind, definition)
    width = max(len(d.names) for d in definitions.values())
    table = {part: np.zeros((len(KINDS), width), dtype=np.int64) for part in kernel.Program._fields[1:]}
    size = np.zeros(len(KINDS), dtype=np.int64)
    constants = added_constants(header)
    for row, kind in enumerate(KINDS):
        if kind not in definitions:
            continue
        definition = definitions[kind]
        n = size[row] = len(definition.names)
        table["encoding"][row, :n] = definition.encodings
        table["span"][row, :n] = _spans(definition.encodings)
        table["unsigned"][row, :n] = definition.unsigned
        for k, predictor in enumerate(definition.predictors):
            table["predictor"][row, k] = Predictor.CONSTANT if predictor in constants else predictor
            table["constant"][row, k] = constants.get(predictor, 0)
    return Layout(definitions, kernel.Program(size=size, **table), _settings(header, definitions))


def _check(kind: str, definition: Definition) -> None:
    if len(definition.names) > MAX_FIELDS:
        raise LayoutError(f"{kind} frames of {len(definition.names)} fields do not fit into a frame")
    for name, encoding, predictor in zip(
        definition.names, definition.encodings, definition.predictors, strict=True
    ):
        if encoding not in ENCODINGS:
            raise LayoutError(f"field {name} of {kind} frames has the unknown encoding {encoding}")
        if predictor > 11:
            raise LayoutError(f"field {name} of {kind} frames has the unknown predictor {predictor}")


def added_constants(header: Header) -> dict[int, int]:
    """What the predictors 4 (least throttle), 8 (1500), 9 (battery) and 11 (least motor output) add."""
    least_throttle = header.number("minthrottle", 1150)
    return {
        4: least_throttle,
        8: 1500,
        9: header.number("vbatref", 4095),
        11: header.number("motorOutput", least_throttle),
    }


def _spans(encodings: tuple[int, ...]) -> list[int]:
    """How many fields are read at once from each field on, if it is the first of its group."""
    found = [SPANS.get(encoding, 1) for encoding in encodings]
    for k in range(len(encodings) - 1, -1, -1):
        if encodings[k : k + 2] == (Encoding.TAG8_8SVB,) * 2:
            found[k] = min(8, found[k + 1] + 1)
    return found


def _settings(header: Header, definitions: Mapping[str, Definition]) -> dict[str, int]:
    """What the kernel must know besides."""
    names = definitions["I"].names
    share, of = _p_interval(header)
    gps = definitions.get("G")
    return {
        "interval": max(1, header.number("I interval", 32)),
        "numerator": share,
        "denominator": of,
        "version": header.number("Data version", 2),
        "iteration_at": names.index("loopIteration") if "loopIteration" in names else -1,
        "time_at": names.index("time"),
        "motor_0_at": names.index("motor[0]") if "motor[0]" in names else -1,
        "gps_time_at": gps.names.index("time") if gps is not None and "time" in gps.names else -1,
        "has_home": int(gps is None or Predictor.AT_HOME not in gps.predictors),
    }


def _p_interval(header: Header) -> tuple[int, int]:
    """n of d loops are logged: "n/d", or "d" for one of d; (0, 1) where only I frames are."""
    found = [int(n) for n in header.numbers("P interval") if 0 <= n < 1 << 31]
    ratio = header.numbers("P ratio")
    if len(found) == 2:
        return (min(found[0], found[1]), found[1]) if min(found) > 0 else (1, 1)
    if not found:
        return 1, 1
    return (0, 1) if found[0] == 0 or ratio == (0.0,) else (1, found[0])


# ----------------------------------------------------------------------------------------------- columns


@dataclass(frozen=True)
class Meaning:
    """What a column is in: physical = raw * scale, in `unit`."""

    unit: str = ""
    scale: float = 1.0
    enum: Mapping[int, str] | None = None
    description: str = ""

    def metadata(self) -> dict[bytes, bytes] | None:
        """As Arrow keeps it."""
        return field_metadata(self.unit, self.scale, self.enum, self.description)


def meanings(header: Header, kind: str, names: tuple[str, ...]) -> list[Meaning]:
    """The meaning of the fields of one kind of frame."""
    known = _gps(header) if kind in "GH" else _SLOW if kind == "S" else _main(header)
    return [_meaning(known, name) for name in names]


def _meaning(known: Mapping[str, Meaning], name: str) -> Meaning:
    """By the whole name, else by the name without its index."""
    return known.get(name) or known.get(re.sub(r"\[\d+\]$", "", name), Meaning())


def _main(header: Header) -> dict[str, Meaning]:
    firmware, version = header.firmware
    fine = 0.1 if header.number("blackbox_high_resolution", 0) == 1 else 1.0
    rate = Meaning("deg/s", fine * gyro_scale(header))
    share = Meaning("%", 0.1, description="of the motors' range, as the mixer takes it")
    stick = Meaning("", fine, description="stick, -500 to 500")
    found = {
        "time": Meaning("us"),
        "gyroADC": rate,
        "gyroUnfilt": rate,
        "gyroRaw": rate,
        "gyroRaw2": rate,
        "gyroRAW": rate,
        "servo": Meaning("us"),
        "axisRate": Meaning("deg/s"),
        "setpoint": Meaning("deg/s", fine),
        "setpoint[3]": Meaning("", 1e-3, description="throttle of the mixer, 0 to 1"),
        "rcCommand": stick,
        "rcData": Meaning("us"),
        "rcCommand[3]": Meaning("us", fine, description="throttle"),
        "motor": _motor(header),
        "BaroAlt": Meaning("cm"),
        "baroAlt": Meaning("cm"),
        "imuQuaternion": Meaning("", 1 / 32767),
        **{f"axis{term}": share for term in "PIDFS"},
    }
    if firmware == "rotorflight":
        found |= {f"axis{term}": Meaning("", 1e-3) for term in "PIDFBO"} | _ROTORFLIGHT
    if firmware == "inav":
        found |= _INAV
    if gravity := header.number("acc_1G", 0):
        found |= dict.fromkeys(("accSmooth", "accADC", "accVib"), Meaning("G", 1 / gravity))
    if (poles := header.number("motor_poles", 0)) > 0:
        found["eRPM"] = Meaning("rpm", 200 / poles)
    if firmware == "betaflight":
        found["vbatLatest"] = _battery(header, version)
        if version >= (3, 1, 7):
            found["amperageLatest"] = Meaning("A", 0.01)
    return found


def gyro_scale(header: Header) -> float:
    """Degrees per second of one count; Baseflight states radians per microsecond."""
    stated = header.numbers("gyro_scale", "gyro.scale")
    scale = stated[0] if stated and np.isfinite(stated[0]) and stated[0] > 0 else 1.0
    return scale * 180e6 / np.pi if header.firmware[0] == "baseflight" else scale


def _motor(header: Header) -> Meaning:
    limits = header.numbers("motorOutput") or header.numbers("minthrottle") + header.numbers("maxthrottle")
    return Meaning(description=f"output, {limits[0]:g} to {limits[1]:g}" if len(limits) == 2 else "")


def _battery(header: Header, version: tuple[int, ...]) -> Meaning:
    """Betaflight: 0.01 V since 4.0, 0.1 V since 3.1, before that the converter's counts."""
    if version >= (4,):
        return Meaning("V", 0.01)
    if version >= (3, 1):
        return Meaning("V", 0.1)
    scale = header.numbers("vbatscale", "vbat_scale")
    return Meaning("V", 0.33 * scale[0] / 4095) if scale else Meaning()


_INAV = {
    "vbat": Meaning("V", 0.01),
    "amperage": Meaning("A", 0.01),
    "attitude": Meaning("ddeg"),
    "navPos": Meaning("cm"),
    "navTgtPos": Meaning("cm"),
    "navVel": Meaning("cm/s"),
    "navTgtVel": Meaning("cm/s"),
    "navAcc": Meaning("cm/s/s"),
    "AirSpeed": Meaning("cm/s"),
    "navEPH": Meaning("cm"),
    "navEPV": Meaning("cm"),
    "navSurf": Meaning("cm"),
    "surfaceRaw": Meaning("cm"),
    "mcPosAxisP": Meaning("cm/s"),
    **{f"mcVelAxis{term}[0]": Meaning("cm/s/s") for term in ("P", "I", "D", "FF", "Out")},
    **{f"mcVelAxis{term}[1]": Meaning("cm/s/s") for term in ("P", "I", "D", "FF", "Out")},
    **{f"fw{loop}{term}": Meaning("ddeg") for loop in ("Alt", "Pos") for term in ("P", "I", "D", "Out")},
    **{f"gyroPeak{axis}": Meaning("Hz") for axis in ("Roll", "Pitch", "Yaw")},
}
_ROTORFLIGHT = {
    "mixer": Meaning("", 1e-3),
    "attitude": Meaning("ddeg"),
    "altitude": Meaning("cm"),
    "vario": Meaning("cm/s"),
    "headspeed": Meaning("rpm"),
    "tailspeed": Meaning("rpm"),
    "Vbat": Meaning("V", 0.01),
    "Ibat": Meaning("A", 0.01),
}
_SLOW = {
    "failsafePhase": Meaning(enum=FAILSAFE),
    **{name: Meaning(enum={0: "no", 1: "yes"}) for name in YES_OR_NO},
    "powerSupplyImpedance": Meaning(),
    "sagCompensatedVBat": Meaning("V", 0.01),
    "wind": Meaning("cm/s"),
    "escRPM": Meaning("rpm"),
}


def _gps(header: Header) -> dict[str, Meaning]:
    firmware, version = header.firmware
    found = {
        "time": Meaning("us"),
        "GPS_coord": Meaning("degE7"),
        "GPS_home": Meaning("degE7"),
        "GPS_speed": Meaning("cm/s"),
        "GPS_ground_course": Meaning("ddeg"),
        "GPS_velned": Meaning("cm/s"),
    }
    if firmware == "betaflight" and version >= (4,):
        found["GPS_altitude"] = Meaning("dm")
    if firmware == "inav":
        found |= {"GPS_altitude": Meaning("m"), "GPS_hdop": Meaning("", 0.01)}
        found |= dict.fromkeys(("GPS_eph", "GPS_epv"), Meaning("cm"))
    return found
