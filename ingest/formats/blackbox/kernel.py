"""Blackbox frames, compiled: encodings, predictors, and the walk over one log's frames.

A frame is a type byte, then its fields in the order of the header, without length or checksum. Fields are
written by one of the encodings below, as differences to a prediction. `walk` goes on until its tables are
full or something is wrong; what then is to be done is decided in `frames`. Small logs are read by the same
compiled loops: loading them costs half a second, once in a process.

Sources: the firmwares' `blackbox.c`, `blackbox_encoding.c` and the descriptions of their authors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

ByteArray = npt.NDArray[np.uint8]
Int32Array = npt.NDArray[np.int32]
IntArray = npt.NDArray[np.int64]
State = Any  # a record of STATE

INTRA, INTER, SLOW, GPS, HOME, EVENT = range(6)
LETTERS = tuple(b"IPSGHE")
END_TEXT = tuple(b"End of log")
SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB = 0, 1, 3, 6
TAG2_3S32, TAG8_4S16, NULL, TAG2_3SVARIABLE = 7, 8, 9, 10
NOTHING, PREVIOUS, STRAIGHT_LINE, AVERAGE, CONSTANT, MOTOR_0, INCREMENT, AT_HOME, AT_TIME = (
    0, 1, 2, 3, 4, 5, 6, 7, 10,
)  # fmt: skip
SYNC, ADJUSTMENT, RESUME, DISARM, MODE, IMU_FAILURE, CUSTOM_DATA, CUSTOM_STRING, END = (
    0, 13, 14, 15, 30, 40, 100, 101, 255,
)  # fmt: skip
ROTORFLIGHT = (50, 51, 52)  # governor, rescue, airborne: one number each
WRONG, PAST_END = -1, -2
LONGEST_FRAME = 256
LONGEST_JUMP = 5000
LONGEST_PAUSE_US = 10_000_000

# what `walk` says: it reached the limit; a table is full; no frame at this place; the log stops inside a
# frame; an I frame does not go on from the frames before it; time falls inside a group; the log has said that
# it ends
LIMIT, FULL, NO_FRAME, CUT, SEAM, FALL, ENDED = range(7)


class Program(NamedTuple):
    """How the fields of the frames I, P, S, G and H are written; all (5, N), `size` (5,).

    Attributes
    ----------
    size : number of fields; 0 where the header does not define the frame.
    encoding, predictor, constant : of each field; `constant` is what predictor CONSTANT adds.
    span : how many fields are read at once, at the first of them.
    unsigned : 1 where the value counts from 0 to 2^32 - 1.
    """

    size: IntArray
    encoding: IntArray
    span: IntArray
    predictor: IntArray
    constant: IntArray
    unsigned: IntArray


class Tables(NamedTuple):
    """Where decoded rows go: fields by rows, and the time of every row in microseconds (-1: before any)."""

    main: Int32Array
    main_us: IntArray
    slow: Int32Array
    slow_us: IntArray
    gps: Int32Array
    gps_us: IntArray
    home: Int32Array
    home_us: IntArray
    event: IntArray
    event_us: IntArray


# What is remembered between calls of `walk`, and what does not change inside a log. Rows from `*_open` on
# belong to the group of the last I frame, which the next one has not confirmed yet.
STATE = np.dtype(
    [(name, np.int64) for name in (
        "interval", "numerator", "denominator", "version",
        "iteration_at", "time_at", "motor_0_at", "gps_time_at", "end", "content_end",
        "main", "slow", "gps", "home", "event",
        "main_open", "slow_open", "gps_open", "home_open", "event_open",
        "has_group", "group_iteration", "iteration", "us", "confirmed_iteration", "confirmed_us", "resumed",
        "newest", "older", "has_home", "home_0", "home_1", "homeless",
    )]
)  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _byte(raw: ByteArray, at: int) -> int:
    return int(np.int64(raw[at]))  # signed, or sums with other numbers would be floats


@numba.njit(cache=True, nogil=True)
def _unsigned_vb(raw: ByteArray, at: int, stop: int) -> tuple[int, int]:
    """(value, where it ends or an error): 7 bits a byte, the lowest first, bit 7 where more follow."""
    value, shift = 0, 0
    while shift < 35:
        if at >= stop:
            return 0, PAST_END
        byte = _byte(raw, at)
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFF, at
        shift += 7
    return 0, WRONG


@numba.njit(cache=True, nogil=True)
def _signed_vb(raw: ByteArray, at: int, stop: int) -> tuple[int, int]:
    """The same with the sign in the lowest bit."""
    value, at = _unsigned_vb(raw, at, stop)
    return (value >> 1) ^ -(value & 1), at


@numba.njit(cache=True, nogil=True)
def _signed(value: int, bits: int) -> int:
    """The lowest bits as a two's complement number."""
    value &= (1 << bits) - 1
    return value - ((value >> (bits - 1)) << bits)


