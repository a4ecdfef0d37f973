"""CBOR (RFC 8949) as JSON, message by message.

Keys become text, byte strings base64url, undefined null, numbers beyond JSON stay as Python writes them. Tags
are passed over: what they stand on is kept. A message that is not one whole item is none.
"""

from __future__ import annotations

import json
import struct
from base64 import urlsafe_b64encode
from typing import Any

from flysid.ingest.formats.common.gather import Bytes, Index

MAX_DEPTH = 64
_OPEN = 31  # of no stated length
_BREAK = 0xFF
_FLOATS = {25: ">e", 26: ">f", 27: ">d"}
_SIMPLE = {20: False, 21: True, 22: None, 23: None}


def cbor_as_json(data: Bytes, at: Index, size: Index) -> list[bytes | None]:
    """Messages data[at : at + size] as JSON; None where a message is damaged."""
    return [
        _as_json(data[start : start + length].tobytes())
        for start, length in zip(at.tolist(), size.tolist(), strict=True)
    ]


def _as_json(raw: bytes) -> bytes | None:
    try:
        value, end = _item(raw, 0, 0)
    except (IndexError, struct.error, ValueError, OverflowError):
        return None
    return json.dumps(value).encode() if end == len(raw) else None


def _item(raw: bytes, at: int, depth: int) -> tuple[Any, int]:
    """The item at a place, and where it ends. Raises ValueError, IndexError or struct.error."""
    if depth > MAX_DEPTH:
        raise ValueError(f"nested more than {MAX_DEPTH} deep")
    kind, short = divmod(raw[at], 32)
    if kind == 7:
        return _simple(raw, at, short)
    count, at = _count(raw, at + 1, short)
    if kind in (0, 1):
        return (count if kind == 0 else -1 - count), at
    if kind in (2, 3):
        return _text(raw, at, count, kind)
    if kind == 6:
        return _item(raw, at, depth + 1)
    items: list[Any] = []
    wanted = count if kind == 4 else 2 * count
    while (count >= 0 and len(items) < wanted) or (count < 0 and raw[at] != _BREAK):
        item, at = _item(raw, at, depth + 1)
        items.append(item)
    at += count < 0
    if kind == 4:
        return items, at
    return {str(key): value for key, value in zip(items[::2], items[1::2], strict=True)}, at


def _count(raw: bytes, at: int, short: int) -> tuple[int, int]:
    """The number that a head states, -1 for none, and where it ends."""
    if short < 24:
        return short, at
    if short == _OPEN:
        return -1, at
    size = 1 << (short - 24)
    if size > 8 or at + size > len(raw):
        raise ValueError("the item ends in its head")
    return int.from_bytes(raw[at : at + size], "big"), at + size


def _text(raw: bytes, at: int, count: int, kind: int) -> tuple[str, int]:
    if count < 0:
        pieces: list[str] = []
        while raw[at] != _BREAK:
            found, at = _item(raw, at, MAX_DEPTH)
            pieces.append(found)
        return "".join(pieces), at + 1
    if at + count > len(raw):
        raise ValueError("the item is cut")
    piece = raw[at : at + count]
    return (piece.decode() if kind == 3 else urlsafe_b64encode(piece).decode()), at + count


def _simple(raw: bytes, at: int, short: int) -> tuple[Any, int]:
    if short in _FLOATS:
        value = struct.unpack_from(_FLOATS[short], raw, at + 1)[0]
        return value, at + 1 + struct.calcsize(_FLOATS[short])
    if short not in _SIMPLE:
        raise ValueError("a simple value without a meaning")
    return _SIMPLE[short], at + 1
