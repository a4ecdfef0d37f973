"""One axis of time for a log, and back to the clock of the vehicle."""

from __future__ import annotations

import pytest

from flysid.facts.clock import log_clock
from flysid.flight import ClockMap

S = 10**9


@pytest.mark.parametrize(
    ("boot", "time_ns"), [(0, 5 * S), (0, 8 * S), (3, 0), (3, S // 2), (3, 7 * S), (9, 2 * S)]
)
def test_a_place_on_the_axis_is_the_vehicles_time_again(boot: int, time_ns: int) -> None:
    clock = log_clock([ClockMap(0, 5 * S, 9 * S), ClockMap(3, 0, 7 * S + 1), ClockMap(9, S, 3 * S)])
    assert clock.place(clock.seconds(boot, time_ns)) == (boot, time_ns)


def test_a_time_before_the_log_lies_before_its_first_boot() -> None:
    assert log_clock([ClockMap(2, 5 * S, 9 * S)]).place(-1.0) == (2, 4 * S)
    assert log_clock([]).place(1.5) == (0, 1_500_000_000)
