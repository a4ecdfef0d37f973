"""Times of tables from elsewhere, row by row: where a counter wraps, and where the clock starts again."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flysid.flight import ClockMap
from flysid.ingest.formats.common.clock import LEAP_NS, UNIX_NS, IntArray, UtcFit, back_steps
from flysid.stretch import FloatArray

MOSTLY = 0.9  # of the steps of a time go forwards, or none
MOVING = 0.25  # of them go forwards: several rows may share a time, but not many


def rises(values: FloatArray, least: float = MOVING) -> bool:
    """Whether values go forwards as the time of every row does: `least` of the steps, and hardly one back."""
    steps = np.diff(values, append=np.inf)
    return len(values) > 0 and bool(np.mean(steps >= 0) >= MOSTLY and np.mean(steps > 0) >= least)


@dataclass(frozen=True)
class Turn:
    """When a counter begins anew.

    Attributes
    ----------
    period_ns : after which it does; 0 where it does not.
    gap_ns : how long no row may be written around that moment. A clock that started again by chance as late
        in its period would be taken for one that turned.
    """

    period_ns: int = 0
    gap_ns: int = LEAP_NS


NO_TURN = Turn()
COUNTERS = {  # autopilots count microseconds or milliseconds in 32 bits
    "s": Turn((1 << 32) * 1000),
    "us": Turn((1 << 32) * 1000),
    "ms": Turn((1 << 32) * 1_000_000),
}


def unwrapped(
    time_ns: IntArray, turn: Turn, last_ns: int | None = None, turns: int = 0
) -> tuple[IntArray, int]:
    """(n,) times of a counter that begins anew after a period, such as a clock at midnight, as rising ones.

    It wraps where it goes on one period later, but for the gap. Any other leap back is a clock that started
    again.

    Parameters
    ----------
    last_ns : what the counter said in the row before; None where these rows are the first.
    turns : periods before that row.

    Returns
    -------
    times, and the turns at their end.
    """
    period_ns, gap_ns = turn.period_ns, turn.gap_ns
    if not period_ns or not len(time_ns) or time_ns.max() >= period_ns or time_ns.min() < 0:
        return time_ns, 0
    steps = np.diff(time_ns, prepend=time_ns[0] if last_ns is None else last_ns)
    onwards = (steps < -gap_ns) & (np.abs(steps + period_ns) <= gap_ns)
    late = (steps > gap_ns) & (np.abs(steps - period_ns) <= gap_ns)
    count = turns + np.cumsum(onwards.astype(np.int64) - late.astype(np.int64))
    again = np.flatnonzero((steps < -gap_ns) & ~onwards)
    for row in again.tolist():
        count[row:] -= count[row]
    return time_ns + count * period_ns, int(count[-1])


@dataclass
class TableClock:
    """Follows the times of a table from batch to batch: its boots, and its map to UTC.

    Attributes
    ----------
    late : rows whose time lies before that of the row above, in the same boot.
    """

    fit: UtcFit = field(default_factory=UtcFit)
    boot: int = 0
    last_ns: int | None = None
    late: int = 0
    _turns: int = 0
    _next: tuple[int, int] = (0, 0)
    _counter_ns: int | None = None

    def unwrapped(self, time_ns: IntArray, turn: Turn) -> IntArray:
        """(n,) times of a counter with its turns undone; `boots` of the same rows makes them count."""
        if not turn.period_ns or not len(time_ns):
            return time_ns
        times, turns = unwrapped(time_ns, turn, self._counter_ns, self._turns)
        self._next = (int(time_ns[-1]), turns)
        return times

    def boots(self, time_ns: IntArray) -> npt.NDArray[np.int32]:
        """(n,) the boot of every row: a time that steps back by more than a second begins another."""
        if not len(time_ns):
            return np.empty(0, dtype=np.int32)
        begins = np.zeros(len(time_ns), dtype=np.int64)
        begins[back_steps(time_ns)] = 1
        if self.last_ns is not None and len(back_steps(np.array([self.last_ns, time_ns[0]]))):
            begins[0] = 1
        boots = self.boot + np.cumsum(begins)
        for boot in np.unique(boots).tolist():
            own = time_ns[boots == boot]
            self.fit.add(int(boot), own, own if own.min() > UNIX_NS else None)
        joined = time_ns if self.last_ns is None else np.append(self.last_ns, time_ns)
        self.late += int(((np.diff(joined) < 0) & (begins[-len(joined) + 1 :] == 0)).sum())
        self.boot, self.last_ns = int(boots[-1]), int(time_ns[-1])
        self._counter_ns, self._turns = self._next
        return boots.astype(np.int32)

    def clocks(self) -> tuple[ClockMap, ...]:
        """One map per boot."""
        return self.fit.clocks() or (ClockMap(0, 0, 0),)


def to_ns(values: FloatArray, unit_ns: int, origin: float = 0.0) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """(n,) numbers of a unit as ns, and which of them are times; whole numbers keep all their digits.

    Parameters
    ----------
    origin : the number that stands for 0 ns.
    """
    values = values - origin if origin else values
    known = np.isfinite(values) & (np.abs(values) < (1 << 62) / unit_ns)
    kept = np.where(known, values, 0.0)
    whole = np.floor(kept)
    return whole.astype(np.int64) * unit_ns + np.round((kept - whole) * unit_ns).astype(np.int64), known
