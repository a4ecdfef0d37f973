"""Blackbox frames and headers as the firmwares write them: every encoding and predictor.

Written from the description of the format, apart from the reader: values go in, what the firmware would write
comes out. Used by the scrubber and the simulator.

Source: the firmwares' `blackbox.c` and `blackbox_encoding.c`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

from flysid.ingest.formats.blackbox.header import START

# ------------------------------------------------------------------------------------------ encodings

Write = Callable[[Sequence[int]], bytes]
_ONE_BYTE = tuple(bytes([value]) for value in range(0x80))
"""Most numbers of a log are that small."""


def wrap(value: int) -> int:
    """As a signed number of 32 bits."""
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def unsigned_vb(value: int) -> bytes:
    value &= 0xFFFFFFFF
    if value < len(_ONE_BYTE):
        return _ONE_BYTE[value]
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def signed_vb(value: int) -> bytes:
    return unsigned_vb(value << 1 ^ value >> 31)


def _fits(values: Sequence[int], bits: Sequence[int]) -> bool:
    return all(-(1 << b - 1) <= v < 1 << b - 1 for v, b in zip(values, bits, strict=True))


def _pack(parts: Sequence[tuple[int, int]]) -> bytes:
    """(value, bits) one after the other, the highest bit first, filled up to a byte."""
    number = 0
    size = 0
    for value, bits in parts:
        number = number << bits | value & (1 << bits) - 1
        size += bits
    spare = -size % 8
    return (number << spare).to_bytes((size + spare) // 8, "big")


def tag2(values: Sequence[int], variable: bool) -> bytes:
    """TAG2_3S32, or TAG2_3SVARIABLE."""
    a, b, c = values
    if _fits(values, (2, 2, 2)):
        return _pack([(0, 2), (a, 2), (b, 2), (c, 2)])
    if variable and _fits(values, (5, 5, 4)):
        return _pack([(1, 2), (a, 5), (b, 5), (c, 4)])
    if variable and _fits(values, (8, 7, 7)):
        return _pack([(2, 2), (a, 8), (b, 7), (c, 7)])
    if not variable and _fits(values, (4, 4, 4)):
        return _pack([(1, 2), (0, 2), (a, 4), (b, 4), (c, 4)])
    if not variable and _fits(values, (6, 6, 6)):
        return _pack([(2, 2), (a, 6), (0, 2), (b, 6), (0, 2), (c, 6)])
    sizes = [next(n for n in (1, 2, 3, 4) if _fits([v], [8 * n])) for v in values]
    tag = 0xC0 | sum(n - 1 << 2 * k for k, n in enumerate(sizes))
    little = [(v & (1 << 8 * n) - 1).to_bytes(n, "little") for v, n in zip(values, sizes, strict=True)]
    return bytes([tag]) + b"".join(little)


def tag8_4s16(values: Sequence[int], version: int) -> bytes:
    if version < 2:
        return _old_tag8_4s16(values)
    kinds = [
        0 if v == 0 else next(k for k, b in ((1, 4), (2, 8), (3, 16)) if _fits([v], [b])) for v in values
    ]
    tag = sum(kind << 2 * k for k, kind in enumerate(kinds))
    return bytes([tag]) + _pack([(v, 2 << k) for v, k in zip(values, kinds, strict=True) if k])


def _old_tag8_4s16(values: Sequence[int]) -> bytes:
    tag = 0
    out = b""
    k = 0
    while k < 4:
        value = values[k]
        if k < 3 and _fits([value, values[k + 1]], [4, 4]) and (value or values[k + 1]):
            tag |= 0b0101 << 2 * k
            out += bytes([value & 0xF | (values[k + 1] & 0xF) << 4])
            k += 2
            continue
        kind = 0 if value == 0 else 2 if _fits([value], [8]) else 3
        tag |= kind << 2 * k
        out += (b"", b"", struct.pack("<b", value) if kind == 2 else b"", struct.pack("<h", value))[kind]
        k += 1
    return bytes([tag]) + out


def tag8_8svb(values: Sequence[int]) -> bytes:
    if len(values) == 1:
        return signed_vb(values[0])
    tag = sum(1 << k for k, v in enumerate(values) if v)
    return bytes([tag]) + b"".join(signed_vb(v) for v in values if v)


def groups(encodings: Sequence[int]) -> list[tuple[int, int, int]]:
    """(first field, number of fields, encoding) of what is written at once."""
    found = []
    k = 0
    while k < len(encodings):
        span = {7: 3, 8: 4, 10: 3}.get(encodings[k], 1)
        if encodings[k] == 6:
            run = next((j for j, e in enumerate(encodings[k:]) if e != 6), len(encodings) - k)
            span = min(run, 8)
        found.append((k, span, encodings[k]))
        k += span
    return found


def encoded(values: Sequence[int], encodings: Sequence[int], version: int = 2) -> bytes:
    """Differences as the firmware writes them, in groups where the encoding has groups."""
    filled = [*values, 0, 0, 0]
    return b"".join([write(filled[part]) for part, write in _writers(tuple(encodings), version)])


@lru_cache
def _writers(encodings: tuple[int, ...], version: int) -> tuple[tuple[slice, Write], ...]:
    """Which fields are written at once, and how."""
    write: dict[int, Write] = {
        0: lambda v: signed_vb(v[0]),
        1: lambda v: unsigned_vb(v[0]),
        3: lambda v: unsigned_vb(-v[0] & 0x3FFF),
        6: tag8_8svb,
        7: lambda v: tag2(v, False),
        8: lambda v: tag8_4s16(v, version),
        9: lambda _: b"",
        10: lambda v: tag2(v, True),
    }
    return tuple((slice(k, k + span), write[code]) for k, span, code in groups(encodings))


# ------------------------------------------------------------------------------------------- predictors


@dataclass(frozen=True)
class Fields:
    """The fields of one kind of frame."""

    names: Sequence[str]
    signed: Sequence[int]
    predictor: Sequence[int]
    encoding: Sequence[int]

    def lines(self, kind: str) -> list[bytes]:
        rows = {
            "name": self.names,
            "signed": self.signed,
            "predictor": self.predictor,
            "encoding": self.encoding,
        }
        chosen = [w for w in rows if kind != "P" or w in ("predictor", "encoding")]
        return [f"H Field {kind} {w}:{','.join(map(str, rows[w]))}\n".encode() for w in chosen]

    @cached_property
    def written(self) -> tuple[int, ...]:
        """Encodings; what follows from the intervals of the header is not written."""
        return tuple(9 if p == 6 else e for p, e in zip(self.predictor, self.encoding, strict=True))


@dataclass
class Writer:
    """Writes the frames of one log.

    Attributes
    ----------
    kinds : fields by letter; P with the names and signs of I.
    settings : header lines behind the fields; predictors count from some of them.
    version : of the data.
    history : the last two main frames.
    home : the last H frame.
    before : the last frame of other kinds, by letter.
    time_us : time of the last main frame.
    """

    kinds: Mapping[str, Fields]
    settings: Mapping[str, str]
    version: int = 2
    history: list[Sequence[int]] = field(default_factory=list)
    home: Sequence[int] = (0, 0)
    before: dict[str, Sequence[int]] = field(default_factory=dict)
    time_us: int = 0

    def header(self) -> list[bytes]:
        lines = [START, f"H Data version:{self.version}\n".encode()]
        for kind, fields in self.kinds.items():
            lines += fields.lines(kind)
        return lines + [f"H {name}:{text}\n".encode() for name, text in self.settings.items()]

    def setting(self, name: str) -> int:
        return int(self.settings[name].split(",")[0])

    def due(self, iteration: int) -> int:
        """The next iteration that is logged."""
        every = self.setting("I interval")
        share, of = (int(n) for n in self.settings["P interval"].split("/"))
        iteration += 1
        while not ((iteration % every + share - 1) % of < share):
            iteration += 1
        return iteration

    def prediction(self, kind: str, k: int, values: Sequence[int]) -> int:
        """What field k is predicted to be; `values` are the frame's own so far."""
        fields = self.kinds[kind]
        code = fields.predictor[k]
        last: Sequence[int] = [0] * len(fields.names)
        older = last
        if kind == "P":
            last = self.history[-1]
            older = self.history[-2]
        elif kind in self.before:
            last = self.before[kind]
        if code == 3:
            total = last[k] + older[k]
            if fields.signed[k]:
                return math.trunc(wrap(total) / 2)
            return total % (1 << 32) // 2
        if code == 5:
            return values[fields.names.index("motor[0]")]
        if code == 6:
            return self.due(last[k])
        if code == 7:
            return self.home[[j for j, p in enumerate(fields.predictor) if p == 7].index(k)]
        if code == 10:
            return self.time_us
        if code in (4, 9, 11):
            return self.setting({4: "minthrottle", 9: "vbatref", 11: "motorOutput"}[code])
        return {0: 0, 1: last[k], 2: 2 * last[k] - older[k], 8: 1500}[code]

    def frame(self, kind: str, values: Sequence[int]) -> bytes:
        """A frame with these values (unsigned ones below 2^32); it becomes history."""
        fields = self.kinds[kind]
        codes = fields.predictor
        raw = [wrap(v - self.prediction(kind, k, values) if codes[k] else v) for k, v in enumerate(values)]
        if kind in "IP" and "time" in fields.names:
            self.time_us = values[list(fields.names).index("time")]
        if kind == "I":
            self.history = [list(values)] * 2
        elif kind == "P":
            self.history = [self.history[-1], list(values)]
        elif kind == "H":
            self.home = list(values)
        else:
            self.before[kind] = list(values)
        return kind.encode() + encoded(raw, fields.written, self.version)