@numba.njit(cache=True, nogil=True)
def _tag2(raw: ByteArray, at: int, stop: int, values: IntArray, variable: bool) -> int:
    """Three values; the two highest bits of the first byte say how wide they are."""
    if at >= stop:
        return PAST_END
    first = _byte(raw, at)
    selector = first >> 6
    if selector == 0:
        values[0] = _signed(first >> 4, 2)
        values[1] = _signed(first >> 2, 2)
        values[2] = _signed(first, 2)
        return at + 1
    if selector == 3:
        at += 1
        for k in range(3):
            size = (first >> (2 * k) & 3) + 1
            if at + size > stop:
                return PAST_END
            value = 0
            for j in range(size):
                value |= _byte(raw, at + j) << (8 * j)
            values[k] = _signed(value, 8 * size)
            at += size
        return at
    if at + selector + 1 > stop:
        return PAST_END
    second = _byte(raw, at + 1)
    if selector == 1:
        if variable:
            values[0] = _signed(first >> 1, 5)
            values[1] = _signed((first & 1) << 4 | second >> 4, 5)
        else:
            values[0] = _signed(first, 4)
            values[1] = _signed(second >> 4, 4)
        values[2] = _signed(second, 4)
        return at + 2
    third = _byte(raw, at + 2)
    if variable:
        values[0] = _signed((first & 0x3F) << 2 | second >> 6, 8)
        values[1] = _signed((second & 0x3F) << 1 | third >> 7, 7)
        values[2] = _signed(third, 7)
    else:
        values[0] = _signed(first, 6)
        values[1] = _signed(second, 6)
        values[2] = _signed(third, 6)
    return at + 3


@numba.njit(cache=True, nogil=True)
def _tag8_4s16(raw: ByteArray, at: int, stop: int, values: IntArray) -> int:
    """Four values of 0, 4, 8 or 16 bits; the tag has two bits for each, the first field's lowest.

    They stand in one stream of nibbles, the highest first, filled up to a byte.
    """
    if at >= stop:
        return PAST_END
    tag = _byte(raw, at)
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
        value = _byte(raw, at - 1) & 0xF if waiting else 0
        while left > 1:
            value = value << 8 | _byte(raw, at)
            at += 1
            left -= 2
        waiting = left
        if left:
            value = value << 4 | _byte(raw, at) >> 4
            at += 1
        values[k] = _signed(value, 2 << kind)
    return at


@numba.njit(cache=True, nogil=True)
def _old_tag8_4s16(raw: ByteArray, at: int, stop: int, values: IntArray) -> int:
    """The same in logs of data version 1: two values of 4 bits share a byte, 16 bits are little-endian."""
    if at >= stop:
        return PAST_END
    tag = _byte(raw, at)
    at += 1
    k = 0
    while k < 4:
        kind = tag >> (2 * k) & 3
        values[k] = 0
        if at + (kind + 1) // 2 > stop:
            return PAST_END
        if kind == 1:
            values[k] = _signed(_byte(raw, at), 4)
            k += 1
            if k < 4:
                values[k] = _signed(_byte(raw, at) >> 4, 4)
        elif kind == 2:
            values[k] = _signed(_byte(raw, at), 8)
        elif kind == 3:
            values[k] = _signed(_byte(raw, at) | _byte(raw, at + 1) << 8, 16)
        at += (kind + 1) // 2
        k += 1
    return at


@numba.njit(cache=True, nogil=True)
def _tag8_8svb(raw: ByteArray, at: int, stop: int, values: IntArray, span: int) -> int:
    """Up to eight values; bit k of the tag is set where value k is not 0. A value alone has no tag."""
    if at >= stop:
        return PAST_END
    tag = 1
    if span > 1:
        tag = _byte(raw, at)
        at += 1
        if tag >> span:
            return WRONG
    for k in range(span):
        values[k] = 0
        if tag >> k & 1:
            values[k], at = _signed_vb(raw, at, stop)
            if at < 0:
                return at
    return at


