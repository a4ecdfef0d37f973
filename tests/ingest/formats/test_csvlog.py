"""Tables in text: what spreadsheets, MATLAB, PlotJuggler, ulog2csv and ground stations write."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import FormatError, UsageError
from flysid.flight import Flight, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import all_formats, detect


def read(text: str | bytes, **limits: Any) -> Flight:
    blob = text.encode() if isinstance(text, str) else text
    return collect(memoryview(blob), "t.csv", all_formats()["csv"], Limits(**limits))


def column(flight: Flight, name: str) -> list[object]:
    values: list[object] = flight["table"][name].to_pylist()
    return values


def seconds(flight: Flight) -> list[float]:
    return [ns / 1e9 for ns in flight["table"]["time_ns"].to_pylist()]


STAMPS = [1_700_000_000_000_000_000 + 20_000_000 * k for k in range(12)]


@pytest.mark.parametrize(
    ("header", "shape", "separator"),
    [
        ("%time,field.a,field.b\n", "{t},{a},{b}\n", ","),  # rostopic echo -p
        ("#timestamp [ns],w_x [rad s^-1],a_y [m s^-2]\n", "{t},{a},{b}\n", ","),  # EuRoC
        ("# made by hand\n# t,x,y\n", "{s:.18e},{a:.18e},{b:.18e}\n", ","),  # numpy.savetxt
        ("# t x y\n", "{s:.18e} {a:.18e} {b:.18e}\n", r"\s+"),
        ("# a trajectory\n# timestamp tx ty\n", "{e:.2f} {a} {b}\n", r"\s+"),  # TUM
        ("% t\tx\ty\n% s\tdeg\tm\n", "{s:.2f}\t{a}\t{b}\n", "\t"),
        ("   time     x       y\n", "{s:8.2f}  {a:8.3f} {b:9.3f} \n", r"\s+"),
        ("epoch,x,y\n", "{e:.2f},{a},{b}\n", ","),
        ("epoch,x,y\n", "{ms},{a},{b}\n", ","),
        ("Unix Time,x,y\n", "{us},{a},{b}\n", ","),
        ("rosbagTimestamp,x,y\n", "{t},{a},{b}\n", ","),
        ("SimTime,x,y\n", "{s:.2f},{a},{b}\n", ","),
        ("Time (msec),x,y\n", "{m},{a},{b}\n", ","),
        ("time(millisecond),datetime(utc),x\n", "{m},2023-11-14 22:13:20,{a}\n", ","),  # AirData
        ("sep=;\nZeit [s];Winkel [\u00b0];y\n", "{s:.2f};{a};{b}\n", ";"),
        (",x,y\n", "2023-11-14 22:13:20.{h:02d},{a},{b}\n", ","),  # pandas, an index without a name
        ("stamp.secs,stamp.nsecs,y\n", "{sec},{nsec},{b}\n", ","),
        ("sec,nanosec,y\n", "{sec},{nsec},{b}\n", ","),
        ("'time','x','y'\n", "{s:.2f},{a},{b}\n", ","),
    ],
)
@pytest.mark.parametrize("wrong", [False, True])
def test_headers_as_programs_write_them(header: str, shape: str, separator: str, wrong: bool) -> None:
    """Times and values are those that pandas reads; a row that is none costs itself only."""
    rows = [
        shape.format(
            **{"t": ns, "us": ns // 1000, "ms": ns // 10**6, "m": ns % 10**9 // 10**6, "s": ns % 10**9 / 1e9},
            **{"e": ns / 1e9, "h": ns % 10**9 // 10**7, "sec": ns // 10**9, "nsec": ns % 10**9},
            **{"a": k * 1.5 + 100, "b": 0.25 * k},
        )
        for k, ns in enumerate(STAMPS)
    ]
    if wrong:
        rows.insert(7, "?\n")
    flight = read(header + "".join(rows))
    times = np.array(flight["table"]["time_ns"].to_pylist())
    assert (times - times[0]).tolist() == pytest.approx([20_000_000 * k for k in range(12)])
    assert flight.damage.bytes_skipped == 2 * wrong
    plain = StringIO("".join(row for row in rows if row != "?\n"))
    table = pd.read_csv(plain, sep=separator, header=None, skipinitialspace=True)
    ours = flight["table"].drop_columns(["time_ns", "boot"])
    assert not {"c1", "c2", "c3"} & set(ours.column_names[1:])
    for k in range(1, 3):
        assert ours[ours.column_names[k]].to_pylist() == table[k].tolist()


def test_units_of_headers_in_comments() -> None:
    text = "# time, roll, h\n# s, deg, m\n0.0, 1, 2\n0.1, 3, 4\n0.2, 5, 6\n"
    schema = read(text)["table"].schema
    assert [(field.name, field_unit(field)) for field in schema][2:] == [
        ("time", "s"),
        ("roll", "deg"),
        ("h", "m"),
    ]


@pytest.mark.parametrize("header", ["time,x\n", "sec,x\n", "date,x\n"])
def test_a_time_that_stands_still_in_most_rows_is_said(header: str) -> None:
    """Whole seconds in a log at 10 Hz are not the rows' times."""
    cell = "2023-05-01 10:00:{:02d}" if header.startswith("date") else "{}"
    flight = read(header + "".join(f"{cell.format(k // 10)},{k}\n" for k in range(60)))
    assert flight.damage.undecoded == {f"table.{header[:-3]}": 60}


