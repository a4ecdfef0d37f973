"""The time axis of a log: seconds since it began, boot after boot, on the vehicle's clock.

Plots, lists of events, tracks, exported tables, the studio and pages count on it. What concerns one boot
(`--between`, the times in a report) counts from that boot's beginning, which is the same in a log of one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flysid.flight import ClockMap

NS = 1e-9


@dataclass(frozen=True)
class LogClock:
    """When the boots of a log began, on the vehicle's clock and on the axis.

    `begins_ns`: boot -> vehicle time of its first row.
    `starts_s`: boot -> seconds on the axis at which it begins: the lengths of the boots before it.

    >>> clock = log_clock([ClockMap(0, 5_000_000_000, 9_000_000_000), ClockMap(1, 0, 3_000_000_000)])
    >>> clock.seconds(0, 6_000_000_000), clock.seconds(1, 500_000_000)
    (1.0, 4.5)
    """

    begins_ns: Mapping[int, int]
    starts_s: Mapping[int, float]

    @property
    def offsets_s(self) -> dict[int, float]:
        """Boot -> seconds to add to its vehicle time."""
        return {boot: self.starts_s[boot] - begin * NS for boot, begin in self.begins_ns.items()}

    def seconds(self, boot: int, time_ns: int) -> float:
        """Vehicle time as seconds on the axis; from zero in a boot that is not known."""
        return self.starts_s.get(boot, 0.0) + (time_ns - self.begins_ns.get(boot, 0)) * NS

    def place(self, seconds: float) -> tuple[int, int]:
        """Boot and vehicle time in ns of seconds on the axis; of the last boot that has begun by then.

        >>> log_clock([ClockMap(0, 5_000_000_000, 9_000_000_000), ClockMap(1, 0, 3_000_000_000)]).place(4.5)
        (1, 500000000)
        """
        begun = [boot for boot, start_s in self.starts_s.items() if start_s <= seconds]
        boot = begun[-1] if begun else next(iter(self.begins_ns), 0)
        return boot, self.begins_ns.get(boot, 0) + round((seconds - self.starts_s.get(boot, 0.0)) / NS)

    @property
    def words(self) -> str:
        """Which clock this is, for people."""
        begins = [f"{begin * NS:.3f} s" for begin in self.begins_ns.values()]
        if not begins:
            return "seconds on the vehicle's clock"
        if len(begins) == 1:
            return f"seconds since the log began, at {begins[0]} on the vehicle's clock"
        shown = ", ".join(begins[:MOST_BOOTS]) + (", ..." if len(begins) > MOST_BOOTS else "")
        return f"seconds since the log began, boot after boot; they began at {shown} on the vehicle's clock"


MOST_BOOTS = 4  # in words


def log_clock(clocks: Sequence[ClockMap]) -> LogClock:
    """The axis of a log with these boots."""
    begins: dict[int, int] = {}
    starts: dict[int, float] = {}
    start_s = 0.0
    for clock in clocks:
        begins[clock.boot] = clock.first_ns
        starts[clock.boot] = start_s
        start_s += (clock.last_ns - clock.first_ns) * NS
    return LogClock(begins, starts)
