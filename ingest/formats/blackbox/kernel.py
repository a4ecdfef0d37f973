"""Blackbox frames, compiled: encodings, predictors, and the walk over one log's frames.

A frame is a type byte, then its fields in the order of the header, without length or checksum. Fields are
written by one of the encodings below, as differences to a prediction. `walk` goes on until its tables are
full or something is wrong; what then is to be done is decided in `frames`. Small logs are read by the same
compiled loops: loading them costs half a second, once in a process.

Sources: the firmwares' `blackbox.c`, `blackbox_encoding.c` and the descriptions of their authors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.ingest.formats.blackbox.codes import Encoding, EventKind, Predictor
from flysid.ingest.formats.blackbox.encodings import (
    PAST_END,
    WRONG,
    ByteArray,
    IntArray,
    byte,
    old_tag8_4s16,
    sign_extend,
    signed_vb,
    tag2,
    tag8_4s16,
    tag8_8svb,
    unsigned_vb,
)

Int32Array = npt.NDArray[np.int32]
State = Any  # a record of STATE

INTRA, INTER, SLOW, GPS, HOME, EVENT = range(6)
LETTERS = tuple(b"IPSGHE")
END_TEXT = tuple(b"End of log")
ROTORFLIGHT = (50, 51, 52)  # governor, rescue, airborne: one number each
LONGEST_FRAME = 256  # of up to 51 fields; INAV logs more than 100
LONGEST_FIELD = 5  # bytes of a number of 32 bits
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
    """Where decoded rows go.

    Fields by rows, the time of every row in microseconds (-1: before any), and (2, rows) where its frame
    begins and ends.
    """

    main: Int32Array
    main_us: IntArray
    main_span: IntArray
    slow: Int32Array
    slow_us: IntArray
    slow_span: IntArray
    gps: Int32Array
    gps_us: IntArray
    gps_span: IntArray
    home: Int32Array
    home_us: IntArray
    home_span: IntArray
    event: IntArray
    event_us: IntArray
    event_span: IntArray


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


@njit(cache=True, nogil=True)
def next_iteration(state: State, iteration: int) -> int:
    """The loop iteration after `iteration` that is logged: (i mod I + num - 1) mod den < num."""
    interval = state.interval
    share = state.numerator
    of = state.denominator
    place = iteration % interval + 1
    if share == 0:
        place = interval
    else:
        phase = (place + share - 1) % of
        if phase >= share:
            place += of - phase
    due: int = iteration - iteration % interval + min(place, interval)
    return due


@njit(cache=True, nogil=True)
def longest_frame(fields: int) -> int:
    """Bytes that a frame of so many fields may take."""
    return max(LONGEST_FRAME, LONGEST_FIELD * fields)


@njit(cache=True, nogil=True)
def read_fields(
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
    count = program.size[kind]
    k = 0
    homes = 0
    stop = min(stop, at + longest_frame(count))
    if count == 0:
        return WRONG
    while k < count:
        encoding = program.encoding[kind, k]
        span = 1
        if program.predictor[kind, k] == Predictor.INCREMENT:
            values[k] = next_iteration(state, before[k])
            if program.unsigned[kind, k]:
                values[k] &= 0xFFFFFFFF
            k += 1
            continue
        if encoding == Encoding.SIGNED_VB:
            many[0], at = signed_vb(raw, at, stop)
        elif encoding == Encoding.UNSIGNED_VB:
            many[0], at = unsigned_vb(raw, at, stop)
        elif encoding == Encoding.NULL:
            many[0] = 0
        elif encoding == Encoding.NEG_14BIT:
            many[0], at = unsigned_vb(raw, at, stop)
            many[0] = -sign_extend(many[0], 14)
        else:
            span = program.span[kind, k]
            if encoding == Encoding.TAG8_8SVB:
                at = tag8_8svb(raw, at, stop, many, span)
            elif encoding == Encoding.TAG8_4S16:
                if state.version < 2:
                    at = old_tag8_4s16(raw, at, stop, many)
                else:
                    at = tag8_4s16(raw, at, stop, many)
            else:
                at = tag2(raw, at, stop, many, encoding == Encoding.TAG2_3SVARIABLE)
        if at < 0:
            return at
        for j in range(min(span, count - k)):
            value = many[j]
            predictor = program.predictor[kind, k]
            unsigned = program.unsigned[kind, k]
            if predictor == Predictor.PREVIOUS:
                value += before[k]
            elif predictor == Predictor.AVERAGE:
                total = before[k] + earlier[k]
                if unsigned:
                    value += (total & 0xFFFFFFFF) >> 1
                else:
                    total = sign_extend(total, 32)
                    value += (total + (total < 0)) >> 1
            elif predictor == Predictor.STRAIGHT_LINE:
                value += 2 * before[k] - earlier[k]
            elif predictor == Predictor.CONSTANT:
                value += program.constant[kind, k]
            elif predictor == Predictor.MOTOR_0:
                if state.motor_0_at >= 0:
                    value += values[state.motor_0_at]
            elif predictor == Predictor.AT_HOME:
                value += state.home_0 if homes == 0 else state.home_1
                homes += 1
            elif predictor == Predictor.AT_TIME:
                value += state.us
            value &= 0xFFFFFFFF
            if not unsigned:
                value -= (value >> 31) << 32
            values[k] = value
            k += 1
    return at


@njit(cache=True, nogil=True)
def read_event(raw: ByteArray, at: int, stop: int, found: IntArray) -> int:
    """Read an event from behind its letter: number, value, other value, place and size of its text."""
    if at >= stop:
        return PAST_END
    kind = byte(raw, at)
    at += 1
    found[:] = 0
    found[0] = kind
    if kind == EventKind.ADJUSTMENT:
        if at >= stop:
            return PAST_END
        found[2] = byte(raw, at)
        at += 1
        if found[2] >= 0x80:
            if at + 4 > stop:
                return PAST_END
            for j in range(4):
                found[1] |= byte(raw, at + j) << (8 * j)
            return at + 4
        found[1], at = signed_vb(raw, at, stop)
        return at
    if kind in (EventKind.CUSTOM_DATA, EventKind.CUSTOM_STRING):
        if at >= stop:
            return PAST_END
        found[3], found[4] = at + 1, byte(raw, at)
        at += 1 + byte(raw, at)
        return at if at <= stop else PAST_END
    if kind == EventKind.END:
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
    if (
        kind in (EventKind.SYNC, EventKind.RESUME, EventKind.DISARM, EventKind.MODE, EventKind.IMU_FAILURE)
        or kind in ROTORFLIGHT
    ):
        found[1], at = unsigned_vb(raw, at, stop)
        if at >= 0 and kind in (EventKind.RESUME, EventKind.MODE):
            found[2], at = unsigned_vb(raw, at, stop)
        return at
    return WRONG


@njit(cache=True, nogil=True)
def kind_of(letter: int) -> int:
    """The frame that a letter begins; -1 where it begins none."""
    for k in range(len(LETTERS)):
        if LETTERS[k] == letter:
            return k
    return -1


@njit(cache=True, nogil=True)
def may_end(raw: ByteArray, at: int, state: State) -> bool:
    """Whether a frame may end here: another begins, or nothing follows."""
    return at >= state.content_end or kind_of(raw[at]) >= 0


@njit(cache=True, nogil=True)
def unwrap(now: int, last_us: int) -> int:
    """A 32-bit time as one that goes on from the last: it wraps after 71.6 minutes."""
    return last_us + sign_extend(now - last_us, 32)


@njit(cache=True, nogil=True)
def close_group(state: State, keep: bool) -> int:
    """End the group of the last I frame, and keep its rows or take them back; how many main rows went."""
    gone = 0
    if not keep:
        gone = state.main - state.main_open
        state.main = state.main_open
        state.slow = state.slow_open
        state.gps = state.gps_open
        state.home = state.home_open
        state.event = state.event_open
        state.iteration = state.confirmed_iteration
        state.us = state.confirmed_us
    state.main_open = state.main
    state.slow_open = state.slow
    state.gps_open = state.gps
    state.home_open = state.home
    state.event_open = state.event
    state.confirmed_iteration = state.iteration
    state.confirmed_us = state.us
    state.has_group = 0
    return gone


@njit(cache=True, nogil=True)
def _keep(
    table: Any, times: IntArray, spans: IntArray, row: int, values: IntArray, us: int, at: int, end: int
) -> None:
    for k in range(table.shape[0]):
        table[k, row] = values[k]  # of a value up to 2^32 - 1, the lowest 32 bits
    times[row] = us
    spans[0, row] = at
    spans[1, row] = end


@njit(cache=True, nogil=True)
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
        kind = kind_of(raw[at])
        if kind < 0:
            return NO_FRAME, at
        if kind == EVENT:
            end = read_event(raw, at + 1, state.end, event)
        elif kind == INTER and not state.has_group:
            return NO_FRAME, at
        else:
            newest = state.newest
            older = state.older
            free = 3 - newest - older if newest != older else (newest + 1) % 3
            place = free if kind <= INTER else kind + 1
            if kind == HOME:
                place = free
            before = history[newest] if kind <= INTER else history[place]
            values = history[free]
            end = read_fields(raw, at + 1, state.end, kind, program, state, values, before, history[older])
        fields = program.size[kind] if kind != EVENT else 0
        if end == PAST_END and state.end <= at + 1 + longest_frame(fields):
            return CUT, at
        if end < 0 or not (may_end(raw, end, state) or (kind == EVENT and event[0] == EventKind.END)):
            return NO_FRAME, at
        if kind <= INTER:
            us = values[state.time_at]
            iteration = values[state.iteration_at] if state.iteration_at >= 0 else 0
            if state.us >= 0:
                us = unwrap(us, state.us)
            step_us = us - state.us
            if kind == INTER:
                if step_us < 0 or step_us > LONGEST_PAUSE_US:
                    return FALL, at
                state.older = newest
            else:
                if state.has_group:
                    due = next_iteration(state, state.iteration)
                    goes_on = 0 <= step_us <= LONGEST_PAUSE_US and (
                        iteration == due or state.iteration_at < 0
                    )
                    if not goes_on and not (state.resumed and step_us >= 0 and iteration >= due):
                        return SEAM, at
                close_group(state, True)
                state.has_group = 1
                state.resumed = 0
                state.group_iteration = iteration
                state.older = free
            state.newest = free
            state.iteration = iteration
            state.us = us
            _keep(tables.main, tables.main_us, tables.main_span, state.main, values, us, at, end)
            state.main += 1
        elif kind == SLOW:
            for field in range(program.size[SLOW]):  # slices take seconds longer to compile
                history[place, field] = values[field]
            _keep(tables.slow, tables.slow_us, tables.slow_span, state.slow, values, state.us, at, end)
            state.slow += 1
        elif kind == GPS:
            for field in range(program.size[GPS]):  # slices take seconds longer to compile
                history[place, field] = values[field]
            us = state.us
            if state.gps_time_at >= 0 and us >= 0:
                us = unwrap(values[state.gps_time_at], us)
            if state.has_home:
                _keep(tables.gps, tables.gps_us, tables.gps_span, state.gps, values, us, at, end)
                state.gps += 1
            else:
                state.homeless += 1
        elif kind == HOME:
            state.has_home = 1
            state.home_0 = values[0]
            state.home_1 = values[1] if program.size[HOME] > 1 else 0
            _keep(tables.home, tables.home_us, tables.home_span, state.home, values, state.us, at, end)
            state.home += 1
        else:
            us = state.us
            _keep(tables.event, tables.event_us, tables.event_span, state.event, event, us, at, end)
            state.event += 1
            if event[0] == EventKind.RESUME:
                state.resumed = 1
            if event[0] == EventKind.END:
                return ENDED, end
        at = end
    return LIMIT, at