@numba.njit(cache=True, nogil=True)
def _next_iteration(state: State, iteration: int) -> int:
    """The loop iteration after `iteration` that is logged: (i mod I + num - 1) mod den < num."""
    interval, share, of = state.interval, state.numerator, state.denominator
    place = iteration % interval + 1
    if share == 0:
        place = interval
    else:
        phase = (place + share - 1) % of
        if phase >= share:
            place += of - phase
    due: int = iteration - iteration % interval + min(place, interval)
    return due


@numba.njit(cache=True, nogil=True)
def _fields(
    raw: ByteArray,
    at: int,
    stop: int,
    kind: int,
    program: Program,
    state: State,
    values: IntArray,
    before: IntArray,
    earlier: IntArray,
) -> int:
    """Read the fields of a frame from behind its type byte into `values`; where it ends, or an error."""
    many = np.empty(8, dtype=np.int64)
    count, k, homes = program.size[kind], 0, 0
    stop = min(stop, at + LONGEST_FRAME)
    if count == 0:
        return WRONG
    while k < count:
        encoding, span = program.encoding[kind, k], 1
        if program.predictor[kind, k] == INCREMENT:
            values[k] = _next_iteration(state, before[k])
            if program.unsigned[kind, k]:
                values[k] &= 0xFFFFFFFF
            k += 1
            continue
        if encoding == SIGNED_VB:
            many[0], at = _signed_vb(raw, at, stop)
        elif encoding == UNSIGNED_VB:
            many[0], at = _unsigned_vb(raw, at, stop)
        elif encoding == NULL:
            many[0] = 0
        elif encoding == NEG_14BIT:
            many[0], at = _unsigned_vb(raw, at, stop)
            many[0] = -_signed(many[0], 14)
        else:
            span = program.span[kind, k]
            if encoding == TAG8_8SVB:
                at = _tag8_8svb(raw, at, stop, many, span)
            elif encoding == TAG8_4S16:
                if state.version < 2:
                    at = _old_tag8_4s16(raw, at, stop, many)
                else:
                    at = _tag8_4s16(raw, at, stop, many)
            else:
                at = _tag2(raw, at, stop, many, encoding == TAG2_3SVARIABLE)
        if at < 0:
            return at
        for j in range(min(span, count - k)):
            value, predictor = many[j], program.predictor[kind, k]
            unsigned = program.unsigned[kind, k]
            if predictor == PREVIOUS:
                value += before[k]
            elif predictor == AVERAGE:
                total = before[k] + earlier[k]
                if unsigned:
                    value += (total & 0xFFFFFFFF) >> 1
                else:
                    total = _signed(total, 32)
                    value += (total + (total < 0)) >> 1
            elif predictor == STRAIGHT_LINE:
                value += 2 * before[k] - earlier[k]
            elif predictor == CONSTANT:
                value += program.constant[kind, k]
            elif predictor == MOTOR_0:
                if state.motor_0_at >= 0:
                    value += values[state.motor_0_at]
            elif predictor == AT_HOME:
                value += state.home_0 if homes == 0 else state.home_1
                homes += 1
            elif predictor == AT_TIME:
                value += state.us
            value &= 0xFFFFFFFF
            if not unsigned:
                value -= (value >> 31) << 32
            values[k] = value
            k += 1
    return at


@numba.njit(cache=True, nogil=True)
def _event(raw: ByteArray, at: int, stop: int, found: IntArray) -> int:
    """Read an event from behind its letter: number, value, other value, place and size of its text."""
    if at >= stop:
        return PAST_END
    kind = _byte(raw, at)
    at += 1
    found[:] = 0
    found[0] = kind
    if kind == ADJUSTMENT:
        if at >= stop:
            return PAST_END
        found[2] = _byte(raw, at)
        at += 1
        if found[2] >= 0x80:
            if at + 4 > stop:
                return PAST_END
            for j in range(4):
                found[1] |= _byte(raw, at + j) << (8 * j)
            return at + 4
        found[1], at = _signed_vb(raw, at, stop)
        return at
    if kind in (CUSTOM_DATA, CUSTOM_STRING):
        if at >= stop:
            return PAST_END
        found[3], found[4] = at + 1, _byte(raw, at)
        at += 1 + _byte(raw, at)
        return at if at <= stop else PAST_END
    if kind == END:
        found[3] = at
        for letter in END_TEXT:
            if at >= stop:
                return PAST_END
            if raw[at] != letter:
                return WRONG
            at += 1
        while at < stop and at < found[3] + LONGEST_FRAME:
            at += 1
            if raw[at - 1] == 0:
                found[4] = at - 1 - found[3]
                return at
        return PAST_END if at >= stop else WRONG
    if kind in (SYNC, RESUME, DISARM, MODE, IMU_FAILURE) or kind in ROTORFLIGHT:
        found[1], at = _unsigned_vb(raw, at, stop)
        if at >= 0 and kind in (RESUME, MODE):
            found[2], at = _unsigned_vb(raw, at, stop)
        return at
    return WRONG


