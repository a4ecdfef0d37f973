"""AR.Drone AT commands: what the vehicle shall do, and its configuration.

`AT*PCMD=seq,flag,roll,pitch,gaz,yaw` carries fractions in [-1, 1] whose float bits are printed as signed
integers. What a fraction means is configured: roll and pitch times `euler_angle_max` (rad), gaz times
`control_vz_max` (mm/s), yaw times `control_yaw` (rad/s), set by
`AT*CONFIG=seq,"control:euler_angle_max","0.25"`. Until a value has been logged the vehicle's default
counts; column `configured` says which. Signs are the vehicle's: positive roll is right, positive pitch is
backward, positive gaz is up.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, RECEIVED, TIME, field_metadata
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.gather import Index

DEFAULTS: Mapping[str, float] = {
    "euler_angle_max": 0.209,  # rad, 12 degrees
    "control_vz_max": 700.0,  # mm/s
    "control_yaw": 1.745,  # rad/s, 100 degrees/s
}
MAX_COMMANDS = 1 << 22
_COMMAND = re.compile(rb"AT\*([A-Z_]+)=(\d{1,10})((?:,[^\r]*)?)\r")
_PCMD = re.compile(rb",(-?\d{1,11}),(-?\d{1,11}),(-?\d{1,11}),(-?\d{1,11}),(-?\d{1,11})(?:,.*)?")
_CONFIG = re.compile(rb',"([^"]{1,200})","([^"]{0,500})"')


@dataclass
class Commands:
    """Collects the commands of a capture; `scales` are those in force."""

    scales: dict[str, float] = field(default_factory=lambda: dict(DEFAULTS))
    logged: set[str] = field(default_factory=set)
    unread: int = 0
    _moves: list[tuple[int, int, int, tuple[float, ...], tuple[float, ...], bool]] = field(
        default_factory=list
    )
    _settings: list[tuple[int, int, str, str]] = field(default_factory=list)

    def add(self, payload: bytes, received_ns: int) -> None:
        """All commands of one datagram."""
        for found in _COMMAND.finditer(payload):
            kind = found[1]
            sequence = int(found[2])
            rest = found[3]
            if len(self._moves) + len(self._settings) >= MAX_COMMANDS:
                self.unread += 1
            elif kind in (b"PCMD", b"PCMD_MAG"):
                self._add_move(sequence, rest, received_ns)
            elif kind == b"CONFIG":
                self._add_setting(sequence, rest, received_ns)

    def _add_move(self, sequence: int, rest: bytes, received_ns: int) -> None:
        values = _PCMD.fullmatch(rest)
        if values is None:
            self.unread += 1
            return
        flag, *bits = (int(v) for v in values.groups())
        if not -(2**31) <= flag < 2**31 or not all(-(2**31) <= b < 2**32 for b in bits):
            self.unread += 1
            return
        fractions = struct.unpack("<4f", struct.pack("<4I", *(b & 0xFFFFFFFF for b in bits)))
        scales = tuple(self.scales[name] for name in DEFAULTS)
        known = self.logged >= set(DEFAULTS)
        self._moves.append((received_ns, sequence, flag, fractions, scales, known))

    def _add_setting(self, sequence: int, rest: bytes, received_ns: int) -> None:
        pair = _CONFIG.fullmatch(rest)
        if pair is None:
            self.unread += 1
            return
        key, value = (raw.decode("utf-8", "replace") for raw in pair.groups())
        self._settings.append((received_ns, sequence, key, value))
        name = key.rpartition(":")[2]
        if name in DEFAULTS:
            try:
                number = float(value)
            except ValueError:
                return
            if np.isfinite(number) and number > 0:
                self.scales[name] = number
                self.logged.add(name)

    def received_ns(self) -> dict[str, Index]:
        """Arrival times of each stream, (n,) each; only streams that hold something."""
        found = {"at/PCMD": [m[0] for m in self._moves], "at/CONFIG": [s[0] for s in self._settings]}
        return {stream: np.array(times, dtype=np.int64) for stream, times in found.items() if times}

    def tables(self, time_ns: Mapping[str, Index], boot: Mapping[str, Index]) -> dict[str, pa.Table]:
        """Streams at/PCMD and at/CONFIG on the vehicle's clock; `time_ns` and `boot` as `received_ns`."""
        columns = {}
        if self._moves:
            columns["at/PCMD"] = self._move_columns()
        if self._settings:
            columns["at/CONFIG"] = self._setting_columns()
        received = self.received_ns()
        found = {}
        for stream, own in columns.items():
            heads = {
                TIME: (arrow_arrays.numeric(time_ns[stream]), None),
                BOOT: (arrow_arrays.numeric(boot[stream].astype(np.int32)), None),
                RECEIVED: (arrow_arrays.numeric(received[stream]), None),
            }
            everything = {**heads, **own}
            fields = [pa.field(n, a.type, metadata=note) for n, (a, note) in everything.items()]
            schema = pa.schema(fields, metadata={"time_source": "arrival, mapped to the vehicle's clock"})
            found[stream] = pa.Table.from_arrays([a for a, _ in everything.values()], schema=schema)
        return found

    def _move_columns(self) -> dict[str, tuple[pa.Array, dict[bytes, bytes] | None]]:
        fractions = np.array([m[3] for m in self._moves], dtype=np.float32)
        angle, climb, turn = np.array([m[4] for m in self._moves]).T
        scaled = fractions.astype(np.float64) * np.stack([angle, angle, climb, turn], axis=1)
        columns: dict[str, tuple[pa.Array, dict[bytes, bytes] | None]] = {
            "sequence": (arrow_arrays.numeric(np.array([m[1] for m in self._moves], dtype=np.int64)), None),
            "flag": (arrow_arrays.numeric(np.array([m[2] for m in self._moves], dtype=np.int32)), None),
        }
        for k, name in enumerate(("roll", "pitch", "gaz", "yaw")):
            columns[name] = (arrow_arrays.numeric(fractions[:, k]), field_metadata(description="fraction"))
        for k, (name, unit, scale) in enumerate(_SCALED):
            note = field_metadata(unit=unit, description=f"fraction times {scale}")
            columns[name] = (arrow_arrays.numeric(scaled[:, k]), note)
        about = field_metadata(description="whether all three scales were logged, not defaults")
        columns["configured"] = (
            arrow_arrays.numeric(np.array([m[5] for m in self._moves], dtype=np.bool_)),
            about,
        )
        return columns

    def _setting_columns(self) -> dict[str, tuple[pa.Array, dict[bytes, bytes] | None]]:
        return {
            "sequence": (
                arrow_arrays.numeric(np.array([s[1] for s in self._settings], dtype=np.int64)),
                None,
            ),
            "key": (arrow_arrays.strings([s[2] for s in self._settings]), None),
            "value": (arrow_arrays.strings([s[3] for s in self._settings]), None),
        }


_SCALED = (
    ("roll_ref", "rad", "euler_angle_max"),
    ("pitch_ref", "rad", "euler_angle_max"),
    ("vz_ref", "mm/s", "control_vz_max"),
    ("yaw_rate_ref", "rad/s", "control_yaw"),
)