def test_a_name_with_a_time_in_it_yields_to_the_time_itself() -> None:
    rows = "".join(f"{k * 3},{k / 50},{k}\n" for k in range(30))
    assert seconds(read("gps time,time_s,x\n" + rows)) == pytest.approx([k / 50 for k in range(30)])
    idle = "".join(f"{k // 9},{k}\n" for k in range(30))
    assert not read("idle_time,x\n" + idle).damage.lossy  # no time of rows, and none that is missed


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("time,u,y\n0.0,1,2\n0.1,3,4\n", ["u", "y"]),
        ("time;u;y\n0,0;1,5;2\n0,1;3,5;4\n", ["u", "y"]),
        ("time\tu\ty\n0.0\t1\t2\n0.1\t3\t4\n", ["u", "y"]),
        ("\ufefftime,u,y\r\n0.0,1,2\r\n0.1,3,4\r\n", ["u", "y"]),
        ("# log of today\n% in the garden\n\ntime,u,y\n0.0,1,2\n0.1,3,4\n", ["u", "y"]),
        ('"time","u","y"\n"0.0","1","2"\n"0.1","3","4"\n', ["u", "y"]),
        ("time_s,u [deg],y (m/s)\n0.0,1,2\n0.1,3,4\n", ["u", "y"]),
        ("time,u,y\ns,deg,m/s\n0.0,1,2\n0.1,3,4\n", ["u", "y"]),
        ("Tempo_s,u,y\n0.0,+1.,2e0\n0.1,3,4\n", ["u", "y"]),
        ("date time,u,y\n1970-01-01 00:00:00.0,1,2\n1970-01-01 00:00:00.1,3,4\n", ["u", "y"]),
    ],
)
def test_the_usual_dialects_give_the_same_table(text: str, names: list[str]) -> None:
    flight = read(text)
    assert seconds(flight) == pytest.approx([0.0, 0.1])
    assert not flight.damage.lossy
    assert column(flight, names[1]) == [2.0, 4.0]
    assert column(flight, names[0]) in ([1.0, 3.0], [1.5, 3.5])


def test_units_come_from_brackets_or_from_a_line_of_their_own() -> None:
    for text in ("time_s,u [deg],y (m/s)\n0,1,2\n1,3,4\n", "time,u,y\ns,deg,m/s\n0,1,2\n1,3,4\n"):
        schema = read(text)["table"].schema
        assert [field_unit(schema.field(n)) for n in ("u", "y")] == ["deg", "m/s"]
    assert "q [furlong]" in read("time_s,u [deg],q [furlong]\n0,1,2\n1,3,4\n")["table"].column_names


