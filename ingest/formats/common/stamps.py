"""Dates and times of day in text, as spreadsheets, phones, ground stations and MATLAB write them.

    2021-01-20T10:11:32.332Z   01/20/2021 10:11:32 AM   17.04.2025 17:00:08,060   20250417_170008.060
    17-Apr-2025 17:00:08.060   Thu Apr 17 17:00:08 2025   17:00:08.060   00:07.980   0 days 00:00:07.98

A column has one form. Where all its cells may stand for dates in two orders, both forms are returned: the
caller asks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.errors import UsageError
from flysid.ingest.formats.common.arrow_arrays import strings
from flysid.ingest.formats.common.clock import LEAP_NS, SECOND_NS, BoolArray, IntArray
from flysid.ingest.formats.common.table_times import NO_TURN, Turn

DATED = "date and time of day"
CLOCKED = "time of day"
HOUR_NS = 3600 * SECOND_NS
DAY_NS = 24 * HOUR_NS
ORDERS: Mapping[str, str] = {"dmy": "day first", "mdy": "month first", "ymd": "year first"}
_MONTHS = {
    **{
        name: k
        for k, name in enumerate(
            ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"], 1
        )
    },
    **{"m\u00e4r": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12, "gen": 1, "ene": 1},
}
_FIRST_YEAR, _LAST_YEAR = 1970, 2261  # what 64 bits of nanoseconds since 1970 hold
_FRACTION = r"(?:[.,:](?P<f>\d{1,9})\d*)?"
_NOON = r"(?: ?(?P<ap>[AaPp])\.?[Mm]\.?)?"
_ZONES: Mapping[str, str] = {  # names that mean one zone only: CST, IST and BST mean several
    **{"WET": "+00", "WEST": "+01", "CET": "+01", "CEST": "+02", "MEZ": "+01", "MESZ": "+02"},
    **{"EET": "+02", "EEST": "+03", "MSK": "+03", "JST": "+09", "KST": "+09", "AEST": "+10", "AEDT": "+11"},
    **{"NZST": "+12", "NZDT": "+13", "EST": "-05", "EDT": "-04", "CDT": "-05", "MST": "-07", "MDT": "-06"},
    **{"PST": "-08", "PDT": "-07"},
}
_ZONE = (
    rf" ?(?:(?P<z>[+-]\d\d(?::?\d\d)?|{'|'.join(_ZONES)})|Z|z|UTC|GMT)?"
    r"(?:\[[\w/+-]+\])?"  # Java names the zone behind its offset
)
_CLOCK = rf"(?P<H>\d{{1,2}}):(?P<M>\d\d)(?::(?P<S>\d\d?){_FRACTION})?{_NOON}{_ZONE}"
_COMPACT_CLOCK = rf"(?P<H>\d\d)(?P<M>\d\d)(?P<S>\d\d)(?:[.,](?P<f>\d{{1,9}})\d*)?{_ZONE}"
_DASHED_CLOCK = r"(?P<H>\d\d)[-.](?P<M>\d\d)[-.](?P<S>\d\d)(?:[.,](?P<f>\d{1,9}))?"
_DAY_CLOCKS = (_CLOCK, _COMPACT_CLOCK, _DASHED_CLOCK)
_PLAIN_CLOCK = rf"(?P<H>\d\d?):(?P<M>\d\d):(?P<S>\d\d){_FRACTION}"
_BETWEEN = r"(?:[Tt_-]|,? +|,)"
_WEEKDAY = r"(?:[A-Za-z]{2,9}\.?,? +)?"
_MONTH = r"(?P<mon>[A-Za-z\x{e4}]{3,9})"
_YEAR = r"(?P<y>\d{4}|\d\d)"
_YEAR_FIRST = r"(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)"
_YEAR_LAST = rf"(?P<a>\d\d?)[-/.](?P<b>\d\d?)[-/.]{_YEAR}"
_DATES: Mapping[str, str] = {
    "": _YEAR_FIRST,
    "compact": r"(?P<y>(?:19|20)\d\d)(?P<m>0[1-9]|1[0-2])(?P<d>[0-2]\d|3[01])",
    "named": rf"{_WEEKDAY}(?P<d>\d\d?)\.?[-/. ]{_MONTH}\.?(?:[-/. ]|, ?){_YEAR}",
    "signs": r"(?P<y>\d{4}) ?[\x{5e74}\x{b144}] ?(?P<m>\d\d?) ?[\x{6708}\x{c6d4}] ?"
    r"(?P<d>\d\d?) ?[\x{65e5}\x{c77c}]",  # Chinese, Japanese, Korean
    "month": rf"{_WEEKDAY}{_MONTH}\.? +(?P<d>\d\d?),? +{_YEAR}",
    "of the year": r"(?P<y>\d{4})[-/:](?P<j>\d{3})",
}
_DAYS_AND_CLOCK = r"(?P<D>\d+)(?: days?,? ?|\.)(?P<H>\d{1,2}):(?P<M>\d\d):(?P<S>\d\d)(?:[.,](?P<f>\d{1,9}))?"
_SINCE = (
    rf"(?P<H>\d{{1,4}}):(?P<M>\d\d):(?P<S>\d\d){_FRACTION}{_NOON}{_ZONE}",
    r"(?P<H>\d{1,2}):(?P<M>\d\d) ?(?P<ap>[AaPp])\.?[Mm]\.?",
    r"(?:(?P<H>\d{1,4}):)?(?P<M>\d{1,4}):(?P<S>\d\d)[.,](?P<f>\d{1,9})\d*",  # hours once there are any
    _DAYS_AND_CLOCK,
    r"(?:P(?P<D>\d+)D)?P?T(?:(?P<H>\d+)H)?(?:(?P<M>\d+)M)?(?P<S>\d+)(?:[.,](?P<f>\d{1,9})\d*)?S",
    r"(?:(?P<H>\d+) ?h(?:ours?|rs?)? ?)?(?P<M>\d+) ?m(?:in)? ?(?P<S>\d+)(?:[.,](?P<f>\d{1,9}))? ?s(?:ec)?",
)
_ISO = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d{1,9})?)?(Z|[+-]\d\d(:?\d\d)?)?")
_ZONE_AT_END = r"(Z|[+-]\d\d(:?\d\d)?)$"
_MAY_BE_ONE = re.compile(r"(?=.*\d.*\d)[\w\u00e4+-][\w\u00e4 :;.,/+-]{3,40}(\[[\w/+-]+\])?$")


def known_order(order: str) -> str:
    """`order`, where it is one of dates or ""; raises UsageError else."""
    if order and order not in ORDERS:
        raise UsageError(f"no order of dates {order!r}", hint="one of " + ", ".join(ORDERS))
    return order


def _for_python(shape: str) -> str:
    """A shape for RE2, which names letters by \\x{...}, as Python's `re` reads it."""
    return re.sub(r"\\x\{([0-9a-f]+)\}", lambda match: chr(int(match[1], 16)), shape)


