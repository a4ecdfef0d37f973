"""Many datagrams with one call: recvmmsg(2) by ctypes, with the kernel's arrival times (Linux).

A call for each datagram costs 12 us of CPU in Python, this one 3 (docs/measured/live.md).
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import socket
import struct
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit

IntArray = npt.NDArray[np.int64]
ByteArray = npt.NDArray[np.uint8]

BATCH = 256
SLOT = 65_536  # the largest datagram there is
ADDRESS = 28  # struct sockaddr_in6
CONTROL = 64
SO_TIMESTAMPNS = 35
SO_MEMINFO = 55
MEMINFO_WORDS = 9
MEMINFO_DROPS = 8
# Nothing there, a signal, and the error of a `udpout:` link whose server is not there.
NO_FAULTS = (errno.EAGAIN, errno.EINTR, errno.ECONNREFUSED)
STAMPED = SO_TIMESTAMPNS << 32 | socket.SOL_SOCKET  # cmsg_level and cmsg_type as one little-endian word


# struct iovec and struct mmsghdr of a system of 64 bits.
SPAN = np.dtype([("base", np.uint64), ("size", np.uint64)])
HEADER = np.dtype(
    [
        ("name", np.uint64),
        ("name_size", np.uint32),
        ("spans", np.uint64),
        ("span_count", np.uint64),
        ("control", np.uint64),
        ("control_size", np.uint64),
        ("flags", np.uint64),  # an int, and what fills struct msghdr up
        ("size", np.uint32),
    ],
    align=True,
)


@dataclass(frozen=True, eq=False)
class Arrival:
    """Bytes of one peer that came together.

    `peer`: the sender's address as the socket states it; b"" on a link with one peer.
    `raw`: the bytes.
    `ends`: (n,) where each datagram ends in `raw`; one end for bytes of a stream.
    `stamps_us`: (n,) arrival of each, microseconds UTC.
    """

    peer: bytes
    raw: ByteArray
    ends: IntArray
    stamps_us: IntArray


def is_offered() -> bool:
    """Whether this system has recvmmsg with the layout that is used here: Linux, 64 bits, little-endian."""
    return sys.platform == "linux" and sys.byteorder == "little" and ctypes.sizeof(ctypes.c_void_p) == 8


class BatchReceiver:
    """Reads datagrams of one UDP socket, up to 256 at a time; never waits."""

    def __init__(self, udp: socket.socket) -> None:
        udp.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._handle = udp.fileno()
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._slots = np.zeros((BATCH, SLOT), np.uint8)
        self._addresses = np.zeros((BATCH, ADDRESS), np.uint8)
        self._controls = np.zeros((BATCH, CONTROL // 8), np.int64)
        self._spans = np.zeros(BATCH, SPAN)
        self._spans["base"] = _rows(self._slots)
        self._spans["size"] = SLOT
        self._headers = np.zeros(BATCH, HEADER)
        self._headers["name"] = _rows(self._addresses)
        self._headers["spans"] = _rows(self._spans)
        self._headers["span_count"] = 1
        self._headers["control"] = _rows(self._controls)
        self._first = ctypes.c_void_p(self._headers.ctypes.data)

    def receive(self) -> tuple[list[Arrival], bool]:
        """What waits in the socket, in order, split where the peer changes; and whether more may wait.

        Raises OSError.
        """
        self._headers["name_size"] = ADDRESS
        self._headers["control_size"] = CONTROL
        count = self._call(self._handle, self._first, BATCH, socket.MSG_DONTWAIT, None)
        if count <= 0:
            number = ctypes.get_errno()
            if count < 0 and number not in NO_FAULTS:
                raise OSError(number, f"recvmmsg: {os.strerror(number)}")
            return [], False
        sizes = self._headers["size"][:count].astype(np.int64)
        ends = np.cumsum(sizes)
        raw = np.empty(int(ends[-1]), np.uint8)
        changes = gather(self._slots, sizes, self._addresses, raw)
        stamps = self._stamps(count)
        arrivals = []
        edges = [0, *np.flatnonzero(changes).tolist(), count]
        for first, stop in itertools.pairwise(edges):
            base = int(ends[first - 1]) if first else 0
            name = self._addresses[first, : self._headers["name_size"][first]].tobytes()
            part = slice(first, stop)
            arrivals.append(Arrival(name, raw[base : ends[stop - 1]], ends[part] - base, stamps[part]))
        return arrivals, count == BATCH

    def _stamps(self, count: int) -> IntArray:
        """(count,) microseconds UTC at which the kernel received each."""
        words = self._controls[:count]
        stamps: IntArray = words[:, 2] * 1_000_000 + words[:, 3] // 1000
        missing = words[:, 1] != STAMPED
        if missing.any():
            stamps[missing] = time.time_ns() // 1000
        return stamps


def _rows(array: npt.NDArray[Any]) -> npt.NDArray[np.uint64]:
    """Where each row of an array begins in memory."""
    at: npt.NDArray[np.uint64] = np.arange(len(array), dtype=np.uint64) * np.uint64(array.strides[0])
    return at + np.uint64(array.ctypes.data)


@njit(cache=True)
def gather(slots: ByteArray, sizes: IntArray, addresses: ByteArray, raw: ByteArray) -> npt.NDArray[np.bool_]:
    """Put datagrams one behind the other into `raw`; (n,) where the peer is another than before."""
    changed = np.zeros(len(sizes), np.bool_)
    at = 0
    for k in range(len(sizes)):
        size = sizes[k]
        for b in range(size):  # a slice's assignment takes seconds longer to compile
            raw[at + b] = slots[k, b]
        at += size
        if k:
            for b in range(addresses.shape[1]):
                if addresses[k, b] != addresses[k - 1, b]:
                    changed[k] = True
    return changed


def dropped_by_kernel(udp: socket.socket) -> int | None:
    """Datagrams that this host received and had no room for since the socket was opened; None where unknown.

    It is the counter of SO_RXQ_OVFL, read by SO_MEMINFO (Linux 4.12): the former travels with the next
    datagram, so that the last drops would never be counted.
    """
    try:
        words = udp.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * MEMINFO_WORDS)
    except OSError:
        return None
    return int(struct.unpack(f"{MEMINFO_WORDS}I", words)[MEMINFO_DROPS])