@pytest.mark.parametrize(
    ("times", "name", "expected"),
    [
        (["100", "104", "108"], "time_ms", [0.1, 0.104, 0.108]),
        (["5000000", "5010000", "5020000"], "timestamp", [5.0, 5.01, 5.02]),  # ulog2csv
        (["5000000", "5004000", "5008000"], "TimeUS", [5.0, 5.004, 5.008]),
        (["0", "20", "40"], "t", [0.0, 0.02, 0.04]),
        (["0", "1", "2"], "t.sec", [0.0, 1.0, 2.0]),
        (["0", "0.5", "1"], "t", [0.0, 0.5, 1.0]),
        (["1700000000", "1700000001", "1700000002"], "t", [0.0, 1.0, 2.0]),
        (["1700000000250.5", "1700000000500.5", "1700000000750.5"], "t", [0.2505, 0.5005, 0.7505]),
        (["1700000000.25", "1700000000.5", "1700000000.75"], "__time", [0.25, 0.5, 0.75]),  # PlotJuggler
        (["1700000000250", "1700000000500", "1700000000750"], "time", [0.25, 0.5, 0.75]),
        (["1700000000250000001", "1700000000500000002", "1700000000750000003"], "time", [0.25, 0.5, 0.75]),
        (["2023-11-14T22:13:20.25Z", "2023-11-14T22:13:20.5Z"], "utc", [0.25, 0.5]),
    ],
)
def test_the_unit_of_a_time_is_stated_or_seen(times: list[str], name: str, expected: list[float]) -> None:
    rows = "".join(f"{t},1.5,2\n" for t in times)
    flight = read(f"{name},u,y\n{rows}")
    since = 1.7e9 if seconds(flight)[0] > 1e9 else 0.0
    assert seconds(flight) == pytest.approx([since + e for e in expected], abs=1e-6)
    if times[0].endswith("1"):
        assert flight["table"]["time_ns"].to_pylist() == [int(t) for t in times]


