"""Tables as strangers write them: read as they were meant, named as lost, or asked about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flysid
from flysid.flight import Flight, field_unit
from flysid.ingest.formats.base import Limits
from tests.command import Done, call
from tests.samplelogs.mcap import json_topic, mcap_file
from tests.table_trials import always, trials

Cell = Callable[[int], str]
ROWS = 120
COUNTED = "control characters in the header"


def quarters(k: int) -> str:
    return f"{k * 0.25:.2f}"


def always_says(text: str) -> Cell:
    return lambda _: text


def table(head: str, *cells: Cell, separator: str = ",") -> str:
    """A header, and rows at 50 Hz of which the last cell counts up in quarters."""
    lines = [separator.join([*(cell(k) for cell in cells), quarters(k)]) for k in range(ROWS)]
    return "\n".join([head, *lines]) + "\n"


def ingest(folder: Path, text: str | bytes, *options: str, name: str = "t.csv") -> Done:
    """What `flysid ingest` says of a table."""
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    return call("ingest", name, "-o", "data", *options, cwd=folder)


def read_sound(folder: Path, text: str | bytes, *options: str, name: str = "t.csv") -> Flight:
    """A table that is read without a loss."""
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    words = dict(
        zip((o.removeprefix("--").replace("-", "_") for o in options[::2]), options[1::2], strict=True)
    )
    flight = flysid.read(folder / name, **words)  # type: ignore[arg-type]
    assert not flight.damage.lossy, flight.damage
    return flight


def since_start(flight: Flight) -> list[float]:
    """(n,) seconds behind the first row, over all boots."""
    times = flight["table"]["time_ns"].to_numpy()
    return list((times - times[0]) / 1e9)


AT_50_HZ = pytest.approx([0.02 * k for k in range(ROWS)], abs=2e-5)


@pytest.mark.parametrize(
    ("head", "cell", "date"),
    [
        ("Time,x", lambda k: f"{45_762.75 + 0.02 * k / 86_400:.11f}", 1_744_740_000.0),  # Excel
        ("datenum,x", lambda k: f"{739_724.25 + 0.02 * k / 86_400:.11f}", 1_744_869_600.0),  # MATLAB
        ("time,x", lambda k: f"{60_782.75 + 0.02 * k / 86_400:.11f}", 1_744_912_800.0),  # modified Julian
        ("time,x", lambda k: f"{133_500_000_000_000_000 + 200_000 * k}", 1_705_526_400.0),  # Windows
        ("time,x", lambda k: f"{3_827_757_600 + 0.02 * k:.3f}", 1_744_912_800.0),  # LabVIEW
        ("time_days,x", lambda k: f"{0.02 * k / 86_400:.12f}", 0.0),
        ("Time [h],x", lambda k: f"{0.02 * k / 3600:.10f}", 0.0),
    ],
)
def test_days_and_other_dates_are_times(tmp_path: Path, head: str, cell: Cell, date: float) -> None:
    """Serial days of Excel gave 4.3 MHz and a time constant of 3.1 us, exit 0."""
    flight = read_sound(tmp_path, table(head, cell))
    assert since_start(flight) == AT_50_HZ
    assert flight["table"]["time_ns"][0].as_py() / 1e9 == pytest.approx(date, abs=1e-4)
    clock = flight.clocks[0]
    assert (clock.utc_offset_ns is not None) == (date > 0)


@pytest.mark.parametrize(
    ("head", "cell", "said", "unit"),
    [
        (
            "time_ms,x",
            lambda k: f"{0.02 * k:.2f}",
            "'time_ms' state 'ms', which makes 0.00238 s at 50,000 Hz",
            "s",
        ),
        ("t [us],x", lambda k: f"{20 * k}", "'t' state 'us', which makes 0.00238 s at 50,000 Hz in us", "ms"),
        ("time,x", lambda k: f"{0.02 * k / 60:.9f}", "2.38 s at 50", "min"),
        ("time,x", lambda k: f"{0.02 * k / 86_400:.12f}", "2.38 s at 50", "d"),
        ("time,x", lambda k: f"{0.1 * k / 60:.9f}", "11.9 s at 10 Hz in min", "min"),
    ],
)
def test_a_rate_that_no_vehicle_logs_is_asked_about(
    tmp_path: Path, head: str, cell: Cell, said: str, unit: str
) -> None:
    done = ingest(tmp_path, table(head, cell))
    assert done.returncode == 1
    assert said in done.stderr
    assert f"--time-unit {unit}" in done.stderr
    told = read_sound(tmp_path, table(head, cell), "--time-unit", unit)
    assert since_start(told)[1] == pytest.approx(0.02 if "0.02" in said or "50" in said else 0.1, abs=1e-6)


def test_parquet_asks_about_such_rates_too(tmp_path: Path) -> None:
    days = [45_762.75 + 0.02 * k / 86_400 for k in range(ROWS)]
    pq.write_table(pa.table({"Time": days, "x": range(ROWS)}), tmp_path / "t.parquet")
    assert since_start(flysid.read(tmp_path / "t.parquet")) == AT_50_HZ
    pq.write_table(
        pa.table({"time_ms": [0.02 * k for k in range(ROWS)], "x": range(ROWS)}), tmp_path / "u.parquet"
    )
    done = call("ingest", "u.parquet", "-o", "data", cwd=tmp_path)
    assert done.returncode == 1
    assert "--time-unit s" in done.stderr


@pytest.mark.parametrize("odd", ["-", "--", "ERR", "#DIV/0!", "1.2.3"])
@pytest.mark.parametrize("rows", [7, 300])
def test_an_odd_cell_is_named_and_the_others_stay_numbers(tmp_path: Path, odd: str, rows: int) -> None:
    """One dash in seven cells made text of the column, exit 0."""
    cells = [odd if k == 3 else f"{k}.5" for k in range(rows)]
    text = "time_s,x\n" + "".join(f"{0.02 * k:.2f},{cell}\n" for k, cell in enumerate(cells))
    done = ingest(tmp_path, text)
    assert done.returncode == 3
    assert f"table.x: '{odd}' in row 4 is not a number" in done.stderr
    values = flysid.read(tmp_path / "t.csv")["table"]["x"].to_pylist()
    assert values == [None if k == 3 else k + 0.5 for k in range(rows)]


def test_all_rows_of_odd_cells_are_located(tmp_path: Path) -> None:
    """Across batches, too: the first five rows, and how many more."""
    lines = [f"{0.02 * k:.2f},{'-' if k % 1000 == 7 else k}" for k in range(9000)]
    (tmp_path / "t.csv").write_text("time_s,x\n" + "\n".join(lines) + "\n")
    damage = flysid.read(tmp_path / "t.csv", limits=Limits(batch_bytes=20_000)).damage
    assert damage.undecoded == {"table.x": 9}
    expected = "'-' in row 8 is not a number; nor in rows 1,008, 2,008, 3,008, 4,008 and 4 more"
    assert damage.reasons["table.x"] == expected


@pytest.mark.parametrize("missing", ["NaN", "nan", "#N/A", "", "N/A", "NULL", "-1.#IND"])
def test_words_for_a_missing_number_are_no_loss(tmp_path: Path, missing: str) -> None:
    text = table("time_s,y,x", lambda k: f"{0.02 * k:.2f}", lambda k: missing if k % 3 else str(k))
    values = read_sound(tmp_path, text)["table"]["y"].to_pylist()
    assert values == [None if k % 3 else k for k in range(ROWS)]


def test_infinity_is_kept(tmp_path: Path) -> None:
    text = table(
        "time_s,y,x", lambda k: f"{0.02 * k:.2f}", lambda k: "inf" if k == 5 else "-Inf" if k == 6 else str(k)
    )
    assert read_sound(tmp_path, text)["table"]["y"].to_pylist()[4:8] == [4.0, np.inf, -np.inf, 7.0]


def test_one_text_among_numbers_of_json_is_named(tmp_path: Path) -> None:
    """One text among 300 numbers made text of the whole field, exit 0; numbers in quotes are numbers."""
    odd: dict[int, object] = {17: "n/a?", 20: "20.5", 30: None}
    messages = [{"x": odd.get(k, k + 0.5), "mode": "HOVER"} for k in range(300)]
    done = ingest(tmp_path, mcap_file([json_topic("/a", {}, messages)]), name="t.mcap")
    assert done.returncode == 3
    assert "/a.x: 'n/a?' in message 18 is not a number" in done.stderr
    values = flysid.read(tmp_path / "t.mcap")["/a"]["x"].to_pylist()
    assert values == [None if k in (17, 30) else k + 0.5 for k in range(300)]


def test_one_text_among_numbers_of_mavlogdump_is_named(tmp_path: Path) -> None:
    values: list[object] = ["bad", *range(1, 40)]
    lines = [
        f'{{"meta": {{"type": "MINE", "timestamp": {100 + k / 50}}}, "data": {{"x": {value!r}}}}}'.replace(
            "'", '"'
        )
        for k, value in enumerate(values)
    ]
    done = ingest(tmp_path, "\n".join(lines) + "\n", name="t.json")
    assert done.returncode == 3
    assert "MINE.x: 'bad' in message 1 is not a number" in done.stderr
    assert flysid.read(tmp_path / "t.json")["MINE"]["x"].to_pylist() == [None, *map(float, range(1, 40))]


def test_numbers_that_parquet_holds_as_text_are_numbers(tmp_path: Path) -> None:
    cells = ["-" if k == 9 else f"{k},5" for k in range(ROWS)]
    times = [f"17.04.2025 10:00:{k // 50:02d},{k % 50 * 20:03d}" for k in range(ROWS)]
    pq.write_table(pa.table({"Zeit": times, "x": cells}), tmp_path / "t.parquet", row_group_size=50)
    done = call("ingest", "t.parquet", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3
    assert "table.x: '-' in row 10 is not a number" in done.stderr
    flight = flysid.read(tmp_path / "t.parquet")
    assert since_start(flight) == AT_50_HZ
    assert flight["table"]["x"].to_pylist() == [None if k == 9 else k + 0.5 for k in range(ROWS)]


@pytest.mark.parametrize(
    ("headers", "names", "units"),
    [
        (["q[0]", "q[1]", "q[2]"], ["q[0]", "q[1]", "q[2]"], ["", "", ""]),
        (["axisP[1]", "u [1]"], ["axisP[1]", "u"], ["", "1"]),
        (["Motor (1)", "Motor (2)"], ["Motor (1)", "Motor (2)"], ["", ""]),
        (["x[A]", "x[B]", "i [A]"], ["x[A]", "x[B]", "i"], ["", "", "A"]),
        (["gyroADC[0] (deg/s)", "gyroADC[1] (deg/s)"], ["gyroADC[0]", "gyroADC[1]"], ["deg/s", "deg/s"]),
        (["u", "u", "u_2"], ["u", "u_3", "u_2"], ["", "", ""]),
        (["boot", "time_ns", "time_ns_2"], ["boot_2", "time_ns_3", "time_ns_2"], ["", "", ""]),
    ],
)
def test_brackets_that_count_are_indices_and_names_stay_apart(
    tmp_path: Path, headers: Sequence[str], names: Sequence[str], units: Sequence[str]
) -> None:
    """q[0], q[1], q[2] became q[0], q in the unit 1, q[2]."""
    text = table(f"time_s,{','.join(headers)},x", lambda k: f"{0.02 * k:.2f}", *[str] * len(headers))
    schema = read_sound(tmp_path, text)["table"].schema
    assert schema.names[3:-1] == names
    assert [field_unit(schema.field(name)) for name in names] == units


@pytest.mark.parametrize("head", ["time\a_s,x", "\x01time_s,x", "time_s,\x1bx", "ti\x02me_s,x"])
def test_a_control_character_in_a_header_costs_itself(tmp_path: Path, head: str) -> None:
    """The header was dropped, and times became row numbers."""
    done = ingest(tmp_path, table(head, lambda k: f"{0.02 * k:.2f}"))
    assert done.returncode == 3
    flight = flysid.read(tmp_path / "t.csv")
    assert flight["table"].column_names[2:] == ["time_s", "x"]
    assert since_start(flight) == AT_50_HZ
    assert [(r.size, r.reason) for r in flight.damage.regions] == [(1, COUNTED)]


def test_facts_above_the_header_are_read(tmp_path: Path) -> None:
    """Blackbox Explorer's lines of facts counted as lost; its times state no unit."""
    facts = '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"rates","70,70,70"\n'
    names = '"loopIteration","time","axisP[0]","axisP[1]"'
    text = facts + table(names, lambda k: str(8 * k), lambda k: str(36_421_123 + 20_000 * k), str)
    flight = read_sound(tmp_path, text)
    assert since_start(flight) == AT_50_HZ
    assert flight.info["header.Product"].startswith("Blackbox")
    assert flight.info["header.rates"] == "70,70,70"


