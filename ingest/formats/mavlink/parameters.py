"""Parameters on MAVLink as numbers: how a system packs whole ones into the message's float.

PX4 copies the bytes of an integer into the float; ArduPilot converts it. A system says which of both it does
in AUTOPILOT_VERSION.capabilities, else by the autopilot that its HEARTBEAT names. Where it says neither, its
values tell: bytes of small integers are numbers such as 5.6e-42, or none, and no whole ones.

The extended messages hold 128 bytes: the value's own, or text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.ingest.formats.common.arrow_arrays import numeric, strings
from flysid.ingest.formats.common.clock import IntArray
from flysid.stretch import FloatArray

Sender = tuple[int, int]
AUTOPILOT_PX4 = 12
AUTOPILOT_ARDUPILOT = 3
CAPABLE_OF_BYTES = 16  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
CAPABLE_OF_CASTS = 131_072  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
VALUE = "param_value"
SENT = "PARAM_VALUE"  # by whom it belongs to; all others are sent to it
NUMBERS = frozenset({SENT, "PARAM_SET"})
EXTENDED = frozenset({"PARAM_EXT_VALUE", "PARAM_EXT_SET", "PARAM_EXT_ACK"})
REAL32 = 9
KINDS: Mapping[int, np.dtype[np.generic]] = {  # MAV_PARAM_TYPE and MAV_PARAM_EXT_TYPE
    1: np.dtype("u1"),
    2: np.dtype("i1"),
    3: np.dtype("<u2"),
    4: np.dtype("<i2"),
    5: np.dtype("<u4"),
    6: np.dtype("<i4"),
    7: np.dtype("<u8"),
    8: np.dtype("<i8"),
    REAL32: np.dtype("<f4"),
    10: np.dtype("<f8"),
}
_IN_FLOAT = {number: kind for number, kind in KINDS.items() if kind.kind in "iu" and kind.itemsize <= 4}
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")


class Encoding(Enum):
    """How an integer becomes a float."""

    BYTES = "bytes"
    CAST = "cast"


@dataclass
class Encodings:
    """What is known of the systems of a log, while its batches pass."""

    _capable: dict[Sender, Encoding] = field(default_factory=dict)
    _autopilots: dict[Sender, Encoding] = field(default_factory=dict)
    _seen: dict[Sender, Encoding] = field(default_factory=dict)

    def note_autopilot(self, sender: Sender, autopilot: int) -> None:
        """A HEARTBEAT's `autopilot`."""
        known = {AUTOPILOT_PX4: Encoding.BYTES, AUTOPILOT_ARDUPILOT: Encoding.CAST}.get(autopilot)
        if known is not None:
            self._autopilots[sender] = known

    def note_capabilities(self, sender: Sender, capabilities: int) -> None:
        """An AUTOPILOT_VERSION's `capabilities`; those of both encodings say nothing."""
        can = (bool(capabilities & CAPABLE_OF_BYTES), bool(capabilities & CAPABLE_OF_CASTS))
        if can[0] != can[1]:
            self._capable[sender] = Encoding.BYTES if can[0] else Encoding.CAST

    def of(self, owner: Sender, values: npt.NDArray[np.float32], kinds: IntArray) -> Encoding:
        """How the integers of a component are packed.

        Parameters
        ----------
        owner : (system, component) whose parameters these are.
        values, kinds : (n,) what messages hold, and the types that they state.
        """
        for said in (self._capable, self._autopilots):
            if owner in said:
                return said[owner]
        told = _evident(values, kinds)
        if told is not None:
            self._seen[owner] = told
        if owner in self._seen:
            return self._seen[owner]
        of_system = [
            said[sender]
            for said in (self._capable, self._autopilots, self._seen)
            for sender in sorted(said)
            if sender[0] == owner[0] or owner[0] == 0
        ]
        return of_system[0] if of_system else Encoding.CAST

    def decode(
        self, owners: npt.NDArray[np.integer], values: npt.NDArray[np.float32], kinds: IntArray
    ) -> FloatArray:
        """(n,) numbers that parameter messages mean.

        Parameters
        ----------
        owners : (n,) system * 256 + component of those whose parameters they are.
        values, kinds : (n,) what the messages hold, and the types that they state.
        """
        found = values.astype(np.float64)
        for owner in np.unique(owners).tolist():
            mine = owners == owner
            if self.of(divmod(owner, 256), values[mine], kinds[mine]) is Encoding.BYTES:
                found[mine] = from_bytes(values[mine], kinds[mine])
        return found


def from_bytes(values: npt.NDArray[np.float32], kinds: IntArray) -> FloatArray:
    """(n,) floats whose bytes are those of integers, as these; floats of other types as they are.

    Examples
    --------
    >>> from_bytes(np.array([4001], np.int32).view(np.float32), np.array([6]))
    array([4001.])
    """
    found = values.astype(np.float64)
    raw = np.ascontiguousarray(values, dtype="<f4").view(np.uint8).reshape(len(values), 4)
    for number, kind in _IN_FLOAT.items():
        mine = kinds == number
        if mine.any():
            cut = np.ascontiguousarray(raw[mine, : kind.itemsize])
            found[mine] = cut.view(kind).reshape(-1)
    return found


def _evident(values: npt.NDArray[np.float32], kinds: IntArray) -> Encoding | None:
    """The encoding that values of integer types show; None where there are none but zeros.

    A converted integer is a whole number; bytes of an integer may be one, too, but only of a very large one.
    """
    whole = np.isin(kinds, list(_IN_FLOAT)) & (values != 0)
    told = values[whole].astype(np.float64)
    if not len(told):
        return None
    are_whole = np.isfinite(told) & (told == np.round(told))
    return Encoding.CAST if are_whole.all() else Encoding.BYTES


def with_values(
    table: pa.Table, encodings: Encodings, name: str, sender: Sender, records: npt.NDArray[np.void]
) -> pa.Table:
    """The table of parameter messages with the values that they mean.

    Parameters
    ----------
    name : of the messages: of NUMBERS or EXTENDED.
    sender : (system, component).
    records : (n,) the messages as they are on the wire.
    """
    kinds = records["param_type"].astype(np.int64)
    if name in EXTENDED:
        raw = np.ascontiguousarray(records[VALUE]).view(np.uint8).reshape(len(records), -1)
        array = strings(extended_texts(raw, kinds))
    else:
        owners = np.full(len(records), sender[0] * 256 + sender[1], dtype=np.int64)
        if name != SENT:
            owners = records["target_system"].astype(np.int64) * 256 + records["target_component"]
        array = numeric(encodings.decode(owners, records[VALUE], kinds))
    at = table.schema.get_field_index(VALUE)
    return table.set_column(at, table.schema.field(at).with_type(array.type), array)


def extended_texts(raw: npt.NDArray[np.uint8], kinds: IntArray) -> list[str]:
    """The values of extended parameter messages as text.

    Parameters
    ----------
    raw : (n, 128) bytes. They are text where all of them are numbers in letters, or of no type of number.
    kinds : (n,) the types that the messages state.
    """
    cells = [bytes(row).rstrip(b"\0") for row in raw]
    typed = [KINDS.get(int(kind)) for kind in kinds]
    in_letters = all(_NUMBER.match(cell) for cell, kind in zip(cells, typed, strict=True) if kind is not None)
    found = []
    for cell, row, kind in zip(cells, raw, typed, strict=True):
        if kind is None or in_letters:
            found.append(cell.partition(b"\0")[0].decode("utf-8", "replace"))
        else:
            found.append(str(np.frombuffer(row[: kind.itemsize].tobytes(), kind)[0].item()))
    return found