@pytest.mark.parametrize(
    ("step", "count", "readings", "units"),
    [
        (1, 100, ("99 s at 1 Hz in s", "0.099 s at 1,000 Hz in ms"), ("s", "ms")),
        (2, 100, ("198 s at 0.5 Hz in s", "0.198 s at 500 Hz in ms"), ("s", "ms")),
        (1000, 100, ("99 s at 1 Hz in ms", "0.099 s at 1,000 Hz in us"), ("ms", "us")),
        (4000, 3000, ("11,996 s at 0.25 Hz in ms", "11.996 s at 250 Hz in us"), ("ms", "us")),
        (16.75, 100, ("1,658.25 s at 0.0597015 Hz in s", "1.65825 s at 59.7015 Hz in ms"), ("s", "ms")),
    ],
)
def test_a_time_that_may_be_in_two_units_is_asked_for(
    step: float, count: int, readings: tuple[str, str], units: tuple[str, str]
) -> None:
    text = "t,u\n" + "".join(f"{i * step:g},{i % 7}.5\n" for i in range(count))
    with pytest.raises(FormatError) as raised:
        read(text)
    assert all(reading in raised.value.message for reading in readings)
    for unit in units:
        assert f"--time-unit {unit}" in raised.value.hint
        size = {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
        told = read(text, time_unit=unit)
        assert seconds(told)[-1] == pytest.approx((count - 1) * step * size)
        assert told.info["time"] == f"t in {unit}, as told"


@pytest.mark.parametrize(
    ("first", "step", "rows"),
    [(0.25, 2.5, 40), (4_111_811.25, 0.5, 40), (0.0, 0.5, 2500), (0.0, 0.125, 9000)],
)
def test_fractions_that_may_well_be_milliseconds_are_asked_for(first: float, step: float, rows: int) -> None:
    """Before, 2.5, 5.0, 7.5 of a log at 400 Hz counted as seconds; so did an uptime of an hour in ms."""
    text = "time,x\n" + "".join(f"{first + step * k},{k}\n" for k in range(rows))
    with pytest.raises(FormatError, match="more than one is plausible") as told:
        read(text)
    assert told.value.hint is not None
    assert told.value.hint.startswith("--time-unit s or --time-unit ms")
    assert seconds(read(text, time_unit="ms"))[-1] == pytest.approx((first + step * (rows - 1)) / 1e3)


def test_dates_tell_the_unit_however_fast_rows_follow() -> None:
    """At 10 kHz they were read as milliseconds of a year that no clock has, and every row was lost."""
    times = [1_707_286_951_554_538 + 100 * k for k in range(9)]
    flight = read("timestamp,x\n" + "".join(f"{us},{k}\n" for k, us in enumerate(times)))
    assert flight["table"]["time_ns"].to_pylist() == [1000 * us for us in times]


@pytest.mark.parametrize(("step", "rows"), [(0.5, 40), (0.2, 900), (0.1, 20_000)])
def test_fractions_are_seconds_else(step: float, rows: int) -> None:
    text = "time,x\n" + "".join(f"{step * k:.6f},{k}\n" for k in range(rows))
    assert seconds(read(text))[-1] == pytest.approx(step * (rows - 1))


def test_a_unit_that_is_stated_outweighs_what_is_told() -> None:
    assert seconds(read("time_ms,u\n0,1\n1,2\n", time_unit="s")) == [0.0, 0.001]
    with pytest.raises(UsageError, match="no unit of time 'day'"):
        read("time,u\n0,1\n1,2\n", time_unit="day")


def test_a_table_longer_than_a_day_in_one_unit_is_in_the_other() -> None:
    text = "timestamp,u\n" + "".join(f"{i * 4000},{i % 7}.5\n" for i in range(25_000))
    assert seconds(read(text))[-1] == pytest.approx(24_999 * 0.004)


@pytest.mark.parametrize("wrong", ["", "nan", "abc", "99999999999999999999"])
def test_long_stamps_keep_their_digits_beside_a_bad_cell(wrong: str) -> None:
    stamps = [1_700_000_000_000_000_001 + 20_000_003 * i for i in range(20)]
    rows = [f"{stamp},{i}.5\n" for i, stamp in enumerate(stamps)]
    rows.insert(12, f"{wrong},1.5\n")
    flight = read("time_ns,u\n" + "".join(rows))
    assert flight["table"]["time_ns"].to_pylist() == stamps
    assert flight.damage.region_count == 1


def test_microseconds_since_1970_keep_their_digits() -> None:
    stamps = [1_700_000_000_000_001 + 20_003 * i for i in range(20)]
    flight = read("time_us,u\n" + "".join(f"{stamp},1.5\n" for stamp in stamps))
    assert flight["table"]["time_ns"].to_pylist() == [1000 * stamp for stamp in stamps]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("pitch_deg", "deg"),
        ("vx_m_s", "m/s"),
        ("alt_m", "m"),
        ("rate_radps", "rad/s"),
        ("p_rad_s", "rad/s"),
        ("roll rate_deg_s", "deg/s"),
        ("ax_m_s2", "m/s/s"),
        ("pwm_us", "us"),
        ("battery_V", "V"),
        ("throttle_pct", "%"),
        ("vx_ms", ""),  # milliseconds, or metres per second?
        ("m", ""),
        ("cmd", ""),
        ("rpm", ""),
        ("pos_north", ""),
    ],
)
def test_a_name_that_ends_with_a_unit_states_it(name: str, unit: str) -> None:
    schema = read(f"time_s,{name}\n0,1\n1,3\n")["table"].schema
    assert field_unit(schema.field(name)) == unit


def test_a_table_without_a_time_has_numbered_rows() -> None:
    flight = read("u,y\n1.5,2\n3,4\n5,6\n")
    assert seconds(flight) == [0.0, 1.0, 2.0]
    assert flight["table"].schema.metadata[b"time_source"] == b"row number"
    skipped = read("u,y\n1.5,2\n3,4,5\n5,6\n")
    assert seconds(skipped) == [0.0, 2.0]  # the time of what is lost goes by


