"""Frames in streams that come in pieces, with garbage between them: nothing lost, nothing invented."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.formats.mavlink.frames import read_header
from flysid.live.batches import Arrival
from flysid.live.framing import Framer
from tests.link_sender import frames

POOL = frames()


def arrival(content: bytes, *ends: int) -> Arrival:
    raw = np.array([*content], np.uint8)
    edges = np.array(ends or (len(raw),), np.int64)
    return Arrival(b"", raw, edges, np.arange(len(edges), dtype=np.int64))


def cut_all(framer: Framer, pieces: list[bytes]) -> tuple[list[bytes], bytes]:
    found = []
    rejected = b""
    for cut in [*(framer.cut(arrival(piece)) for piece in pieces), framer.finish()]:
        content = cut.raw.tobytes()
        for q in cut.starts.tolist():
            head = read_header(content, q)
            assert head is not None
            found.append(content[q : head.end])
        rejected += cut.rejected
    return found, rejected


@settings(deadline=None)
@given(st.lists(st.integers(0, 255), min_size=1, max_size=40), st.lists(st.integers(1, 90), min_size=1))
def test_frames_do_not_depend_on_where_the_stream_is_cut(numbers: list[int], lengths: list[int]) -> None:
    sent = [POOL[k] for k in numbers]
    stream = b"".join(sent)
    pieces = []
    at = 0
    for k in range(len(stream)):
        length = lengths[k % len(lengths)]
        pieces.append(stream[at : at + length])
        at += length
    found, rejected = cut_all(Framer(False), [piece for piece in pieces if piece])
    assert found == sent
    assert rejected == b""


@settings(deadline=None)
@given(st.lists(st.one_of(st.sampled_from(POOL), st.binary(min_size=1, max_size=60)), max_size=30))
def test_every_byte_is_in_a_frame_or_rejected(parts: list[bytes]) -> None:
    found, rejected = cut_all(Framer(False), parts)
    assert sum(map(len, found)) + len(rejected) == sum(map(len, parts))
    assert all(frame in POOL for frame in found)  # 16 bits of checksum: chance would need 65,536 tries


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from(POOL), st.binary(max_size=30)), min_size=1, max_size=20))
def test_garbage_between_frames_costs_no_frame(parts: list[tuple[bytes, bytes]]) -> None:
    stream = b"".join(frame + bytes(b for b in noise if b not in (0xFD, 0xFE)) for frame, noise in parts)
    found, rejected = cut_all(Framer(False), [stream])
    assert found == [frame for frame, _ in parts]
    assert len(rejected) == len(stream) - sum(map(len, found))


def test_a_wrong_checksum_is_counted_and_the_next_frame_kept() -> None:
    broken = POOL[1][:-1] + bytes([POOL[1][-1] ^ 1])
    cut = Framer(True).cut(arrival(POOL[0] + broken + POOL[2]))
    assert (len(cut.starts), cut.bad_checksums, cut.rejected) == (2, 1, broken)


def unknown_frame() -> bytes:
    """A frame of an id that nobody has: 10 bytes of header, 4 of payload, any checksum."""
    return bytes([0xFD, 4, 0, 0, 7, 1, 1, 0xFF, 0xFF, 0xEE, 1, 2, 3, 4, 9, 9])


def test_an_unknown_id_is_kept_where_its_datagram_ends_with_it() -> None:
    cut = Framer(True).cut(arrival(unknown_frame() + POOL[0], 16, 16 + len(POOL[0])))
    assert len(cut.starts) == 2
    alone = Framer(True).cut(arrival(unknown_frame()))
    assert len(alone.starts) == 1


@settings(deadline=None)
@given(st.integers(1, 11), st.sampled_from(POOL[:8]))
def test_a_frame_behind_what_looks_like_a_longer_one_is_not_lost(length: int, good: bytes) -> None:
    noise = bytes([0, 0xFD, 255, 0, *bytes(length)])
    found, rejected = cut_all(Framer(True), [noise, good])
    assert (found, rejected) == ([good], noise)


@settings(deadline=None)
@given(st.integers(1, 11), st.sampled_from(POOL[:8]))
def test_garbage_cannot_pose_as_an_unknown_frame_around_a_good_one(length: int, good: bytes) -> None:
    header = unknown_frame()[:1] + bytes([length + len(good) - 12]) + unknown_frame()[2:10]
    noise = b"\x00" + (header + bytes(10))[:length]
    framer = Framer(True)
    first = framer.cut(arrival(noise))
    second = framer.cut(arrival(good + POOL[9], len(good), len(good) + len(POOL[9])))
    assert len(second.starts) == 2
    assert first.rejected + second.rejected == noise


def test_an_unknown_id_in_a_stream_needs_a_frame_behind_it() -> None:
    assert len(Framer(False).cut(arrival(unknown_frame() + POOL[0])).starts) == 2
    assert len(Framer(False).cut(arrival(unknown_frame() + b"nothing")).starts) == 0
