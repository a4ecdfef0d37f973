"""Settings of a blackbox header as every verb reads them."""

from __future__ import annotations

from pathlib import Path

import pytest

import flysid
from flysid.errors import DataError
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.headers import header_of, needed_numbers, stated_number, stated_numbers
from flysid.loops.blackbox_loops import settings_of
from flysid.reviews.logged import LoggedFlight
from tests.flysid.spectra.gyro_logs import BETAFLIGHT, blackbox

ODD = ("abc", "46,", "nan", "inf", "1e400", "1/0x", "--1")


@pytest.mark.parametrize("text", ODD)
def test_a_text_that_is_no_number_is_refused_by_name(text: str) -> None:
    with pytest.raises(DataError, match=f"states looptime as '{text}', not as a number"):
        stated_number({"looptime": text}, "looptime", otherwise=1.0)


def test_what_is_missing_has_another_value_or_is_named() -> None:
    settings = {"new": "", "old": "46,45/25"}
    assert stated_numbers(settings, "new", "old") == (46.0, 45.0, 25.0)
    assert stated_numbers(settings, "new") == ()
    assert stated_number(settings, "new", otherwise=7.0) == 7.0
    with pytest.raises(DataError, match="does not state new"):
        needed_numbers(settings, "new")
    with pytest.raises(DataError, match="states old as '46,45/25', not as 4 numbers"):
        needed_numbers(settings, "old", least=4)


def test_the_first_statement_of_a_setting_counts_everywhere(tmp_path: Path) -> None:
    path = tmp_path / "twice.bbl"
    sound = blackbox(BETAFLIGHT, {"gyroADC[0]": [0] * 50}, [1_000_000 + 1000 * k for k in range(50)])
    path.write_bytes(sound.replace(b"H looptime:125\n", b"H looptime:125\nH looptime:250\n"))
    log = FlightLog(flysid.read(path))
    flight = LoggedFlight(log)
    assert header_of(log)["looptime"] == settings_of(log)["looptime"] == flight.headers["looptime"] == "125"
    assert flight.parameters["looptime"] == 125.0


def test_other_logs_have_no_header() -> None:
    log = FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog"))
    assert header_of(log) == {}
    with pytest.raises(DataError, match="records no rate loop"):
        settings_of(log)
