"""Which columns of a table tell the time of its rows: one of numbers or stamps, or several together.

time_s    datetime    Date + Time    Date + Time + ms    secs + nsecs    year + month + ... + second
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.errors import FormatError
from flysid.ingest.formats.common.arrow_arrays import numeric, strings
from flysid.ingest.formats.common.clock import SECOND_NS, BoolArray, IntArray
from flysid.ingest.formats.common.stamps import (
    CALENDAR,
    CALENDAR_SIGNS,
    CLOCKED,
    ORDERS,
    PACKED,
    Form,
    forms_of,
    is_date,
    known_order,
    packed_form_of,
)
from flysid.ingest.formats.common.table_columns import (
    TimeName,
    fraction_beside,
    time_name,
)
from flysid.ingest.formats.common.table_kinds import Column, array_of, nameless_numbers, values_of
from flysid.ingest.formats.common.table_numbers import (
    MISSING,
    MOSTLY,
    PLAIN,
    Style,
    floats,
)
from flysid.ingest.formats.common.table_times import COUNTERS, MOVING, NO_TURN, Turn, rises, to_ns, unwrapped
from flysid.ingest.formats.common.time_units import (
    TICKS,
    TIME_UNITS_NS,
    TimeUnit,
    are_dates,
    known_unit,
    plausible_units,
    time_unit,
)
from flysid.stretch import FloatArray

WHOLE = r"^\d{1,19}$"  # dates in nanoseconds and in ticks have more digits than a float
_CALENDAR_NAMES = (
    frozenset({"year", "yyyy"}),
    frozenset({"month", "mon"}),
    frozenset({"day", "dayofmonth"}),
    frozenset({"hour", "hours", "hr"}),
    frozenset({"minute", "minutes", "min"}),
    frozenset({"second", "seconds", "sec"}),
)
_UNITS_BESIDE = {"loopiteration": "us"}  # Blackbox Explorer names no unit, and this column beside the time
_BY_SIZE = TimeName("", is_plain=False)
_DAY_WORDS = re.compile("date|datum|day|fecha|data")
_LETTERS = re.compile(r"[^a-z]")


@dataclass(frozen=True)
class TimeColumn:
    """Which columns tell the time.

    Attributes
    ----------
    parts : their numbers; several are joined with the characters of `glue` to stamps.
    forms : how stamps are spelled; several where dates may be meant in two orders; () for numbers.
    style : how numbers are spelled.
    unit : of numbers, as stated; "" where nothing states it.
    counted : how numbers count the time, once that is known.
    first : (n,) the first values; of stamps in seconds.
    fraction : the column that holds what is missing of a second, in `fraction_ns`; -1 where none does.
    """

    parts: tuple[int, ...]
    name: str
    glue: str = ""
    forms: tuple[Form, ...] = ()
    style: Style = PLAIN
    unit: str = ""
    counted: TimeUnit | None = None
    first: FloatArray = field(default_factory=lambda: np.empty(0), compare=False)
    fraction: int = -1
    fraction_ns: int = 1
    why: str = "stated"

    @property
    def has_one_unit(self) -> bool:
        """Whether nobody needs to be asked for the unit of its numbers."""
        is_stated = bool(self.forms or self.unit or self.fraction >= 0)
        return is_stated or len(plausible_units(self.first, float(np.ptp(self.first)))) == 1

    @property
    def is_exact(self) -> bool:
        """Whether its numbers are read as whole ones, which have more digits than a float."""
        return self.counted is not None and self.counted.unit in ("ns", TICKS)

    @property
    def is_packed(self) -> bool:
        """Whether the digits of a number are read as those of a date and a clock."""
        return len(self.forms) == 1 and self.forms[0] in PACKED

    @property
    def columns(self) -> tuple[int, ...]:
        """All columns that tell of the time."""
        return self.parts if self.fraction < 0 else (*self.parts, self.fraction)

    @property
    def turn(self) -> Turn:
        """When its times begin anew."""
        if self.forms:
            return self.forms[0].turn
        return NO_TURN if self.counted is None else turn_of(self.counted)

    @property
    def source(self) -> str:
        """In words, for the stream's `time_source`."""
        if self.forms:
            return f"{self.name}: {self.forms[0].words}"
        assert self.counted is not None
        return f"{self.name} in {self.counted.unit}, {self.why}"

    def resolved(self, last: float, unit: str, order: str, path: str) -> TimeColumn:
        """With one form or unit.

        Parameters
        ----------
        last : the last value of the table.
        unit, order : what the caller says of units of time and of the order of dates; "" for nothing.

        Raises
        ------
        FormatError : several are plausible, or none. UsageError : `unit` or `order` is not known.
        """
        known_order(order)
        known_unit(unit)
        if not self.forms:
            counted = TimeUnit("s", self.why) if self.fraction >= 0 else None
            counted = counted or time_unit(self.name, self.first, last, self.unit, unit, path)
            return replace(self, counted=counted, why=self.why if self.fraction >= 0 else counted.why)
        if unit and self.is_packed:
            return replace(self, forms=(), counted=TimeUnit(unit, "as told"))
        if len(self.forms) == 1:
            return self
        told = [form for form in self.forms if form.order == order]
        if not told:
            readings = " or ".join(f"{ORDERS[form.order]} ({form.order})" for form in self.forms)
            raise FormatError(
                f"the dates in {self.name!r} may be meant {readings}, and nothing in them tells which",
                path=path,
                hint=" or ".join(f"--date-order {form.order}" for form in self.forms)
                + " (in Python: date_order=)",
            )
        return replace(self, forms=tuple(told))

    def read(self, text: Callable[[int], pa.Array]) -> tuple[IntArray, BoolArray]:
        """(n,) times in ns, and which rows have one; turns of a counter are not undone.

        Parameters
        ----------
        text : gives the cells of a column, without blanks around them.
        """
        if self.forms:
            time_ns, known = self.forms[0].read(joined([text(part) for part in self.parts], self.glue))
        else:
            time_ns, known = self._count(text(self.parts[0]))
        if self.fraction < 0:
            return time_ns, known
        return self.with_fraction(time_ns, known, floats(text(self.fraction), self.style)[0])

    def with_fraction(
        self, time_ns: IntArray, known: BoolArray, beside: pa.Array
    ) -> tuple[IntArray, BoolArray]:
        """(n,) whole seconds with the fractions of a column of their own, and which of them are times."""
        fraction, told = to_ns(array_of(beside).astype(np.float64), self.fraction_ns)
        return time_ns + fraction, known & told

    def _count(self, text: pa.Array) -> tuple[IntArray, BoolArray]:
        assert self.counted is not None
        time_ns, known = self.count(floats(text, self.style)[0])
        if self.is_exact:
            exact = known & array_of(pc.match_substring_regex(text, WHOLE)).astype(bool)
            whole = text.filter(numeric(exact)).cast(pa.int64())
            time_ns[exact] = self.count_whole(whole)
        return time_ns, known

    def count(self, values: pa.Array) -> tuple[IntArray, BoolArray]:
        """(n,) numbers as ns, and which of them are times."""
        assert self.counted is not None
        return to_ns(array_of(values).astype(np.float64), self.counted.unit_ns, self.counted.origin)

    def count_whole(self, values: pa.Array) -> IntArray:
        """(n,) whole numbers as ns, exactly."""
        assert self.counted is not None
        return (array_of(values).astype(np.int64) - int(self.counted.origin)) * self.counted.unit_ns


