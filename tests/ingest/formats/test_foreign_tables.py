"""Tables from other countries and programs: their times, blanks and bars are read as they were meant."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flysid
from flysid.ingest.formats.base import HEAD_BYTES
from tests.command import call

ROWS = 150
AT_50_HZ = [0.02 * k for k in range(ROWS)]
BEGIN = dt.datetime(2024, 2, 28, 23, 59, 58, 500_000, tzinfo=dt.UTC)
WHEN = [BEGIN + dt.timedelta(milliseconds=20 * k) for k in range(ROWS)]

Spell = Callable[[dt.datetime, int], str]


def rows_of(head: str, spell: Spell, sign: str = ",") -> str:
    return head + "\n" + "".join(f"{spell(at, k)}{sign}{k / 4}\n" for k, at in enumerate(WHEN))


def seconds_of(folder: Path, text: str, **words: str) -> list[float]:
    """(n,) seconds behind the first row of a table that is read without a loss."""
    (folder / "t.csv").write_text(text)
    flight = flysid.read(folder / "t.csv", **words)  # type: ignore[arg-type]
    assert not flight.damage.lossy, flight.damage
    times = flight["table"]["time_ns"].to_numpy()
    return list((times - times[0]) / 1e9)


@pytest.mark.parametrize(
    ("head", "spell"),
    [
        ("\u6642\u523b,x", lambda at, _: f"{at.year}\u5e74{at:%m}\u6708{at:%d}\u65e5 {clock(at)}"),
        ("time,x", lambda at, _: f"{at:%Y%m%d%H%M%S}{at.microsecond // 1000:03d}"),
        ("UTC,x", lambda at, _: f"{at:%H%M%S}.{at.microsecond // 1000:03d}"),
        ("ts,x", lambda at, _: str(round(at.timestamp() * 1000))),
        ("JD,x", lambda at, _: f"{2_440_587.5 + at.timestamp() / 86_400:.10f}"),
        ("GPS_TOW,x", lambda _, k: f"{345_600 + 0.02 * k:.2f}"),
        ("\u0412\u0440\u0435\u043c\u044f \u043c\u0441,x", lambda _, k: str(20 * k)),
        ("\u65f6\u95f4(\u6beb\u79d2),x", lambda _, k: str(20 * k)),
        ("Elapsed,x", lambda _, k: past_an_hour(3598.5 + 0.02 * k)),
        (",x", lambda _, k: f"0 days 00:00:{0.02 * k:09.6f}"),
    ],
)
def test_times_by_other_names_and_in_other_digits(tmp_path: Path, head: str, spell: Spell) -> None:
    """Rows counted as 1 s each without a word, or a date's digits as nanoseconds."""
    assert seconds_of(tmp_path, rows_of(head, spell)) == pytest.approx(AT_50_HZ, abs=2e-4)


def clock(at: dt.datetime) -> str:
    return f"{at:%H:%M:%S}.{at.microsecond // 1000:03d}"


def past_an_hour(seconds: float) -> str:
    """59:59.980, then 1:00:00.000."""
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    hours, minutes = divmod(minutes, 60)
    return (f"{hours}:" if hours else "") + f"{minutes:02d}:{rest / 1000:06.3f}"


@pytest.mark.parametrize("blank", ["\u00a0", "\u202f", "\u2009"])
def test_blanks_that_do_not_break_are_no_control_characters(tmp_path: Path, blank: str) -> None:
    """ "text that is no table of numbers", for every row of such a table."""
    text = rows_of("time_us;x", lambda _, k: f"{20_000 * k:,}".replace(",", blank), ";")
    assert seconds_of(tmp_path, text) == pytest.approx(AT_50_HZ)
    text = rows_of("y;time_s;x", lambda _, k: f"{1000 * k + 0.5:,.1f};{k / 50}".replace(",", blank), ";")
    assert seconds_of(tmp_path, text.replace(".", ",")) == pytest.approx(AT_50_HZ)
    values = flysid.read(tmp_path / "t.csv")["table"]["y"].to_pylist()
    assert values == [1000 * k + 0.5 for k in range(ROWS)]


def test_bars_between_columns(tmp_path: Path) -> None:
    text = rows_of("time_s|x", lambda _, k: f"{k / 50}", "|")
    assert seconds_of(tmp_path, text) == pytest.approx(AT_50_HZ)


def test_dates_in_the_digits_of_numbers_in_parquet(tmp_path: Path) -> None:
    stamps = [int(f"{at:%Y%m%d%H%M%S}{at.microsecond // 1000:03d}") for at in WHEN]
    pq.write_table(pa.table({"time": stamps, "x": range(ROWS)}), tmp_path / "t.parquet")
    times = flysid.read(tmp_path / "t.parquet")["table"]["time_ns"].to_numpy()
    assert times[0] / 1e9 == pytest.approx(BEGIN.timestamp())
    assert list((times - times[0]) / 1e9) == pytest.approx(AT_50_HZ)


def test_seconds_that_look_like_a_clock_are_named_and_may_be_told(tmp_path: Path) -> None:
    """101105.5 is taken for 10:11:05.5, as a clock read as seconds would gain 40 s a minute in silence."""
    count = HEAD_BYTES // 8
    text = "time,x\n" + "".join(f"{101_105 + k * 0.01:.2f},{k}\n" for k in range(count))
    (tmp_path / "t.csv").write_text(text)
    done = call("ingest", "t.csv", "-o", "data", cwd=tmp_path)
    assert done.returncode == 3
    assert "a time that is missing or cannot be read" in done.stderr
    assert seconds_of(tmp_path, text, time_unit="s") == pytest.approx([0.01 * k for k in range(count)])