@dataclass(frozen=True)
class Form:
    """How a column spells its times.

    Attributes
    ----------
    kind : DATED or CLOCKED.
    shape : a regular expression with a group for every part; for RE2 and Python alike.
    order : of a date in numbers whose year stands last: a key of ORDERS; "" where the shape says it.
    """

    kind: str
    shape: str
    order: str = ""

    @property
    def words(self) -> str:
        """In words, for a stream's `time_source`."""
        return f"{self.kind}, {ORDERS[self.order]}" if self.order else self.kind

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """For single cells."""
        return re.compile(f"^(?:{_for_python(self.shape)})$")

    @property
    def turn(self) -> Turn:
        """When its times begin anew: at midnight, or after an hour where hours may be left out."""
        if self.kind == DATED or "(?P<D>" in self.shape:
            return NO_TURN
        period_ns = HOUR_NS if "(?:(?P<H>" in self.shape else DAY_NS
        return Turn(period_ns, max(LEAP_NS, period_ns // 24))

    def read(self, text: pa.Array) -> tuple[IntArray, BoolArray]:
        """(n,) nanoseconds since 1970 (UTC where no zone is named), or since midnight, and which are times.

        Parameters
        ----------
        text : (n,) strings without blanks around them.
        """
        if self is ISO:
            return _read_iso(text)
        found = pc.extract_regex(text, f"^(?:{self.shape})$")
        known = _bools(found.is_valid())
        parts = {found.type.field(i).name: found.field(i) for i in range(found.type.num_fields)}
        shown_ns, sound = _clock_ns(parts)
        time_ns = shown_ns - _zone_ns(parts)
        if self.kind == DATED:
            days, exist = _days(parts, self.order)
            sound &= exist & (shown_ns < DAY_NS)
            return np.where(known & exist, days * DAY_NS + time_ns, 0), known & sound
        return np.where(known, time_ns, 0), known & sound


ISO = Form(DATED, _ISO.pattern.replace("(", "(?:"))
_DATED = (
    *(Form(DATED, f"{date}{_BETWEEN}{clock}") for date in _DATES.values() for clock in _DAY_CLOCKS),
    Form(DATED, rf"{_WEEKDAY}{_MONTH} +(?P<d>\d\d?) +{_PLAIN_CLOCK} +{_YEAR}"),
    Form(DATED, rf"{_CLOCK}{_BETWEEN}{_YEAR_FIRST}"),
)
CALENDAR = Form(
    DATED,
    r"(?P<y>\d{4})(?:\.0*)?-(?P<m>\d\d?)(?:\.0*)?-(?P<d>\d\d?)(?:\.0*)? "
    r"(?P<H>\d\d?)(?:\.0*)?:(?P<M>\d\d?)(?:\.0*)?:(?P<S>\d\d?)(?:\.(?P<f>\d{1,9})\d*|\.)?",
)
"""Year, month, day, hour, minute and second from columns of their own, joined with `CALENDAR_SIGNS`."""
CALENDAR_SIGNS = "-- ::"
_OPEN = tuple(
    tuple(Form(DATED, shape, order) for order in ORDERS)
    for shape in (f"{_YEAR_LAST}{_BETWEEN}{_CLOCK}", f"{_YEAR_LAST}{_BETWEEN}{_COMPACT_CLOCK}")
)
_CLOCKS = tuple(Form(CLOCKED, shape) for shape in _SINCE)
_DATES_ALONE = tuple(re.compile(f"^{_for_python(d)}$") for d in (*_DATES.values(), _YEAR_LAST))
_PACKED_CLOCK = r"(?P<H>[01]\d|2[0-3])(?P<M>[0-5]\d)(?P<S>[0-5]\d)"
_PACKED_DATE = Form(DATED, rf"{_DATES['compact']}{_PACKED_CLOCK}(?:\.?(?P<f>\d{{1,9}})\d*)?")
_PACKED_TIME = Form(CLOCKED, rf"{_PACKED_CLOCK}(?:[.,](?P<f>\d{{1,9}})\d*)?")
PACKED = (_PACKED_DATE, _PACKED_TIME)


def is_stamp(cell: str) -> bool:
    """Whether a cell is a time in any form, or a date."""
    if not _MAY_BE_ONE.match(cell):
        return False
    return is_date(cell) or any(form.pattern.match(cell) for form in _every_form())


def is_date(cell: str) -> bool:
    """Whether a cell is a date without a time of day."""
    return any(shape.match(cell) for shape in _DATES_ALONE)


def forms_of(cells: Sequence[str], share: float) -> tuple[Form, ...]:
    """The form that at least a `share` of cells have; () for none, several where dates fit in two orders.

    An order is taken where the days and months of all cells exist in no other, where the times rise, or stay
    within a day, in no other, or where all orders say the same.

    Examples
    --------
    >>> [form.order for form in forms_of(["01/20/2021 10:11:32", "01/20/2021 10:11:33"], 0.9)]
    ['mdy']
    """
    least = max(1.0, share * len(cells))
    if not cells or sum(bool(_MAY_BE_ONE.match(cell)) for cell in cells) < least:
        return ()
    text = strings(cells)
    fitting: list[tuple[int, Form]] = []
    for form in (ISO, *_DATED, *_CLOCKS):
        count = _matches(form, cells)
        if count >= least and form.read(text)[1].sum() >= least:
            fitting.append((count, form))
            if count == len(cells):
                break
    if fitting:  # the one of most cells: minutes and seconds get hours within a table
        return (max(fitting, key=lambda each: each[0])[1],)
    for orders in _OPEN:
        if _matches(orders[0], cells) >= least:
            return _possible(orders, text, least)
    return ()


def packed_form_of(cells: Sequence[str], *, slowest_s: float = 5.0) -> Form | None:
    """The form of numbers whose digits are a date and a clock, or, as GPS receivers write it, a clock alone.

    101132 may be a count, too: digits are a clock's where they begin with a zero, have a fraction, or leap
    from 59 seconds to the next minute. Where they are seconds after all, cells beyond 59 seconds are named as
    no times; taken for seconds, a clock would gain 40 s a minute without a word.

    Parameters
    ----------
    slowest_s : no flight is logged with rows further apart.

    Examples
    --------
    >>> packed_form_of(["20240228235959980", "20240229000000020"]).kind
    'date and time of day'
    >>> packed_form_of(["101159.5", "101200.0"]).kind, packed_form_of(["101132", "101133"])
    ('time of day', None)
    """
    if cells and all(map(_PACKED_DATE.pattern.match, cells)):
        return _PACKED_DATE
    if not cells or not all(map(_PACKED_TIME.pattern.match, cells)):
        return None
    shown_s = _PACKED_TIME.read(strings(cells))[0] / SECOND_NS
    values = np.array([float(cell.replace(",", ".")) for cell in cells])
    leaps = bool(np.ptp(values - shown_s) >= 1.0)
    is_clock = leaps or any(cell.startswith("0") or not cell.isdecimal() for cell in cells)
    is_slow = len(cells) > 1 and float(np.median(np.diff(shown_s))) > slowest_s
    return _PACKED_TIME if is_clock and not is_slow else None


def _possible(orders: Sequence[Form], text: pa.Array, least: float) -> tuple[Form, ...]:
    """The orders in which dates may be meant."""
    read = [(form, *form.read(text)) for form in orders]
    most = max(int(known.sum()) for _, _, known in read)
    fits = [each for each in read if int(each[2].sum()) == most] if most >= least else []
    if len(fits) > 1 and all(np.array_equal(fits[0][1], time_ns) for _, time_ns, _ in fits):
        return (fits[0][0],)
    rising = [each for each in fits if (np.diff(each[1][each[2]]) >= 0).all()] or fits
    short = [each for each in rising if np.ptp(each[1][each[2]]) <= DAY_NS]
    return tuple(form for form, _, _ in short or rising)


def _every_form() -> Iterator[Form]:
    yield from (ISO, *_DATED, *_CLOCKS)
    yield from (orders[0] for orders in _OPEN)


def _matches(form: Form, cells: Sequence[str]) -> int:
    return sum(bool(form.pattern.match(cell)) for cell in cells)


# ------------------------------------------------------------------------------------------- parts


def _number(parts: Mapping[str, pa.Array], name: str) -> IntArray | int:
    """(n,) a part as a number, 0 where it is left out; 0 for all where the form has none."""
    if name not in parts:
        return 0
    text = parts[name]
    filled = pc.if_else(pc.equal(pc.fill_null(text, ""), ""), "0", text)
    return _whole(pc.fill_null(filled, "0"))


def _whole(text: pa.Array) -> IntArray:
    return np.asarray(text.cast(pa.int64()).to_numpy(zero_copy_only=False), dtype=np.int64)


def _bools(array: pa.Array) -> BoolArray:
    return np.asarray(array.to_numpy(zero_copy_only=False), dtype=bool)


def _clock_ns(parts: Mapping[str, pa.Array]) -> tuple[IntArray, BoolArray]:
    """(n,) nanoseconds of days, hours, minutes and seconds, and which are such as clocks show."""
    count = len(next(iter(parts.values())))
    days, hours, minutes, seconds = (_number(parts, name) for name in "DHMS")
    sound = np.ones(count, dtype=bool)
    sound &= np.asarray(seconds) < 60
    if "H" in parts:
        has_hours = _bools(pc.not_equal(pc.fill_null(parts["H"], ""), ""))
        sound &= (np.asarray(minutes) < 60) | ~has_hours
    if "ap" in parts:
        hours, fits = _with_noon(np.asarray(hours), parts["ap"])
        sound &= fits
    whole = ((np.asarray(days) * 24 + hours) * 60 + minutes) * 60 + seconds
    time_ns = whole * SECOND_NS + _fraction_ns(parts)
    return np.broadcast_to(time_ns, (count,)).astype(np.int64), sound


def _with_noon(hours: IntArray, half: pa.Array) -> tuple[IntArray, BoolArray]:
    """Hours of 24 from those of 12 before and after noon; which of them such a clock shows."""
    mark = pc.utf8_lower(pc.fill_null(half, ""))
    after = _bools(pc.equal(mark, "p"))
    marked = after | _bools(pc.equal(mark, "a"))
    return np.where(marked, hours % 12 + 12 * after, hours), ~marked | ((hours >= 1) & (hours <= 12))


def _fraction_ns(parts: Mapping[str, pa.Array]) -> IntArray | int:
    """(n,) nanoseconds of the digits behind the seconds."""
    if "f" not in parts:
        return 0
    digits = pc.utf8_rpad(pc.fill_null(parts["f"], ""), 9, "0")
    return _whole(digits)


def _zone_ns(parts: Mapping[str, pa.Array]) -> IntArray | int:
    """(n,) how far a clock is ahead of UTC."""
    if "z" not in parts:
        return 0
    text = pc.replace_substring(pc.fill_null(parts["z"], ""), ":", "")
    for name in pc.unique(pc.filter(text, pc.match_substring_regex(text, "^[A-Z]"))).to_pylist():
        text = pc.replace_substring_regex(text, f"^{name}$", _ZONES[str(name)])
    full = pc.if_else(pc.equal(text, ""), "+0000", pc.utf8_rpad(text, 5, "0"))
    number = _whole(pc.utf8_ltrim(full, "+"))
    size = np.abs(number)
    ahead_ns: IntArray = np.sign(number) * (size // 100 * 60 + size % 100) * 60 * SECOND_NS
    return ahead_ns


def _days(parts: Mapping[str, pa.Array], order: str) -> tuple[IntArray, BoolArray]:
    """(n,) days since 1970 of dates, and which of them exist."""
    named = {"y": _number(parts, "y"), "m": _number(parts, "m"), "d": _number(parts, "d")}
    if order:
        written = (_number(parts, "a"), _number(parts, "b"), named["y"])
        named = dict(zip(order, written, strict=True))
    elif "mon" in parts:
        named["m"] = _months(parts["mon"])
    if "j" in parts:
        return _days_of_year(np.asarray(named["y"], dtype=np.int64), np.asarray(_number(parts, "j")))
    year, month, day = (np.asarray(named[key], dtype=np.int64) for key in "ymd")
    exist = (day < 100) | (order != "ymd")  # four digits are a year, which would stand last
    year = np.where(year < 100, year + 2000, year)
    exist &= (month >= 1) & (month <= 12) & (day >= 1) & (year >= _FIRST_YEAR) & (year <= _LAST_YEAR)
    months = np.where(exist, (year - 1970) * 12 + month - 1, 0).astype("datetime64[M]")
    first = months.astype("datetime64[D]").astype(np.int64)
    length = (months + 1).astype("datetime64[D]").astype(np.int64) - first
    return first + day - 1, exist & (day <= length)


def _days_of_year(year: IntArray, number: IntArray) -> tuple[IntArray, BoolArray]:
    """(n,) days since 1970 of the days of years, 1 for the first, and which of them exist."""
    exist = (year >= _FIRST_YEAR) & (year <= _LAST_YEAR) & (number >= 1)
    years = np.where(exist, year - 1970, 0).astype("datetime64[Y]")
    first = years.astype("datetime64[D]").astype(np.int64)
    length = (years + 1).astype("datetime64[D]").astype(np.int64) - first
    return first + number - 1, exist & (number <= length)


def _months(names: pa.Array) -> IntArray:
    """(n,) numbers of months by the first letters of their names; 0 for other words."""
    short: Sequence[str | None] = pc.utf8_slice_codeunits(pc.utf8_lower(names), 0, 3).to_pylist()
    return np.array([_MONTHS.get(name or "", 0) for name in short], dtype=np.int64)


# --------------------------------------------------------------------------------------------- ISO


def _read_iso(text: pa.Array) -> tuple[IntArray, BoolArray]:
    """ISO 8601, which Arrow reads at once."""
    shaped = pc.match_substring_regex(text, f"^{_ISO.pattern}$")
    zoned = pc.match_substring_regex(text, _ZONE_AT_END)
    found = np.zeros(len(text), dtype=np.int64)
    known = np.zeros(len(text), dtype=bool)
    for mine, type_ in ((pc.invert(zoned), pa.timestamp("ns")), (zoned, pa.timestamp("ns", "UTC"))):
        chosen = pc.if_else(pc.and_(shaped, mine), text, pa.scalar(None, pa.string()))
        stamps = _cast_stamps(chosen, type_)
        hit = _bools(stamps.is_valid())
        found[hit] = stamps.drop_null().to_numpy(zero_copy_only=False)
        known |= hit
    return found, known


def _cast_stamps(text: pa.Array, kind: pa.DataType) -> pa.Array:
    """Stamps as ns; null where there is no such day or hour, for which Arrow refuses a whole array."""
    try:
        return text.cast(kind).cast(pa.int64())
    except pa.ArrowInvalid:
        if len(text) == 1:
            return pa.nulls(1, pa.int64())
    half = len(text) // 2
    return pa.concat_arrays([_cast_stamps(text[:half], kind), _cast_stamps(text[half:], kind)])