@pytest.mark.parametrize(
    ("name", "cells", "expected"),
    [
        (
            "time",
            [f"9:59:{k:02d}.25" for k in range(58, 60)] + ["10:00:00", "10:00:00.5"],
            [0, 1, 1.75, 2.25],
        ),
        ("time_min", ["0.5", "0.55", "0.6", "0.65"], [0, 3, 6, 9]),
        ("time [h]", ["1", "1.001", "1.002", "1.003"], [0, 3.6, 7.2, 10.8]),
    ],
)
def test_times_of_day_minutes_and_hours_are_times(name: str, cells: list[str], expected: list[float]) -> None:
    flight = read(f"{name},x\n" + "".join(f"{cell},{k}\n" for k, cell in enumerate(cells)))
    first = seconds(flight)[0]
    assert [s - first for s in seconds(flight)] == pytest.approx(expected)
    assert not flight.damage.lossy


@pytest.mark.parametrize("cells", [["5", "4", "3", "2", "1"], ["noon", "noon", "one", "one", "two"]])
def test_a_time_that_cannot_be_used_is_said(cells: list[str]) -> None:
    """Before, rows of a log at 100 Hz counted as 1 s each without a word."""
    flight = read("time,x\n" + "".join(f"{cell},{k}\n" for k, cell in enumerate(cells)))
    assert flight.damage.undecoded == {"table.time": 5}
    assert "rows count as 1 s each" in flight.damage.reasons["table.time"]


@pytest.mark.parametrize("cell", ["1e400", "-1e999", "9" * 400])
def test_a_number_that_no_float_holds_is_not_infinite(cell: str) -> None:
    flight = read("time_s,x\n" + "".join(f"{k},{cell if k == 7 else k}\n" for k in range(20)))
    assert column(flight, "x")[7] is None
    assert flight.damage.undecoded == {"table.x": 1}


@pytest.mark.parametrize("missing", [1, 3, 9, 10])
def test_rows_without_a_time_are_lost_not_numbered(missing: int) -> None:
    cells = ["" if k in range(1, 1 + missing) else f"{k / 50}" for k in range(20)]
    flight = read("time_s,x\n" + "".join(f"{cell},{k}\n" for k, cell in enumerate(cells)))
    assert seconds(flight) == pytest.approx([float(cell) for cell in cells if cell])
    assert flight.damage.bytes_skipped == sum(len(f",{k}\n") for k in range(1, 1 + missing))


def test_the_fuller_time_is_taken() -> None:
    rows = "".join(f"{k / 10 if k % 3 else ''},{k / 50},{k}\n" for k in range(30))
    flight = read("gps time,time_s,x\n" + rows)
    assert seconds(flight) == pytest.approx([k / 50 for k in range(30)])
    assert not flight.damage.lossy


def test_a_table_without_a_header_has_numbered_columns() -> None:
    assert read("1.5,2\n3,4\n5,6\n")["table"].column_names[2:] == ["c1", "c2"]


def test_missing_is_missing_and_nonsense_is_counted() -> None:
    rows = "".join(f"{i / 10},{i},{i}\n" for i in range(20))
    flight = read(f"time,u,y\n{rows}2.0,,nan\n2.1,abc,5\n2.2,7\n2.3,8,9\n")
    assert column(flight, "u")[20:] == [None, None, 8.0]
    assert column(flight, "y")[20:] == [None, 5.0, 9.0]
    assert flight.damage.undecoded == {"table.u": 1}
    assert flight.damage.reasons == {"table.u": "'abc' in row 22 is not a number"}
    start = len(f"time,u,y\n{rows}2.0,,nan\n2.1,abc,5\n")
    assert [(r.start, r.end) for r in flight.damage.regions] == [(start, start + len("2.2,7\n"))]


def test_losses_are_in_the_order_of_the_file() -> None:
    rows = [f"{i / 10},{i},{i}\n" for i in range(20)]
    rows[5] = "0.5,1\n"
    rows[9] = "nine,1,1\n"
    rows[12] = "1\n"
    flight = read("time,u,y\n" + "".join(rows))
    starts = [r.start for r in flight.damage.regions]
    assert len(starts) == 3
    assert starts == sorted(starts)
    assert flight.rows == 17