@pytest.mark.parametrize(
    ("lines", "units"),
    [
        (["time,u,x", "s,counts,-"], ["s", "counts", "-"]),
        (["time,u,x", "[s],[deg],[m/s]"], ["s", "deg", "m/s"]),
        (["time,u,x", "ms,,"], ["ms", "", ""]),
    ],
)
def test_a_line_of_units_may_hold_others_than_flysid_knows(
    tmp_path: Path, lines: Sequence[str], units: Sequence[str]
) -> None:
    step = 20 if units[0] == "ms" else 0.02
    flight = read_sound(tmp_path, table("\n".join(lines), lambda k: f"{step * k:.2f}", str))
    assert since_start(flight) == AT_50_HZ
    assert [field_unit(f) for f in flight["table"].schema][2:] == units


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("time_s,x", "{t},{x},"),  # separators at the ends of rows
        ("time_s,x,", "{t},{x}"),  # or of the header
        ('"time_s","x"', '"{n}",{t},{x}'),  # R numbers its rows, without a name
    ],
)
def test_a_header_of_another_length_is_found(tmp_path: Path, head: str, row: str) -> None:
    rows = [row.format(t=f"{0.02 * k:.2f}", x=k / 4, n=k + 1) for k in range(ROWS)]
    flight = read_sound(tmp_path, head + "\n" + "\n".join(rows) + "\n")
    assert since_start(flight) == AT_50_HZ
    assert flight["table"]["x"].to_pylist() == [k / 4 for k in range(ROWS)]


