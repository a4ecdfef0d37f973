"""Tables in random formats of times, numbers and headers: what was written must come back, or be named.

A seed draws a flight (times, values, cells that are no numbers) and how a program spells it. Nothing may be
lost, invented or mixed without a word: a table is read as it was meant, or flysid asks where two readings are
open. What it asks for is then given, and the table must be read as it was meant.
"""

from __future__ import annotations

import datetime as dt
import io
import math
import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pyarrow as pa
import pyarrow.parquet as pq

from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import detect, find_format
from soak import Outcome

RATES_HZ = (1, 4, 5, 10, 20, 25, 50, 100, 200, 250, 400)
UNITS_NS = {
    "s": 10**9,
    "ms": 10**6,
    "us": 10**3,
    "ns": 1,
    "min": 60 * 10**9,
    "h": 3600 * 10**9,
    "d": 86_400 * 10**9,
}
UNIT_WORDS = {
    "s": ("s", "sec", "seconds"),
    "ms": ("ms", "msec", "milliseconds"),
    "us": ("us", "usec", "microseconds"),
    "ns": ("ns", "nanoseconds"),
    "min": ("min", "minutes"),
    "h": ("h", "hours"),
    "d": ("d", "days"),
}
DAY_EPOCHS = {"Excel": 25_569.0, "MATLAB": 719_529.0, "modified Julian": 40_587.0, "Julian": 2_440_587.5}
MISSING = ("", "NaN", "nan", "#N/A", "NA", "null", "None")
NO_NUMBERS = ("-", "--", "ERR", "#DIV/0!", "n.a.", "?", "overflow", "12..5", "1.2.3")
MODES = (
    "HOVER",
    "LOITER",
    "RTL",
    "Position Hold",
    "\u200f\u05d4\u05d5\u05d1\u05e8",
    "\U0001f468\u200d\u2708",
)
ZONES = {"+05:30": 5.5, " CEST": 2.0, " EST": -5.0, "+02:00[Europe/Berlin]": 2.0, "-0800": -8.0}
FOREIGN = ("\u65f6\u95f4", "\u6642\u523b", "\uc2dc\uac04", "\u0412\u0440\u0435\u043c\u044f", "hora", "abc")
MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")

DATES: dict[str, Callable[[dt.datetime], str]] = {
    "iso": lambda at: f"{at:%Y-%m-%d}",
    "slashed": lambda at: f"{at.year}/{at.month}/{at.day}",
    "compact": lambda at: f"{at:%Y%m%d}",
    "named": lambda at: f"{at.day:02d}-{MONTHS[at.month - 1]}-{at.year}",
    "month": lambda at: f"{MONTHS[at.month - 1]} {at.day}, {at.year}",
    "of the year": lambda at: f"{at:%Y-%j}",
    "signs": lambda at: f"{at.year}\u5e74{at.month}\u6708{at.day}\u65e5",
}


@dataclass
class Times:
    """How a table tells its times.

    Attributes
    ----------
    headers, cells : of its columns; cells are strings, row by row.
    digits_s : to what the cells are rounded.
    utc : whether they are dates.
    open_to : options that flysid may ask for: their names and the values that are meant.
    units : of the columns, for a line of units.
    numeric : whether they are numbers, whose decimal sign is the table's.
    """

    headers: list[str]
    cells: list[list[str]]
    digits_s: float
    utc: bool
    open_to: dict[str, str] = field(default_factory=dict)
    units: list[str] = field(default_factory=list)
    numeric: bool = False


@dataclass
class Trial:
    """A table with what it means.

    Attributes
    ----------
    blob : the file.
    times_ns : of every row since 1970, or since any start where `times.utc` is False.
    values : of every column that holds numbers; None where a cell is missing or no number.
    odd : cells that are no numbers, by column.
    """

    seed: int
    suffix: str
    blob: bytes
    times: Times
    times_ns: list[int]
    values: dict[int, list[float | None]]
    odd: dict[int, int]
    names: list[str]


