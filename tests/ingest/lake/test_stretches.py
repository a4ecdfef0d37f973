"""Stretches of flights: times as people write them, flight modes, and what went wrong left out."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from flysid.errors import UsageError
from flysid.flight import BOOT, TIME, Flight, Source
from flysid.ingest.align.conditions import ALWAYS
from flysid.ingest.align.resample import FOREVER
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.failures import Mishap
from flysid.ingest.lake.mishaps import mishaps
from flysid.ingest.lake.stretches import Part, Stretches, held_spans, parse_between, parse_part

S = 10**9
START = 100 * S
INFO = {"autopilot": "ardupilot", "vehicle": "copter"}


def stream(times_s: list[float], **columns: object) -> pa.Table:
    times = [START + round(t * S) for t in times_s]
    return pa.table(
        {TIME: pa.array(times, pa.int64()), BOOT: pa.array([0] * len(times), pa.int32()), **columns}
    )


def log(**streams: pa.Table) -> FlightLog:
    ticks = np.arange(0.0, 60.0, 0.1).tolist()
    return FlightLog(
        Flight(Source("f", "dataflash", 1, "0" * 64), {"IMU": stream(ticks, x=ticks), **streams}, info=INFO)
    )


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("12:30..14:00", (750.0, 840.0)),
        ("1:00:00..", (3600.0, float("inf"))),
        ("..90.5", (0.0, 90.5)),
        ("", (0.0, float("inf"))),
    ],
)
def test_times_are_read_as_people_write_them(text: str, seconds: tuple[float, float]) -> None:
    assert parse_between(text) == seconds


@pytest.mark.parametrize("text", ["12:30", "14:00..12:30", "noon..2", "1..1", "-3..4"])
def test_what_is_no_pair_of_times_is_refused_at_once(text: str) -> None:
    with pytest.raises(UsageError, match="not two times"):
        Stretches(between=text)


def test_between_counts_from_the_beginning_of_the_flight() -> None:
    found = Stretches(between="0:10..0:20").allowed(log())
    assert found.spans == {0: [(START + 10 * S, START + 20 * S)]}
    assert found.notes == ("only 0:10..0:20 of the flight, as asked",)
    beyond = Stretches(between="20:00..21:00").allowed(log())
    assert beyond.never == ("20:00..21:00 never holds: the log ends after 60 s",)


def test_a_part_of_one_flight_is_left_out_of_that_flight_alone() -> None:
    found = Stretches(without=("f@0:10..0:20", "f@0:50..")).allowed(log())
    assert found.spans == {0: [(ALWAYS, START + 10 * S), (START + 20 * S, START + 50 * S)]}
    assert "0:10..0:20" in found.notes[0]
    assert Stretches(without=("other@0:10..0:20",)).allowed(log()).spans == {}
    with pytest.raises(UsageError, match="no such boot"):
        Stretches(without=("f#1@0:10..0:20",)).allowed(log())


def test_what_is_held_out_is_named_by_flight_and_time() -> None:
    assert held_spans([log()], ["f@0:10..0:20", "f@0:50.."])["f"] == [
        (START + 10 * S, START + 20 * S),
        (START + 50 * S, FOREVER),
    ]
    assert held_spans([log()], ["f"])["f"] == [(ALWAYS, FOREVER)]
    for absent in ("g", "f#1"):
        with pytest.raises(UsageError, match="not among the chosen"):
            held_spans([log()], [absent])


@pytest.mark.parametrize("text", ["0042", "0042#1", "0042@12:30..14:00", "0042#1@..5"])
def test_parts_of_flights_are_read_and_written(text: str) -> None:
    assert str(parse_part(text)) == text
    assert parse_part("0042#1@..5") == Part("0042", 1, "..5")


@pytest.mark.parametrize("text", ["", "@1..2", "0042@", "0042#@1..2", "0042#x", "0042@2..1", "0042@noon.."])
def test_what_names_no_part_is_refused_at_once(text: str) -> None:
    with pytest.raises(UsageError):
        Stretches(without=(text,))


def test_a_mode_lasts_until_the_next_and_one_never_flown_is_named() -> None:
    modes = log(MODE=stream([0.0, 20.0, 40.0], ModeNum=[0, 5, 0]))
    assert Stretches(modes=("loiter",)).allowed(modes).spans == {0: [(START + 20 * S, START + 40 * S)]}
    never = Stretches(modes=("ACRO",)).allowed(modes)
    assert never.spans == {0: []}
    assert never.never == ("mode ACRO never holds: the modes of the log are STABILIZE, LOITER",)


def test_a_failsafe_is_left_out_until_it_ends_and_a_crash_for_good() -> None:
    found = mishaps(log(ERR=stream([10.0, 15.0, 30.0, 31.0], Subsys=[5, 5, 12, 12], ECode=[1, 0, 1, 0])))
    assert found == [
        Mishap(0, (START + 10 * S, START + 15 * S), "radio failsafe"),
        Mishap(0, (START + 30 * S, FOREVER), "crash", ends=True),
    ]


@pytest.mark.parametrize(
    ("message", "column", "values", "what"),
    [
        ("vehicle_status", "failsafe", [0, 1, 0], "failsafe"),
        ("vehicle_status", "failure_detector_status", [3, 128, 0], "motor failure"),
        ("HEARTBEAT", "system_status", [4, 5, 4], "failsafe (CRITICAL)"),
    ],
)
def test_states_count_for_as_long_as_they_are_said(
    message: str, column: str, values: list[int], what: str
) -> None:
    found = mishaps(log(**{message: stream([0.0, 10.0, 20.0], **{column: values})}))
    assert found == [Mishap(0, (START + 10 * S, START + 20 * S), what)]


def attitude(error_deg: float, seconds: float) -> pa.Table:
    """Roll follows its setpoint across the turn at 180 degrees, but for some seconds from the 30th on."""
    times = np.arange(0.0, 60.0, 0.1)
    asked = np.full(len(times), 179.0)
    roll = np.where((times >= 30.0) & (times < 30.0 + seconds), asked + error_deg, -179.0)
    zero = np.zeros(len(times))
    return stream(times.tolist(), DesRoll=asked, Roll=roll, DesPitch=zero, Pitch=zero)


def test_attitude_far_from_its_setpoint_for_two_seconds_is_a_crash() -> None:
    found = mishaps(log(ATT=attitude(50.0, 3.0)))
    assert [m.span[1] for m in found] == [FOREVER]
    assert found[0].span[0] == pytest.approx(START + 30 * S, abs=S // 5)
    assert "roll more than 30 deg from its setpoint for 2 s" in found[0].what
    assert mishaps(log(ATT=attitude(50.0, 1.5))) == []
    assert mishaps(log(ATT=attitude(25.0, 9.0))) == []


@pytest.mark.parametrize(("at_s", "words"), [(59.6, "1:00"), (3599.8, "1:00:00"), (4210.0, "1:10:10")])
def test_the_second_that_a_crash_is_left_out_from_is_one_that_between_reads(at_s: float, words: str) -> None:
    (note,) = Stretches().allowed(log(ERR=stream([at_s], Subsys=[12], ECode=[1]))).notes
    assert note.startswith(f"left out from {words} to the end")


def test_what_is_left_out_is_said_and_may_be_kept() -> None:
    crashed = log(ERR=stream([29.7], Subsys=[12], ECode=[1]))
    found = Stretches().allowed(crashed)
    assert found.notes == ("left out from 0:30 to the end: crash (--keep-mishaps keeps it)",)
    assert found.spans[0][0][1] == START + 297 * S // 10
    assert len(found.spans[0]) == 1
    assert Stretches(mishaps=True).allowed(crashed).spans == {}