def turn_of(counted: TimeUnit) -> Turn:
    """When a counter of this unit begins anew; dates do not."""
    return NO_TURN if counted.origin else COUNTERS.get(counted.unit, NO_TURN)


def joined(texts: Sequence[pa.Array], glue: str) -> pa.Array:
    """Cells of several columns as one text, with a character of `glue` between each."""
    whole = texts[0]
    for sign, text in zip(glue, texts[1:], strict=True):
        whole = pc.binary_join_element_wise(whole, text, sign)
    return whole


# ----------------------------------------------------------------------------------------- finding


def find_time(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> TimeColumn | None:
    """The columns that tell most rows their time, at least half, and rise; the plainest of such.

    Rows without a time are counted as lost. Numbering all rows for their sake would invent times. Stamps in
    text need no name.
    """
    best: tuple[int, int, float, bool] = (0, 0, 0.0, False)
    found = None
    for time, says in _candidates(columns, rows):
        if not rises(time.first, MOVING if says is None or says.is_plain else MOSTLY):
            continue
        rank = 0 if says is None else 1 + says.is_plain
        moving = float(np.mean(np.diff(time.first) > 0)) if len(time.first) > 1 else 0.0
        merits = (len(time.first), rank, moving, time.has_one_unit)
        if merits > best:
            best, found = merits, time
    return found if 2 * best[0] >= len(rows) else None


def unused_times(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> dict[str, str]:
    """Columns that are called a time, where none tells it: why each does not."""
    found = {}
    for index, column in enumerate(columns):
        says = time_name(column.name)
        if says is None or not says.is_plain:
            continue
        told = [row[index] for row in rows if row[index] not in MISSING]
        read = [time.first for time, _ in _candidates(columns, rows) if index in time.parts]
        if 2 * len(told) < len(rows):
            why = "fewer than half of the rows have one"
        elif read and (np.diff(read[0]) >= 0).all():
            count = len(read[0]) / len(np.unique(read[0]))
            why = f"it stands still while rows follow: about {count:.0f} rows share each of its values"
        elif read:
            why = "its values do not rise from row to row"
        else:
            why = f"its cells, such as {told[0][:40]!r}, are in no format of times that flysid knows"
        found[column.name] = f"named like a time, and not used as one: {why}; rows count as 1 s each"
    return found


def _candidates(
    columns: Sequence[Column], rows: Sequence[Sequence[str]]
) -> Iterator[tuple[TimeColumn, TimeName | None]]:
    """Columns that may tell the time, with what their names say of it; several together come first."""
    names = [column.name for column in columns]
    plain = TimeName("", is_plain=True)
    days = [i for i, column in enumerate(columns) if _holds_dates(column, rows, i)]
    calendar = _calendar(names)
    if calendar:
        yield from (
            (t, plain) for t in _stamps(rows, calendar, CALENDAR_SIGNS, "-".join(names[i] for i in calendar))
        )
    for index, column in enumerate(columns):
        says = time_name(column.name)
        for day in days if says is not None or column.is_text else ():
            if day != index:
                name = f"{names[day]} {column.name}"
                for time in _stamps(rows, (day, index), " ", name):
                    yield from ((each, plain) for each in _with_fractions(time, columns, rows))
    fractions = {name: beside for name in names if (beside := fraction_beside(name, names))}
    dated = [i for i in range(len(columns)) if _counts_from_1970(columns, rows, i)]
    fractions |= {names[i]: names[i + 1] for i in dated if _has_nanoseconds_behind(columns, rows, i)}
    for index, column in enumerate(columns):
        says = time_name(column.name) or (_BY_SIZE if index in dated else None)
        if column.name in fractions.values() or (says is None and not column.is_text):
            continue
        if column.is_text:
            for time in _stamps(rows, (index,), "", column.name):
                yield from ((each, says) for each in _with_fractions(time, columns, rows))
        elif index not in days:
            if (packed := _packed(rows, index, column, says)) is not None:
                yield packed, says
            other = names.index(fractions[column.name]) if column.name in fractions else -1
            yield _numbers(column, index, other, says, columns, rows), says


def _counts_from_1970(columns: Sequence[Column], rows: Sequence[Sequence[str]], index: int) -> bool:
    """Whether a column without a name holds numbers that are dates in one of the usual units."""
    return are_dates(nameless_numbers(columns, rows, index))


def _has_nanoseconds_behind(columns: Sequence[Column], rows: Sequence[Sequence[str]], index: int) -> bool:
    """Whether a nameless column of nanoseconds follows whole seconds, as `ros2 topic echo --csv` has it."""
    whole, rest = (nameless_numbers(columns, rows, i) for i in (index, index + 1))
    is_fraction = bool(((rest >= 0) & (rest < SECOND_NS) & (rest % 1 == 0)).all()) and bool(rest.any())
    is_still = bool((np.diff(whole) == 0).any()) and not (whole % 1).any()
    return is_fraction and is_still and rises(whole + rest / SECOND_NS, MOSTLY)


def _holds_dates(column: Column, rows: Sequence[Sequence[str]], index: int) -> bool:
    """Whether a column's cells are dates without a time of day; 20250417 only under such a name."""
    if not column.is_text and not _DAY_WORDS.search(column.name.lower()):
        return False
    told = [row[index] for row in rows if row[index] not in MISSING]
    return bool(told) and sum(map(is_date, told)) >= MOSTLY * len(told)


def _calendar(names: Sequence[str]) -> tuple[int, ...]:
    """The columns of year, month, day, hour, minute and second; () where one is missing."""
    bare = [_LETTERS.sub("", name.lower()) for name in names]
    found = [next((i for i, name in enumerate(bare) if name in called), -1) for called in _CALENDAR_NAMES]
    return tuple(found) if min(found) >= 0 else ()


def _stamps(
    rows: Sequence[Sequence[str]], parts: tuple[int, ...], glue: str, name: str
) -> Iterator[TimeColumn]:
    """The time that stamps in these columns tell, if they are stamps."""
    told = [[row[i] for i in parts] for row in rows if not any(row[i] in MISSING for i in parts)]
    cells = [_glued(each, glue) for each in told]
    is_calendar = glue == CALENDAR_SIGNS
    forms = (CALENDAR,) if is_calendar and cells else forms_of(cells, MOSTLY)
    if not forms or (len(parts) > 1 and forms[0].kind == CLOCKED):
        return
    time_ns, known = forms[0].read(strings(cells))
    if known.sum() >= MOSTLY * len(cells):
        first = unwrapped(time_ns[known], forms[0].turn)[0] / SECOND_NS
        yield TimeColumn(parts, name, glue, forms, first=first)


def _packed(
    rows: Sequence[Sequence[str]], index: int, column: Column, says: TimeName | None
) -> TimeColumn | None:
    """The time that a column's numbers tell digit by digit: 20240228235958500, or 235958.50."""
    if column.unit or (says is not None and says.unit):
        return None
    cells = [row[index] for row in rows if row[index] not in MISSING]
    form = packed_form_of(cells)
    if form is None:
        return None
    first = unwrapped(form.read(strings(cells))[0], form.turn)[0] / SECOND_NS
    return TimeColumn((index,), column.name, "", (form,), column.style, first=first)


def _glued(cells: Sequence[str], glue: str) -> str:
    return cells[0] + "".join(sign + cell for sign, cell in zip(glue, cells[1:], strict=True))


def _with_fractions(
    time: TimeColumn, columns: Sequence[Column], rows: Sequence[Sequence[str]]
) -> Iterator[TimeColumn]:
    """Stamps of whole seconds with the column that holds what is missing of them; those alone as well."""
    for index, column in enumerate(columns):
        says = time_name(column.name)
        unit = says.unit if says else ""
        if index in time.parts or column.is_text or unit not in ("ms", "us", "ns") or (time.first % 1).any():
            continue
        whole = [row for row in rows if not any(row[i] in MISSING for i in (*time.parts, index))]
        values = values_of(whole, index, column.style)
        unit_ns = TIME_UNITS_NS[unit]
        if len(values) != len(time.first) or not ((values >= 0) & (values * unit_ns < SECOND_NS)).all():
            continue
        first = time.first + values * (unit_ns / SECOND_NS)
        if rises(first, MOSTLY) and (np.diff(first) > 0).sum() > (np.diff(time.first) > 0).sum():
            name = f"{time.name} {column.name}"
            yield replace(
                time, name=name, first=first, fraction=index, fraction_ns=unit_ns, style=column.style
            )
    yield time


def _numbers(
    column: Column,
    index: int,
    other: int,
    says: TimeName | None,
    columns: Sequence[Column],
    rows: Sequence[Sequence[str]],
) -> TimeColumn:
    """The time that numbers tell; `other` is the column of their nanoseconds, or -1."""
    values = values_of(rows, index, column.style)
    if other >= 0:
        whole = values + values_of(rows, other, column.style) / SECOND_NS
        return TimeColumn(
            (index,),
            column.name,
            style=column.style,
            unit="s",
            first=whole[np.isfinite(whole)],
            fraction=other,
            why=f"with {columns[other].name}",
        )
    beside = (_UNITS_BESIDE.get(_LETTERS.sub("", each.name.lower()), "") for each in columns)
    stated = column.unit if column.unit in TIME_UNITS_NS else says.unit if says else ""
    return TimeColumn(
        (index,),
        column.name,
        style=column.style,
        unit=stated or next((unit for unit in beside if unit), ""),
        first=values[np.isfinite(values)],
    )
