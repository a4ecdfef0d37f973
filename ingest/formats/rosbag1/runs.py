"""Messages of a ROS 1 bag that follow one another without a gap, found in one pass.

Nearly all records of a bag are messages, and one recorder writes the fields of every header in one order.
So a header is compared with what is constant in it, and its numbers come out in the same step.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import permutations
from operator import itemgetter
from typing import Any, NamedTuple

from flysid.ingest.formats.common.clock import SECOND_NS

HEAD_BYTES = 46  # of a message: all of it but its data
RUN_BYTES = 1 << 20  # a run is copied at once
_LENGTH = b"\x26\0\0\0"  # of the fields of a message
_FIELDS = {"conn": b"\x09\0\0\0conn=", "op": b"\x04\0\0\0op=\x02", "time": b"\x0d\0\0\0time="}
_NUMBERS = {"conn": "I", "op": "", "time": "II"}  # what follows these, as `struct` says it


class MessagePlace(NamedTuple):
    """A message with its data at [data_at, end): its connection and when it was recorded."""

    connection: int
    log_ns: int
    data_at: int
    end: int


class _Head:
    """The head of a message whose fields come in one order."""

    def __init__(self, order: Sequence[str]) -> None:
        constants = [_LENGTH + _FIELDS[order[0]], _FIELDS[order[1]], _FIELDS[order[2]]]
        layout = "<"
        places: list[int] = []
        numbers: dict[str, int] = {}
        count = 0
        for name, constant in zip(order, constants, strict=True):
            places.append(count)
            numbers[name] = count + 1
            layout += f"{len(constant)}s{_NUMBERS[name]}"
            count += 1 + len(_NUMBERS[name])
        self.unpack = struct.Struct(f"{layout}I").unpack_from
        self.constants = tuple(constants)
        self.constants_of = itemgetter(*places)
        self.connection = numbers["conn"]
        self.time = numbers["time"]

    def is_at(self, source: memoryview | bytes, at: int, limit: int) -> bool:
        """Whether a whole head of this order begins at `at`."""
        return at + HEAD_BYTES <= limit and self.constants_of(self.unpack(source, at)) == self.constants

    def run(self, source: memoryview | bytes, at: int, limit: int) -> list[MessagePlace]:
        """Messages from `at`, where a head begins, each of them followed by another head of this order."""
        found = []
        last = limit - HEAD_BYTES
        stop = at + RUN_BYTES
        seconds, fraction = self.time, self.time + 1
        values: tuple[Any, ...] = self.unpack(source, at)
        while at < stop:
            data_at = at + HEAD_BYTES
            end = data_at + values[-1]
            if end > last:
                break
            following = self.unpack(source, end)
            if self.constants_of(following) != self.constants:
                break
            log_ns = values[seconds] * SECOND_NS + values[fraction]
            found.append(MessagePlace(values[self.connection], log_ns, data_at, end))
            at = end
            values = following
        return found


_HEADS = [_Head(order) for order in permutations(_FIELDS)]


def message_run(source: memoryview | bytes, at: int, limit: int) -> list[MessagePlace]:
    """The messages from `at` on that lie back to back before `limit`, but the last; none where there is none.

    What follows the last one decides whether its length is right, so it is left to the caller.
    """
    head = next((head for head in _HEADS if head.is_at(source, at, limit)), None)
    return head.run(source, at, limit) if head is not None else []
