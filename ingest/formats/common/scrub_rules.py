"""What a log says about where it was flown, by whom and with which hardware; and how that is taken out.

Positions: columns that are named as a latitude and a longitude are a pair, with their altitude beside them.
"shift" moves every pair so that the log's median position lies at `NEUTRAL` and keeps the metres in between
(a local tangent plane there); "remove" makes them 0, 0, which receivers write without a fix. Results
are rounded to 1e-7 degrees at random up or down: the scale of the longitude, the cosine of the true
latitude, would otherwise stand in their digits. See docs/adr/0010-scrubbed-positions-are-shifted.md.

Texts keep their length; what looks like an identifier, a coordinate, a path or an address becomes x.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from flysid.stretch import FloatArray

BoolArray = npt.NDArray[np.bool_]
Gps = Literal["shift", "remove"]

NEUTRAL = (0.01, 0.01)  # off the coast of Africa; not 0, 0, which means "no fix"
GRID_DEG = 1e-7
UNSET_DEG = 214.7483647  # the largest int32, in 1e-7 degrees: "not given"
GLOBAL_FRAMES = (0, 3, 5, 6, 10, 11)  # MAV_FRAME with latitude and longitude
LOCATED_COMMANDS = (
    *range(16, 96),
    179,
    192,
    195,
    201,
    241,
    3000,
    43003,
)  # MAV_CMD: parameters 5 to 7 are a place

POSITION = "positions"
ALTITUDE = "altitudes above sea level"
IDENTITY = "identifiers"
TEXT = "words in texts"
PARAMETER = "parameters"
CONTENT = "embedded data"
UNREADABLE = "bytes that could not be read"
SIGNATURE = "signatures"

_LATITUDE = re.compile(r"^((?:.*_)?)(lat|latitude)(_int|_deg|_fused?|\d)?$")
_PAIR = re.compile(r"^((gps_)(?:coord|home))\[0\]$")  # of blackbox: latitude, then longitude
_ALTITUDE = re.compile(r"^(?:alt|altitude|elevation)(?:_ellipsoid|_msl|_amsl|_int|_m|_msl_m|_ellipsoid_m)?$")
_IDENTITIES = frozenset(
    (
        *(
            "uid",
            "uid1",
            "uid2",
            "uuid",
            "vehicle_uuid",
            "flight_uuid",
            "hw_unique_id",
            "uas_id",
            "id_or_mac",
        ),
        *("serial", "serial_number", "serial_num", "serialnumber", "serialno", "sn", "imei", "iccid", "mmsi"),
        *(
            "ssid",
            "password",
            "passphrase",
            "passkey",
            "secret_key",
            "apn",
            "pin",
            "puk",
            "new_pin",
            "old_pin",
        ),
        *(
            "icao",
            "icao_address",
            "callsign",
            "operator",
            "operator_id",
            "pilot",
            "owner",
            "username",
            "user",
        ),
        *("email", "hostname", "mac", "mac_address", "ip", "ip_address", "device_name", "uri"),
        "cam_definition_uri",
    )
)
_PARAMETER = re.compile(
    r"(_SER|_SERIAL_?NUM|_SERIAL_?NO|_SN|_UID\d*|_UUID|DEV_?ID\d*|_ID\d*|_SSID|_PSWD|_PASSWORD|_PASSKEY|_PWD|_LAT|_LON|_LNG|"
    r"_LATITUDE|_LONGITUDE|^COMPASS_DEC|^CAL_MAG_DECL|^ATT_MAG_DECL|^SIM_OPOS_\w+)$"
)
_KEPT_PARAMETERS = frozenset({"MAV_SYS_ID", "MAV_COMP_ID", "SYSID_THISMAV"})
_TOKENS = re.compile(
    rb"-?\d{1,3}\.\d{4,}"  # a coordinate
    rb"|(?<![(\w])[0-9A-Fa-f]{2}(?:[:-][0-9A-Fa-f]{2}){5}"  # a MAC address
    rb"|\d{1,3}(?:\.\d{1,3}){3}"  # an IP address
    rb"|[\w.+-]+@[\w-]+\.[\w.]+"  # an e-mail address
    rb"|(?:[A-Za-z]:\\|/)[^\s,;:\"'()]+(?:[/\\][^\s,;:\"'()]*)+"  # a path
    rb"|(?<![(\w.])(?=[0-9A-Fa-f]*\d)[0-9A-Fa-f]{6,}(?!\w)"  # a number of hardware, but no "(commit)"
)


@dataclass(frozen=True)
class Fix:
    """A position: degrees, degrees, metres above sea level."""

    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass(frozen=True)
class ScrubColumn:
    """A column of a record: its key in the structured array, its name, and its scale where one is stated."""

    key: str
    name: str
    scale: float | None = None


@dataclass(frozen=True)
class Position:
    """Columns that hold one position; `altitudes` may be none."""

    lat: ScrubColumn
    lon: ScrubColumn
    altitudes: tuple[ScrubColumn, ...]


@dataclass
class Scrubber:
    """What is to be done, and the account of what was done.

    Attributes
    ----------
    gps : shift positions, or remove them.
    middle : the log's median position; None where there is none (positions, if any, are removed).
    removed : (what, where) -> fields.
    notes : what a person should know besides.
    """

    gps: Gps = "shift"
    middle: Fix | None = None
    removed: Counter[tuple[str, str]] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=np.random.default_rng)

    def note(self, what: str, where: str, count: int | bool | np.bool_) -> None:
        if count:
            self.removed[what, where] += int(count)

    def moved(self, lat_deg: FloatArray, lon_deg: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """New latitudes and longitudes on the grid, and where there was a fix; marks of "none" stay."""
        is_fix = has_fix(lat_deg, lon_deg)
        lat, lon = (np.where(is_unset(x), x, 0.0) for x in (lat_deg, lon_deg))
        if self.gps == "shift" and self.middle is not None:
            east = (lon_deg - self.middle.lon_deg + 540.0) % 360.0 - 180.0
            lat = np.where(is_fix, self._on_grid(NEUTRAL[0] + lat_deg - self.middle.lat_deg), lat)
            scale = np.cos(np.radians(self.middle.lat_deg)) / np.cos(np.radians(NEUTRAL[0]))
            lon = np.where(is_fix, self._on_grid(NEUTRAL[1] + east * scale), lon)
        return lat, lon, is_fix

    def raised(self, alt_m: FloatArray) -> FloatArray:
        """Altitudes above the middle's; 0 where positions are removed."""
        if self.gps == "shift" and self.middle is not None:
            return alt_m - round(self.middle.alt_m, 2)
        return np.where(np.isfinite(alt_m), 0.0, alt_m)

    def _on_grid(self, degrees: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore"):
            return np.floor(degrees / GRID_DEG + self.rng.random(degrees.shape)) * GRID_DEG


def is_unset(degrees: FloatArray) -> BoolArray:
    """Where a coordinate is a mark of "not given": NaN, or the largest int32 in 1e-7 degrees."""
    found: BoolArray = ~np.isfinite(degrees) | (np.abs(np.abs(degrees) - UNSET_DEG) < 1e-3)
    return found


def has_fix(lat_deg: FloatArray, lon_deg: FloatArray) -> BoolArray:
    """Where a pair is a position: finite, in range and not 0, 0."""
    with np.errstate(invalid="ignore"):
        inside = (np.abs(lat_deg) <= 90.0) & (np.abs(lon_deg) <= 360.0)
    found: BoolArray = inside & np.isfinite(lon_deg) & ((lat_deg != 0.0) | (lon_deg != 0.0))
    return found


# --------------------------------------------------------------------------------------------- columns


def places(columns: Sequence[ScrubColumn]) -> tuple[Position, ...]:
    """Positions among the columns of one record, by their names."""
    by_name = {c.name.lower(): c for c in columns}
    return tuple(
        Position(by_name[lat], by_name[lon], tuple(by_name[a] for a in alts))
        for lat, lon, alts in _places(tuple(by_name))
    )


@cache
def _places(names: tuple[str, ...]) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    found = []
    for name in names:
        path, dot, last = name.rpartition(".")
        pair = _PAIR.match(last)
        if pair is not None and (east := f"{path}{dot}{pair[1]}[1]") in names:
            beside = [n for n in names if n.startswith(pair[2]) and _ALTITUDE.match(n[len(pair[2]) :])]
            found.append((name, east, tuple(beside)))
        match = _LATITUDE.match(last)
        if match is None:
            continue
        before = path + dot + match[1]
        after = match[3] or ""
        lon = next(
            (n for word in ("lon", "lng", "longitude", "long") if (n := before + word + after) in names), None
        )
        if lon is not None:
            alts = [n for n in names if n.startswith(before) and _ALTITUDE.match(n[len(before) :])]
            found.append((name, lon, tuple(alts)))
    return tuple(found)


def is_identity(name: str) -> bool:
    """Whether a field of this name holds an identifier of hardware, vehicle or person."""
    return name.lower().rpartition(".")[2].partition("[")[0] in _IDENTITIES


def is_private_parameter(name: str) -> bool:
    """Whether a parameter holds a serial number, a device id, a place or a password."""
    return name not in _KEPT_PARAMETERS and _PARAMETER.search(name) is not None


def scrub_rows(
    rows: npt.NDArray[Any], columns: Sequence[ScrubColumn], where: str, scrubber: Scrubber
) -> None:
    """Scrub structured records in place: positions and identifiers, by the names of their columns."""
    for place in places(columns):
        scrub_place(rows, place, where, scrubber)
    for column in columns:
        if is_identity(column.name):
            clear(rows, column.key, (IDENTITY, f"{where}.{column.name}"), scrubber)


def scrub_place(
    rows: npt.NDArray[Any], place: Position, where: str, scrubber: Scrubber, mask: BoolArray | None = None
) -> None:
    """Move or remove one position of every record (of those in `mask`)."""
    chosen = np.ones(len(rows), dtype=np.bool_) if mask is None else mask
    lat, lon = (_degrees(rows, c) for c in (place.lat, place.lon))
    new_lat, new_lon, is_fix = scrubber.moved(lat, lon)
    changed = chosen & ((new_lat != lat) | (new_lon != lon)) & ~(np.isnan(lat) & np.isnan(lon))
    for column, values in ((place.lat, new_lat), (place.lon, new_lon)):
        _put(rows, column, values, changed, GRID_DEG)
    scrubber.note(POSITION, where, changed.sum())
    for column in place.altitudes:
        metres = rows[column.key].astype(np.float64) * _scale(rows, column, 1e-3)
        _put(rows, column, scrubber.raised(metres), chosen & is_fix, 1e-3)
        scrubber.note(ALTITUDE, f"{where}.{column.name}", (chosen & is_fix).sum())


def _degrees(rows: npt.NDArray[Any], column: ScrubColumn) -> FloatArray:
    degrees: FloatArray = rows[column.key].astype(np.float64) * _scale(rows, column, GRID_DEG)
    return degrees


def _scale(rows: npt.NDArray[Any], column: ScrubColumn, integers: float) -> float:
    """The stated scale, or what whole numbers mean by custom: 1e-7 degrees, millimetres."""
    if column.scale is not None and column.scale != 1.0:
        return column.scale
    return integers if rows.dtype[column.key].kind in "iu" else 1.0


def _put(
    rows: npt.NDArray[Any], column: ScrubColumn, values: FloatArray, mask: BoolArray, integers: float
) -> None:
    kind = rows.dtype[column.key]
    raw = values[mask] / _scale(rows, column, integers)
    if kind.kind in "iu":
        limits = np.iinfo(kind)
        raw = np.clip(np.rint(raw), limits.min, limits.max)
    rows[column.key][mask] = raw.astype(kind)


def clear(rows: npt.NDArray[Any], key: str, what: tuple[str, str], scrubber: Scrubber) -> None:
    """Make a column zero."""
    values = rows[key]
    blank = np.zeros((), dtype=values.dtype)
    filled = values != blank
    if filled.ndim > 1:
        filled = filled.reshape(len(values), -1).any(axis=1)
    scrubber.note(*what, count=int(filled.sum()))
    rows[key] = blank


# ----------------------------------------------------------------------------------------------- texts


def redact(text: bytes) -> bytes:
    """A text of the same length without what looks like an identifier, a coordinate, a path or an address."""
    return _TOKENS.sub(lambda match: b"x" * len(match[0]), text)


def redacted_field(text: bytes) -> bytes:
    """`redact` for a field of fixed size: what stands behind the first NUL goes too."""
    head = text.split(b"\0", 1)[0]
    return redact(head).ljust(len(text), b"\0")


def scrub_texts(rows: npt.NDArray[Any], key: str, what: tuple[str, str], scrubber: Scrubber) -> None:
    """Redact a column of fixed-size texts in place."""
    width = rows.dtype[key].itemsize
    flat = np.ascontiguousarray(rows[key]).view(f"S{width}").reshape(-1)
    padded = [bytes(text).ljust(width, b"\0") for text in flat]
    clean = [redacted_field(text) for text in padded]
    scrubber.note(*what, count=sum(redact(t) != t for t in padded))
    rows[key] = np.array(clean, dtype=f"S{width}").view(rows.dtype[key])


def scrub_tree(value: Any, where: str, scrubber: Scrubber) -> Any:
    """A JSON value scrubbed: objects with a latitude and a longitude, identifiers, texts."""
    if isinstance(value, Mapping):
        tree = {k: scrub_tree(v, f"{where}.{k}", scrubber) for k, v in value.items()}
        numbers = {k: v for k, v in tree.items() if isinstance(v, int | float) and not isinstance(v, bool)}
        columns = [
            ScrubColumn(k, k, None if isinstance(v, float) or abs(v) <= 360 else 1e-7)
            for k, v in numbers.items()
        ]
        for place in places(columns):
            used = (place.lat, place.lon, *place.altitudes)
            rows = np.array([tuple(float(numbers[c.key]) for c in used)], dtype=[(c.key, "f8") for c in used])
            scrub_place(rows, place, where, scrubber)
            tree |= {c.key: _like(numbers[c.key], float(rows[c.key][0])) for c in used}
        for key, content in tree.items():
            if is_identity(key) and content not in (None, "", 0):
                scrubber.note(IDENTITY, f"{where}.{key}", 1)
                tree[key] = "" if isinstance(content, str) else 0
        return tree
    if isinstance(value, list):
        return [scrub_tree(item, where, scrubber) for item in value]
    if isinstance(value, str):
        clean = redact(value.encode()).decode("utf-8", "replace")
        scrubber.note(TEXT, where, clean != value)
        return clean
    return value


def _like(old: float, new: float) -> float:
    return round(new) if isinstance(old, int) and abs(old) > 360 else new
