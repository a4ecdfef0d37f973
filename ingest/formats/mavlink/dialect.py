"""MAVLink message layouts from pymavlink's dialect modules, as NumPy dtypes with units and enumerations.

Only facts are taken from a dialect's classes (ids, CRC seeds, wire order, units, enums); pymavlink's parser
is not used. Layouts are built when a message is first met: building all 353 takes longer than a small log.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.common.columns import Field, RecordLayout

DEFAULT = "ardupilotmega"
OTHERS = ("development", "all", "common")
UNKNOWN = -1

UNITS: Mapping[str, tuple[str, float]] = {
    "degE7": ("deg", 1e-7),
    "degE5": ("deg", 1e-5),
    "cdeg": ("deg", 0.01),
    "ddeg/s": ("deg/s", 0.1),
    "deg/2": ("deg", 2.0),
    "mrad/s": ("rad/s", 1e-3),
    "mm": ("m", 1e-3),
    "cm": ("m", 0.01),
    "dm": ("m", 0.1),
    "dam": ("m", 10.0),
    "mm/s": ("m/s", 1e-3),
    "cm/s": ("m/s", 0.01),
    "dm/s": ("m/s", 0.1),
    "m/s*5": ("m/s", 0.2),
    "m/s/s": ("m/s^2", 1.0),
    "mG": ("m/s^2", 9.80665e-3),
    "mgauss": ("gauss", 1e-3),
    "mV": ("V", 1e-3),
    "cV": ("V", 0.01),
    "mA": ("A", 1e-3),
    "cA": ("A", 0.01),
    "mAh": ("Ah", 1e-3),
    "cdegC": ("degC", 0.01),
    "c%": ("%", 0.01),
    "d%": ("%", 0.1),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "cs": ("s", 0.01),
    "ds": ("s", 0.1),
    "hPa": ("Pa", 100.0),
    "mbar": ("Pa", 100.0),
    "kPa": ("Pa", 1000.0),
    "MHz": ("Hz", 1e6),
    "cm^2": ("m^2", 1e-4),
    "hJ": ("J", 100.0),
}


KEYS: Mapping[str, str] = {
    "ACTUATOR_CONTROL_TARGET": "group_mlx",
    "ADSB_VEHICLE": "ICAO_address",
    "AIS_VESSEL": "MMSI",
    "BATTERY_INFO": "id",
    "CAMERA_CAPTURE_STATUS": "camera_device_id",
    "CAMERA_FEEDBACK": "cam_idx",
    "CAMERA_FOV_STATUS": "camera_device_id",
    "CAMERA_INFORMATION": "camera_device_id",
    "CAMERA_SETTINGS": "camera_device_id",
    "CAMERA_STATUS": "cam_idx",
    "CAMERA_TRACKING_GEO_STATUS": "camera_device_id",
    "CAMERA_TRACKING_IMAGE_STATUS": "camera_device_id",
    "CANFD_FRAME": "bus",
    "CAN_FRAME": "bus",
    "COLLISION": "id",
    "DEBUG": "ind",
    "EFI_STATUS": "ecu_index",
    "ESC_INFO": "index",
    "ESC_STATUS": "index",
    "FUEL_STATUS": "id",
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "gimbal_device_id",
    "GIMBAL_DEVICE_INFORMATION": "gimbal_device_id",
    "GPS2_RTK": "rtk_receiver_id",
    "GPS_RTK": "rtk_receiver_id",
    "HIL_GPS": "id",
    "HIL_OPTICAL_FLOW": "sensor_id",
    "HIL_SENSOR": "id",
    "OPTICAL_FLOW": "sensor_id",
    "RAW_RPM": "index",
    "RC_CHANNELS_RAW": "port",
    "RC_CHANNELS_SCALED": "port",
    "SET_ACTUATOR_CONTROL_TARGET": "group_mlx",
}
"""Message -> the field that tells its things apart, where the XML does not say so by `instance="true"`."""


@dataclass(frozen=True, eq=False)
class Dialect:
    """A dialect: the CRC seed of every id, and layouts on demand.

    Attributes
    ----------
    name : pymavlink's module name.
    crc_extra : (highest id + 1,) int16; `UNKNOWN` where no message has that id.
    """

    name: str
    crc_extra: npt.NDArray[np.int16]
    _module: ModuleType

    def layout(self, message_id: int) -> RecordLayout:
        """The layout of a known message."""
        return _layout(self.name, message_id)

    def key(self, message_id: int) -> str:
        """The field that tells to which of several things a message belongs; "" where none does."""
        return _key(self.name, message_id)

    def message_name(self, message_id: int) -> str:
        """ "ATTITUDE"; "#12345" for an id that this dialect does not know."""
        known = self._module.mavlink_map.get(message_id)
        return str(known.msgname) if known else f"#{message_id}"

    def enum_name(self, enum: str, value: int) -> str:
        """The name of a value of an enumeration, or the value itself."""
        entry = self._module.enums.get(enum, {}).get(value)
        return str(entry.name) if entry else str(value)


@cache
def load_dialect(name: str = DEFAULT) -> Dialect:
    """Import a dialect of pymavlink (0.1 s of CPU)."""
    module = importlib.import_module(f"pymavlink.dialects.v20.{name}")
    messages = module.mavlink_map
    extra = np.full(max(messages) + 1, UNKNOWN, dtype=np.int16)
    for message_id, message in messages.items():
        extra[message_id] = message.crc_extra
    extra.setflags(write=False)
    return Dialect(name, extra, module)


@cache
def _layout(dialect: str, message_id: int) -> RecordLayout:
    module = load_dialect(dialect)._module
    message = module.mavlink_map[message_id]
    wire = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)
    formats: dict[str, Any] = {}
    for name, (count, code) in zip(message.ordered_fieldnames, wire, strict=True):
        formats[name] = _dtype(code, int(count) if count else 0)
    dtype = np.dtype(list(formats.items()))
    fields = tuple(_field(module, message, name, formats[name]) for name in message.fieldnames)
    return RecordLayout(str(message.msgname), dtype, fields)


@cache
def _key(dialect: str, message_id: int) -> str:
    message = load_dialect(dialect)._module.mavlink_map[message_id]
    field = message.instance_field or KEYS.get(message.msgname, "")
    return field if field in message.fieldnames else ""


def _dtype(code: str, count: int) -> Any:
    if code in "sc":
        return f"S{max(count, 1)}"
    return ("<" + code, (count,)) if count else "<" + code


def _field(module: ModuleType, message: Any, name: str, dtype: Any) -> Field:
    stated = message.fieldunits_by_name.get(name, "")
    unit, scale = UNITS.get(stated, (stated, 1.0))
    entries = module.enums.get(message.fieldenums_by_name.get(name, ""), {})
    return Field(
        name,
        is_text=isinstance(dtype, str) and dtype.startswith("S"),
        unit=unit,
        scale=scale,
        enum={value: str(e.name) for value, e in entries.items() if not e.name.endswith("_ENUM_END")},
    )