def test_a_time_that_fits_no_neighbour_costs_its_row() -> None:
    rows = [f"{i / 10},{i},{i}\n" for i in range(20)]
    rows[10] = "10000,10,10\n"
    flight = read("time,u,y\n" + "".join(rows))
    assert flight.rows == 19
    assert flight.damage.region_count == 1


def test_a_clock_that_starts_again_begins_a_boot() -> None:
    half = "".join(f"{10 + i / 10},{i},{i}\n" for i in range(20))
    assert read(f"time,u,y\n{half}{half}")["table"]["boot"].to_pylist() == [0] * 20 + [1] * 20


def test_separators_in_quotes_and_words_are_kept() -> None:
    flight = read('time,mode,y\n0.0,"POS, HOLD",1\n0.1, LOITER ,2\n')
    assert column(flight, "mode") == ["POS, HOLD", "LOITER"]


def test_dates_that_do_not_exist_cost_their_row() -> None:
    rows = "".join(f"2024-02-01 00:00:{i:02d},{i}\n" for i in range(12))
    flight = read(f"date,u\n{rows}2024-02-31 00:00:12,1\n2024-02-01 00:00:13,1\n")
    assert flight.rows == 13
    assert flight.damage.region_count == 1


GPS = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n"


@pytest.mark.parametrize(
    "text",
    [
        "hello\nworld\n",
        "a,b\n",
        "a,b\nc,d\ne,f\n",
        "1 2 and\n3 4 not\n",
        "\n",
        GPS * 40,
        "[1, 2, 3]\n" * 40,
        '{"a": 1, "b": 2,\n"c": 3, "d": 4}\n' * 40,
        '{\n"x":\n[\n1,2\n,\n3,4\n]\n}\n',
    ],
)
def test_what_is_no_table_of_numbers_is_refused(text: str) -> None:
    with pytest.raises(FormatError):
        read(text)
    with pytest.raises(FormatError):
        detect(text.encode(), "log.csv")


def test_lines_that_look_like_a_table_in_a_binary_file_are_none() -> None:
    noise = np.random.default_rng(3).integers(1, 256, 5000, dtype=np.uint8).tobytes()
    with pytest.raises(FormatError):
        read(noise + b"\n1,2,3\n4,5,6\n" + noise + b"\n")


def test_other_text_logs_keep_their_reader() -> None:
    head = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n" + b"ATT, 1, 2, 3, 4, 5\n" * 9
    assert detect(head, "log.csv").name == "dataflash_text"


cells = st.one_of(st.floats(allow_nan=False, allow_infinity=False, width=64), st.none())
rows_of_cells = st.lists(st.tuples(cells, cells), min_size=2, max_size=40)


@settings(max_examples=60, deadline=None)
@given(rows_of_cells, st.sampled_from([",", ";", "\t"]), st.integers(20, 5000))
def test_what_pandas_writes_comes_back_to_the_last_digit(
    rows: list[tuple[float | None, float | None]], separator: str, batch: int
) -> None:
    frame = pd.DataFrame(rows, columns=["u", "y"], dtype=float)
    frame.insert(0, "time_s", np.arange(len(rows)) / 8)
    flight = read(frame.to_csv(index=False, sep=separator), batch_bytes=batch)
    assert not flight.damage.lossy
    got = flight["table"].to_pandas()
    pd.testing.assert_frame_equal(got[["time_s", "u", "y"]], frame, check_exact=True)


def test_cell_by_cell_says_what_the_fast_way_says() -> None:
    rng = np.random.default_rng(1)
    frame = pd.DataFrame({"time_s": np.arange(500) / 50, "u": rng.standard_normal(500), "mode": "HOVER"})
    text = frame.to_csv(index=False)
    assert read(text)["table"].equals(read(text.replace(",HOVER", ',"HOVER"'))["table"])


