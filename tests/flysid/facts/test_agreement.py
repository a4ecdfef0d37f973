"""Every verb tells the same of one log: losses, time in the air, modes, vehicle, clock."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import flysid
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.timeline import lay_out, read_fields
from flysid.showing import clock
from flysid.studio.flights import Flights
from flysid.studio.folders import Workspace
from tests import private_logs
from tests.command import call

LOGS = Path(__file__).parents[3] / ".." / "shared" / "logs"
OWN = {
    name: getattr(private_logs, name)
    for name in (
        "telemetry",
        "binary",
        "text",
        "px4",
        "ros_bag",
        "ros2_bag",
        "robot",
        "ardrone",
        "betaflight",
    )
}
REAL = (
    "tlog/sitl_copter_500s.tlog",
    "tlog/sitl_mavlink_flood.tlog",
    "tlog/sitl_vtol_v1.tlog",
    "tlog/sitl_x27_two_boots_stray_bytes.tlog",
    "dataflash/copter_437s.bin",
    "dataflash/sitl_copter_49s.BIN",
    "ulog/pyulog_sample.ulg",
    "ulog/quad_position_76s.ulg",
    "blackbox/error_recovery.bbl",
    "navdata/packet_a.bin",
)
ROW = re.compile(r"^(\w+)\s{2,}(.+)$")


class Told:
    """What the verbs say of one log."""

    def __init__(self, log: Path, folder: Path) -> None:
        self.folder = folder
        self.log = log
        call("ingest", log, "-o", folder / "data", "-q", cwd=folder)
        self.doctor = json.loads(call("doctor", log, "--json", cwd=folder).stdout)["logs"][0]
        self.ls = json.loads(call("ls", folder / "data", "--json", cwd=folder).stdout)["flights"][0]
        self.table = call("ls", folder / "data", cwd=folder).stdout.splitlines()[-1].split()
        shown = call("show", log, cwd=folder).stdout.partition("\n\n")[0]
        rows = [match.groups() for line in shown.splitlines() if (match := ROW.match(line))]
        self.show: dict[str, list[str]] = {}
        for name, text in rows:
            self.show.setdefault(name, []).append(text)
        self.flights = Flights(Workspace(folder / "data"), folder / "cache")
        self.studio: dict[str, Any] = self.flights.describe(self.ls["id"])
        self.python = flysid.read(log)


@pytest.fixture(params=[*OWN, *REAL], scope="module")
def told(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Told:
    folder = tmp_path_factory.mktemp("facts")
    if request.param in OWN:
        own = OWN[request.param]()
        log = folder / f"log{own.suffix}"
        log.write_bytes(own.blob)
    else:
        log = LOGS / request.param
        if not log.is_file():
            pytest.skip("needs ../shared/logs")
    return Told(log, folder)


def test_losses(told: Told) -> None:
    words = told.doctor["losses"]
    assert told.ls["losses"] == words
    assert told.studio["losses"] == words
    assert ("yes" in told.table) == bool(words) == ("lost" in told.show)
    link = sum(told.python.damage.sequence_gaps.values())
    assert (f"{link:,} on the link" in words) == bool(link)
    stated = [int(n.replace(",", "")) for n in re.findall(r"([\d,]+) messages? of \S+ never", str(told.show))]
    assert sum(stated) == link


def test_copies(told: Told) -> None:
    copies = sum(told.python.damage.repeats.values())
    assert sum(told.doctor["damage"]["repeats"].values()) == copies
    assert bool(copies) == ("repeats" in told.show)


def test_time_in_the_air(told: Told) -> None:
    seconds = told.doctor["flown_s"]
    [shown] = told.show["flown"]
    assert shown == (
        "unknown: the log states neither arming nor landing"
        if seconds is None
        else clock(seconds, padded=True)
    )
    assert seconds is None or 0.0 <= seconds <= told.doctor["duration_s"] + 1e-6


def test_modes(told: Told) -> None:
    events = call("show", told.log, "--events", cwd=told.folder).stdout.splitlines()
    listed = [line.split(maxsplit=3)[3] for line in events if line.split()[2:3] == ["mode"]]
    shown = told.show.get("modes", [""])[0]
    assert [part.rpartition(" ")[0] for part in shown.split(", ") if part] == list(dict.fromkeys(listed))
    assert {name for _, _, name in told.studio["modes"]} <= set(listed)


def test_vehicle_and_length(told: Told) -> None:
    assert told.ls["info"] == told.doctor["info"] == told.studio["info"] == dict(told.python.info)
    assert told.ls["duration_s"] == pytest.approx(told.doctor["duration_s"])
    assert told.studio["duration_s"] == pytest.approx(told.doctor["duration_s"])
    assert told.show["duration"][0].startswith(clock(told.doctor["duration_s"], padded=True))


def test_one_axis_of_time(told: Told) -> None:
    [log] = open_lake(told.folder / "data").logs
    streams = [s for s in told.studio["streams"] if s["rows"] > 20 and s["fields"]]
    if not streams:
        pytest.skip("too short to be drawn")
    stream, field = streams[0]["stream"], streams[0]["fields"][0][0]
    drawn = lay_out(log, read_fields(log, [f"{stream}.{field}"]))
    target = told.folder / "one.csv"
    done = call("export", told.log, stream, "-o", target, "--force", cwd=told.folder)
    exported = [float(row.split(",")[0]) for row in target.read_text().splitlines()[1:]]
    assert min(exported) == pytest.approx(float(drawn.panels[0][0].time_s[0]), abs=1e-6)
    [words] = told.show["times"]
    assert words == drawn.clock
    assert f"time_s: {words}" in done.stderr
    begin_ns = int(told.studio["clocks"][0][1])
    assert words.startswith("seconds since the log began")
    assert f"{begin_ns * 1e-9:.3f} s" in words


@pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")
def test_the_time_flown_of_a_log_whose_parameters_are_older_than_it(tmp_path: Path) -> None:
    told = Told(LOGS / "dataflash/copter_437s.bin", tmp_path)
    assert told.doctor["flown_s"] == pytest.approx(50.9, abs=0.05)
    assert told.show["modes"] == ["RTL 01:48"]
