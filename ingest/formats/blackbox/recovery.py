"""Where frames count again behind damage: at an I frame that the frames behind it bear out; compiled."""

from __future__ import annotations

import numpy as np

from flysid.compiling import njit
from flysid.ingest.formats.blackbox.codes import EventKind
from flysid.ingest.formats.blackbox.encodings import ByteArray, IntArray, sign_extend
from flysid.ingest.formats.blackbox.kernel import (
    EVENT,
    INTER,
    INTRA,
    LETTERS,
    LONGEST_PAUSE_US,
    Program,
    State,
    kind_of,
    may_end,
    next_iteration,
    read_event,
    read_fields,
    unwrap,
)

LONGEST_JUMP = 5000  # loop iterations
FIELDS_A_BYTE = 2
"""What a search may decode for every byte that it passes. Bytes that look like frames cost a frame each: a
megabyte of them took half a second. True frames behind damage take a tenth of this."""
GROUPS_AT_FIRST = 16
"""And as much as these groups of frames, so that a wound may hold such bytes by the hundred."""


@njit(cache=True, nogil=True)
def is_confirmed(
    raw: ByteArray, at: int, program: Program, state: State, scratch: IntArray, found: IntArray
) -> int:
    """Whether the frames behind an I frame at `at` bear it out.

    2 : they lead without a gap to another I frame that goes on from it. 1 : they lead to the log's end.
    0 : neither, or there are more frames than a group has. `found` (3,) takes its iteration and its time
    (32 bits), and how many fields were decoded for this. `scratch` is (4, N).
    """
    event = np.empty(5, dtype=np.int64)
    found[2] = program.size[INTRA]
    end = read_fields(raw, at + 1, state.end, INTRA, program, state, scratch[0], scratch[0], scratch[0])
    if end < 0 or not may_end(raw, end, state):
        return 0
    found[0] = scratch[0, state.iteration_at] if state.iteration_at >= 0 else 0
    found[1] = scratch[0, state.time_at]
    iteration = found[0]
    us = found[1]
    newest = 0
    older = 0
    longest = found[2] * (state.interval + 1)
    while end < state.content_end:
        kind = kind_of(raw[end])
        at = end + 1
        found[2] += program.size[kind] if kind != EVENT else 1
        if found[2] > longest:
            return 0
        free = 3 - newest - older if newest != older else (newest + 1) % 3
        if kind == EVENT:
            end = read_event(raw, at, state.end, event)
            if end >= 0 and event[0] == EventKind.END:
                return 1
            if end >= 0 and event[0] == EventKind.RESUME:
                return 2
        elif kind <= INTER:
            end = read_fields(
                raw, at, state.end, kind, program, state, scratch[free], scratch[newest], scratch[older]
            )
        else:
            end = read_fields(raw, at, state.end, kind, program, state, scratch[3], scratch[3], scratch[3])
        if end < 0 or not may_end(raw, end, state):
            return 0
        if kind <= INTER:
            now = unwrap(scratch[free, state.time_at], us)
            stated = scratch[free, state.iteration_at] if state.iteration_at >= 0 else 0
            if now < us or now - us > LONGEST_PAUSE_US:
                return 0
            if kind == INTRA:
                return 2 if state.iteration_at < 0 or stated == next_iteration(state, iteration) else 0
            older = newest
            newest = free
            us = now
            iteration = stated
    return 1


@njit(cache=True, nogil=True)
def find_intra(
    raw: ByteArray, at: int, program: Program, state: State, scratch: IntArray, found: IntArray
) -> int:
    """The next place that is, as far as can be seen, an I frame or the log's End event; -1 where none is.

    An I frame counts where the frames behind it bear it out and it lies behind the last frame that was kept.
    What looks like one is left untried while more was decoded than FIELDS_A_BYTE and GROUPS_AT_FIRST allow.
    """
    event = np.empty(5, dtype=np.int64)
    allowed = min(
        GROUPS_AT_FIRST * program.size[INTRA] * state.interval, FIELDS_A_BYTE * (state.content_end - at)
    )
    while at < state.content_end:
        allowed += FIELDS_A_BYTE
        if raw[at] == LETTERS[EVENT]:
            if read_event(raw, at + 1, state.end, event) >= 0 and event[0] == EventKind.END:
                return at
        elif raw[at] == LETTERS[INTRA] and allowed > 0:
            sure = is_confirmed(raw, at, program, state, scratch, found)
            allowed -= found[2]
            if sure and state.us < 0:
                return at
            step_us = sign_extend(found[1] - state.us, 32)
            forward = step_us > 0 and (state.iteration_at < 0 or found[0] > state.iteration)
            near = step_us <= LONGEST_PAUSE_US and (
                state.iteration_at < 0 or found[0] - state.iteration <= LONGEST_JUMP
            )
            if sure and forward and (near or sure == 2):
                return at
        at += 1
    return -1
