"""DataFlash definitions: what FMT, FMTU, UNIT and MULT messages say, as layouts.

    FMT   type u8, length u8, name char[4], format char[16], labels char[64]
    FMTU  TimeUS u64, FmtType u8, UnitIds char[16], MultIds char[16]
    UNIT  TimeUS u64, Id i8, Label char[64]         MULT  TimeUS u64, Id i8, Mult f64

A MULT is the whole factor from the raw number to the unit. Logs without MULT (before 2018) leave it to the
format character: c, C, e, E are hundredths and L is 1e-7 degrees. A FMT with another format or other labels
for a known name begins a new stream with "~2" behind its name.
"""

from __future__ import annotations

import string
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from flysid.ingest.formats.common.columns import Field, RecordLayout
from flysid.ingest.formats.common.instance_names import INSTANCE_NAMES, TIMES

FMT_ID = 128
IDS = 256  # that a byte can tell apart
FMT_LENGTH = 89
HEADER_BYTES = 3
MAX_DEFINITIONS = 4096

CHARACTERS: Mapping[str, tuple[str, int, float]] = {
    # character: (NumPy type, count, factor to the physical value)
    "a": ("<i2", 32, 1.0),
    "b": ("<i1", 0, 1.0),
    "B": ("<u1", 0, 1.0),
    "h": ("<i2", 0, 1.0),
    "H": ("<u2", 0, 1.0),
    "i": ("<i4", 0, 1.0),
    "I": ("<u4", 0, 1.0),
    "f": ("<f4", 0, 1.0),
    "d": ("<f8", 0, 1.0),
    "g": ("<f2", 0, 1.0),
    "n": ("S4", 0, 1.0),
    "N": ("S16", 0, 1.0),
    "Z": ("S64", 0, 1.0),
    "c": ("<i2", 0, 0.01),
    "C": ("<u2", 0, 0.01),
    "e": ("<i4", 0, 0.01),
    "E": ("<u4", 0, 0.01),
    "L": ("<i4", 0, 1e-7),
    "M": ("<u1", 0, 1.0),
    "q": ("<i8", 0, 1.0),
    "Q": ("<u8", 0, 1.0),
}
BINARY_FIELDS = {("FILE", "Data")}  # declared as text, holds pieces of files
BINARY_TEXT = ("<u1", 64, 1.0)
TIME_LABELS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
LEGACY_UNITS = {"L": "deg"}
NO_UNIT = "-?\0# "
INSTANCE = "#"
"""The unit of fields that tell instances apart (AP_Logger/LogStructure.h)."""


@dataclass(frozen=True)
class Definition:
    """One FMT.

    Attributes
    ----------
    number : message id.
    length : bytes of a message with its header.
    name, format, labels : as stated.
    stream : the stream's key, e.g. "ATT" or "ATT~2".
    layout : None where the FMT contradicts itself; such messages are framed, and not decoded.
    """

    number: int
    length: int
    name: str
    format: str
    labels: tuple[str, ...]
    stream: str
    layout: RecordLayout | None