# ------------------------------------------------------------------------------------------------ times


def clock(k: int, sign: str = ".") -> str:
    """10:59:58.000 and on, at 50 Hz."""
    second = 59 * 60 + 58 + k // 50
    return f"{10 + second // 3600}:{second // 60 % 60:02d}:{second % 60:02d}{sign}{k % 50 * 20:03d}"


@pytest.mark.parametrize(
    ("head", "cells"),
    [
        ("time,x", [lambda k: f"01/20/2021 {clock(k)}"]),
        ("Zeit,x", [lambda k: f'"17.04.2025 {clock(k, ",")}"']),
        ("time,x", [lambda k: f"4/17/2025 {clock(k)} AM"]),
        ("time,x", [lambda k: f"20250417_{clock(k).replace(':', '')}"]),
        ("time,x", [lambda k: f"17-Apr-2025 {clock(k)}"]),
        ("time,x", [lambda k: f"2025-04-17T{clock(k)}+02:00"]),
        (
            "time,x",
            [
                lambda k: f"{58 + k // 50 - 60 * (k >= 100):02d}.{k % 50 * 20:03d}".join(
                    ("00:" if k < 100 else "01:", "")
                )
            ],
        ),
        ("time,x", [lambda k: f"0 days 00:00:{k // 50:02d}.{k % 50 * 20:03d}000"]),
        ("time,x", [lambda k: f"{0.02 * k:.2f} sec"]),
        ("time,x", [lambda k: f"{20 * k} ms"]),
        ("time_ms,x", [lambda k: f'"{900 + 20 * k:,}"']),
        ("time [s],x", [lambda k: f'"{0.02 * k:.2f}"'.replace(".", ",")]),
        ("Date,Time,x", [always_says("17/04/2025"), clock]),
        ("Date,Time,ms,x", [always_says("17/04/2025"), lambda k: clock(k)[:8], lambda k: clock(k)[-3:]]),
        ("Date,Time,x", [always_says("20250417"), lambda k: clock(k).replace(":", "")]),
        (
            "Year,Month,Day,Hour,Minute,Second,x",
            [
                always_says("2025"),
                always_says("4"),
                always_says("17"),
                *(lambda k, i=i: clock(k).split(":")[i] for i in range(3)),
            ],
        ),
    ],
)
def test_times_of_spreadsheets_and_phones_are_read(tmp_path: Path, head: str, cells: list[Cell]) -> None:
    """All these were said not to rise, and rows counted as 1 s each."""
    assert since_start(read_sound(tmp_path, table(head, *cells))) == AT_50_HZ


