"""How blackbox frames write numbers: bytes in, numbers and the place behind them out; compiled.

Every function takes the bytes, where to begin and where to stop, and returns where it ended, or an error:
WRONG where no writer would write such bytes, PAST_END where they stop short.

Source: the firmwares' `blackbox_encoding.c`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit

ByteArray = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]

WRONG = -1
PAST_END = -2


@njit(cache=True, nogil=True)
def byte(raw: ByteArray, at: int) -> int:
    return int(np.int64(raw[at]))  # signed, or sums with other numbers would be floats


@njit(cache=True, nogil=True)
def unsigned_vb(raw: ByteArray, at: int, stop: int) -> tuple[int, int]:
    """(value, where it ends or an error): 7 bits a byte, the lowest first, bit 7 where more follow."""
    value = 0
    shift = 0
    while shift < 35:
        if at >= stop:
            return 0, PAST_END
        octet = byte(raw, at)
        at += 1
        value |= (octet & 0x7F) << shift
        if octet < 0x80:
            return value & 0xFFFFFFFF, at
        shift += 7
    return 0, WRONG


@njit(cache=True, nogil=True)
def signed_vb(raw: ByteArray, at: int, stop: int) -> tuple[int, int]:
    """The same with the sign in the lowest bit."""
    value, at = unsigned_vb(raw, at, stop)
    return (value >> 1) ^ -(value & 1), at


@njit(cache=True, nogil=True)
def sign_extend(value: int, bits: int) -> int:
    """The lowest bits as a two's complement number."""
    value &= (1 << bits) - 1
    return value - ((value >> (bits - 1)) << bits)


@njit(cache=True, nogil=True)
def tag2(raw: ByteArray, at: int, stop: int, values: IntArray, variable: bool) -> int:
    """Three values; the two highest bits of the first byte say how wide they are."""
    if at >= stop:
        return PAST_END
    first = byte(raw, at)
    selector = first >> 6
    if selector == 0:
        values[0] = sign_extend(first >> 4, 2)
        values[1] = sign_extend(first >> 2, 2)
        values[2] = sign_extend(first, 2)
        return at + 1
    if selector == 3:
        at += 1
        for k in range(3):
            size = (first >> (2 * k) & 3) + 1
            if at + size > stop:
                return PAST_END
            value = 0
            for j in range(size):
                value |= byte(raw, at + j) << (8 * j)
            values[k] = sign_extend(value, 8 * size)
            at += size
        return at
    if at + selector + 1 > stop:
        return PAST_END
    second = byte(raw, at + 1)
    if selector == 1:
        if variable:
            values[0] = sign_extend(first >> 1, 5)
            values[1] = sign_extend((first & 1) << 4 | second >> 4, 5)
        else:
            values[0] = sign_extend(first, 4)
            values[1] = sign_extend(second >> 4, 4)
        values[2] = sign_extend(second, 4)
        return at + 2
    third = byte(raw, at + 2)
    if variable:
        values[0] = sign_extend((first & 0x3F) << 2 | second >> 6, 8)
        values[1] = sign_extend((second & 0x3F) << 1 | third >> 7, 7)
        values[2] = sign_extend(third, 7)
    else:
        values[0] = sign_extend(first, 6)
        values[1] = sign_extend(second, 6)
        values[2] = sign_extend(third, 6)
    return at + 3


@njit(cache=True, nogil=True)
def tag8_4s16(raw: ByteArray, at: int, stop: int, values: IntArray) -> int:
    """Four values of 0, 4, 8 or 16 bits; the tag has two bits for each, the first field's lowest.

    They stand in one stream of nibbles, the highest first, filled up to a byte.
    """
    if at >= stop:
        return PAST_END
    tag = byte(raw, at)
    at += 1
    waiting = 0  # nibbles of the byte before `at` that are still to be read
    for k in range(4):
        kind = tag >> (2 * k) & 3
        values[k] = 0
        if kind == 0:
            continue
        left = (1 << (kind - 1)) - waiting  # nibbles that the next bytes must give
        if at + (left + 1) // 2 > stop:
            return PAST_END
        value = byte(raw, at - 1) & 0xF if waiting else 0
        while left > 1:
            value = value << 8 | byte(raw, at)
            at += 1
            left -= 2
        waiting = left
        if left:
            value = value << 4 | byte(raw, at) >> 4
            at += 1
        values[k] = sign_extend(value, 2 << kind)
    return at


@njit(cache=True, nogil=True)
def old_tag8_4s16(raw: ByteArray, at: int, stop: int, values: IntArray) -> int:
    """The same in logs of data version 1: two values of 4 bits share a byte, 16 bits are little-endian."""
    if at >= stop:
        return PAST_END
    tag = byte(raw, at)
    at += 1
    k = 0
    while k < 4:
        kind = tag >> (2 * k) & 3
        values[k] = 0
        if at + (kind + 1) // 2 > stop:
            return PAST_END
        if kind == 1:
            values[k] = sign_extend(byte(raw, at), 4)
            k += 1
            if k < 4:
                values[k] = sign_extend(byte(raw, at) >> 4, 4)
        elif kind == 2:
            values[k] = sign_extend(byte(raw, at), 8)
        elif kind == 3:
            values[k] = sign_extend(byte(raw, at) | byte(raw, at + 1) << 8, 16)
        at += (kind + 1) // 2
        k += 1
    return at


@njit(cache=True, nogil=True)
def tag8_8svb(raw: ByteArray, at: int, stop: int, values: IntArray, span: int) -> int:
    """Up to eight values; bit k of the tag is set where value k is not 0. A value alone has no tag."""
    if at >= stop:
        return PAST_END
    tag = 1
    if span > 1:
        tag = byte(raw, at)
        at += 1
        if tag >> span:
            return WRONG
    for k in range(span):
        values[k] = 0
        if tag >> k & 1:
            values[k], at = signed_vb(raw, at, stop)
            if at < 0:
                return at
    return at
