"""What the header of a Crazyflie log says: the kinds of events and their variables.

    0xBC, version (u16), kinds (u16), then for each kind: id (u16), name NUL, variables (u16), then for each
    variable its name and type as in `gyro.x(f)` NUL

An event is its kind's id (u16), the time (version 1: u32 in ms; version 2: u64 in us), and the variables,
packed, little-endian. At the end stands a CRC-32 of everything before it. Described by the firmware's own
decoder (bitcraze/crazyflie-firmware, tools/usdlog).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.common.columns import Field, RecordLayout

MAGIC = 0xBC
TIME_NS: Mapping[int, int] = {1: 10**6, 2: 10**3}  # of one count
TIME_BYTES: Mapping[int, int] = {1: 4, 2: 8}
ID_BYTES = 2
TYPES: Mapping[str, str] = {
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "e": "<f2",
    "f": "<f4",
    "d": "<f8",
}
# as the firmware documents its log variables; a group's own unit, then those of single variables
GROUP_UNITS: Mapping[str, str] = {
    "acc": "G",
    "gyro": "deg/s",
    "stabilizer": "deg",
}
POSITION_UNITS: Mapping[str, str] = {
    **dict.fromkeys(("x", "y", "z", "stateX", "stateY", "stateZ"), "m"),
    **dict.fromkeys(("vx", "vy", "vz", "statePX", "statePY", "statePZ"), "m/s"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "deg"),
    **dict.fromkeys(("rollRate", "pitchRate", "yawRate"), "deg/s"),
}
GROUPS_OF_POSITION = ("stateEstimate", "ctrltarget", "controller", "kalman", "locSrv")
VARIABLE_UNITS: Mapping[str, str] = {
    **{f"stateEstimate.a{axis}": "G" for axis in "xyz"},
    **{f"ctrltarget.a{axis}": "G" for axis in "xyz"},
    **{f"stateEstimateZ.{axis}": "mm" for axis in "xyz"},
    **{f"stateEstimateZ.v{axis}": "mm/s" for axis in "xyz"},
    **{f"stateEstimateZ.a{axis}": "mm/s/s" for axis in "xyz"},
    **{f"stateEstimateZ.rate{axis}": "mrad/s" for axis in ("Roll", "Pitch", "Yaw")},
    "stabilizer.thrust": "",
    "pm.vbat": "V",
    "pm.vbatMV": "mV",
    "baro.asl": "m",
    "range.zrange": "mm",
}


@dataclass(frozen=True)
class Header:
    """The kinds of events by id, the format's version, and where the first event begins."""

    kinds: Mapping[int, RecordLayout]
    version: int
    end: int

    @property
    def head_bytes(self) -> int:
        """Of an event before its variables: id and time."""
        return ID_BYTES + TIME_BYTES[self.version]

    def size_of(self, kind: int) -> int:
        """Bytes of an event."""
        return self.head_bytes + self.kinds[kind].size


def header_of(data: bytes) -> Header | None:
    """The header at the beginning of these bytes; None where there is no sound one."""
    if len(data) < 5 or data[0] != MAGIC:
        return None
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in TIME_NS or not count:
        return None
    kinds: dict[int, RecordLayout] = {}
    at = 5
    try:
        for _ in range(count):
            (number,) = struct.unpack_from("<H", data, at)
            name, at = _text(data, at + 2)
            (variables,) = struct.unpack_from("<H", data, at)
            at += 2
            fields = []
            for _ in range(variables):
                word, at = _text(data, at)
                fields.append(_variable(word))
            if number in kinds or name in {layout.name for layout in kinds.values()}:
                return None
            kinds[number] = _layout(name, fields)
    except (ValueError, struct.error):
        return None
    return Header(kinds, version, at)


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A word and where it ends. Raises ValueError where there is none."""
    end = data.index(b"\0", at)
    word = data[at:end].decode("utf-8")
    if not word or not word.isprintable():
        raise ValueError("no word")
    return word, end + 1


def _variable(word: str) -> tuple[str, str]:
    """(name, dtype) of `gyro.x(f)`. Raises ValueError."""
    if len(word) < 4 or word[-3] != "(" or word[-1] != ")" or word[-2] not in TYPES:
        raise ValueError(f"{word!r} names no type")
    return word[:-3], TYPES[word[-2]]


def _layout(name: str, fields: list[tuple[str, str]]) -> RecordLayout:
    names = [field for field, _ in fields]
    if len(set(names)) != len(names):
        raise ValueError("a variable twice")
    dtype = np.dtype(fields) if fields else np.dtype([])
    return RecordLayout(name, dtype, tuple(Field(field, unit=unit_of(field)) for field in names))


def unit_of(variable: str) -> str:
    """The unit of a log variable, `group.name`; "" where the firmware documents none that is known here."""
    group, _, name = variable.partition(".")
    if variable in VARIABLE_UNITS:
        return VARIABLE_UNITS[variable]
    if group in GROUPS_OF_POSITION:
        return POSITION_UNITS.get(name, "")
    return GROUP_UNITS.get(group, "")
