"""Lines that `mavlogdump --format json` prints, against the logs that they were printed from."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pymavlink
import pytest

import flysid
from flysid.flight import field_unit, stem_of
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import all_formats, detect

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs"
TOOL = Path(pymavlink.__file__).parent / "tools" / "mavlogdump.py"
LETTER_SCALES = {**dict.fromkeys("cCeE", 0.01), "L": 1e-7}  # what pymavlink applies when it prints
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/logs is not there")


def printed(log: Path, *words: str) -> bytes:
    """What the real tool prints of a log."""
    command = [sys.executable, "-W", "ignore", str(TOOL), "--format", "json", *words, str(log)]
    return subprocess.run(command, capture_output=True, check=True).stdout


def read(blob: bytes) -> flysid.Flight:
    return collect(memoryview(blob), "log.json", all_formats()["mavlogdump"], Limits())


@needs_logs
def test_every_field_of_a_telemetry_log_is_what_the_log_itself_says() -> None:
    path = LOGS / "tlog" / "sitl_copter_98s.tlog"
    blob = printed(path, "--show-source")
    assert detect(blob[:65536], "log.json").name == "mavlogdump"
    flight = read(blob)
    log = flysid.read(path)
    assert not flight.damage.lossy
    assert set(flight.streams) == set(log.streams)
    for stream, table in log.tables.items():
        other = flight.tables[stream]
        assert other.num_rows == table.num_rows
        for name in table.column_names:
            left = other[name].to_pylist()
            right = table[name].to_pylist()
            if name in (
                "time_ns",
                "recv_ns",
            ):  # arrivals are printed as seconds in a float; times lie between
                assert np.abs(np.subtract(left, right)).max() < (1_000 if name == "recv_ns" else 10_000)
            else:
                assert left == right or np.array_equal(left, right, equal_nan=True), (stream, name)
            assert other.schema.field(name).metadata == table.schema.field(name).metadata
            assert other.schema.field(name).type == table.schema.field(name).type


@needs_logs
@pytest.mark.parametrize("name", ["pymavlink_test.BIN", "copter_437s.bin"])
def test_every_field_of_a_dataflash_log_is_what_the_log_itself_says(name: str) -> None:
    path = LOGS / "dataflash" / name
    flight = read(printed(path))
    log = flysid.read(path)
    compared = 0
    printed_scale = {
        row["Name"]: {
            column: LETTER_SCALES[letter]
            for column, letter in zip(row["Columns"].split(","), row["Format"], strict=False)
            if letter in LETTER_SCALES
        }
        for row in flight["FMT"].to_pylist()
    }
    for stream, table in log.tables.items():
        kind = stem_of(stream)
        if stream not in flight.streams or flight.tables[stream].num_rows != table.num_rows:
            continue  # the log's own reader keeps two formats of one message apart
        other = flight.tables[stream]
        for column in set(table.column_names) & set(other.column_names) - {"time_ns", "boot"}:
            left = other[column].to_pylist()
            right = table[column].to_pylist()
            if isinstance(right[0], (int, float)):
                expected = np.array(right, dtype=float) * printed_scale[kind].get(column, 1.0)
                assert np.allclose(np.array(left, dtype=float), expected, rtol=1e-6, equal_nan=True)
                compared += len(left)
        if "TimeUS" in table.column_names:
            assert other["time_ns"].to_pylist() == [1000 * us for us in table["TimeUS"].to_pylist()]
    assert compared > 5_000


def test_units_and_times_are_those_of_telemetry() -> None:
    from tests.samplelogs import mavlogdump as sample

    table = read(sample.build())["ATTITUDE"]
    assert table["time_ns"].to_pylist()[:2] == [5_000_000_000, 5_200_000_000]
    assert field_unit(table.schema.field("roll")) == "rad"


def test_what_does_not_fit_its_message_is_counted() -> None:
    from tests.samplelogs import mavlogdump as sample

    lines = sample.build().splitlines(keepends=True)
    lines[4] = lines[4].replace(b'"yaw": 1.5', b'"yaw": "x"')
    lines[5] = lines[5].replace(b'"pitch"', b'"pytch"')
    lines[6] = b'{"meta": {"type": "BAD_DATA", "timestamp": 1.0}, "data": {"reason": "x", "data": [1]}}\n'
    lines[7] = b"lost 3 messages\n"
    flight = read(b"".join(lines))
    assert flight.rows == len(lines) - 2
    assert flight.damage.undecoded == {"1.1/ATTITUDE.yaw": 1, "1.1/ATTITUDE.pytch": 1, "BAD_DATA": 1}
    assert flight.damage.bytes_skipped == len(lines[7])


def test_a_last_line_without_its_end_is_whole_where_its_brackets_are_closed() -> None:
    from tests.samplelogs import mavlogdump as sample

    blob = sample.build()
    whole = read(blob)
    without = read(blob[:-1])
    cut = read(blob[:-2])
    assert (without.rows, cut.rows) == (whole.rows, whole.rows - 1)
    assert not without.damage.lossy
    assert cut.damage.truncated