def test_dates_that_fit_two_orders_are_asked_for(tmp_path: Path) -> None:
    text = table("time,x", lambda k: f"04/05/2025 {clock(k)}")
    done = ingest(tmp_path, text)
    assert done.returncode == 1
    assert "day first (dmy) or month first (mdy)" in done.stderr
    for order, date in (("dmy", "2025-05-04"), ("mdy", "2025-04-05")):
        first = read_sound(tmp_path, text, "--date-order", order)["table"]["time_ns"][0].as_py()
        assert str(np.datetime64(first, "ns"))[:10] == date
    assert "no order of dates 'ydm'" in ingest(tmp_path, text, "--date-order", "ydm").stderr


@pytest.mark.parametrize(
    ("days", "date"),
    [
        (("04/13/2025", "04/13/2025"), "2025-04-13"),  # a value above 12
        (("05/05/2025", "05/05/2025"), "2025-05-05"),  # both orders say the same
        (("04/05/2025", "05/05/2025"), "2025-05-04"),  # the next day, not the next month
    ],
)
def test_the_order_of_dates_is_seen_where_the_data_show_it(
    tmp_path: Path, days: tuple[str, str], date: str
) -> None:
    before = "23:59:5" if days[0] != days[1] else "00:00:0"

    def cell(k: int) -> str:
        clock = f"{before}{k // 12 + 5}" if k < 60 else f"00:00:{10 + (k - 60) // 12}"
        return f"{days[k >= 60]} {clock}.{k % 12 * 80:03d}"

    flight = read_sound(tmp_path, table("time,x", cell))
    assert str(np.datetime64(flight["table"]["time_ns"][0].as_py(), "ns"))[:10] == date