@numba.njit(cache=True, nogil=True)
def _kind(letter: int) -> int:
    """The frame that a letter begins; -1 where it begins none."""
    for k in range(len(LETTERS)):
        if LETTERS[k] == letter:
            return k
    return -1


@numba.njit(cache=True, nogil=True)
def _may_end(raw: ByteArray, at: int, state: State) -> bool:
    """Whether a frame may end here: another begins, or nothing follows."""
    return at >= state.content_end or _kind(raw[at]) >= 0


@numba.njit(cache=True, nogil=True)
def _unwrapped(now: int, last_us: int) -> int:
    """A 32-bit time as one that goes on from the last: it wraps after 71.6 minutes."""
    return last_us + _signed(now - last_us, 32)


@numba.njit(cache=True, nogil=True)
def close_group(state: State, keep: bool) -> int:
    """End the group of the last I frame, and keep its rows or take them back; how many main rows went."""
    gone = 0
    if not keep:
        gone = state.main - state.main_open
        state.main, state.slow, state.gps = state.main_open, state.slow_open, state.gps_open
        state.home, state.event = state.home_open, state.event_open
        state.iteration, state.us = state.confirmed_iteration, state.confirmed_us
    state.main_open, state.slow_open, state.gps_open = state.main, state.slow, state.gps
    state.home_open, state.event_open = state.home, state.event
    state.confirmed_iteration, state.confirmed_us = state.iteration, state.us
    state.has_group = 0
    return gone


@numba.njit(cache=True, nogil=True)
def _keep(table: Int32Array, times: IntArray, row: int, values: IntArray, us: int) -> None:
    for k in range(table.shape[0]):
        table[k, row] = values[k]  # of a value up to 2^32 - 1, the lowest 32 bits
    times[row] = us


@numba.njit(cache=True, nogil=True)
def walk(
    raw: ByteArray,
    at: int,
    limit: int,
    program: Program,
    state: State,
    history: IntArray,
    tables: Tables,
) -> tuple[int, int]:
    """Decode frames from `at` on into the tables.

    Parameters
    ----------
    raw : (n,) the whole file. limit : no frame from here on is begun.
    state : a record of STATE. history : (5, N) the last main frames (three, in turn), S and G frame.

    Returns what stopped it (LIMIT ... ENDED), and where.
    """
    event = np.empty(5, dtype=np.int64)
    while at < limit and at < state.content_end:
        if (
            state.main == len(tables.main_us)
            or state.slow == len(tables.slow_us)
            or state.gps == len(tables.gps_us)
            or state.home == len(tables.home_us)
            or state.event == len(tables.event_us)
        ):
            return FULL, at
        kind = _kind(raw[at])
        if kind < 0:
            return NO_FRAME, at
        if kind == EVENT:
            end = _event(raw, at + 1, state.end, event)
        elif kind == INTER and not state.has_group:
            return NO_FRAME, at
        else:
            newest, older = state.newest, state.older
            free = 3 - newest - older if newest != older else (newest + 1) % 3
            place = free if kind <= INTER else kind + 1
            if kind == HOME:
                place = free
            before = history[newest] if kind <= INTER else history[place]
            values = history[free]
            end = _fields(raw, at + 1, state.end, kind, program, state, values, before, history[older])
        if end == PAST_END and state.end <= at + 1 + LONGEST_FRAME:
            return CUT, at
        if end < 0 or not (_may_end(raw, end, state) or (kind == EVENT and event[0] == END)):
            return NO_FRAME, at
        if kind <= INTER:
            us = values[state.time_at]
            iteration = values[state.iteration_at] if state.iteration_at >= 0 else 0
            if state.us >= 0:
                us = _unwrapped(us, state.us)
            step_us = us - state.us
            if kind == INTER:
                if step_us < 0 or step_us > LONGEST_PAUSE_US:
                    return FALL, at
                state.older = newest
            else:
                if state.has_group:
                    due = _next_iteration(state, state.iteration)
                    goes_on = 0 <= step_us <= LONGEST_PAUSE_US and (
                        iteration == due or state.iteration_at < 0
                    )
                    if not goes_on and not (state.resumed and step_us >= 0 and iteration >= due):
                        return SEAM, at
                close_group(state, True)
                state.has_group, state.resumed = 1, 0
                state.group_iteration = iteration
                state.older = free
            state.newest = free
            state.iteration = iteration
            state.us = us
            _keep(tables.main, tables.main_us, state.main, values, us)
            state.main += 1
        elif kind == SLOW:
            history[place, : program.size[SLOW]] = values[: program.size[SLOW]]
            _keep(tables.slow, tables.slow_us, state.slow, values, state.us)
            state.slow += 1
        elif kind == GPS:
            history[place, : program.size[GPS]] = values[: program.size[GPS]]
            us = state.us
            if state.gps_time_at >= 0 and us >= 0:
                us = _unwrapped(values[state.gps_time_at], us)
            if state.has_home:
                _keep(tables.gps, tables.gps_us, state.gps, values, us)
                state.gps += 1
            else:
                state.homeless += 1
        elif kind == HOME:
            state.has_home, state.home_0 = 1, values[0]
            state.home_1 = values[1] if program.size[HOME] > 1 else 0
            _keep(tables.home, tables.home_us, state.home, values, state.us)
            state.home += 1
        else:
            tables.event[:, state.event] = event
            tables.event_us[state.event] = state.us
            state.event += 1
            if event[0] == RESUME:
                state.resumed = 1
            if event[0] == END:
                return ENDED, end
        at = end
    return LIMIT, at