@pytest.mark.parametrize(
    "damage",
    [(48, b"\x02"), (79, b"\x08"), (59, b"\0\0"), (48, b"\xff"), (34, b'"')],
    ids=["line end", "first row", "cells", "not UTF-8", "quote"],
)
def test_damage_above_the_second_row_is_counted(damage: tuple[int, bytes]) -> None:
    from tests.samplelogs import csv as sample

    blob = sample.build()
    (at, raw) = damage
    whole, flight = (
        collect(memoryview(b), "a.csv", all_formats()["csv"], Limits())
        for b in (blob, blob[:at] + raw + blob[at + len(raw) :])
    )
    assert not whole.damage.lossy
    assert flight.rows <= whole.rows
    assert flight.damage.lossy


def test_a_table_without_a_header_keeps_its_first_row_where_a_column_holds_words() -> None:
    flight = read("".join(f"{k / 10},{k % 3},HOVER\n" for k in range(60)))
    assert flight["table"].column_names[2:] == ["c1", "c2", "c3"]
    assert flight.rows == 60


@pytest.mark.parametrize("ahead", [b"\xff" * 3, b"\xff" * 700, b"\x01\x02"])
def test_rubbish_ahead_of_a_header_is_counted_and_the_header_is_read(ahead: bytes) -> None:
    """The header was lost with it, and the times became row numbers."""
    from tests.samplelogs import csv as sample

    blob = sample.build()
    flight = collect(memoryview(ahead + blob), "a.csv", all_formats()["csv"], Limits())
    assert flight.damage.bytes_skipped == len(ahead)
    assert flight.rows == 150
    assert seconds(flight)[:2] == pytest.approx([100.0, 100.02])
    assert flight["table"].column_names[2:4] == ["time_s", "pitch_cmd"]


def test_a_first_row_of_ones_holds_no_units(tmp_path: Path) -> None:
    """It was read as one: "1 cannot become ns"."""
    path = tmp_path / "ones.csv"
    path.write_text("time_s,u,y\n" + "".join(f"{i},1,1\n" for i in range(1, 30)))
    table = next(iter(flysid.read(path).tables.values()))
    assert table.num_rows == 29
    assert table["u"].to_pylist() == [1.0] * 29


def test_rows_that_are_late_are_counted() -> None:
    order = [*range(10), 3, *range(11, 20)]
    flight = read("time_s,x\n" + "".join(f"{i / 10},{i}\n" for i in order))
    assert flight["table"]["time_ns"].to_pylist()[10] == 300_000_000
    assert flight.damage.out_of_order == {"table": 1}
    assert read("time_s,x\n" + "".join(f"{i / 10},{i}\n" for i in range(20))).damage.out_of_order == {}


def test_late_rows_are_counted_across_batches() -> None:
    order = [i ^ (i % 10 < 2) for i in range(400)]
    blob = ("time_s,x\n" + "".join(f"{i / 10},{i}\n" for i in order)).encode()
    assert read(blob, batch_bytes=150).damage.out_of_order == {"table": 40}


@pytest.mark.parametrize(
    ("ends", "last"),
    [
        ([f"{0.5 * i:.3f}" for i in range(20)], 9.5),  # as many decimals as all others: whole
        ([f"{0.5 * i:.3f}" for i in range(19)] + ["9.5"], None),  # may be 9.500
        ([f"{0.125 * i}" for i in range(20)], None),  # 2.375 may be 2.3751
        ([str(i % 2) for i in range(20)], 1.0),  # all of one character
        ([str(i) for i in range(20)], None),  # 19 may be 190
        ([f'"{i}"' for i in range(20)], 19.0),
        ([f"{0.5 * i:.3f}" for i in range(19)] + [""], None),
    ],
)
def test_a_last_row_without_a_line_end_is_read_as_far_as_it_is_surely_whole(
    ends: list[str], last: float | None
) -> None:
    text = "\n".join(["time_s,a,b", *(f"{0.1 * i:.2f},{i},{end}" for i, end in enumerate(ends))])
    flight = read(text.encode())
    table = flight["table"]
    assert table["a"].to_pylist() == list(range(20))
    assert table["b"].to_pylist()[-1] == last
    assert flight.damage.lossy == flight.damage.truncated == (last is None)
    with_end = read(text.encode() + b"\r")
    assert not with_end.damage.lossy
