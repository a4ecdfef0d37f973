"""Units that logs use, and the factors between them.

Unit strings follow MAVLink's and DataFlash's spelling ("cdeg", "cm/s", "degE7", "d%"). Two units convert
when their dimension is the same. Temperatures are left out: nothing here is fitted in them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from flysid.errors import RecipeError

# unit -> (dimension, factor to the dimension's base unit)
_UNITS: Mapping[str, tuple[str, float]] = {
    "": ("1", 1.0),
    "1": ("1", 1.0),
    "%": ("1", 1e-2),
    "c%": ("1", 1e-4),
    "d%": ("1", 1e-3),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e-3),
    "deg": ("angle", math.pi / 180),
    "ddeg": ("angle", math.pi / 1.8e3),
    "cdeg": ("angle", math.pi / 1.8e4),
    "mdeg": ("angle", math.pi / 1.8e5),
    "degE7": ("angle", math.pi / 1.8e9),
    "rad/s": ("angle/s", 1.0),
    "mrad/s": ("angle/s", 1e-3),
    "deg/s": ("angle/s", math.pi / 180),
    "cdeg/s": ("angle/s", math.pi / 1.8e4),
    "rpm": ("angle/s", math.pi / 30),
    "rad/s/s": ("angle/s/s", 1.0),
    "deg/s/s": ("angle/s/s", math.pi / 180),
    "m": ("length", 1.0),
    "dm": ("length", 1e-1),
    "cm": ("length", 1e-2),
    "mm": ("length", 1e-3),
    "km": ("length", 1e3),
    "ft": ("length", 0.3048),
    "m/s": ("length/s", 1.0),
    "dm/s": ("length/s", 1e-1),
    "cm/s": ("length/s", 1e-2),
    "mm/s": ("length/s", 1e-3),
    "km/h": ("length/s", 1 / 3.6),
    "ft/s": ("length/s", 0.3048),
    "kn": ("length/s", 1852 / 3600),
    "mi/h": ("length/s", 1609.344 / 3600),
    "m/s/s": ("length/s/s", 1.0),
    "cm/s/s": ("length/s/s", 1e-2),
    "mm/s/s": ("length/s/s", 1e-3),
    "mG": ("length/s/s", 9.80665e-3),
    "G": ("length/s/s", 9.80665),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "d": ("time", 86400.0),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "A": ("current", 1.0),
    "cA": ("current", 1e-2),
    "mA": ("current", 1e-3),
    "Ah": ("charge", 3600.0),
    "mAh": ("charge", 3.6),
    "N": ("force", 1.0),
    "Nm": ("torque", 1.0),
    "Hz": ("1/time", 1.0),
}
_ALIASES: Mapping[str, str] = {
    "degheading": "deg",
    "degrees": "deg",
    "radians": "rad",
    "\u00b0": "deg",
    "\u00b0/s": "deg/s",
    "meters": "m",
    "metres": "m",
    "feet": "ft",
    "knots": "kn",
    "mph": "mi/h",
    "m s^-1": "m/s",
    "m s^-2": "m/s/s",
    "rad s^-1": "rad/s",
    "m/s^2": "m/s/s",
    "m/s²": "m/s/s",
    "rad/s^2": "rad/s/s",
    "deg/s^2": "deg/s/s",
    "dps": "deg/s",
    "RPM": "rpm",
    "PWM": "us",
    "norm": "",
    "-": "",
}


def is_known(unit: str) -> bool:
    """True where `unit` can be converted."""
    return _ALIASES.get(unit, unit) in _UNITS


def factor(unit: str, wanted: str) -> float:
    """value in `wanted` = factor * value in `unit`.

    Raises
    ------
    RecipeError : a unit is not known, or they measure different things.
    """
    from_unit = _ALIASES.get(unit, unit)
    to_unit = _ALIASES.get(wanted, wanted)
    if from_unit == to_unit:
        return 1.0
    if from_unit not in _UNITS or to_unit not in _UNITS:
        raise RecipeError(f"unknown unit {unit if from_unit not in _UNITS else wanted!r}")
    (dimension, base), (other, wanted_base) = _UNITS[from_unit], _UNITS[to_unit]
    if dimension != other:
        raise RecipeError(
            f"{unit or 'a plain number'} cannot become {wanted or 'a plain number'}",
            hint="state the same kind of unit for the signal and for its source",
        )
    return base / wanted_base