@numba.njit(cache=True, nogil=True)
def is_confirmed(
    raw: ByteArray, at: int, program: Program, state: State, scratch: IntArray, found: IntArray
) -> int:
    """Whether the frames behind an I frame at `at` bear it out.

    2 : they lead without a gap to another I frame that goes on from it. 1 : they lead to the log's end.
    0 : neither. `found` (2,) takes its iteration and its time (32 bits). `scratch` is (4, N).
    """
    event = np.empty(5, dtype=np.int64)
    end = _fields(raw, at + 1, state.end, INTRA, program, state, scratch[0], scratch[0], scratch[0])
    if end < 0 or not _may_end(raw, end, state):
        return 0
    found[0] = scratch[0, state.iteration_at] if state.iteration_at >= 0 else 0
    found[1] = scratch[0, state.time_at]
    iteration, us, newest, older = found[0], found[1], 0, 0
    while end < state.content_end:
        kind, at = _kind(raw[end]), end + 1
        free = 3 - newest - older if newest != older else (newest + 1) % 3
        if kind == EVENT:
            end = _event(raw, at, state.end, event)
            if end >= 0 and event[0] == END:
                return 1
            if end >= 0 and event[0] == RESUME:
                return 2
        elif kind <= INTER:
            end = _fields(
                raw, at, state.end, kind, program, state, scratch[free], scratch[newest], scratch[older]
            )
        else:
            end = _fields(raw, at, state.end, kind, program, state, scratch[3], scratch[3], scratch[3])
        if end < 0 or not _may_end(raw, end, state):
            return 0
        if kind <= INTER:
            now = _unwrapped(scratch[free, state.time_at], us)
            stated = scratch[free, state.iteration_at] if state.iteration_at >= 0 else 0
            if now < us or now - us > LONGEST_PAUSE_US:
                return 0
            if kind == INTRA:
                return 2 if state.iteration_at < 0 or stated == _next_iteration(state, iteration) else 0
            older, newest, us, iteration = newest, free, now, stated
    return 1


@numba.njit(cache=True, nogil=True)
def find_intra(
    raw: ByteArray, at: int, program: Program, state: State, scratch: IntArray, found: IntArray
) -> int:
    """The next place that is, by all that can be told, an I frame or the log's End event; -1 where none is.

    An I frame counts where the frames behind it bear it out and it lies behind the last frame that was kept.
    """
    event = np.empty(5, dtype=np.int64)
    while at < state.content_end:
        if raw[at] == LETTERS[EVENT]:
            if _event(raw, at + 1, state.end, event) >= 0 and event[0] == END:
                return at
        elif raw[at] == LETTERS[INTRA]:
            sure = is_confirmed(raw, at, program, state, scratch, found)
            if sure and state.us < 0:
                return at
            step_us = _signed(found[1] - state.us, 32)
            forward = step_us > 0 and (state.iteration_at < 0 or found[0] > state.iteration)
            near = step_us <= LONGEST_PAUSE_US and (
                state.iteration_at < 0 or found[0] - state.iteration <= LONGEST_JUMP
            )
            if sure and forward and (near or sure == 2):
                return at
        at += 1
    return -1