def numbers(rng: random.Random, when: list[dt.datetime], since_s: list[float]) -> Times:
    """Numbers of a unit that is stated, or of dates, or that has to be guessed."""
    unit = rng.choice(tuple(UNITS_NS))
    size = UNITS_NS[unit] / 1e9
    dated = rng.random() < 0.4
    epoch_s = when[0].replace(tzinfo=dt.UTC).timestamp()
    offset = 0.0
    if dated:
        offset = epoch_s / size + (rng.choice(tuple(DAY_EPOCHS.values())) if unit == "d" else 0.0)
        dated = unit not in ("min", "h")
    if not dated:
        offset = rng.choice((0.0, rng.uniform(0, 3600) / size))
    digits = {"s": 4, "ms": 1, "us": 0, "ns": 0, "min": 7, "h": 9, "d": 10}[unit]
    cells = [f"{offset + s / size:.{digits}f}" for s in since_s]
    if unit in ("us", "ns"):  # exactly, as programs write them
        start = round(epoch_s) * UNITS_NS["s"] // UNITS_NS[unit] if dated else round(offset)
        cells = [str(start + round(s / size)) for s in since_s]
    word = rng.choice(UNIT_WORDS[unit])
    header, line = rng.choice(
        ((f"time_{word}", ""), (f"Time [{word}]", ""), (f"t ({word})", ""), ("Time", word), ("time", "open"))
    )
    open_to = {"time_unit": unit} if line == "open" else {}
    precision = 0.51 * 10.0**-digits * size + 2 * math.ulp(offset) * size + 1e-9
    units = ["" if line == "open" else line]
    return Times([header], [[cell] for cell in cells], precision, dated, open_to, units, numeric=True)


def _clock(rng: random.Random, digits: int) -> tuple[Callable[[dt.datetime], str], float]:
    """How a time of day is spelled, with as many digits behind the seconds, and how finely that is."""
    sign = rng.choice((".", ".", ",", ":")) if digits == 3 else "."
    half = rng.random() < 0.25
    two = rng.random() < 0.7

    def spell(at: dt.datetime) -> str:
        hour = (at.hour - 1) % 12 + 1 if half else at.hour
        text = f"{hour:02d}" if two or not half else str(hour)
        text += f":{at.minute:02d}:{at.second:02d}"
        text += f"{sign}{at.microsecond:06d}"[: 1 + digits] if digits else ""
        return text + ((" AM" if at.hour < 12 else " PM") if half else "")

    return spell, 10.0**-digits


def _date(rng: random.Random) -> tuple[Callable[[dt.datetime], str], dict[str, str]]:
    """How a date is spelled, and the order that flysid may have to ask for."""
    kind = rng.choice((*DATES, "numbers"))
    if kind != "numbers":
        return DATES[kind], {}
    order = rng.choice(("dmy", "mdy"))
    sign = rng.choice("/.-")
    short = sign == "/" and rng.random() < 0.2

    def numbered(at: dt.datetime) -> str:
        parts = {
            "d": f"{at.day:02d}",
            "m": f"{at.month:02d}",
            "y": f"{at.year % 100:02d}" if short else f"{at.year}",
        }
        return sign.join(parts[key] for key in order)

    return numbered, {"date_order": order}


def _digits(rng: random.Random, since_s: list[float]) -> int:
    """Digits behind the seconds that tell all rows apart."""
    spacing_ms = round(since_s[1] * 1000)
    return rng.choice([d for d, step_ms in ((0, 1000), (2, 10), (3, 1), (6, 1)) if spacing_ms % step_ms == 0])