@dataclass
class Definitions:
    """All definitions met so far, in order, and which one each message id means at the moment."""

    items: list[Definition] = field(default_factory=list)
    current: dict[int, int] = field(default_factory=dict)
    refused: int = 0
    _known: dict[tuple[object, ...], int] = field(default_factory=dict)
    _names: dict[str, list[tuple[str, tuple[str, ...]]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.add(FMT_ID, FMT_LENGTH, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")

    def add(self, number: int, length: int, name: str, form: str, labels: str) -> bool:
        """Take in a FMT; True where it changes what follows.

        A length below the header's is refused, and so is a definition of FMT itself with another length.
        """
        key = (number, length, name, form, labels)
        index = self._known.get(key)
        if index is not None and self.current.get(number) == index:
            return False
        bad_self = number == FMT_ID and bool(self.items) and length != FMT_LENGTH
        if length < HEADER_BYTES or bad_self or (index is None and len(self.items) >= MAX_DEFINITIONS):
            self.refused += 1
            return False
        if index is None:
            index = self._known[key] = len(self.items)
            columns = tuple(labels.split(",")) if labels else ()
            stream = self._stream_key(number, name, form, columns)
            layout = make_layout(name, form, columns, length)
            self.items.append(Definition(number, length, name, form, columns, stream, layout))
        self.current[number] = index
        return True

    def _stream_key(self, number: int, name: str, form: str, columns: tuple[str, ...]) -> str:
        name = name or f"#{number}"
        variants = self._names.setdefault(name, [])
        if (form, columns) not in variants:
            variants.append((form, columns))
        which = variants.index((form, columns)) + 1
        return name if which == 1 else f"{name}~{which}"


def packed_length(form: str) -> int:
    """Bytes of a message of this format with its header; 0 where a character is unknown."""
    if any(c not in CHARACTERS for c in form):
        return 0
    kinds = (CHARACTERS[c] for c in form)
    return HEADER_BYTES + sum(np.dtype(kind).itemsize * max(count, 1) for kind, count, _ in kinds)


def stated_definition(data: memoryview, at: int) -> tuple[int, int, str, str, str]:
    """Type, length, name, format and labels of the FMT message at `at`."""
    return _stated(bytes(data[at + HEADER_BYTES : at + FMT_LENGTH]).ljust(FMT_LENGTH - HEADER_BYTES, b"\0"))


@lru_cache(maxsize=1024)
def _stated(body: bytes) -> tuple[int, int, str, str, str]:
    """The same of a message's body; logs of one firmware share theirs."""
    return body[0], body[1], _text(body[2:6]), _text(body[6:22]), _text(body[22:86])


def may_define(raw: npt.NDArray[np.uint8], at: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Which FMT messages at `at` have a name and a format that begin as such do; see `is_consistent`."""
    last = len(raw) - 1
    name = raw[np.minimum(at + HEADER_BYTES + 2, last)]
    form = raw[np.minimum(at + HEADER_BYTES + 6, last)]
    found: npt.NDArray[np.bool_] = FIRST_OF_NAMES[name] & _FIRST_OF_FORMATS[form]
    return found


def _bytes_in(characters: str) -> npt.NDArray[np.bool_]:
    """(256,) which bytes are among these characters."""
    table = np.zeros(256, dtype=np.bool_)
    table[list(characters.encode())] = True
    return table


FIRST_OF_NAMES = _bytes_in(string.ascii_letters + string.digits)
_FIRST_OF_FORMATS = _bytes_in("".join(CHARACTERS) + "\0")


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


@lru_cache(maxsize=1024)
def is_consistent(number: int, length: int, name: str, form: str, labels: str) -> bool:
    """Does a FMT agree with itself: plain name, a label per field, the right length?"""
    columns = tuple(labels.split(",")) if labels else ()
    plain = name.isalnum() and name.isascii() and len(columns) == len(form)
    return plain and 0 <= number < 256 and make_layout(name, form, columns, length) is not None


@lru_cache(maxsize=1024)
def make_layout(name: str, form: str, labels: tuple[str, ...], length: int) -> RecordLayout | None:
    """The layout of a message; None where a character is unknown or the lengths disagree.

    Missing labels are made up, superfluous ones ignored, repeated ones numbered. Logs share their layouts.
    """
    if any(c not in CHARACTERS for c in form):
        return None
    names: list[str] = []
    for i, _ in enumerate(form):
        label = labels[i].strip() if i < len(labels) and labels[i].strip() else f"field{i + 1}"
        while label in names:
            label += f"_{i + 1}"
        names.append(label)
    kinds = [
        BINARY_TEXT if (name, n) in BINARY_FIELDS else CHARACTERS[c] for n, c in zip(names, form, strict=True)
    ]
    dtype = np.dtype(
        [(n, k, (count,)) if count else (n, k) for n, (k, count, _) in zip(names, kinds, strict=True)]
    )
    if dtype.itemsize + HEADER_BYTES != length:
        return None
    fields = tuple(_field(n, c, k, scale) for n, c, (k, _, scale) in zip(names, form, kinds, strict=True))
    return RecordLayout(name, dtype, fields)


def _field(name: str, character: str, kind: str, scale: float) -> Field:
    """A field as far as its FMT alone tells."""
    if name in TIME_LABELS and scale == 1.0:
        return Field(name, unit="s", scale=TIME_LABELS[name])
    return Field(name, is_text=kind.startswith("S"), scale=scale, unit=LEGACY_UNITS.get(character, ""))


@dataclass
class Units:
    """Units and multipliers by their one-letter ids, and which letters each message id uses."""

    labels: dict[str, str] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)
    of_message: dict[int, tuple[str, str]] = field(default_factory=dict)

    def apply(self, definition: Definition) -> tuple[RecordLayout, str]:
        """The definition's layout with units and factors, and the fields that tell its instances apart.

        Several are joined by commas; "" where there are none.
        """
        assert definition.layout is not None
        unit_ids, factor_ids = self.of_message.get(definition.number, ("", ""))
        own = definition.layout.fields
        fields = [self._with_unit(f, unit_ids[i : i + 1], factor_ids[i : i + 1]) for i, f in enumerate(own)]
        keys = [f.name for f, unit_id in zip(own, unit_ids, strict=False) if unit_id == INSTANCE]
        keys = keys if unit_ids else undeclared_key(definition)
        return replace(definition.layout, fields=tuple(fields)), ",".join(keys)

    def _with_unit(self, spec: Field, unit_id: str, factor_id: str) -> Field:
        if spec.is_text:
            return spec
        factor = self.factors.get(factor_id, 0.0)
        stated = np.isfinite(factor) and factor not in (0.0, 1.0)
        label = "" if not unit_id or unit_id in NO_UNIT else self.labels.get(unit_id, "")
        unit, extra = UNIT_NAMES.get(label, (label, 1.0))
        scale = float(factor) if stated else spec.scale
        return replace(spec, unit=unit or spec.unit, scale=scale * extra)


def undeclared_key(definition: Definition) -> list[str]:
    """The field that tells instances apart in a log that states no units, as ArduPilot lays it out: a byte
    behind the time.
    """
    names = [f.name for f in definition.layout.fields] if definition.layout is not None else []
    is_key = len(names) > 1 and names[0] in TIMES and names[1] in INSTANCE_NAMES
    return [names[1]] if is_key and definition.format[1] in "bB" else []


UNIT_NAMES: Mapping[str, tuple[str, float]] = {
    # ArduPilot's label: (name in flysid, factor)
    "deglatitude": ("deg", 1.0),
    "deglongitude": ("deg", 1.0),
    "degheading": ("deg", 1.0),
    "m/s/s": ("m/s^2", 1.0),
    "instance": ("", 1.0),
    "UNKNOWN": ("", 1.0),
    "no-unit": ("", 1.0),
}
