"""Losses, silences, overtaken frames and restarts, told by what frames say of themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common

from flysid.live.ledger import Ledger
from tests.link_sender import frames

POOL = frames()


def enter(ledger: Ledger, numbers: list[int], stamps_us: list[int], pool: list[bytes] = POOL) -> Any:
    """Frames of these numbers at these times; returns what the sender's link lost."""
    content = [pool[k & 0xFF] for k in numbers]
    raw = np.array([*b"".join(content)], np.uint8)
    ends = np.cumsum([len(frame) for frame in content])
    starts = np.array([0, *ends[:-1].tolist()], np.int64)
    records, _ = ledger.enter(0, raw, starts, ends, np.array(stamps_us, np.int64))
    assert len(records) == len(raw) + 8 * len(numbers)
    return ledger.loss(1)


def steady(count: int, each_us: int = 2_000) -> list[int]:
    return [1_000_000 + each_us * k for k in range(count)]


def test_a_whole_stream_has_no_losses() -> None:
    row = enter(Ledger(), list(range(1000)), steady(1000))
    assert (row.frames, row.lost, row.late, row.silences) == (1000, 0, 0, 0)


def test_lost_frames_are_counted_by_the_sequence() -> None:
    kept = [k for k in range(1000) if k % 10]
    row = enter(Ledger(), kept, [1_000_000 + 2_000 * k for k in kept])
    assert row.lost == 1000 - len(kept) - 1  # the very first cannot be missed


def test_a_long_gap_adds_what_eight_bits_hide() -> None:
    kept = [*range(2000), *range(5000, 6000)]  # 3,000 lost in 6 s
    row = enter(Ledger(), kept, [1_000_000 + 2_000 * k for k in kept])
    assert row.silences == 1
    assert row.lost == 3000 % 256
    assert row.lost + row.hidden == 3000


def test_a_heartbeat_a_second_is_not_silence() -> None:
    row = enter(Ledger(), list(range(20)), steady(20, 1_000_000))
    assert (row.silences, row.lost, row.hidden) == (0, 0, 0)


def test_overtaken_frames_are_no_losses() -> None:
    numbers = [
        *range(10),
        11,
        10,
        *range(12, 30),
        29,
    ]  # one overtaken, one twice: too few to be called copies
    row = enter(Ledger(), numbers, steady(len(numbers)))
    assert (row.lost, row.late) == (0, 1)


def test_a_sequence_that_jumps_back_is_followed() -> None:
    numbers = [*range(100), *range(60, 90)]
    row = enter(Ledger(), numbers, steady(len(numbers)))
    assert row.lost == 0


def told_times(times_ms: list[int]) -> list[bytes]:
    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    made = []
    for k, time_ms in enumerate(times_ms):
        link.seq = k
        made.append(bytes(link.attitude_encode(time_ms, 0.1, 0, 0, 0, 0, 0.5).pack(link)))
    return made


def test_a_restart_is_seen_and_its_sequence_is_no_loss() -> None:
    before = told_times([60_000 + 2 * k for k in range(100)])
    after = told_times([300 + 2 * k for k in range(50)])
    ledger = Ledger()
    enter(ledger, list(range(100)), steady(100), before)
    row = enter(ledger, list(range(50)), [t + 3_000_000 for t in steady(50)], after)
    assert (row.boots, row.clock_steps) == (1, 0)
    assert (row.lost, row.hidden) == (0, 0)


def test_a_clock_that_is_set_forward_is_a_step() -> None:
    times = [60_000 + 2 * k + 100_000 * (k >= 50) for k in range(100)]
    row = enter(Ledger(), list(range(100)), steady(100), told_times(times))
    assert (row.boots, row.clock_steps) == (0, 1)


def test_a_step_of_the_hosts_clock_is_no_silence() -> None:
    ledger = Ledger()
    enter(ledger, list(range(100)), steady(100))
    ledger.shift_clock(3_600_000_000)
    row = enter(ledger, list(range(100, 200)), [t + 3_600_200_000 for t in steady(100)])
    assert (row.silences, row.lost, row.hidden) == (0, 0, 0)


def test_two_addresses_with_one_number_stay_two() -> None:
    ledger = Ledger()
    raw = np.array([*POOL[1]], np.uint8)
    for peer in (0, 1):
        ledger.enter(peer, raw, np.array([0]), np.array([len(raw)]), np.array([1_000_000]))
    assert ledger.senders["peer"].tolist()[1:] == [0, 1]
    assert ledger.senders["frames"].tolist()[1:] == [1, 1]