def stamps(rng: random.Random, when: list[dt.datetime], since_s: list[float]) -> Times:
    """Dates and times of day, in one column or in several."""
    split = rng.random() < 0.4
    has_ms = split and rng.random() < 0.4
    clock, digits_s = _clock(rng, 0 if has_ms else _digits(rng, since_s))
    if rng.random() < 0.1:  # digit by digit, as one number
        header = rng.choice(("time", "Timestamp", "datetime"))
        return Times(
            [header], [[f"{at:%Y%m%d%H%M%S}{at.microsecond // 1000:03d}"] for at in when], 1e-3, True
        )
    date, open_to = _date(rng)
    if split:
        pairs = [[date(at), clock(at)] for at in when]
        headers = rng.choice(
            (["Date", "Time"], ["date", "time"], ["Datum", "Zeit"], ["GPS Date", "GPS Time"])
        )
        if has_ms:
            for pair, at in zip(pairs, when, strict=True):
                pair.append(str(at.microsecond // 1000))
            return Times([*headers, "ms"], pairs, 1e-3, True, open_to)
        return Times(list(headers), pairs, digits_s, True, open_to)
    between = rng.choice((" ", " ", "T", ", ", "_"))
    zone, ahead_h = rng.choice(tuple(ZONES.items())) if rng.random() < 0.2 else ("", 0.0)
    header = rng.choice(("time", "Timestamp", "datetime", "Date Time", "UTC", "Zeitstempel", *FOREIGN))
    local = [at + dt.timedelta(hours=ahead_h) for at in when]
    return Times([header], [[date(at) + between + clock(at) + zone] for at in local], digits_s, True, open_to)


def clocks(rng: random.Random, when: list[dt.datetime], since_s: list[float]) -> Times:
    """Times of day alone, times since the start, and calendars in six columns."""
    kind = rng.choice(("day", "elapsed", "minutes", "past", "timedelta", "measured", "calendar", "packed"))
    if kind == "day":
        clock, digits_s = _clock(rng, _digits(rng, since_s))
        return Times(["Time"], [[clock(at)] for at in when], digits_s, False)
    if kind == "packed":  # as receivers write it
        names = rng.choice(("UTC", "GPS Time", "time"))
        return Times(
            [names],
            [[f"{at:%H%M%S}.{at.microsecond // 1000:03d}"] for at in when],
            1e-3,
            False,
            numeric=True,
        )
    if kind == "calendar":
        headers = ["Year", "Month", "Day", "Hour", "Minute", "Second"]
        rows = [
            [
                str(at.year),
                str(at.month),
                str(at.day),
                str(at.hour),
                str(at.minute),
                f"{at.second}.{at.microsecond // 1000:03d}",
            ]
            for at in when
        ]
        return Times(headers, rows, 1e-3, True)
    if kind == "measured":
        unit = rng.choice(("sec", "s", "ms"))
        size = 1e-3 if unit == "ms" else 1.0
        return Times(["time"], [[f"{s / size:.3f} {unit}"] for s in since_s], 1e-3 * size, False)
    cells = []
    ahead_s = (
        3600 - rng.randint(1, 20) if kind == "past" else 0
    )  # past the first hour, cells have three parts
    for s in since_s:
        whole, ms = divmod(round(s * 1000), 1000)
        whole += ahead_s
        minutes, seconds = divmod(whole, 60)
        hours, left = divmod(minutes, 60)
        cells.append(
            {
                "elapsed": f"{hours:02d}:{left:02d}:{seconds:02d}.{ms:03d}",
                "minutes": f"{minutes:02d}:{seconds:02d}.{ms:03d}",
                "past": (f"{hours}:" if hours else "") + f"{left:02d}:{seconds:02d}.{ms:03d}",
                "timedelta": f"0 days {hours:02d}:{left:02d}:{seconds:02d}.{ms:03d}000",
            }[kind]
        )
    return Times(["Time"], [[cell] for cell in cells], 1e-3, False)


@dataclass
class Spelling:
    """How a table spells its numbers."""

    decimal: str
    thousands: str
    minus: str = "-"
    lakhs: bool = False

    def number(self, value: float, digits: int) -> str:
        """A number with as many digits behind the decimal sign."""
        text = f"{value:,.{digits}f}"
        if self.lakhs:
            whole, point, rest = text.replace(",", "").partition(".")
            text = re.sub(r"(?<=\d)(?=(\d\d)*\d{3}$)", ",", whole) + point + rest
        text = text.replace(",", "T").replace(".", self.decimal)
        return text.replace("T", self.thousands).replace("-", self.minus)


@dataclass
class Names:
    """Headers of columns of numbers, their names as read, and lines of groups above them."""

    headers: list[str]
    read: list[str]
    groups: list[list[str]] = field(default_factory=list)


def _header_names(rng: random.Random, count: int) -> Names:
    kind = rng.choice(("plain", "indices", "spaced", "units", "twice", "groups", "bodies"))
    if kind == "indices":
        return Names([f"q[{k}]" for k in range(count)], [f"q[{k}]" for k in range(count)])
    if kind == "spaced":
        return Names([f"Motor ({k + 1})" for k in range(count)], [f"Motor ({k + 1})" for k in range(count)])
    if kind == "units":
        words = [rng.choice(("m", "deg", "m/s", "V")) for _ in range(count)]
        return Names([f"x{k} [{w}]" for k, w in enumerate(words)], [f"x{k}" for k in range(count)])
    if kind == "twice":
        return Names(["x"] * count, ["x", *(f"x_{k + 2}" for k in range(count - 1))])
    plain = [f"x{k}" for k in range(count)]
    if kind == "groups":
        return Names(plain, plain, [["imu", *[""] * (count - 1)]])
    if kind == "bodies":  # a line that tells nothing, and one that tells equal names apart
        bodies = [f"body {k}" for k in range(count)]
        return Names(["X"] * count, [f"{body}.X" for body in bodies], [["Rigid"] * count, bodies])
    return Names(plain, plain)


def _values(rng: random.Random, rows: int, spelling: Spelling) -> tuple[list[str], list[float | None], int]:
    """A column: its cells, what they mean, and how many are no numbers."""
    digits = rng.choice((0, 1, 2, 4))
    scale = rng.choice((1.0, 30.0, 3000.0, 2e6))
    unit = rng.choice(("", "", "", "", " V", " m/s", "%"))
    share = rng.choice((0.0, 0.0, 0.02, 0.1, 0.3))
    cells = []
    values: list[float | None] = []
    odd = 0
    for _ in range(rows):
        draw = rng.random()
        if draw < share / 2:
            cells.append(rng.choice(MISSING))
            values.append(None)
        elif draw < share:
            cells.append(rng.choice(NO_NUMBERS))
            values.append(None)
            odd += 1
        else:
            value = round(rng.uniform(-scale, scale), digits)
            cells.append(spelling.number(value, digits) + unit)
            values.append(value)
    return cells, values, odd


def draw(seed: int) -> Trial:
    """The table that a seed draws."""
    rng = random.Random(seed)
    rows = rng.randint(40, 250)
    rate = rng.choice(RATES_HZ)
    hour = 23 if rng.random() < 0.3 else rng.randint(0, 22)
    begin = dt.datetime(
        rng.randint(2015, 2026), rng.randint(1, 12), rng.randint(1, 28), hour, 59, rng.randint(0, 58)
    )
    spacing = 1000 // rate
    micros = [spacing * 1000 * k for k in range(rows)]
    when = [begin + dt.timedelta(microseconds=m) for m in micros]
    times = rng.choice((numbers, numbers, stamps, stamps, clocks))(rng, when, [m / 1e6 for m in micros])
    separator = rng.choice((",", ";", "\t", "|"))
    spelling = rng.choice(
        (Spelling(".", ""), Spelling(".", ""), Spelling(",", ""), Spelling(".", ","), Spelling(",", "."))
        if rng.random() < 0.9
        else (Spelling(",", "\u202f"), Spelling(",", "\u00a0"), Spelling(".", "\u2009"))
    )
    if rng.random() < 0.1:
        spelling = rng.choice((Spelling(".", ",", lakhs=True), Spelling(".", "", "\u2212")))
    count = rng.randint(2, 4)
    columns = [_values(rng, rows, spelling) for _ in range(count)]
    named = _header_names(rng, count)
    if times.numeric:
        times.cells = [[cell.replace(".", spelling.decimal) for cell in row] for row in times.cells]
    modes = [rng.choice(MODES) for _ in range(rows)] if rng.random() < 0.4 else None
    table = [
        [*times.cells[k], *(cells[k] for cells, _, _ in columns), *([modes[k]] if modes else [])]
        for k in range(rows)
    ]
    head = [*times.headers, *named.headers, *(["mode"] if modes else [])]
    units = [*(times.units or [""] * len(times.headers)), *([""] * count), *([""] if modes else [])]
    start = len(times.headers)
    above = [[*[""] * start, *cells, *([""] if modes else [])] for cells in named.groups]
    in_parquet = rng.random() < 0.15 and len(set(head)) == len(head) and not any(times.units)
    blob = _parquet(head, table) if in_parquet else _text(rng, [*above, head], units, table, separator)
    epoch = dt.datetime(1970, 1, 1)
    truth = [round((at - epoch) / dt.timedelta(microseconds=1)) * 1000 for at in when]
    return Trial(
        seed,
        ".parquet" if in_parquet else ".csv",
        blob,
        times,
        truth,
        {start + k: values for k, (_, values, _) in enumerate(columns)},
        {start + k: odd for k, (_, _, odd) in enumerate(columns) if odd},
        named.read,
    )


def _text(
    rng: random.Random, heads: list[list[str]], units: list[str], rows: list[list[str]], separator: str
) -> bytes:
    """The table as text: quotes where a cell needs them, or around all; ends of lines, marks and remarks."""
    everywhere = rng.random() < 0.2
    trailing = separator if rng.random() < 0.1 else ""

    def line(cells: list[str]) -> str:
        quoted = [f'"{cell}"' if everywhere or separator in cell else cell for cell in cells]
        return separator.join(quoted) + trailing

    lines = []
    if rng.random() < 0.15:
        lines += ["# written by a program", "# for a test"]
    if rng.random() < 0.15:
        lines += [f'"Product"{separator}"Logger 7"', f'"firmwareVersion"{separator}"4.4.2"']
    lines += map(line, heads)
    if any(units):
        lines.append(line(units))
    lines += [line(row) for row in rows]
    end = rng.choice(("\n", "\r\n"))
    mark = "\ufeff" if rng.random() < 0.2 else ""
    return (mark + end.join(lines) + end).encode()


def _parquet(head: list[str], rows: list[list[str]]) -> bytes:
    """The table in parquet, all cells as text, as programs write that were told no types."""
    out = io.BytesIO()
    pq.write_table(
        pa.table({name: [row[k] for row in rows] for k, name in enumerate(head)}), out, row_group_size=97
    )
    return out.getvalue()


def faults(trial: Trial) -> Iterator[str]:
    """What is lost, invented or mixed without a word when flysid reads a table."""
    try:
        flight = _read(trial, Limits())
    except FormatError as asked:
        if not trial.times.open_to or not _asks(asked, trial.times.open_to):
            yield f"refused: {asked}"
            return
        told = trial.times.open_to
        limits = Limits(time_unit=told.get("time_unit", ""), date_order=told.get("date_order", ""))
        flight = _read(trial, limits)
    table = flight["table"]
    if table.num_rows != len(trial.times_ns):
        yield f"{table.num_rows} rows of {len(trial.times_ns)}; {flight.damage}"
        return
    yield from _wrong_times(trial, flight)
    start = len(trial.times.headers)
    got = table.column_names[2 + start : 2 + start + len(trial.names)]
    if got != trial.names:
        yield f"columns {got}, not {trial.names}"
    odd = 0
    for index, values in trial.values.items():
        pairs = list(zip(table.column(2 + index).to_pylist(), values, strict=True))
        unlike = [f"row {k}: {a!r}, not {b!r}" for k, (a, b) in enumerate(pairs) if not _same(a, b)]
        if unlike:
            yield f"column {index}: {len(unlike)} cells unlike, {unlike[0]}"
        odd += trial.odd.get(index, 0)
    counted = sum(flight.damage.undecoded.values())
    if counted != odd:
        yield f"{counted} cells are named as lost, {odd} are: {dict(flight.damage.reasons)}"
    if bool(odd) != flight.damage.lossy:
        yield f"{odd} odd cells, lossy {flight.damage.lossy}: {flight.damage.regions[:2]}"


def _read(trial: Trial, limits: Limits) -> Flight:
    view = memoryview(trial.blob)
    name = f"t{trial.suffix}"
    fmt = find_format("csv") if trial.suffix == ".csv" else detect(trial.blob[:65536], name)
    return collect(view, name, fmt, limits)


def _asks(error: FormatError, open_to: dict[str, str]) -> bool:
    """Whether an error asks for an option and offers what is meant."""
    return any(f"--{name.replace('_', '-')} {value}" in (error.hint or "") for name, value in open_to.items())


def _same(got: object, meant: float | None) -> bool:
    if meant is None or not isinstance(got, float):
        return got is meant
    return math.isclose(got, meant, rel_tol=1e-12, abs_tol=1e-12)


def _wrong_times(trial: Trial, flight: Flight) -> Iterator[str]:
    table = flight["table"]
    got = table["time_ns"].to_pylist()
    origin = 0 if trial.times.utc else got[0] - trial.times_ns[0]
    slack = trial.times.digits_s * 1e9 * (1 if trial.times.utc else 2) + 2
    for k, (a, b) in enumerate(zip(got, trial.times_ns, strict=True)):
        if abs(a - origin - b) > slack:
            yield f"row {k} is at {a - origin} ns, not at {b} ({flight.info['time']})"
            return
    if len(set(table["boot"].to_pylist())) != 1:
        yield f"{len(set(table['boot'].to_pylist()))} boots"


def always() -> bool:
    return True


def trials(count: int, goes_on: Callable[[], bool], first_seed: int = 0) -> Outcome:
    """Draw and judge tables, one seed each."""
    outcome = Outcome("text and parquet")
    for seed in range(first_seed, first_seed + count):
        if not goes_on():
            break
        trial = draw(seed)
        with outcome.trial():
            outcome.failures += [f"seed {seed}: {fault}" for fault in faults(trial)]
        outcome.keep(len(trial.times_ns), len(trial.times_ns))
    return outcome
