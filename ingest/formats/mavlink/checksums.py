"""Checksums of MAVLink frames: CRC-16/MCRF4XX from behind the marker on, then the seed of the layout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
ByteArray = npt.NDArray[np.uint8]
Buffer = bytes | memoryview


def crc_table() -> npt.NDArray[np.uint16]:
    """(256,) table of CRC-16/MCRF4XX: polynomial 0x1021, reflected."""
    table: npt.NDArray[np.uint16] = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = (table >> np.uint16(1)) ^ np.where(table & 1, np.uint16(0x8408), np.uint16(0))
    return table


CRC_TABLE = crc_table()


@dataclass(frozen=True)
class Header:
    """A frame's header: where its CRC and its end are, and its message id."""

    crc_at: int
    end: int
    message: int


def crc_holds(
    raw: ByteArray, starts: IntArray, crc_at: IntArray, seed: npt.NDArray[np.int16]
) -> npt.NDArray[np.bool_]:
    """Of which frames the CRC is right: from behind `starts` to `crc_at`, then the seed."""
    import fastcrc

    base = int(starts[0]) if len(starts) else 0
    body = raw[base : int(crc_at.max())].tobytes() if len(starts) else b""
    crc16 = fastcrc.crc16.mcrf4xx
    spans = zip((starts + 1 - base).tolist(), (crc_at - base).tolist(), strict=True)
    crc = np.fromiter((crc16(body[a:b]) for a, b in spans), np.uint16, len(starts))
    crc = (crc >> 8) ^ CRC_TABLE[(crc ^ seed.astype(np.uint16)) & 0xFF]
    right: npt.NDArray[np.bool_] = crc == (raw[crc_at] | raw[crc_at + 1].astype(np.uint16) << 8)
    return right


def is_valid(buffer: Buffer, q: int, head: Header, seed: int) -> bool:
    """True where the CRC of a known message holds."""
    import fastcrc

    stated = int.from_bytes(buffer[head.crc_at : head.crc_at + 2], "little")
    return bool(fastcrc.crc16.mcrf4xx(bytes(buffer[q + 1 : head.crc_at]) + bytes([seed])) == stated)


def seed_of(buffer: Buffer, q: int, head: Header) -> int:
    """The seed with which the CRC of a frame holds: that of its layout; -1 for none.

    A frame that damage changed has one by chance, once in 256.
    """
    import fastcrc

    stated = int.from_bytes(buffer[head.crc_at : head.crc_at + 2], "little")
    crc = fastcrc.crc16.mcrf4xx(bytes(buffer[q + 1 : head.crc_at]))
    fits = np.flatnonzero((crc >> 8) ^ CRC_TABLE == stated)
    return int(fits[0]) ^ (crc & 0xFF) if len(fits) else -1
