"""What objects say of themselves at a Python prompt and in a notebook; their plots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.errors import UsageError
from flysid.flight import Flight, Source
from flysid.ingest.lake.lake import Lake
from flysid.manifest import Manifest, StreamEntry
from flysid.model.plots import bode
from flysid.showing import MOST_LINES, Table, as_html, as_text, clock, duration, rough_duration, significant
from tests.ingest.align.test_align import T50, table
from tests.validate.show.page.test_first_screen import facts

N = 600


@pytest.fixture(scope="module")
def data() -> flysid.Dataset:
    rng = np.random.default_rng(3)
    u = [np.repeat(rng.normal(size=N // 20), 20) for _ in range(30)]
    y = []
    for own in u:
        out = np.zeros(N)
        for k in range(1, N):
            out[k] = 0.9 * out[k - 1] + 0.2 * own[k - 1]
        y.append(out + 0.01 * rng.normal(size=N))
    return flysid.Dataset.from_arrays(u, y, 0.1, inputs=["roll_in"], outputs=["roll"], name="roll")


@pytest.fixture(scope="module")
def model(data: flysid.Dataset) -> flysid.ARX:
    return flysid.ARX(na=1, nb=1, nk=1).fit(data)  # type: ignore[return-value]


def both(thing: object) -> str:
    """The text, after what holds of every text and of its HTML."""
    text = repr(thing)
    assert len(text.splitlines()) <= MOST_LINES
    page = thing._repr_html_()  # type: ignore[attr-defined]
    assert "<table>" in page
    return text


def test_numbers_have_no_exponent_where_they_are_short() -> None:
    assert [significant(v) for v in (0.0, 1.0, 1048.0, 999_960.0, 0.00034, -23.04, 2.5e7, 3.3e-5)] == [
        "0", "1", "1050", "1e+06", "0.00034", "-23", "2.5e+07", "3.3e-05",
    ]  # fmt: skip
    assert significant(283.0, 2) == "280"
    assert significant(float("inf")) == "inf"


def test_a_clock_carries_what_it_rounds() -> None:
    times = (0.0, 59.4, 59.7, 68.0, 119.6, 3599.6, 3725.0, -1.0)
    assert [clock(t) for t in times] == ["0:00", "0:59", "1:00", "1:08", "2:00", "1:00:00", "1:02:05", "0:00"]
    assert [clock(t, padded=True) for t in (68.0, 600.0, 3725.0)] == ["01:08", "10:00", "1:02:05"]


def test_a_duration_is_exact_or_rough() -> None:
    times = (40.2, 99.6, 180.0, 200.0, 7500.0)
    assert [duration(t) for t in times] == ["40 s", "1 min 40 s", "3 min", "3 min 20 s", "2 h 5 min"]
    assert [rough_duration(t) for t in times] == ["40.2 s", "99.6 s", "3 min", "3 min", "2.1 h"]


def test_a_table_fits_and_counts_what_is_left_out() -> None:
    rows = [(f"<{i}>", "x" * 99) for i in range(1000)]
    lines = as_text(Table("many\nof them", ("a", "b"), rows)).splitlines()
    assert lines[0] == "many of them"
    assert len(lines) == MOST_LINES
    assert lines[-1] == "... and 983 more"
    assert max(map(len, lines)) < 60
    assert "&lt;0&gt;" in as_html(Table("t", ("a", "b"), rows))
    assert len(as_text(Table("t", ("a", "b"), rows[:18])).splitlines()) == MOST_LINES
    assert as_text(Table("nothing", ("a",), [])) == "nothing"


def test_a_folder_of_two_thousand_flights_says_it_in_twenty_lines() -> None:
    lake = Lake(Path("data"), tuple(facts(i, vehicle="copter") for i in range(2000)))
    text = both(lake)
    assert text.startswith("data: 2,000 flights, 3,000 min\n")
    assert "copter" in text
    assert text.endswith("... and 1,983 more")


def test_a_flight_names_its_longest_streams() -> None:
    flight = Flight(
        Source("f.tlog", "tlog", 1, "0" * 64), {"A": table(T50[:5], x=T50[:5]), "B": table(T50, x=T50)}
    )
    lines = both(flight).splitlines()
    assert lines[0].startswith("f.tlog: tlog, ")
    assert lines[2].split()[0] == "B"


def test_an_ingested_flight_names_its_longest_streams_too() -> None:
    streams = tuple(
        StreamEntry(f"s{i}", f"s{i}.parquet", rows=i, columns=(), rate_hz=i / 2.0) for i in range(30)
    )
    lines = both(Manifest("f-1", Source("f.tlog", "tlog", 1, "0" * 64), streams)).splitlines()
    assert lines[0] == "f-1: tlog, 435 records in 30 streams, 0.0 s"
    assert lines[2].split() == ["s29", "29", "14.5"]
    assert lines[-1] == "... and 13 more"


def test_a_dataset_names_its_signals_and_flights(data: flysid.Dataset) -> None:
    text = both(data)
    assert text.startswith("roll: roll_in -> roll; 30 segments, 18,000 samples, 10 Hz\n")
    assert "segment-0" in text


def test_models_and_comparisons_are_short(data: flysid.Dataset, model: flysid.ARX) -> None:
    assert "ARX model" in both(model)
    static = flysid.StaticTS().fit(data)
    assert both(static)
    comparison = flysid.compare([model, static], data)  # type: ignore[list-item]
    assert "arx" in both(comparison)


def test_responses_are_those_of_the_plant(model: flysid.ARX) -> None:
    frequency_hz, (response,) = bode(model)  # type: ignore[arg-type]
    z = np.exp(2j * np.pi * frequency_hz * 0.1)
    assert np.abs(response - 0.2 / (z - 0.9)) == pytest.approx(0.0, abs=0.05)


def test_plots_are_axes(data: flysid.Dataset, model: flysid.ARX) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    step = model.plot_step()  # type: ignore[attr-defined]
    assert step.lines[0].get_ydata()[-1] == pytest.approx(2.0, rel=0.02)
    magnitude, phase = model.plot_bode()  # type: ignore[attr-defined]
    assert magnitude.lines[0].get_ydata()[0] == pytest.approx(20 * np.log10(2.0), abs=0.5)
    assert phase.get_xlabel() == "frequency, Hz"
    comparison = flysid.compare([model, replace(model)], data)  # type: ignore[list-item]
    axes = comparison.plot()
    assert [line.get_label() for line in axes.lines] == ["ARX, free run", "ARX-2, free run", "measured"]
    with pytest.raises(UsageError, match="no output 'yaw'"):
        comparison.plot("yaw")
    matplotlib.pyplot.close("all")