@pytest.mark.parametrize("head", ["Date,Time,x", "Time,x"])
def test_midnight_is_no_second_boot(tmp_path: Path, head: str) -> None:
    """Date and Time columns over midnight gave two boots and no date."""

    def at(k: int) -> tuple[str, str]:
        second = 86_399 + k // 50
        return (
            f"{17 + second // 86_400}.04.2025",
            f"{second // 3600 % 24:02d}:{second // 60 % 60:02d}:{second % 60:02d}.{k % 50 * 20:03d}",
        )

    cells: list[Cell] = [lambda k: at(k)[0], lambda k: at(k)[1]]
    flight = read_sound(tmp_path, table(head, *cells[2 - head.count(",") :]))
    assert since_start(flight) == AT_50_HZ
    assert set(flight["table"]["boot"].to_pylist()) == {0}
    assert (flight["table"]["time_ns"][0].as_py() > 10**18) == head.startswith("Date")


@pytest.mark.parametrize(("unit", "period"), [("us", 1 << 32), ("ms", 1 << 32)])
@pytest.mark.parametrize("batch", [500, 8 << 20])
def test_counters_of_32_bits_wrap_and_restarts_do_not(
    tmp_path: Path, unit: str, period: int, batch: int
) -> None:
    step = 20_000 if unit == "us" else 20
    text = table(f"time_{unit},x", lambda k: str((period - 50 * step + k * step) % period))
    (tmp_path / "t.csv").write_text(text)
    flight = flysid.read(tmp_path / "t.csv", limits=Limits(batch_bytes=batch))
    assert since_start(flight) == AT_50_HZ
    assert set(flight["table"]["boot"].to_pylist()) == {0}
    restarted = table(f"time_{unit},x", lambda k: str((k if k < 60 else k - 60) * step + 5_000 * step))
    flight = flysid.read(_written(tmp_path, restarted))
    assert flight["table"]["boot"].to_pylist() == [0] * 60 + [1] * 60


