"""Times of tables from elsewhere: what unit they are in, and where the clock starts again.

A time that states no unit has one where its size and steps leave one reading. Where they leave two, a guess
would be silently wrong by a factor of 1000, so that the caller is asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flysid.errors import FormatError, UsageError
from flysid.flight import ClockMap
from flysid.ingest.formats.common.clock import UNIX_NS, IntArray, UtcFit, back_steps
from flysid.stretch import FloatArray

TIME_UNITS_NS: Mapping[str, int] = {
    "s": 10**9,
    "ms": 10**6,
    "us": 10**3,
    "ns": 1,
    "min": 60 * 10**9,
    "h": 3600 * 10**9,
}
GUESSED = ("s", "ms", "us", "ns")  # minutes and hours are stated or told
UNUSED = (
    "named like a time, and not used as one: its values do not rise, or fewer than half of the rows have "
    "one; rows count as 1 s each"
)
MOSTLY = 0.9  # of the steps of a time go forwards, or none
MOVING = 0.25  # of them go forwards: several rows may share a time, but not many
YEARS_S = (946_684_800.0, 4_102_444_800.0)  # 2000 to 2100


def time_unit(name: str, times: FloatArray, last: float, told: str, path: str) -> tuple[str, str]:
    """The unit of a time column that states none, and how it is known.

    Parameters
    ----------
    name : of the column.
    times : (n,) its first values.
    last : its last value.
    told : what the caller says of it; "" for nothing.
    path : of the table, for the error.

    Raises
    ------
    FormatError : two units are plausible, or none. UsageError : `told` is no unit of time.
    """
    if told:
        if told not in TIME_UNITS_NS:
            raise UsageError(f"no unit of time {told!r}", hint="one of " + ", ".join(TIME_UNITS_NS))
        return told, "as told"
    span = max(float(last - times[0]), float(times.max() - times[0])) if len(times) else 0.0
    found = plausible_units(times, span)
    if len(found) == 1:
        return found[0], "by its size and steps"
    step = _step(times)
    readings = [_reading(unit, span, step) for unit in found or GUESSED]
    asked = " or ".join(f"--time-unit {unit}" for unit in found or TIME_UNITS_NS)
    count = "more than one is" if found else "none is"
    raise FormatError(
        f"the times in {name!r} state no unit, and {count} plausible: {', or '.join(readings)}",
        path=path,
        hint=f"{asked} (in Python: time_unit=), or a name that states it, such as {name}_ms",
    )


def rises(values: FloatArray, least: float = MOVING) -> bool:
    """Whether values go forwards as the time of every row does: `least` of the steps, and hardly one back."""
    steps = np.diff(values, append=np.inf)
    return len(values) > 0 and bool(np.mean(steps >= 0) >= MOSTLY and np.mean(steps > 0) >= least)


def plausible_units(
    times: FloatArray,
    span: float,
    *,
    fastest_s: float = 1.2e-4,
    slowest_s: float = 5.0,
    longest_s: float = 86_400.0,
    latest_s: float = 604_800.0,
    shortest_s: float = 1.0,
) -> list[str]:
    """The units in which rows of a flight may count: by steps, length, and dates since 1970.

    Parameters
    ----------
    times : (n,) first values. span : from the first to the last value of the table.
    fastest_s : no table is logged faster than 8 kHz, the fastest loop of flight controllers.
    slowest_s : nor flown with rows further apart.
    longest_s : nor for longer than a day.
    latest_s, shortest_s : whoever writes fractions writes seconds; other units are plausible, too, where
        these would be more than one apart, or count more than a week (GPS) and give no date, or where
        another unit makes a flight of at least this time.
    """
    step = _step(times)
    if step == 0.0:
        return ["s"]
    usual = []
    dated = []
    for unit in GUESSED:
        size = TIME_UNITS_NS[unit] / 1e9
        is_date = YEARS_S[0] <= float(np.median(times)) * size <= YEARS_S[1]
        is_fast = step * size < fastest_s and not is_date
        if is_fast or span * size > longest_s or float(np.abs(times).max()) * size > YEARS_S[1]:
            continue
        if step * size <= slowest_s:
            usual.append(unit)
        if is_date:
            dated.append(unit)
    both = [unit for unit in usual if unit in dated]
    if both:
        return both
    if (times % 1).any():
        is_clock = "s" in dated or float(np.abs(times).max()) <= latest_s
        flights = [unit for unit in usual if unit != "s" and span * TIME_UNITS_NS[unit] / 1e9 >= shortest_s]
        is_usual = step <= 1.0 and is_clock and not flights
        return ["s"] if is_usual else list(dict.fromkeys(["s", *usual]))
    return [unit for unit in GUESSED if unit in usual or unit in dated]


def _step(times: FloatArray) -> float:
    """The median step forwards; 0 where there is none."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _reading(unit: str, span: float, step: float) -> str:
    size = TIME_UNITS_NS[unit] / 1e9
    return f"{span * size:,.6g} s at {1 / (step * size):,.6g} Hz in {unit}"


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
        return boots.astype(np.int32)

    def clocks(self) -> tuple[ClockMap, ...]:
        """One map per boot."""
        return self.fit.clocks() or (ClockMap(0, 0, 0),)


def to_ns(values: FloatArray, unit_ns: int) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """(n,) numbers of a unit as ns, and which of them are times; whole numbers keep all their digits."""
    known = np.isfinite(values) & (np.abs(values) < (1 << 62) / unit_ns)
    kept = np.where(known, values, 0.0)
    whole = np.floor(kept)
    return whole.astype(np.int64) * unit_ns + np.round((kept - whole) * unit_ns).astype(np.int64), known
