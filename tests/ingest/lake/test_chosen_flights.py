"""Which flights are meant, and whose they are."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import UsageError
from flysid.facts.vehicle import vehicle_of
from flysid.flight import Source
from flysid.ingest.formats.base import Parts, StreamPart, Summary
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.chosen_flights import (
    Selection,
    of_one_vehicle,
    require_one_vehicle,
    select,
    vehicles,
)
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.stretches import Stretches
from flysid.store import create_data_folder, write_flight
from tests.ingest.lake.test_lake import attitudes

SERIALS = ("0006000000003736323032335111002f0022", "0006000000003535323734325116003d0021")


def parts(seed: int, info: dict[str, str]) -> Parts:
    yield from attitudes(seed)
    return Summary(info=info)


def folder_of(tmp_path: Path, infos: list[dict[str, str]]) -> Path:
    data = create_data_folder(tmp_path / "data")
    for i, info in enumerate(infos):
        write_flight(data, Source(f"flight{i}.tlog", "tlog", 1, f"{i}" * 64), parts(i, info))
    return data


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Two flights of one vehicle, one of another, one that does not say."""
    return folder_of(
        tmp_path,
        [{"autopilot": "px4", "sys_uuid": SERIALS[i]} for i in (0, 0, 1)] + [{}],
    )


@pytest.mark.parametrize(
    ("info", "name"),
    [
        ({"autopilot": "ardupilotmega", "vehicle": "quadrotor"}, "ardupilot copter"),
        ({"autopilot": "ardupilot", "vehicle": "copter"}, "ardupilot copter"),
        ({"autopilot": "ardupilotmega", "vehicle": "fixed_wing"}, "ardupilot plane"),
        ({"autopilot": "px4", "sys_uuid": "ab"}, "px4 ab"),
        ({"autopilot": "px4", "vehicle": "quadrotor", "uid2": "ab"}, "px4 ab"),
        ({"autopilot": "ardupilotmega", "vehicle": "quadrotor", "uid2": "ab"}, "ardupilot copter"),
        ({}, ""),
    ],
)
def test_one_vehicle_has_one_name_in_every_kind_of_log(info: dict[str, str], name: str) -> None:
    assert vehicle_of(info) == name


def numbers(lake: Lake) -> list[int]:
    return [int(facts.id.removeprefix("flight")[0]) for facts in lake.facts]


def test_a_part_that_is_left_out_is_kept_by_the_whole_id_of_its_flight(mixed: Path) -> None:
    lake = select(flysid.open(mixed), Selection(stretches=Stretches(without=("flight2@0:01..0:02",))))
    [part] = lake.stretches.without
    assert part == f"{lake.find('flight2')}@0:01..0:02"
    assert Selection(stretches=lake.stretches).options == [f"--exclude {part}"]
    with pytest.raises(UsageError):
        select(lake, Selection(stretches=Stretches(without=("nobody@0:01..0:02",))))