def _written(folder: Path, text: str) -> Path:
    path = folder / "again.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("cells", "why"),
    [
        (lambda k: f"the {k}th", "its cells, such as 'the 0th', are in no format of times that flysid knows"),
        (lambda k: f"{ROWS - k}", "its values do not rise from row to row"),
        (lambda k: f"{k}" if k % 3 == 0 else "", "fewer than half of the rows have one"),
    ],
)
def test_why_a_time_is_not_used_is_said_by_cause(tmp_path: Path, cells: Cell, why: str) -> None:
    """Whatever the cause was, its values were said not to rise."""
    done = ingest(tmp_path, table("time,x", cells))
    assert done.returncode == 3
    assert why in done.stderr


def test_a_time_that_cannot_be_read_is_not_called_a_stray(tmp_path: Path) -> None:
    text = table("time,x", lambda k: "17h00" if k == 50 else f"01/20/2021 {clock(k)}")
    ingest(tmp_path, text)
    regions = flysid.read(tmp_path / "t.csv").damage.regions
    assert [region.reason for region in regions] == ["a time that is missing or cannot be read"]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["1,234.5", "2,000.25"], [1234.5, 2000.25]),
        (["1.234,5", "2.000,25"], [1234.5, 2000.25]),
        (["998", "999", "1,000", "1,001"], [998.0, 999.0, 1000.0, 1001.0]),
        (["1'234.5", "999.5"], [1234.5, 999.5]),
        (["0,125", "1,234"], [0.125, 1.234]),
        (["1.234", "2.345"], [1.234, 2.345]),
        (["12.5 V", "11.5 V"], [12.5, 11.5]),
        (["45 %", "46 %"], [45.0, 46.0]),
    ],
)
def test_numbers_are_read_as_they_are_spelled(
    tmp_path: Path, cells: list[str], expected: list[float]
) -> None:
    rows = [f"{20 * k}\t{cells[k % len(cells)]}" for k in range(ROWS)]
    flight = read_sound(tmp_path, "time_ms\ty\n" + "\n".join(rows) + "\n")
    assert flight["table"]["y"].to_pylist() == [expected[k % len(cells)] for k in range(ROWS)]


# ----------------------------------------------------------------------------------------------- drawn


def test_drawn_tables_come_back_as_they_were_meant(fresh_seed: int) -> None:
    """A failure names its seed: `tests.table_trials.draw(seed)` draws the table again."""
    outcome = trials(150, always, fresh_seed)
    assert not outcome.failures, "\n".join(outcome.failures)
    assert outcome.trials == 150
