"""What unit the times of a table from elsewhere are in, and from when they count.

A time that states no unit has one where its size and steps leave one reading. Where they leave two, a guess
would be silently wrong by a factor of 60 or 1000, so the caller must choose. The same holds where a stated
unit makes the rows follow faster than any vehicle logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.errors import FormatError, UsageError
from flysid.stretch import FloatArray

TIME_UNITS_NS: Mapping[str, int] = {
    "s": 10**9,
    "ms": 10**6,
    "us": 10**3,
    "ns": 1,
    "min": 60 * 10**9,
    "h": 3600 * 10**9,
    "d": 86_400 * 10**9,
    "100ns": 100,
}
TICKS = "100ns"  # of Windows: only dates are guessed to be in them
SHORT = ("s", "ms", "us", "ns")
LONG = ("min", "h", "d")  # only fractions are guessed to be in them
YEARS_S = (946_684_800.0, 2_240_611_200.0)
"""2000 to 2041, in which no two of the EPOCHS give one number two dates."""
EPOCHS: Mapping[str, tuple[float, ...]] = {  # by unit: the numbers of 1970-01-01
    "s": (0.0, 2_082_844_800.0),  # Unix; LabVIEW, since 1904
    "ms": (0.0,),
    "us": (0.0,),
    "ns": (0.0,),
    "d": (0.0, 25_569.0, 40_587.0, 719_529.0, 2_440_587.5),  # Excel, modified Julian, MATLAB, Julian days
    TICKS: (116_444_736_000_000_000.0, 621_355_968_000_000_000.0),  # Windows, since 1601; .NET, since year 1
}
FASTEST_S = 1.2e-4
"""No table is logged faster than 8 kHz, the fastest loop of flight controllers."""


@dataclass(frozen=True)
class TimeUnit:
    """How a column of numbers counts the time.

    Attributes
    ----------
    unit : a key of TIME_UNITS_NS.
    why : how it is known, in a word or two.
    origin : the number that stands for 0: that of 1970 where the column counts days from another date.
    """

    unit: str
    why: str = "stated"
    origin: float = 0.0

    @property
    def unit_ns(self) -> int:
        """Nanoseconds per unit."""
        return TIME_UNITS_NS[self.unit]


def known_unit(unit: str) -> str:
    """`unit`, where it is one of time or ""; raises UsageError else."""
    if unit and unit not in TIME_UNITS_NS:
        raise UsageError(f"no unit of time {unit!r}", hint="one of " + ", ".join(TIME_UNITS_NS))
    return unit


def time_unit(name: str, times: FloatArray, last: float, stated: str, told: str, path: str) -> TimeUnit:
    """The unit of a column of times, and how it is known.

    Parameters
    ----------
    name : of the column.
    times : (n,) its first values.
    last : its last value.
    stated : what its name or its metadata say of it; "" for nothing.
    told : what the caller says of it; "" for nothing. It is taken where nothing is stated, or where what is
        makes the rows follow too fast.
    path : of the table, for the error.

    Raises
    ------
    FormatError : two units are plausible, or none. UsageError : `told` is no unit of time.
    """
    known_unit(told)
    if stated and not is_too_fast(times, stated):
        return TimeUnit(stated, "stated", _origin(times, stated))
    if told:
        return TimeUnit(told, "as told", _origin(times, told))
    span = max(float(last - times[0]), float(times.max() - times[0])) if len(times) else 0.0
    found = [] if stated else plausible_units(times, span)
    if len(found) == 1:
        return TimeUnit(found[0], "by its size and steps", _origin(times, found[0]))
    others = [unit for unit in (*SHORT, *LONG) if unit != stated and _fits(unit, times, span)]
    asked = " or ".join(f"--time-unit {unit}" for unit in found or others or TIME_UNITS_NS)
    readings = ", or ".join(_reading(unit, span, _step(times)) for unit in found or others or SHORT)
    if stated:
        said = f"the times in {name!r} state {stated!r}, which makes {_reading(stated, span, _step(times))}: "
        said += f"faster than any vehicle logs; {readings or 'no unit'} would be plausible"
        hint = f"{asked}, or --time-unit {stated} where the rate is right (in Python: time_unit=)"
    else:
        count = "more than one is" if found else "none is"
        said = f"the times in {name!r} state no unit, and {count} plausible: {readings}"
        hint = f"{asked} (in Python: time_unit=), or a name that states it, such as {name}_ms"
    raise FormatError(said, path=path, hint=hint)


def plausible_units(
    times: FloatArray,
    span: float,
    *,
    usual_s: float = 1e-3,
    slowest_s: float = 5.0,
    longest_s: float = 86_400.0,
    hour_s: float = 3600.0,
    latest_s: float = 604_800.0,
    shortest_s: float = 1.0,
) -> list[str]:
    """The units in which rows of a flight may count: by steps, length, and dates since 1970.

    Parameters
    ----------
    times : (n,) first values. span : from the first to the last value of the table.
    usual_s : fractions that follow faster than at 1 kHz may well be minutes, hours or days.
    slowest_s : no flight is logged with rows further apart.
    longest_s : nor for longer than a day.
    hour_s : fractions that are whole milliseconds of minutes, hours or days, but not of seconds, may well be
        those, in a flight of at most this time.
    latest_s, shortest_s : whoever writes fractions writes seconds; other units are plausible, too, where
        these would be more than one apart, or count more than a week (GPS) and give no date, or where
        another unit makes a flight of at least this time.
    """
    step = _step(times)
    if step == 0.0:
        return ["s"]
    dated = [unit for unit in EPOCHS if _is_dated(times, unit) and (unit in SHORT or _is_slow(times, unit))]
    usual = [unit for unit in SHORT if _fits(unit, times, span, slowest_s, longest_s)]
    both = [unit for unit in dated if unit in usual or unit not in SHORT]
    if both:
        return both
    if not (times % 1).any():
        return [unit for unit in SHORT if unit in usual or unit in dated]
    long = [unit for unit in LONG if _fits(unit, times, span, slowest_s, longest_s)]
    if is_too_fast(times, "s"):
        return long
    even = [unit for unit in long if _is_even(times, unit) and span * seconds_in(unit) <= hour_s]
    if "s" not in dated and not _is_even(times, "s") and even:
        return ["s", *even]
    if "s" not in dated and _pace(times) < usual_s and long:
        return ["s", *long]
    is_clock = "s" in dated or float(np.abs(times).max()) <= latest_s
    flights = [unit for unit in usual if unit != "s" and span * seconds_in(unit) >= shortest_s]
    is_usual = step <= 1.0 and is_clock and not flights
    return ["s"] if is_usual else list(dict.fromkeys(["s", *usual]))


def is_too_fast(times: FloatArray, unit: str) -> bool:
    """Whether rows would follow faster than any vehicle logs; dates tell their unit however fast they do."""
    return 0.0 < _pace(times) * seconds_in(unit) < FASTEST_S and not _is_dated(times, unit)


def are_dates(times: FloatArray) -> bool:
    """Whether numbers are dates of our years, in seconds or parts of them since 1970."""
    return len(times) > 0 and any(0.0 in _dates(times, unit) for unit in SHORT)


def seconds_in(unit: str) -> float:
    """Seconds per unit."""
    return TIME_UNITS_NS[unit] / 1e9


def _fits(
    unit: str, times: FloatArray, span: float, slowest_s: float = 5.0, longest_s: float = 86_400.0
) -> bool:
    """Whether rows may follow as fast, and go on for as long, as in a flight."""
    size = seconds_in(unit)
    is_past = float(np.abs(times).max()) * size > 2 * YEARS_S[1]
    return (
        not is_too_fast(times, unit)
        and not is_past
        and span * size <= longest_s
        and _step(times) * size <= slowest_s
    )


def _is_slow(times: FloatArray, unit: str, slowest_s: float = 5.0) -> bool:
    return _step(times) * seconds_in(unit) <= slowest_s


def _is_dated(times: FloatArray, unit: str) -> bool:
    return bool(_dates(times, unit))


def _dates(times: FloatArray, unit: str) -> list[float]:
    """The numbers of 1970 that make dates of these times in our years."""
    median = float(np.median(times)) if len(times) else np.nan
    size = seconds_in(unit)
    return [at for at in EPOCHS.get(unit, ()) if YEARS_S[0] <= (median - at) * size < YEARS_S[1]]


def _origin(times: FloatArray, unit: str) -> float:
    """The number that stands for 0: that of 1970 where the times are dates, else 0."""
    return next(iter(_dates(times, unit)), 0.0)


def _is_even(times: FloatArray, unit: str, *, most_digits: int = 9, certain: float = 0.1) -> bool:
    """Whether times differ by whole milliseconds, as far as the digits that they are written with tell."""
    size_ms = seconds_in(unit) * 1e3
    digits = next((d for d in range(most_digits) if (np.round(times, d) == times).all()), most_digits)
    left = (times - times[0]) * size_ms
    slack = 1.01 * 10.0**-digits * size_ms
    return slack <= certain and bool((np.abs(left - np.round(left)) <= slack + 1e-6).all())


def _step(times: FloatArray) -> float:
    """The median step forwards; 0 where there is none."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _pace(times: FloatArray, rows: int = 20) -> float:
    """The time from row to row, over some of them: rows may come in bursts. 0 where it stands still."""
    apart = max(1, min(rows, len(times) // 2))
    over = (times[apart:] - times[:-apart]) / apart
    return float(np.median(over[over > 0])) if (over > 0).any() else 0.0


def _reading(unit: str, span: float, step: float) -> str:
    size = seconds_in(unit)
    return f"{span * size:,.6g} s at {1 / (step * size):,.6g} Hz in {unit}"