def test_flights_are_chosen_and_left_out(mixed: Path) -> None:
    lake = flysid.open(mixed)
    assert [f.id[:7] for f in select(lake, Selection(("flight2", "flight0"))).facts] == ["flight0", "flight2"]
    assert [f.id[:7] for f in select(lake, Selection(exclude=("flight1",))).facts] == [
        "flight0",
        "flight2",
        "flight3",
    ]
    assert len(select(lake, Selection(vehicle="2f0022"))) == 2
    assert {name: len(ids) for name, ids in vehicles(lake).items()} == {
        f"px4 {SERIALS[0]}": 2,
        f"px4 {SERIALS[1]}": 1,
        "": 1,
    }


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        (Selection(("flight9",)), "no flight 'flight9'"),
        (Selection(("flight",)), "names 4 flights"),
        (Selection(("flight0",), ("flight0",)), "no flight matches"),
        (Selection(vehicle="px4"), "'px4' names 2 vehicles"),
        (Selection(vehicle="heli"), "no vehicle 'heli'"),
    ],
)
def test_what_names_nothing_or_too_much_is_refused(mixed: Path, selection: Selection, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        select(flysid.open(mixed), selection)


def test_several_vehicles_are_not_one(mixed: Path) -> None:
    lake = flysid.open(mixed)
    with pytest.raises(UsageError, match="flights of 2 vehicles") as caught:
        require_one_vehicle(lake)
    named = str(caught.value.hint).split("'")[1]
    require_one_vehicle(select(lake, Selection(vehicle=named)))
    require_one_vehicle(select(lake, Selection(("flight0", "flight1", "flight3"))))


def test_a_transfer_function_is_of_one_vehicle_unless_asked(mixed: Path) -> None:
    def tf(*arguments: str) -> object:
        words = ["tf", str(mixed), "-r", "ardupilot-attitude", "-c", "roll", "-q"]
        words += ["--poles", "1", "--zeros", "0", "--dead-time", "0"]
        done = CliRunner().invoke(root, [*words, *arguments])
        return done.exception or done.stdout

    assert "flights of 2 vehicles" in str(tf())
    assert "3 flights" not in str(tf("--vehicle", SERIALS[0]))
    assert "2 flights" in str(tf("--vehicle", SERIALS[0]))
    assert "4 flights" in str(tf("--pool"))


def stated_folder(tmp_path: Path, settings: list[dict[str, float]]) -> Path:
    """Flights of boards without a serial number, and the parameters that they state."""
    data = create_data_folder(tmp_path / "stated")
    for i, own in enumerate(settings):
        write_flight(data, Source(f"flight{i}.tlog", "tlog", 1, f"{i}" * 64), stating(i, own))
    return data


def stating(seed: int, values: dict[str, float]) -> Parts:
    yield from attitudes(seed)
    table = pa.table(
        {
            "time_ns": pa.array(range(len(values)), pa.int64()),
            "boot": pa.array([0] * len(values), pa.int32()),
            "param_id": pa.array(list(values), pa.string()),
            "param_value": pa.array(list(values.values()), pa.float64()),
        }
    )
    yield StreamPart("1.1/PARAM_VALUE", table)
    return Summary(info={"autopilot": "ardupilotmega", "vehicle": "quadrotor"})


@pytest.mark.parametrize("fact", ["FRAME_CLASS", "SYSID_THISMAV"])
def test_vehicles_without_serial_numbers_are_told_apart_by_their_frame(tmp_path: Path, fact: str) -> None:
    """Three airframes of one autopilot were pooled without a word."""
    data = stated_folder(tmp_path, [{fact: 1.0, "ATC_RAT_RLL_P": 0.1}, {fact: 1.0}, {fact: 2.0}, {}])
    lake = flysid.open(data)
    with pytest.raises(UsageError, match=f"flights of 2 vehicles, by {fact}: 1: 2 flights; 2: 1 flight"):
        require_one_vehicle(lake)
    require_one_vehicle(select(lake, Selection(exclude=("flight2",))))


def test_a_quadrotor_and_a_hexarotor_are_two(tmp_path: Path) -> None:
    kinds = ("quadrotor", "hexarotor", "copter")
    data = folder_of(tmp_path, [{"autopilot": "ardupilotmega", "vehicle": kind} for kind in kinds])
    with pytest.raises(UsageError, match="flights of 2 vehicles, by kind: quadrotor"):
        require_one_vehicle(flysid.open(data))
    require_one_vehicle(select(flysid.open(data), Selection(exclude=("flight1",))))


def test_flights_without_the_streams_of_a_recipe_are_of_no_other_vehicle(tmp_path: Path) -> None:
    for kind in ("dataflash", "ulog"):
        words = (
            f"synth -o {tmp_path / kind} --plant ardrone --plan steps --duration 20 --no-truth -q --format"
        )
        made = CliRunner().invoke(root, [*words.split(), kind])
        assert made.exit_code == 0, made.output
    logs = find_logs([tmp_path / "dataflash", tmp_path / "ulog"])
    list(ingest_logs(logs, tmp_path / "data", bounds=None))
    lake = open_lake(tmp_path / "data")
    with pytest.raises(UsageError, match="flights of 2 vehicles"):
        of_one_vehicle(lake, "")
    (kept,) = of_one_vehicle(lake, "px4-velocity").facts
    assert kept.format == "ulog"
